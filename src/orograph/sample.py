"""The built-in sample: the Jacksboro fault (Tennessee, USA), an SRTM elevation model that comes with matplotlib.

matplotlib is an extra (``pip install 'orograph[sample]'``); nothing else of it is used.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.errors import ReadError
from orograph.geo.grid import Grid


def write_jacksboro(folder: Path) -> Path:
    """Write the sample as a GeoTIFF, jacksboro.tif, into an existing folder; returns its path.

    Raises:
        ReadError: matplotlib is not installed. OutputError: the file cannot be written.
    """
    import rasterio

    from orograph.dem.writing import raster_file

    dem = jacksboro()
    path = folder / "jacksboro.tif"
    rows, cols = dem.grid.shape
    with raster_file(path, keep=True) as part, rasterio.open(
        part, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="int16", crs="EPSG:4326",
        transform=dem.grid.transform, compress="deflate",
    ) as file:  # fmt: skip
        file.write(dem.heights.astype(np.int16), 1)
    return path


def jacksboro() -> Dem:
    """The sample as a DEM: 344 × 403 samples at 3 arc-seconds, metres, WGS 84 longitude and latitude.

    Raises:
        ReadError: matplotlib is not installed.
    """
    found = importlib.util.find_spec("matplotlib")
    if found is None or found.origin is None:
        raise ReadError(
            "The sample comes with matplotlib, which is not installed.", remedy="pip install 'orograph[sample]'"
        )
    path = Path(found.origin).parent / "mpl-data" / "sample_data" / "jacksboro_fault_dem.npz"
    if not path.is_file():
        raise ReadError("This matplotlib has no elevation sample.", path=path, remedy="Install a full matplotlib.")
    with np.load(path) as data:
        heights = data["elevation"].astype(np.float32)
        west, east = sorted(float(data[k]) for k in ("xmin", "xmax"))
        south, north = sorted(float(data[k]) for k in ("ymin", "ymax"))  # the file has the two swapped
    rows, cols = heights.shape
    transform = Affine((east - west) / cols, 0.0, west, 0.0, (south - north) / rows, north)
    return Dem(
        heights, Grid((rows, cols), transform, CRS.from_epsg(4326)), "EGM96 height", "Jacksboro fault, Tennessee"
    )
