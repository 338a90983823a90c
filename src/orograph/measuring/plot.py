"""Pictures of profiles and lines of sight, by matplotlib (the extra ``sample``), as PNG, SVG or PDF.

Height over true horizontal distance, with gaps at holes and the vertical exaggeration noted. Under a line of sight the
ground that the eye does not see is darker, and the place where the line first meets the ground is marked. On a round
body the line is drawn bent upward, as it runs over heights that are counted from sea level.
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.output import Beside, check_folder

if TYPE_CHECKING:
    from orograph.measuring.profile import Profile
    from orograph.measuring.sight import Sight

Array = NDArray[np.float64]

ENDINGS = (".png", ".svg", ".pdf")
_GROUND, _LINE, _DARK, _RAY, _MARK = "#d9cbb0", "#5b4a32", "#8d7b62", "#1f5fa8", "#c62f1d"


def check_plot(path: str | os.PathLike[str]) -> None:
    """Raise before any work if a plot cannot be written: wrong ending, no folder, no matplotlib."""
    if Path(path).suffix.lower() not in ENDINGS:
        raise UsageError(f"A plot must be written as {', '.join(ENDINGS)}.", path=path)
    check_folder(Path(path))
    if importlib.util.find_spec("matplotlib") is None:
        raise ReadError("Plots need matplotlib, which is not installed.", remedy="pip install 'orograph[sample]'")


def save_profile(profile: Profile, path: str | os.PathLike[str]) -> None:
    """Draw a profile.

    Args:
        path: .png, .svg or .pdf.

    Raises:
        UsageError: wrong ending. ReadError: matplotlib is not installed. OutputError: the file cannot be written.
    """
    check_plot(path)
    figure, axes, unit, scale = _axes(profile)
    _ground(axes, profile, scale)
    for k in profile.vertices[1:-1]:
        axes.axvline(profile.distance[k] / scale, color="#777777", linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    notes = [f"{_metres(profile.length)} on the ground", f"{_metres(float(profile.distance[-1]))} horizontally",
            f"+{profile.climb:,.0f} m  −{profile.descent:,.0f} m"]  # fmt: skip
    if profile.missing:
        notes.append(f"{_metres(profile.missing)} without data")
    _finish(figure, axes, profile, unit, scale, f"Profile over {profile.places.terrain.name}", notes, path)


def save_sight(sight: Sight, path: str | os.PathLike[str]) -> None:
    """Draw a line of sight over its ground; arguments and errors as ``save_profile``."""
    check_plot(path)
    profile = sight.profile
    figure, axes, unit, scale = _axes(profile, np.append(sight.line, profile.surface_heights))
    _ground(axes, profile, scale)
    s = profile.distance / scale
    hidden = sight.hidden()
    if hidden.any():
        floor = axes.get_ylim()[0]
        axes.fill_between(s, floor, profile.surface_heights, where=hidden, color=_DARK, linewidth=0, zorder=2)
    color = _RAY if sight.visible else _MARK
    stop = len(s)
    mark = sight.obstruction
    if mark is not None:
        stop = int(np.searchsorted(profile.distance, mark.distance))
        axes.plot(s[stop - 1 :], sight.line[stop - 1 :], color=_MARK, linewidth=0.9, linestyle=(0, (4, 3)), zorder=4)
    axes.plot(s[:stop], sight.line[:stop], color=_RAY, linewidth=1.2, zorder=5)
    axes.plot(s[[0, -1]], sight.line[[0, -1]], "o", color=color, markersize=4, zorder=6, clip_on=False)
    if mark is not None:
        axes.plot([mark.distance / scale], [mark.height], "o", color=_MARK, markersize=6, markerfacecolor="white",
                  markeredgewidth=1.6, zorder=7)  # fmt: skip
        left = mark.distance < 0.6 * profile.distance[-1]
        axes.annotate(
            f"obstructed at {_metres(mark.distance)}, {mark.height:,.0f} m", (mark.distance / scale, mark.height),
            xytext=(9 if left else -9, 9), textcoords="offset points", ha="left" if left else "right", va="bottom",
            color=_MARK, fontsize=9, zorder=8, bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "none",
            "alpha": 0.85},
        )  # fmt: skip
    notes = ["visible" if sight.visible else f"not visible: a target needs {sight.needed:,.1f} m",
            f"eye {sight.eye:g} m, target {sight.target:g} m above ground",
            "round body, refraction" if sight.bend else "plane"]  # fmt: skip
    _finish(figure, axes, profile, unit, scale, f"Line of sight over {profile.places.terrain.name}", notes,
            path)  # fmt: skip


def _axes(profile: Profile, values: Array | None = None) -> tuple[Any, Any, str, float]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    unit, scale = ("km", 1000.0) if profile.distance[-1] >= 2000 else ("m", 1.0)
    heights = profile.surface_heights if values is None else values
    known = heights[np.isfinite(heights)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    room = max(high - low, 1.0)
    axes.set_xlim(0, profile.distance[-1] / scale)
    axes.set_ylim(low - 0.12 * room, high + 0.15 * room)
    return figure, axes, unit, scale


def _ground(axes: Any, profile: Profile, scale: float) -> None:
    """The ground, with gaps at holes: known piece by piece, so that a single missing piece shows too."""
    s, z = profile.distance / scale, profile.surface_heights.copy()
    breaks = np.flatnonzero(~profile.known)
    s = np.insert(s, breaks + 1, s[breaks])
    z = np.insert(z, breaks + 1, np.nan)
    axes.fill_between(s, axes.get_ylim()[0], z, color=_GROUND, linewidth=0, zorder=1)
    axes.plot(s, z, color=_LINE, linewidth=1.0, zorder=3)


def _finish(
    figure: Any, axes: Any, profile: Profile, unit: str, scale: float, title: str, notes: list[str],
    path: str | os.PathLike[str],
) -> None:  # fmt: skip
    axes.set_title(title, loc="left", fontsize=11, pad=19)
    axes.set_xlabel(f"distance ({unit})")
    axes.set_ylabel("height (m)")
    axes.grid(axis="y", color="#cccccc", linewidth=0.5, zorder=0)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for x, name in ((0.012, "A"), (0.988, "B")):
        axes.text(x, 0.985, name, transform=axes.transAxes, ha="center", va="top", fontsize=11, fontweight="bold")
    figure.canvas.draw()
    box, (low, high) = axes.get_window_extent(), axes.get_ylim()
    stretch = (box.height / (high - low)) / (box.width / float(profile.distance[-1]))
    notes.append(f"heights ×{stretch:.3g}")
    axes.text(0.0, 1.03, "  ·  ".join(notes), transform=axes.transAxes, ha="left", va="bottom", fontsize=8,
              color="#444444")  # fmt: skip
    with Beside(Path(path)) as part:
        figure.savefig(part, format=Path(path).suffix.lower()[1:])


def _metres(value: float) -> str:
    return f"{value / 1000:,.2f} km" if value >= 2000 else f"{value:,.1f} m"
