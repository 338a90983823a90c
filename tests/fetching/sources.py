"""Real tiles under the products' own URL rules, served without a network."""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from PIL import Image
from rasterio.io import MemoryFile

CALIFORNIA = "california-3s-tiles"
COP = "Copernicus_DSM_COG_30_{0}_DEM"


def heights(data: Path, name: str) -> np.ndarray:
    """(1201, 1201) int16 of one of the tiles of California, shared borders included."""
    with rasterio.open(data / CALIFORNIA / f"{name}.tif") as file:
        return file.read(1)


def tiff(values: np.ndarray, west: float, north: float, dx: float, dy: float, crs: str = "EPSG:4326", **more) -> bytes:
    """A tiled, deflated GeoTIFF of samples whose first cell's corner is (west, north)."""
    profile = {"nodata": None, "compress": "deflate", "tiled": True, "blockxsize": 256, "blockysize": 256, **more}
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=values.shape[1], height=values.shape[0], count=1, dtype=values.dtype.name, crs=crs,
            transform=Affine(dx, 0, west, 0, -dy, north), **profile,
        ) as file:  # fmt: skip
            file.write(values, 1)
        return memory.read()


def corner(name: str) -> tuple[int, int]:
    """(latitude, longitude) of the south-west corner of "N37W119"."""
    lat, lon = int(name[1:3]), int(name[4:7])
    return lat if name[0] == "N" else -lat, lon if name[3] == "E" else -lon


def copernicus(name: str, values: np.ndarray, factor: float = 1, n: int = 1200) -> tuple[str, bytes]:
    """Path and bytes of a GLO-90 tile: samples on whole multiples, the south row and the east column cut off."""
    lat, lon = corner(name)
    m = round(n / factor)
    assert values.shape == (n, m)
    path = COP.format(f"{name[:3]}_00_{name[3:]}_00")
    data = tiff(values.astype(np.float32), lon - 0.5 / m, lat + 1 + 0.5 / n, 1 / m, 1 / n, predictor=3)
    return f"{path}/{path}.tif", data


def srtm3(data: Path, name: str) -> tuple[str, bytes]:
    """Path and bytes of a tile as OpenTopography's mirror of SRTM GL3 has it, whose nodata value is said to be 0."""
    lat, lon = corner(name)
    n = 1200
    file = tiff(heights(data, name), lon - 0.5 / n, lat + 1 + 0.5 / n, 1 / n, 1 / n, predictor=2, nodata=0)
    return f"North/North_30_60/{name}.tif", file


def skadi(name: str, values: np.ndarray) -> tuple[str, bytes]:
    """Path and bytes of a gzipped .hgt."""
    return f"{name[:3]}/{name}.hgt.gz", gzip.compress(values.astype(">i2").tobytes(), mtime=0)


def nasa(name: str, values: np.ndarray) -> tuple[str, bytes]:
    """Path and bytes of a zipped .hgt."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{name}.hgt", values.astype(">i2").tobytes())
    return f"{name}.SRTMGL1.hgt/{name}.SRTMGL1.hgt.zip", held.getvalue()


def terrarium(metres: np.ndarray) -> bytes:
    """A PNG of (256, 256) heights, steps of 1/256 m."""
    code = np.round((metres.astype(np.float64) + 32768) * 256).astype(np.int64)
    held = io.BytesIO()
    bands = [code >> 16, (code >> 8) & 255, code & 255]
    Image.fromarray(np.stack(bands, 2).astype(np.uint8)).save(held, "PNG")
    return held.getvalue()
