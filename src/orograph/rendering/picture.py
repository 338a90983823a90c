"""A finished picture: pixels, depth, and writing them."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph._named import named
from orograph.cards import png
from orograph.dem.header import copyright_tags
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.color import Tint
from orograph.output import Beside
from orograph.rendering.metadata import check_dpi, save_options, tiff_tags
from orograph.viewpoint import View

if TYPE_CHECKING:
    import xarray as xr


ELSEWHERE = {
    **dict.fromkeys(("savefig", "to_png", "to_file", "write"), "picture.save(path)"),
    **dict.fromkeys(("shape", "size", "width", "height"), "picture.pixels.shape"),
    **dict.fromkeys(("to_image", "to_pil"), "PIL.Image.fromarray(picture.pixels)"),
    "imshow": "picture.plot(ax) or picture.show()",
    "to_numpy": "numpy.asarray(picture)",
    "image": "picture.pixels",
    "array": "picture.pixels",
}
"""Names in other libraries → names here."""


@named("A picture")
@dataclass(frozen=True, slots=True, repr=False)
class Picture:
    """A picture drawn by a backend.

    Attributes:
        pixels: (height, width, 3) uint8, sRGB.
        depth: (height, width) float32, view-space depth in metres at pixel centres, NaN where nothing is hit.
        view: the camera.
        facts: measurements made while drawing (windows, rays, seconds by stage), and "warnings": sentences.
        grid: where the pixels of a plan lie, in the terrain's CRS; None in perspective.
        void_filled: (height, width), where missing data is shown (which has no depth); None: nowhere.
        tint: the colours of heights that were drawn; None: not known.
        crs: the terrain's, in which the camera stands. exaggeration: how heights are stretched on the screen.
        attribution: whom the makers of its heights want to be named; files carry it.
    """

    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    view: View
    facts: dict[str, Any] = field(default_factory=dict)
    grid: Grid | None = None
    void_filled: NDArray[np.bool_] | None = None
    tint: Tint | None = None
    crs: CRS | None = None
    exaggeration: float = 1.0
    attribution: tuple[str, ...] = ()

    def __repr__(self) -> str:
        size = f"{self.view.width} × {self.view.height} pixels"
        if "panels" in self.facts:
            return f"<Picture {size}, {self.facts['panels']} panels>"
        hit = float(np.isfinite(self.depth).mean()) if self.depth.size else 0.0
        return f"<Picture {size}, {self.view.projection}, {hit:.0%} ground>"

    def _repr_png_(self) -> bytes:
        return png(self.pixels)

    def __getattr__(self, name: str) -> Any:
        if name in ELSEWHERE:
            raise AttributeError(f"A Picture has no {name}; use {ELSEWHERE[name]}.")
        raise AttributeError(f"A Picture has no {name}.")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The pixels, (height, width, 3) uint8."""
        return np.array(self.pixels, dtype, copy=copy)

    def describe(self) -> str:
        """The picture in words: its terrain, camera, light, and data with values and uncertainty."""
        return str(self.facts.get("description", ""))

    def show(self) -> None:
        """Show the picture: in a notebook's cell, otherwise in the system's image viewer."""
        from orograph.rendering.plotting import show

        show(self)

    def plot(self, ax: Any = None, **options: Any) -> Any:
        """Draw the picture on matplotlib's or cartopy's axes; a plan at its position in its CRS (``plotting.plot``).

        Args:
            ax: the axes; None: new ones.
            options: for ``Axes.imshow`` (alpha, zorder, interpolation…).

        Returns: the axes' image; its ``axes`` are the axes.

        Raises:
            UsageError: matplotlib is not installed.
        """
        from orograph.rendering.plotting import plot

        return plot(self, ax, **options)

    def colorbar(self, ax: Any = None, **options: Any) -> Any:
        """A colour bar of the heights beside matplotlib's axes (``Figure.colorbar``, whose options it takes).

        Raises:
            UsageError: the picture does not know its colours of heights, or matplotlib is not installed.
        """
        from orograph.rendering.plotting import colorbar

        return colorbar(self, ax, **options)

    def places(self) -> NDArray[np.float64]:
        """What each pixel shows: (height, width, 3), easting and northing in the terrain's CRS and height in true
        metres; NaN where there is no ground."""
        origin, ou, ov, d, du, dv = self.view.ray_basis(self.exaggeration)
        x, y = np.meshgrid(np.arange(self.view.width) + 0.5, np.arange(self.view.height) + 0.5)
        x, y, depth = x[..., None], y[..., None], self.depth[..., None].astype(np.float64)
        found: NDArray[np.float64] = origin + x * ou + y * ov + depth * (d + x * du + y * dv)
        return np.where(np.isfinite(depth), found, np.nan)

    def to_xarray(self) -> xr.Dataset:
        """Pixels, depth, and for each pixel its place, as a Dataset (``plotting.to_xarray``)."""
        from orograph.rendering.plotting import to_xarray

        return to_xarray(self)

    def save(self, path: str | os.PathLike[str], *, dpi: float | None = None) -> Path:
        """Write the picture; the format follows the ending (png, jpg, webp, tif). A plan as .tif is a GeoTIFF.

        Args:
            dpi: dots per inch, from which programs take the print size; None: not stated.

        Raises:
            UsageError: the ending is unknown, or the resolution invalid. OutputError: the file cannot be written.
        """
        if hasattr(path, "write"):
            raise UsageError(
                "A picture is saved under a path, not in an open file.",
                remedy="PIL.Image.fromarray(picture.pixels).save(file, format) writes into files.",
            )
        out = Path(path)
        kind = picture_format(out)
        check_dpi(dpi)
        if kind == "TIFF" and self.grid is not None:
            creation = {"photometric": "RGB", "predictor": 2}
            self._write_tiff(out, self.pixels.transpose(2, 0, 1), creation, tags=tiff_tags(dpi))
            return out
        return save_pixels(self.pixels, out, self.attribution, dpi)

    def save_depth(self, path: str | os.PathLike[str]) -> Path:
        """Write the depth as a float32 TIFF, metres, NaN where nothing is hit; that of a plan is a GeoTIFF.

        Raises:
            OutputError: the file cannot be written.
        """
        out = Path(path)
        self._write_tiff(out, self.depth[None], {"nodata": float("nan"), "predictor": 3}, "view-space depth, metres")
        return out

    def _write_tiff(
        self, out: Path, bands: NDArray[Any], creation: dict[str, Any], description: str | None = None,
        tags: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Write bands (count, height, width) deflated, with the plan's place if this is one."""
        import rasterio

        from orograph.dem.writing import raster_file

        count, rows, cols = bands.shape
        profile = {
            "driver": "GTiff", "width": cols, "height": rows, "count": count, "dtype": bands.dtype.name,
            "compress": "deflate", **creation,
        }  # fmt: skip
        if self.grid is not None:
            profile["transform"] = self.grid.transform
            if self.grid.crs is not None:
                profile["crs"] = self.grid.crs.to_wkt()
        with raster_file(out) as part, rasterio.open(part, "w", **profile) as file:
            file.write(bands)
            file.update_tags(**copyright_tags(self.attribution), **(tags or {}))
            if description is not None:
                file.set_band_description(1, description)


def plan_grid(view: View, crs: CRS | None) -> Grid | None:
    """The georeference of a plan; None for a view in perspective."""
    if view.projection != "plan":
        return None
    origin, across, down, *_ = view.ray_basis()
    # Where a side lies along an axis, rounding of the camera's axes must not make a turned raster of it.
    a, b, d, e = (
        0.0 if abs(v) < 1e-12 * view.pixel_metres else float(v) for v in (across[0], down[0], across[1], down[1])
    )
    transform = Affine(a, b, float(origin[0]), d, e, float(origin[1]))
    return Grid((view.height, view.width), transform, crs)


def save_pixels(
    pixels: NDArray[np.uint8], out: Path, attribution: tuple[str, ...] = (), dpi: float | None = None
) -> Path:
    """Write pixels (height, width, 3) in the format of the path's ending.

    Args:
        attribution: whom to name in the file's metadata. dpi: dots per inch in print; None: not stated.

    Raises:
        UsageError: the ending is unknown, or the resolution invalid. OutputError: the file cannot be written.
    """
    from PIL import Image

    kind = picture_format(out)
    check_dpi(dpi)
    every: dict[str, dict[str, Any]] = {
        "PNG": {"compress_level": 4},
        "JPEG": {"quality": 92, "subsampling": 0},
        "WEBP": {"lossless": True},
        "TIFF": {"compression": "tiff_deflate"},
    }
    encoded = io.BytesIO()  # not the file: of a full disk libtiff speaks for itself
    Image.fromarray(pixels).save(encoded, format=kind, **every[kind], **save_options(kind, attribution, dpi))
    with Beside(out) as part:
        part.write_bytes(encoded.getbuffer())
    return out


FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP", ".tif": "TIFF", ".tiff": "TIFF"}


def picture_format(path: Path) -> str:
    """Pillow's name of the format that a path's ending stands for.

    Raises:
        UsageError: pictures cannot be written with this ending.
    """
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise UsageError(
            f"Pictures cannot be written as {path.suffix or 'a file without ending'}.",
            path=path,
            remedy="Use .png, .jpg, .webp or .tif.",
        )
    return kind
