"""Marks of measuring on the ground: the clicked points, the line between them, what blocks a line of sight.

They are drawn over the picture, even behind a mountain, so that measurements never disappear. Units: logical pixels;
metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from orograph.viewer.overlay import color
from orograph.viewer.results import Kind
from orograph.viewpoint import Point

if TYPE_CHECKING:
    from orograph.viewer.window import Window

Array = NDArray[np.float64]


def trace(
    window: Window, kind: Kind, points: Sequence[Point], line: Array | None, result: Any, marked: Point | None
) -> None:
    """Draw points and lines, as far as they are in front of the eye.

    Args:
        points: the clicked points. line: (n, 3) along what was measured, or None.
        result: of the measurement, or None. marked: the place of the line under the cursor.
    """
    draw: Any = imgui.get_background_draw_list()
    ink, dark = color(1.0, 0.82, 0.25), color(0, 0, 0, 0.65)
    if line is not None:
        for part in on_screen(window, line):
            draw.add_polyline(part, dark, 4.0, 0)
            draw.add_polyline(part, ink, 2.0, 0)
    for spot in on_screen(window, np.array(points).reshape(-1, 3), single=True):
        draw.add_circle_filled(spot[0], 5.0, dark)
        draw.add_circle_filled(spot[0], 3.5, ink)
    if kind == "los" and result is not None and result.obstruction is not None:
        mark = result.obstruction
        for (at,) in on_screen(window, np.array([[mark.easting, mark.northing, mark.height]]), single=True):
            for s in (-1, 1):
                draw.add_line((at[0] - 7, at[1] - 7 * s), (at[0] + 7, at[1] + 7 * s), dark, 5.0)
                draw.add_line((at[0] - 7, at[1] - 7 * s), (at[0] + 7, at[1] + 7 * s), color(1, 0.25, 0.2), 2.5)
    if marked is not None and math.isfinite(marked[2]):
        for (at,) in on_screen(window, np.array([marked]), single=True):
            draw.add_circle(at, 6.0, color(1, 1, 1), 20, 2.0)


def on_screen(window: Window, points: Array, single: bool = False) -> list[list[tuple[float, float]]]:
    """Runs of places (n, 3) in front of the eye; ``single``: one run for each."""
    if len(points) == 0:
        return []
    session = window.session
    pixels, depth = session.view.project(points, session.settings.exaggeration)
    runs: list[list[tuple[float, float]]] = [[]]
    for (x, y), d in zip(pixels, depth):
        if single:
            runs.append([])
        if d > 0 and math.isfinite(x) and math.isfinite(y) and abs(x) < 1e5 and abs(y) < 1e5:
            runs[-1].append(window.to_canvas(float(x), float(y)))
        elif not single:
            runs.append([])
    return [r for r in runs if len(r) > (0 if single else 1)]
