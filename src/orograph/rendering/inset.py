"""A small map of the whole terrain for the furniture of a perspective: what is in view keeps its colours, the rest is
pale, and a wedge marks the eye. North is up. Units: pixels, metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError
from orograph.rendering.furniture.lettering import Style
from orograph.rendering.furniture.pieces import INK, PAPER
from orograph.rendering.picture import Picture
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.viewpoint import View

ACROSS = 8.5
"""Units of type that the longer side of the map takes."""

PALE = 0.62
"""How much of the ground out of view is paper."""

LINE = (196, 62, 0)
"""The colour of the view's border and of the eye."""


def inset_of(scene: Scene, draw: Callable[[Scene], Picture]) -> NDArray[np.uint8] | None:
    """The map, (rows, cols, 3) sRGB; None where the scene has none.

    Args:
        draw: draws a scene without furniture.
    """
    view = scene.view
    if not scene.annotations.inset or view.projection != "perspective":
        return None
    unit = Style.of((view.whole.width, view.whole.height), "").unit
    west, south, east, north = scene.terrain.grid.bounds()
    longest = ACROSS * unit / max(east - west, north - south)
    size = max(8, round(longest * (east - west))), max(8, round(longest * (north - south)))
    flat = scene.but(
        view=camera.plan(scene.terrain, size), furniture=False, title=None, inset=False, aids=None, contours=None,
        silhouettes=None, method="auto", triangles=None, wireframe=False, mesh_view=None, sky=False, detail=None,
    )  # fmt: skip
    try:
        picture = draw(flat)
    except NothingInViewError:
        return None
    return marked(picture, view.whole, scene.surface.exaggeration)


def marked(picture: Picture, view: View, exaggeration: float) -> NDArray[np.uint8]:
    """A map's pixels with what a view shows of it.

    Args:
        picture: the map. view: the whole view. exaggeration: of the view.
    """
    seen = in_view(picture, view, exaggeration)
    paper = ~np.isfinite(picture.depth)
    pixels = picture.pixels.astype(np.float64)
    pixels[~seen & ~paper] += PALE * (np.array(PAPER) - pixels[~seen & ~paper])
    inner = seen.copy()
    inner[1:] &= seen[:-1]
    inner[:-1] &= seen[1:]
    inner[:, 1:] &= seen[:, :-1]
    inner[:, :-1] &= seen[:, 1:]
    pixels[seen & ~inner] = LINE
    return _with_eye(np.rint(pixels).astype(np.uint8), picture.view, view)


def in_view(picture: Picture, view: View, exaggeration: float) -> NDArray[np.bool_]:
    """Which pixels of a map show ground that is in a view's frame (behind other ground or not)."""
    places = picture.places()
    (xy, depth) = view.project(places.reshape(-1, 3), exaggeration)
    with np.errstate(invalid="ignore"):
        inside = (depth >= view.near) & (xy >= 0).all(-1) & (xy <= [view.width, view.height]).all(-1)
    found: NDArray[np.bool_] = inside.reshape(picture.depth.shape)
    return found


def eye_on(flat: View, view: View) -> tuple[float, float]:
    """The eye's position on a map, or, if it is outside the map, the nearest position on it."""
    xy, _ = flat.project(np.array([[*view.eye[:2], view.target[2]]]))
    x, y = np.clip(xy[0], 0, [flat.width, flat.height])
    return float(x), float(y)


def _with_eye(pixels: NDArray[np.uint8], flat: View, view: View) -> NDArray[np.uint8]:
    from PIL import Image, ImageDraw

    x, y = eye_on(flat, view)
    way = np.array([view.target[0] - view.eye[0], -(view.target[1] - view.eye[1])])
    size = float(np.hypot(*way))
    if size == 0:
        return pixels
    (dx, dy), r = way / size, max(5.0, min(pixels.shape[:2]) / 14)
    x, y = (float(np.clip(v, 0.8 * r, n - 0.8 * r)) for v, n in ((x, flat.width), (y, flat.height)))
    shape = ((1.0, 0.0), (-1.0, 0.7), (-0.4, 0.0), (-1.0, -0.7))  # ahead, aside
    corners = [(x + r * (a * dx - b * dy), y + r * (a * dy + b * dx)) for a, b in shape]
    sheet = Image.fromarray(pixels).resize((3 * flat.width, 3 * flat.height), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(sheet)
    outline = [(3 * a, 3 * b) for a, b in corners]
    pen.polygon(outline, fill=LINE, outline=INK, width=2)
    return np.asarray(sheet.resize((flat.width, flat.height), Image.Resampling.BOX), np.uint8).copy()
