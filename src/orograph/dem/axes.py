"""Projected CRSs whose coordinates increase westwards or southwards, and their eastward and northward twins.

South Africa and Namibia use westings and southings (EPSG:2046–2055), Krovak's projection of Bohemia southings and
westings (EPSG:5513). A raster's coordinates are then those numbers, in that order (GDAL's and PROJ's traditional GIS
order swaps only northing, easting). Views, light and azimuths need east and north, so a terrain is placed in the twin:
coordinates are negated or exchanged exactly, and no sample moves. The twin of Transverse Mercator (South Orientated),
EPSG method 9808, is Transverse Mercator (9807) with negative false origins; that of Krovak (9819) is Krovak (North
Orientated), 1041 (EPSG Guidance Note 7-2, §3.2.3 and §3.4.2). Units: those of the CRS.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

_EAST = {"east": 1, "west": -1}
_NORTH = {"north": 1, "south": -1}
_SOUTH_ORIENTATED, _KROVAK = "Transverse Mercator (South Orientated)", "Krovak"


@lru_cache(maxsize=64)
def east_north(crs: CRS) -> tuple[CRS, Affine]:
    """The CRS whose coordinates increase eastwards and northwards, and the map from ``crs``'s coordinates (x, y) to it.

    It is ``crs`` itself with the identity if its axes already do so, point along meridians (polar projections), or have
    no known twin.
    """
    same = (crs, Affine.identity())
    axes = [axis.direction.lower() for axis in crs.axis_info]
    if not crs.is_projected or len(axes) != 2 or sorted(axes) == ["east", "north"]:
        return same
    if axes[0] in _EAST and axes[1] in _NORTH:
        turn = Affine(_EAST[axes[0]], 0, 0, 0, _NORTH[axes[1]], 0)
    elif axes[0] in _NORTH and axes[1] in _EAST:
        turn = Affine(0, _EAST[axes[1]], 0, _NORTH[axes[0]], 0, 0)
    else:
        return same
    twin = _twin(crs)
    if twin is None or not _agree(crs, twin, turn):
        return same
    code = twin.to_epsg(min_confidence=70)
    coded = twin if code is None else CRS.from_epsg(code)  # EPSG:5514 is the twin of EPSG:5513
    return (coded if _agree(crs, coded, turn) else twin), turn


def _twin(crs: CRS) -> CRS | None:
    said: dict[str, Any] = crs.to_json_dict()
    conversion = said["conversion"]
    method = conversion["method"]
    if method["name"] == _SOUTH_ORIENTATED:
        method.update(name="Transverse Mercator", id={"authority": "EPSG", "code": 9807})
        for parameter in conversion["parameters"]:
            if parameter["name"] in ("False easting", "False northing"):
                parameter["value"] = -parameter["value"] or 0  # no -0
    elif method["name"] == _KROVAK:
        method.update(name="Krovak (North Orientated)", id={"authority": "EPSG", "code": 1041})
    else:
        return None
    unit = said["coordinate_system"]["axis"][0]["unit"]
    said["coordinate_system"]["axis"] = [
        {"name": name, "abbreviation": name[0], "direction": name[:-3].lower(), "unit": unit}
        for name in ("Easting", "Northing")
    ]
    for part in (said, conversion):  # the code no longer applies
        for key in ("id", "ids", "usages"):
            part.pop(key, None)
    said["name"] = f"{said['name']} to east and north"
    conversion["name"] = f"{conversion['name']} to east and north"
    try:
        return CRS.from_json_dict(said)
    except CRSError:
        return None


def _agree(crs: CRS, twin: CRS, turn: Affine) -> bool:
    """Whether both CRSs map places to the same coordinates, after the conversion."""
    area = crs.area_of_use
    west, south, east, north = area.bounds if area is not None else (10.0, -30.0, 20.0, -20.0)
    lon, lat = np.array([west, east, (west + east) / 2]), np.array([south, north, (south + north) / 2])
    try:
        x, y, e, n = (
            *Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True).transform(lon, lat),
            *Transformer.from_crs(crs.geodetic_crs, twin, always_xy=True).transform(lon, lat),
        )
    except ProjError:
        return False
    a, b, _, d, f, _ = turn[:6]
    off = np.abs(a * x + b * y - e) + np.abs(d * x + f * y - n)
    return bool(np.isfinite(off).all() and off.max() < 1e-3)
