"""A fetched area as one GeoTIFF: tiled, compressed, cloud-optimised, with its datum, unit and attribution.

The numbers are those of the product's tiles (whole metres in 16 bits stay so); the CRS is compound if PROJ knows the
vertical datum. Tags: ATTRIBUTION, LICENSE, PRODUCT, SOURCE, MODEL, YEARS, VERTICAL_DATUM, and TIFFTAG_COPYRIGHT for
tools that look there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from orograph.dem.header import copyright_tags
from orograph.dem.writing import check_written, raster_file, write_cog
from orograph.fetching.asking import public
from orograph.fetching.raster import Fetched
from orograph.geo.vertical import ELLIPSOIDAL, known_datum
from orograph.output import beside, check_folder, remove
from orograph.parallel import aside
from orograph.progress import Progress

BLOCK = 512
CODES = {"EGM96 height": 5773, "EGM2008 height": 3855, "EGM84 height": 5798}


class Rows(Protocol):
    """A source of rows."""

    @property
    def code(self) -> tuple[str, float]: ...

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]: ...


def write_geotiff(out: Path, rows: Rows, raster: Fetched, vertical: str | None, progress: Progress) -> None:
    """Write an area.

    Args:
        rows: the heights: the raster's, or converted ones.
        raster: provides their metadata. vertical: their datum.

    Raises:
        OutputError: the file cannot be written.
    """
    import rasterio
    from rasterio.windows import Window

    dtype, nodata = rows.code
    height, width = raster.grid.shape
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": width, "height": height, "count": 1, "dtype": dtype, "nodata": nodata,
        "crs": full_crs(raster, vertical).to_wkt(), "transform": raster.grid.transform, "BIGTIFF": "IF_SAFER",
        "tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK, "compress": "zstd", "zstd_level": 1,
    }  # fmt: skip
    check_folder(out)
    scratch = beside(out, "raw")
    strips = range(0, height, BLOCK)
    try:
        with raster_file(out) as part:
            with (
                progress.task(f"Writing {out.name}", total=len(strips) + 1) as task,
                rasterio.open(scratch, "w", **profile) as file,
            ):
                for row in strips:
                    end = min(row + BLOCK, height)
                    heights = rows.read(row, end, 0, width)
                    if dtype != "float32":
                        heights = np.where(np.isnan(heights), np.float32(nodata), heights)
                    file.write(heights.astype(dtype), 1, window=Window(0, row, width, end - row))
                    task.advance()
                file.update_tags(**tags(raster, vertical))
                file.set_band_description(1, "height")
                file.units = ("m",)
            check_written(scratch, out)
            aside(lambda: write_cog(scratch, part, floats=dtype == "float32", threads=2))
    finally:
        remove(scratch)


def tags(raster: Fetched, vertical: str | None) -> dict[str, str]:
    """The description of a file's sources."""
    product = raster.product
    texts = {
        **copyright_tags(raster.attribution),
        "LICENSE": product.licence,
        "PRODUCT": f"{product.title} ({product.name})",
        "SOURCE": public(product.base),
        "MODEL": f"{product.model} model",
        "YEARS": product.years,
        "VERTICAL_DATUM": vertical or "",
        "TIFFTAG_IMAGEDESCRIPTION": f"{raster.name}, metres",
    }
    return {name: text for name, text in texts.items() if text}


def full_crs(raster: Fetched, vertical: str | None) -> CRS:
    """The CRS with its vertical datum, if PROJ knows that; else the horizontal one."""
    crs = raster.grid.crs
    assert crs is not None
    if vertical is None:
        return crs
    known = known_datum(vertical)
    if known == ELLIPSOIDAL and crs.is_geographic and raster.product.body == "Earth":
        return crs.to_3d()
    code = raster.product.vertical if vertical == raster.product.datum else f"EPSG:{CODES.get(known, 0)}"
    try:
        return CompoundCRS(f"{crs.name} + {vertical}", [crs, CRS.from_user_input(code)])
    except CRSError:
        return crs
