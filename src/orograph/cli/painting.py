"""A relief picture with a viewshed painted on the terrain and a mark at the eye."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph.folders import temporary

if TYPE_CHECKING:
    from orograph.measuring import Viewshed
    from orograph.progress import Progress
    from orograph.rendering.picture import Picture
    from orograph.store.terrain import Terrain


def painted(
    terrain: Terrain, shed: Viewshed, camera: Mapping[str, Any], path: str, progress: Progress,
    max_memory: int | None, jobs: int | None,
) -> dict[str, float]:  # fmt: skip
    """Draw the picture; returns how much is visible.

    Raises:
        OutputError: it cannot be written. NothingInViewError: it would be empty.
    """
    from dataclasses import replace

    from orograph.cli.camera import camera_view
    from orograph.measuring.paint import save_paint
    from orograph.measuring.viewshed import Summary
    from orograph.rendering.api import render
    from orograph.scene.sizes import dpi_of

    told = Summary(shed)
    view = camera_view(terrain, camera)
    with temporary() as folder:
        drape = Path(folder) / "seen.tif"
        save_paint(shed, told.over(shed.blocks(progress)), drape)
        picture = render(
            terrain, view, layers=drape if told.seen else (), max_memory=max_memory, jobs=jobs, progress=progress,
        )  # fmt: skip
    replace(picture, pixels=_marked(picture, shed)).save(path, dpi=dpi_of(camera["size"]))
    return told.result()


def _marked(picture: Picture, shed: Viewshed) -> Any:
    """The picture's pixels with a ring at the eye; the ring is thin where ground in front hides it."""
    import numpy as np
    from PIL import Image, ImageDraw

    at, depth = picture.view.project(np.array([*shed.point, shed.ground + shed.eye]))
    height, width = picture.depth.shape
    x, y = float(at[0]), float(at[1])
    if not (0 <= x < width and 0 <= y < height):
        return picture.pixels
    before = picture.depth[int(y), int(x)]
    hidden = bool(np.isfinite(before) and before < 0.98 * float(depth))
    scale = 4
    image = Image.fromarray(picture.pixels)
    r = max(5.0, height / 110)
    box = (int(x - 3 * r), int(y - 3 * r), int(x + 3 * r) + 1, int(y + 3 * r) + 1)
    part = image.crop(box).resize(((box[2] - box[0]) * scale, (box[3] - box[1]) * scale), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(part)
    u, v, r = (x - box[0]) * scale, (y - box[1]) * scale, r * scale
    draw.ellipse((u - r, v - r, u + r, v + r), outline="white", width=round(0.55 * r))
    draw.ellipse((u - 0.85 * r, v - 0.85 * r, u + 0.85 * r, v + 0.85 * r), outline=(160, 20, 20), width=round(0.3 * r))
    if not hidden:
        draw.ellipse((u - 0.3 * r, v - 0.3 * r, u + 0.3 * r, v + 0.3 * r), fill=(160, 20, 20))
    image.paste(part.resize((box[2] - box[0], box[3] - box[1]), Image.Resampling.LANCZOS), box[:2])
    return np.asarray(image)
