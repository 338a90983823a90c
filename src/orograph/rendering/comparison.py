"""One sheet that shows the meshes of several methods side by side, for the same terrain and camera.

Each panel is a separate picture: the mesh, refined for the panel's pixels, in light relief, with its edges as thin
lines; above it the method's name and the referee's result. The panels of a row are as wide as the sheet allows and have
the view's proportions. Units: pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.sun import Sun
from orograph.rendering.cpu.draw import draw
from orograph.rendering.furniture.lettering import Style, cut, length, set_type
from orograph.scene.camera import direction, ground, outline, whole
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

Pixels = NDArray[np.uint8]

SHEET = (255, 255, 255)
INK, GREY, ALARM = (28, 30, 36), (96, 98, 104), (176, 42, 30)
HAIR = (190, 190, 186)
WIDTH, ALONE = 1600, 1000
"""Width of a sheet, and of one with a single panel."""

MARGIN, GAP = 30, 22

LOW, ASIDE = 9.0, 215.0
"""Pitch and azimuth, in degrees, of the low oblique default view."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One method's part of the sheet.

    Attributes:
        title: the method, as for ``--method``. mesh: for the panel's view; None shows the terrain itself.
        lines: of text about it. alarm: whether the last of them reports an error.
    """

    title: str
    mesh: Tessellation | None
    lines: tuple[str, ...]
    alarm: bool = False


def usual_views(terrain: Terrain, size: tuple[int, int] = (1280, 720), exaggeration: float = 1.0) -> dict[str, View]:
    """Views, by name, in which methods differ: all of the terrain; low over it; straight down onto its middle.

    Args:
        size: (width, height) in pixels. exaggeration: heights are stretched by this on the screen.

    Raises:
        NothingInViewError: no sample is valid.
    """
    points = outline(terrain)
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    span = float(np.linalg.norm(high - low))
    middle = (low + high) / 2
    default = float(np.median(points[:, 2]))
    target = np.array([*middle, ground(terrain, middle[0], middle[1], default)])
    forward = direction(ASIDE, LOW)
    eye = target - 0.4 * span * forward
    # At least a tenth of the way up, since otherwise a ridge may block the view.
    eye[2] = max(eye[2], ground(terrain, eye[0], eye[1], default) + 0.04 * span / exaggeration)
    above = target + np.array([0.0, 0.0, 0.45 * float(np.min(high - low)) / exaggeration])
    above[2] = max(above[2], terrain.height_range[1] + 0.1 * span / exaggeration)
    return {
        "overview": whole(terrain, size, exaggeration=exaggeration),
        "low oblique": View(tuple(eye), tuple(target), fov_y=50.0, width=size[0], height=size[1]),
        "straight down": View(tuple(above), tuple(target), (0.0, 1.0, 0.0), 60.0, size[0], size[1]),
    }


def columns(count: int) -> int:
    """Panels per row, for a number of panels."""
    return 1 if count == 1 else 3 if count == 3 or count > 6 else 2


def sheet_width(count: int) -> int:
    """Width of a sheet of panels, pixels."""
    return ALONE if count == 1 else WIDTH


def panel_view(view: View, count: int) -> View:
    """The view at its size as one of ``count`` panels on a sheet."""
    wide = (sheet_width(count) - 2 * MARGIN - (columns(count) - 1) * GAP) // columns(count)
    return view.resized(wide, max(1, round(wide * view.height / view.width)))


def sheet(
    terrain: Terrain,
    view: View,
    panels: Sequence[Panel],
    *,
    title: str,
    note: str,
    drape: Any = None,
    exaggeration: float = 1.0,
    jobs: int | None = None,
) -> Pixels:
    """The sheet, (height, width, 3) uint8 sRGB.

    Args:
        terrain: the terrain of the meshes.
        view: of every panel (``panel_view``).
        panels: at least one.
        title: above all. note: below all, in small type.
        drape: the image over the ground; None: its tint.
        exaggeration: as the meshes'.
        jobs: threads.

    Raises:
        UsageError: the meshes' surfaces do not fit into memory.
        NothingInViewError: no ground is in view.
    """
    from PIL import Image

    width = sheet_width(len(panels))
    across = columns(len(panels))
    down = -(-len(panels) // across)
    if len(panels) < across * down:  # a free panel shows the terrain itself
        rows, cols = terrain.grid.shape
        panels = [*panels, Panel("the terrain", None, (f"{cols:,} × {rows:,} samples", "no mesh"))]
    words = " ".join([title, note, *(t for p in panels for t in (p.title, *p.lines))])
    style = Style(18.0, Style.of((width, width), words).face)
    head, name, small, tiny = (style.font(s) for s in (1.5, 1.12, 0.86, 0.8))
    lead = 23
    most = max(len(p.lines) for p in panels)
    caption = 30 + lead * most
    top = MARGIN + 52
    tall = top + down * (caption + view.height) + (down - 1) * 1.3 * GAP + 52
    page = Image.new("RGB", (width, math.ceil(tall)), SHEET)
    set_type(page, (MARGIN, MARGIN + 20), cut(style.text(title), head, width - 2 * MARGIN, style), head, INK, "ls")
    for k, panel in enumerate(panels):
        x = MARGIN + (k % across) * (view.width + GAP)
        y = round(top + (k // across) * (caption + view.height + 1.3 * GAP))
        set_type(page, (x, y + 20), style.text(panel.title), name, INK, "ls")
        for i, line in enumerate(panel.lines):
            color = ALARM if panel.alarm and i == len(panel.lines) - 1 else GREY
            words = cut(style.text(line), small, view.width, style)
            set_type(page, (x, y + 20 + lead * (i + 1)), words, small, color, "ls")
        picture = Image.fromarray(_picture(terrain, view, panel, drape, exaggeration, jobs))
        page.paste(HAIR, (x - 1, y + caption - 1, x + view.width + 1, y + caption + view.height + 1))
        page.paste(picture, (x, y + caption))
    words = style.text(note)
    fitted = tiny if length(tiny, words) <= width - 2 * MARGIN else style.font(0.68)
    set_type(page, (MARGIN, page.height - 24), cut(words, fitted, width - 2 * MARGIN, style), fitted, GREY, "ls")
    return np.asarray(page, np.uint8).copy()


def _picture(
    terrain: Terrain, view: View, panel: Panel, drape: Any, exaggeration: float, jobs: int | None
) -> Pixels:  # fmt: skip
    """A panel's mesh with its edges over the terrain's relief, or the terrain alone."""
    scene = Scene.of(
        terrain, view, sun=Sun(315.0, 50.0), shadows=False, exaggeration=exaggeration, jobs=jobs,
        method="auto" if panel.mesh is None else panel.title, wireframe=panel.mesh is not None,
        layers=() if drape is None else drape,
    )  # fmt: skip
    return draw(scene, mesh=panel.mesh).pixels


def caption(triangles: int, bound: float | None, aimed: float | None, largest: float) -> tuple[tuple[str, ...], bool]:
    """Text about a mesh, and whether it is an alarm: its size, then the error and the promise.

    Args:
        bound: promised pixels; None: none. aimed: pixels requested or reached, if known.
        largest: pixels, by the referee.
    """
    first = f"{triangles:,} triangles"
    reached = f"largest error {largest:.2f} px" if math.isfinite(largest) else "unbounded error"
    if bound is None:
        return (first, f"{reached} · no promise"), aimed is not None and largest > aimed
    if largest <= bound * (1 + 1e-9):
        return (first, f"{reached} · within the promised {bound:.3g} px"), False
    return (first, f"{reached} · promised {bound:.3g} px"), True
