"""A finished picture: pixels, depth, and how they are written."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError
from orograph.view import View


@dataclass(frozen=True, slots=True)
class Picture:
    """What a backend made of a scene.

    Attributes:
        pixels: (height, width, 3) uint8, sRGB.
        depth: (height, width) float32, view-space depth in metres at pixel centres, NaN where nothing is hit.
        view: the camera.
        facts: what was measured while drawing (windows, rays, seconds by stage).
    """

    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    view: View
    facts: dict[str, Any] = field(default_factory=dict)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture; the format follows the ending (png, jpg, webp, tif).

        Raises:
            OutputError: the ending is unknown, or the file cannot be written.
        """
        from PIL import Image

        out = Path(path)
        kind = picture_format(out)
        every: dict[str, dict[str, Any]] = {
            "PNG": {"compress_level": 4},
            "JPEG": {"quality": 92, "subsampling": 0},
            "WEBP": {"lossless": True},
            "TIFF": {"compression": "tiff_deflate"},
        }
        with Beside(out) as part:
            Image.fromarray(self.pixels).save(part, format=kind, **every[kind])
        return out

    def save_depth(self, path: str | os.PathLike[str]) -> Path:
        """Write the depth as a float32 TIFF without georeference, metres, NaN where nothing is hit.

        Raises:
            OutputError: the file cannot be written.
        """
        import warnings

        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError

        out = Path(path)
        rows, cols = self.depth.shape
        profile = {
            "driver": "GTiff", "width": cols, "height": rows, "count": 1, "dtype": "float32", "nodata": float("nan"),
            "compress": "deflate", "predictor": 3,
        }  # fmt: skip
        with Beside(out) as part, warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            try:
                with rasterio.open(part, "w", **profile) as file:
                    file.write(self.depth, 1)
                    file.set_band_description(1, "view-space depth, metres")
            except RasterioError as error:
                raise OutputError(f"The depth cannot be written: {error}.", path=path) from error
        return out


FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP", ".tif": "TIFF", ".tiff": "TIFF"}


def picture_format(path: Path) -> str:
    """Pillow's name of the format that a path's ending stands for.

    Raises:
        OutputError: pictures are not written with such an ending.
    """
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise OutputError(
            f"Pictures cannot be written as {path.suffix or 'a file without ending'}.",
            path=path,
            remedy="Use .png, .jpg, .webp or .tif.",
        )
    return kind


def check_folder(path: Path) -> None:
    """Raise OutputError unless there is a folder to write ``path`` into."""
    if not path.parent.is_dir():
        raise OutputError(f"There is no folder {path.parent} to write to.", path=path, remedy="Make it first.")


class Beside:
    """A temporary path beside ``out`` that becomes ``out`` on success and vanishes on failure."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.part = out.with_name(f".{out.name}.{os.getpid()}.part")

    def __enter__(self) -> Path:
        check_folder(self.out)
        return self.part

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is None:
            try:
                self.part.replace(self.out)
            except OSError as cause:
                self.part.unlink(missing_ok=True)
                raise OutputError(f"The file cannot be written: {cause.strerror}.", path=self.out) from cause
            return
        self.part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(
                f"The file cannot be written: {error.strerror or error}.", path=self.out,
                remedy="See that the disk has room and the folder is yours to write in.",
            ) from error  # fmt: skip
