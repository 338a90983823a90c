"""A finished picture: pixels, depth, and how they are written."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.header import copyright_tags, plain_copyright
from orograph.errors import OutputError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.color import Tint
from orograph.output import Beside
from orograph.viewpoint import View


@dataclass(frozen=True, slots=True, repr=False)
class Picture:
    """What a backend made of a scene.

    Attributes:
        pixels: (height, width, 3) uint8, sRGB.
        depth: (height, width) float32, view-space depth in metres at pixel centres, NaN where nothing is hit.
        view: the camera.
        facts: what was measured while drawing (windows, rays, seconds by stage), and "warnings": sentences.
        grid: where the pixels of a plan lie, in the terrain's CRS; None in perspective.
        void_filled: (height, width), where missing data is shown (which has no depth); None: nowhere.
        tint: the colours of heights that were drawn; None: not known.
        attribution: whom the makers of its heights want to be named; files carry it.
    """

    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    view: View
    facts: dict[str, Any] = field(default_factory=dict)
    grid: Grid | None = None
    void_filled: NDArray[np.bool_] | None = None
    tint: Tint | None = None
    attribution: tuple[str, ...] = ()

    def __repr__(self) -> str:
        hit = float(np.isfinite(self.depth).mean()) if self.depth.size else 0.0
        return f"<Picture {self.view.width} × {self.view.height} pixels, {self.view.projection}, {hit:.0%} ground>"

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture; the format follows the ending (png, jpg, webp, tif). A plan as .tif is a GeoTIFF.

        Raises:
            UsageError: the ending is unknown. OutputError: the file cannot be written.
        """
        out = Path(path)
        kind = picture_format(out)
        if kind == "TIFF" and self.grid is not None:
            self._write_tiff(out, self.pixels.transpose(2, 0, 1), "picture", {"photometric": "RGB", "predictor": 2})
            return out
        return save_pixels(self.pixels, out, self.attribution)

    def save_depth(self, path: str | os.PathLike[str]) -> Path:
        """Write the depth as a float32 TIFF, metres, NaN where nothing is hit; that of a plan is a GeoTIFF.

        Raises:
            OutputError: the file cannot be written.
        """
        out = Path(path)
        self._write_tiff(
            out, self.depth[None], "depth", {"nodata": float("nan"), "predictor": 3}, "view-space depth, metres"
        )
        return out

    def _write_tiff(
        self, out: Path, bands: NDArray[Any], what: str, creation: dict[str, Any], description: str | None = None
    ) -> None:
        """Write bands (count, height, width) deflated, with the plan's place if this is one."""
        import warnings

        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError

        count, rows, cols = bands.shape
        profile = {
            "driver": "GTiff", "width": cols, "height": rows, "count": count, "dtype": bands.dtype.name,
            "compress": "deflate", **creation,
        }  # fmt: skip
        if self.grid is not None:
            profile["transform"] = self.grid.transform
            if self.grid.crs is not None:
                profile["crs"] = self.grid.crs.to_wkt()
        with Beside(out) as part, warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            try:
                with rasterio.open(part, "w", **profile) as file:
                    file.write(bands)
                    file.update_tags(**copyright_tags(self.attribution))
                    if description is not None:
                        file.set_band_description(1, description)
            except RasterioError as error:
                raise OutputError(f"The {what} cannot be written: {error}.", path=out) from error


def plan_grid(view: View, crs: CRS | None) -> Grid | None:
    """Where the pixels of a plan lie; None for a view in perspective."""
    if view.projection != "plan":
        return None
    origin, across, down, *_ = view.ray_basis()
    # Where a side lies along an axis, rounding of the camera's axes must not make a turned raster of it.
    a, b, d, e = (
        0.0 if abs(v) < 1e-12 * view.pixel_metres else float(v) for v in (across[0], down[0], across[1], down[1])
    )
    transform = Affine(a, b, float(origin[0]), d, e, float(origin[1]))
    return Grid((view.height, view.width), transform, crs)


def _credited(kind: str, attribution: tuple[str, ...]) -> dict[str, Any]:
    """What Pillow writes into a file to name the makers of what it shows."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = "; ".join(attribution)
    if not text:
        return {}
    if kind == "PNG":
        info = PngInfo()
        info.add_text("Copyright", text)
        return {"pnginfo": info}
    if kind == "TIFF":
        return {"tiffinfo": {COPYRIGHT: plain_copyright(attribution)}}
    exif = Image.Exif()
    exif[COPYRIGHT] = plain_copyright(attribution)
    return {"exif": exif}


def save_pixels(pixels: NDArray[np.uint8], out: Path, attribution: tuple[str, ...] = ()) -> Path:
    """Write pixels (height, width, 3) in the format that the path's ending stands for.

    Args:
        attribution: whom to name in the file's metadata.

    Raises:
        UsageError: the ending is unknown. OutputError: the file cannot be written.
    """
    from PIL import Image

    kind = picture_format(out)
    every: dict[str, dict[str, Any]] = {
        "PNG": {"compress_level": 4},
        "JPEG": {"quality": 92, "subsampling": 0},
        "WEBP": {"lossless": True},
        "TIFF": {"compression": "tiff_deflate"},
    }
    with Beside(out) as part:
        Image.fromarray(pixels).save(part, format=kind, **every[kind], **_credited(kind, attribution))
    return out


COPYRIGHT = 0x8298
"""The tag of TIFF and EXIF."""

FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP", ".tif": "TIFF", ".tiff": "TIFF"}


def picture_format(path: Path) -> str:
    """Pillow's name of the format that a path's ending stands for.

    Raises:
        UsageError: pictures are not written with such an ending.
    """
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise UsageError(
            f"Pictures cannot be written as {path.suffix or 'a file without ending'}.",
            path=path,
            remedy="Use .png, .jpg, .webp or .tif.",
        )
    return kind
