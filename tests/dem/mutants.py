"""Cut and altered copies of raster files, and what becomes of them in a process of its own.

``outcomes`` reads files in processes whose C library fills fresh memory with a given byte (glibc's MALLOC_PERTURB_), so
that uninitialised memory shows as a difference between two bytes. It survives what ends such a process.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.shutil import copy

READER = """
import hashlib, json, sys
from orograph.dem import Source
from orograph.errors import OrographError
for line in sys.stdin:
    path, encoding = json.loads(line)
    try:
        with Source.open(path, encoding=encoding) as source:
            rows, cols = source.shape
            if rows * cols > 3e7:
                raise OrographError("large")
            found = ["read", hashlib.md5(source.read(0, rows, 0, cols)).hexdigest(), rows, cols]
    except OrographError as error:
        found = ["refused", str(error)]
    except Exception as error:
        found = ["fault", repr(error)]
    print(json.dumps(found), flush=True)
"""

Outcome = list[str | int]


def outcomes(files: list[tuple[Path, str | None]], fill: int) -> list[Outcome]:
    """("read", digest, rows, cols), ("refused", message), ("fault", error) or ("died", exit code) of each file."""
    found: list[Outcome] = []
    while len(found) < len(files):
        lines = "".join(json.dumps([str(path), encoding]) + "\n" for path, encoding in files[len(found) :])
        run = subprocess.run(
            [sys.executable, "-c", READER], input=lines, capture_output=True, text=True, timeout=1200,
            env={**os.environ, "MALLOC_PERTURB_": str(fill)},
        )  # fmt: skip
        found += [json.loads(line) for line in run.stdout.splitlines()]
        if len(found) < len(files):
            found.append(["died", run.returncode])
    return found


def mutants(data: bytes, rng: random.Random, cuts: int, changes: int) -> Iterator[tuple[str, bytes]]:
    """Copies cut short, and copies with a bit flipped, 64 zeros or 16 random bytes somewhere."""
    size = len(data)
    for part in [rng.uniform(0.02, 0.98) for _ in range(cuts)]:
        yield f"cut {int(size * part)}", data[: int(size * part)]
    for i in range(changes):
        at, copied = rng.randrange(size), bytearray(data)
        if i % 3 == 0:
            copied[at] ^= 1 << rng.randrange(8)
        elif i % 3 == 1:
            copied[at : at + 64] = bytes(len(copied[at : at + 64]))
        else:
            copied[at : at + 16] = rng.randbytes(len(copied[at : at + 16]))
        yield f"changed {i % 3} at {at}", bytes(copied)


DRIVERS = {
    "AAIGrid": "asc", "BT": "bt", "EHdr": "bil", "ENVI": "img", "ERS": "ers", "GSAG": "grd", "GSBG": "grd",
    "GS7BG": "grd", "HF2": "hf2", "HFA": "img", "ILWIS": "mpr", "ISCE": "isce", "JP2OpenJPEG": "jp2", "MRF": "mrf",
    "NITF": "ntf", "PAux": "raw", "PCIDSK": "pix", "RRASTER": "grd", "RST": "rst", "SAGA": "sdat", "SIGDEM": "sigdem",
    "XYZ": "xyz", "ZMap": "dat", "netCDF": "nc", "ISIS3": "cub", "PDS4": "xml", "VICAR": "vic", "LAN": "lan",
    "GRIB": "grb2", "GPKG": "gpkg", "BAG": "bag", "GTX": "gtx", "PCRaster": "map", "KRO": "kro", "MFF": "hdr",
    "PNG": "png", "BMP": "bmp", "PNM": "pgm", "SGI": "rgb", "GIF": "gif", "JPEG": "jpg",
}  # fmt: skip
VARIANTS: dict[str, tuple[str, str, dict[str, str]]] = {
    "netCDF-2": ("netCDF", "nc", {"FORMAT": "NC2"}),
    "netCDF-4": ("netCDF", "nc", {"FORMAT": "NC4", "COMPRESS": "DEFLATE"}),
    "netCDF-5": ("netCDF", "nc", {"FORMAT": "NC5"}),
    "HFA runs": ("HFA", "img", {"COMPRESSED": "YES"}),
    "HFA spilled": ("HFA", "img", {"USE_SPILL": "YES"}),
    "MRF Deflate": ("MRF", "mrf", {"COMPRESS": "DEFLATE"}),
    "PCIDSK tiled": ("PCIDSK", "pix", {"INTERLEAVING": "TILED", "COMPRESSION": "RLE"}),
    **{
        f"GTiff {name}": ("GTiff", "tif", {"COMPRESS": name, "TILED": "YES", "BLOCKXSIZE": "64", "BLOCKYSIZE": "64"})
        for name in ("NONE", "LZW", "DEFLATE", "ZSTD", "PACKBITS", "LERC", "LERC_DEFLATE", "LZMA")
    },
    "GTiff Deflate strips": ("GTiff", "tif", {"COMPRESS": "DEFLATE", "PREDICTOR": "2"}),
}


def made(folder: Path, only: set[str] | None = None) -> list[tuple[str, Path, Path]]:
    """(format, what to open, the file of the samples) of a small hill in each format that GDAL can write."""
    y, x = np.mgrid[:61, :83]
    hill = 900 + 300 * np.sin(x / 9) * np.cos(y / 7) + 37 * np.sin(x * y / 50)
    place = Affine(30, 0, 500_000, 0, -30, 4_000_000)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, (driver, ending, options) in {**{d: (d, e, {}) for d, e in DRIVERS.items()}, **VARIANTS}.items():
            for dtype in ("int16", "float32", "uint8") if only is None or name in only else ():
                values = hill / 6 if dtype == "uint8" else hill
                inside = folder / f"{name} {dtype}"
                inside.mkdir(parents=True)
                with rasterio.open(folder / "hill.tif", "w", driver="GTiff", height=61, width=83, count=1, dtype=dtype,
                                   crs="EPSG:32611", transform=place) as file:  # fmt: skip
                    file.write(values.astype(dtype), 1)
                try:
                    copy(str(folder / "hill.tif"), str(inside / f"a.{ending}"), driver=driver, **options)
                except Exception:  # a type that the format does not have
                    shutil.rmtree(inside)
                    continue
                files = [f for f in inside.rglob("*") if f.is_file() and not f.name.endswith(".aux.xml")]
                found.append((name, inside / f"a.{ending}", max(files, key=lambda f: f.stat().st_size)))
    return found


def write(folder: Path, opened: Path, data: Path, mutant: bytes) -> Path:
    """A copy of a file and of what lies beside it, one of them altered; what to open."""
    if opened.parent.name.rpartition(" ")[2] in ("int16", "float32", "uint8"):
        shutil.copytree(opened.parent, folder)
    else:
        folder.mkdir()
    (folder / data.name).write_bytes(mutant)
    return folder / opened.name
