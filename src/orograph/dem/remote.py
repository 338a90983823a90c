"""Settings that let GDAL read rasters in buckets and on web servers efficiently.

GDAL sends few requests, retries when a server is busy, and finds buckets as the reader of stores does. It reads a
raster's ranges by ``/vsis3/``, ``/vsigs/``, ``/vsiaz/`` and ``/vsicurl/``, neighbours together. No folder is listed:
possible companion files are requested by name. GDAL's settings in the environment, or in an enclosing rasterio ``Env``,
take precedence.
"""

from __future__ import annotations

import os
import re
from typing import Any
from urllib.parse import urlsplit

from rasterio.env import getenv, hasenv

SILENCE = 30
"""Seconds without a byte after which a server counts as not answering."""

_ALWAYS = {
    "GDAL_HTTP_MAX_RETRY": 6, "GDAL_HTTP_RETRY_DELAY": 0.25, "GDAL_HTTP_RETRY_CODES": "408,425,429,500,502,503,504",
    "GDAL_HTTP_CONNECTTIMEOUT": SILENCE, "GDAL_HTTP_LOW_SPEED_TIME": SILENCE, "GDAL_HTTP_LOW_SPEED_LIMIT": 1,
}  # fmt: skip
_FAR = {"GDAL_DISABLE_READDIR_ON_OPEN": "TRUE", "GDAL_INGESTED_BYTES_AT_OPEN": 32768}

_BESIDE = ("", ".aux.xml", ".msk")
"""Endings of companion files of a GeoTIFF that affect its samples."""

_NAMES = {
    "AZURE_STORAGE_ACCOUNT": ("AZURE_STORAGE_ACCOUNT_NAME",),
    "AZURE_STORAGE_ACCESS_KEY": ("AZURE_STORAGE_ACCOUNT_KEY",),
    "AZURE_STORAGE_SAS_TOKEN": ("AZURE_STORAGE_SAS_KEY",),
    "AWS_NO_SIGN_REQUEST": ("AWS_SKIP_SIGNATURE",),
}
"""GDAL's names of settings that the clouds' own tools name differently."""


def is_remote(location: str) -> bool:
    """Whether GDAL fetches it over a network."""
    return "://" in location or location.startswith(("/vsicurl", "/vsis3", "/vsigs", "/vsiaz", "/vsiadls"))


def network(location: str) -> dict[str, Any]:
    """GDAL's settings for a raster that may be, or refer to, a remote one."""
    found = {**_ALWAYS, **(_FAR if is_remote(location) else {}), **_endpoint()}
    if is_remote(location) and (end := re.search(r"\.tiff?$", location, re.IGNORECASE)):
        # Otherwise GDAL requests about forty other names one by one: of sensors, overviews, GCPs.
        found["CPL_VSIL_CURL_ALLOWED_EXTENSIONS"] = ",".join(f"{end[0]}{more}" for more in _BESIDE) + ",.tfw,.wld"
    for name, others in _NAMES.items():
        value = next((os.environ[other] for other in others if other in os.environ), None)
        if value is not None:
            found[name] = value
    around = getenv() if hasenv() else {}  # readers of a product's tiles have excluded companions
    return {name: value for name, value in found.items() if name not in os.environ and name not in around}


def _endpoint() -> dict[str, Any]:
    """The address of S3, if it is not Amazon's."""
    address = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    if "://" not in address:
        return {}
    cut = urlsplit(address)
    return {
        "AWS_S3_ENDPOINT": f"{cut.netloc}{cut.path}".rstrip("/"), "AWS_HTTPS": "NO" if cut.scheme == "http" else "YES",
        "AWS_VIRTUAL_HOSTING": "FALSE",
    }  # fmt: skip
