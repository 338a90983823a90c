"""Small multiples: one picture of several panels, one for each member, band or time of data, or a map and a relief.

All panels have one camera (``view`` but for the map), one scale of values and one of uncertainties, and one legend
beside them (Tory et al. 2006, of 2D and 3D views side by side; Tufte's small multiples). Units: pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset, datasets_of
from orograph.geovis.data.features import has_features
from orograph.geovis.data.listing import times_in
from orograph.geovis.data.points import is_table
from orograph.geovis.data.reading import members_in
from orograph.geovis.data.series import OneScale, doubt_of
from orograph.geovis.data.times import matches
from orograph.geovis.layers import drawn as visible
from orograph.progress import SILENT, Progress
from orograph.rendering.backends import session
from orograph.rendering.furniture.furnish import furnish, insets
from orograph.rendering.furniture.legend import Drawn, furniture_of, sampled
from orograph.rendering.furniture.lettering import Style, cut, set_type
from orograph.rendering.picture import Picture
from orograph.rendering.standing import extent_of
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

PAPER, INK = (246, 244, 239), (36, 40, 46)
EACH = ("view", "data", "member", "band", "time")
MOST = 36
"""Panels: more are too small to read."""

CAPTION = 1.9
"""Heights of a caption, in units of type."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One of several pictures: what stands above it, its data, whether it is a map, and whether its data have the
    styles of the other panels."""

    title: str
    data: tuple[Dataset, ...]
    plan: bool = False
    alike: bool = True


def draw_panels(
    terrain: Terrain, view: View, each: str, options: Mapping[str, Any], *, backend: str = "cpu",
    again: Callable[..., View] | None = None, progress: Progress = SILENT,
) -> Picture:  # fmt: skip
    """A picture of panels.

    Args:
        view: of each panel; its size is that of the whole.
        each: "view": a map beside the relief; "data": one panel for each of several data, with scales of their own;
            "member", "band" or "time" of the first data: all of them, or some, "member=1-6", "time=2019-03-01".
        options: of a scene, ``furniture`` and ``title`` being those of the whole.
        again: makes an automatic camera for panels of a ``size``, as ``camera.whole`` does: ``also`` are further
            positions (n, 3) to show. None: ``view`` is to be kept.

    Raises:
        UsageError: there are no such panels, or too many. Others: as ``backends.draw``.
    """
    panels = panels_of(datasets_of(options.get("data")), each, terrain)
    size = (view.width, view.height)
    common = {name: value for name, value in options.items() if name not in ("furniture", "title", "data")}
    free = (0.0, 0.0, 0.0, 0.0)
    if options.get("furniture"):
        told = datasets_of(options.get("data")) if each == "data" else panels[0].data
        legend = Scene.of(terrain, view, **common, data=told)
        free = insets(size, terrain.attribution, (), legend.keys)
    style = Style.of(size, " ".join(panel.title for panel in panels))
    caption = math.ceil(CAPTION * style.unit)
    stretch = float(options.get("exaggeration") or 1.0)
    also = _standing(terrain, view, panels, common) if again is not None or panels[0].plan else None
    shape = None if again is None else _proportions(terrain, size, panels, again, also, stretch)
    boxes = _boxes(len(panels), size, free, caption, style.gap, shape)
    wide, tall = boxes[0][2], boxes[0][3] - caption
    sheet = np.empty((size[1], size[0], 3), np.uint8)
    sheet[:] = PAPER
    cover = np.zeros(sheet.shape[:2], bool)
    draw = session(progress, backend=backend)
    whole = view if again is None else again(size=size, also=also)
    seen = view.resized(wide, tall) if again is None else again(size=(wide, tall), also=also)
    above = camera.plan(terrain, (wide, tall), also=also) if panels[0].plan else seen
    made: list[tuple[Scene, Picture]] = []
    with progress.task("Drawing panels", total=len(panels)) as task:
        for panel, (x, y, _, _) in zip(panels, boxes):
            scene = Scene.of(terrain, above if panel.plan else seen, **common, data=panel.data)
            picture = draw(scene)
            made.append((scene, picture))
            sheet[y + caption : y + caption + tall, x : x + wide] = picture.pixels
            cover[y : y + caption + tall, x : x + wide] = True
            task.advance()
    sheet = _captioned(sheet, panels, boxes, style)
    scene, picture = made[-1]
    if options.get("furniture"):
        shown = legend if each == "data" else scene.but(view=whole)
        sheet = _furnished(sheet, cover, shown, picture, options.get("title"), _note(panels, each))
    names = ", ".join(panel.title for panel in panels)
    words = f"{len(panels)} panels: {names}. {picture.facts['description']}"
    facts = {
        **picture.facts,
        "panels": len(panels),
        "description": words,
    }
    return Picture(
        sheet, np.full(sheet.shape[:2], np.nan, np.float32), whole, facts, None, None, picture.tint,
        picture.crs, picture.exaggeration, picture.attribution,
    )  # fmt: skip


def _standing(
    terrain: Terrain, view: View, panels: Sequence[Panel], common: Mapping[str, Any]
) -> NDArray[np.float64] | None:  # fmt: skip
    """Positions (n, 3) around what stands in any of the panels; None: nothing stands."""
    found = []
    for panel in panels[:1] if panels[0].plan else panels:  # (a map and its relief have the same data)
        points = extent_of(Scene.of(terrain, view, **common, data=panel.data))
        if points is not None:
            found.append(points)
        elif panel.alike:
            break
    return np.concatenate(found) if found else None


def _proportions(
    terrain: Terrain, size: tuple[int, int], panels: Sequence[Panel], again: Callable[..., View], also: Any,
    stretch: float,
) -> float:  # fmt: skip
    """Width over height of what automatic cameras show; of a map and a relief the mean."""
    views = [again(size=size, also=also)]
    if panels[0].plan:
        views.append(camera.plan(terrain, size, also=also))
    points = camera.joined(camera.outline(terrain), also)
    found = [np.ptp(view.project(points, stretch)[0], axis=0) for view in views]
    return float(np.exp(np.mean([np.log(wide / max(tall, 1.0)) for wide, tall in found])))


def panels_of(data: tuple[Dataset, ...], each: str, terrain: Terrain) -> list[Panel]:
    """The panels that are asked for, their data with one scale.

    Raises:
        UsageError: there are none, or too many, or they cannot be told apart.
    """
    key, _, some = each.partition("=")
    if key not in EACH:
        raise UsageError(f"There is no panel for each {key!r}.", remedy=f"There are {', '.join(EACH)}.")
    if key == "view":
        return [Panel("Map", data, True), Panel("Relief", data)]
    if key == "data":
        return _of_several(data)
    if not data:
        raise UsageError(f"A panel for each {key} is of data, and there are none.")
    first, *rest = data
    if has_features(first.source) or is_table(first.source):
        raise UsageError(f"A panel for each {key} is of a raster.", path=first.called)
    if key != "time" and first.derived:
        raise UsageError(
            f"A panel for each {key} shows one {key}, but value= or exceeds= is taken over several.",
            remedy="Leave it out, or make a panel for each time.",
        )
    first, whole = first.but(uncertainty=None), first
    own = getattr(first, key)
    some = some or ("" if own is None else str(own))
    if key == "time":
        chosen = [time for time in times_in(first) if not some or matches(time, some)]
        days = {time.partition("T")[0] for time in chosen}
        ones = [(time.partition("T")[2] if len(days) == 1 else time.replace("T", " "), first.but(time=time))
                for time in chosen]  # fmt: skip
    else:
        numbers = members_in(first, terrain.grid, some or "all")
        ones = [(f"{key} {number}", first.but(**{key: str(number)})) for number in numbers]
    if not 2 <= len(ones) <= MOST:
        raise UsageError(
            f"Panels are 2 to {MOST}, and there {'is' if len(ones) == 1 else 'are'} {len(ones)}.",
            remedy=f"Choose some: {key}=1-6." if key != "time" else "Choose some: time=2019-03-01, time=T12.",
        )  # fmt: skip
    doubt = doubt_of(whole, ones[0][1], terrain.grid)
    ones = [(title, one.but(uncertainty=doubt)) for title, one in ones]
    scale = OneScale.of(whole, [one for _, one in ones], terrain.grid)
    return [Panel(title, (scale.over(one), *rest)) for title, one in ones]


def _of_several(data: tuple[Dataset, ...]) -> list[Panel]:
    """A panel for each of several data.

    Raises:
        UsageError: there are too few, or too many.
    """
    if not 2 <= len(data) <= MOST:
        raise UsageError(f"Panels of data are 2 to {MOST}, and there are {len(data)}.", remedy="Give several `data`.")

    def title(number: int, one: Dataset) -> str:
        source = Path(one.source).stem if isinstance(one.source, str) else f"data {number}"
        return (one.name or one.variable or source).replace("_", " ")

    return [Panel(title(k + 1, one), (one,), alike=False) for k, one in enumerate(data)]


def _boxes(
    count: int,
    size: tuple[int, int],
    free: tuple[float, float, float, float],
    caption: int,
    gap: int,
    shape: float | None = None,
) -> list[tuple[int, int, int, int]]:
    """(x, y, width, height with the caption) of panels, as large as they can be.

    Args:
        shape: their width over their height; None: the picture's.
    """
    shape = size[0] / size[1] if shape is None else shape
    left, right, top, bottom = (
        round(part * side) for part, side in zip(free, (size[0], size[0], size[1], size[1]))
    )  # fmt: skip
    room_x, room_y = size[0] - left - right - 2 * gap, size[1] - top - bottom - 2 * gap
    best = (0.0, 1)
    for across in range(1, count + 1):
        down = -(-count // across)
        wide = (room_x - (across - 1) * gap) / across
        tall = (room_y - (down - 1) * gap) / down - caption
        best = max(best, (min(wide, tall * shape), across))
    wide, across = int(best[0]), best[1]
    tall = int(wide / shape)
    if wide < 48 or tall < 32:
        raise UsageError(f"{count} panels do not fit into {size[0]} × {size[1]} pixels.", remedy="Make it larger.")
    down = -(-count // across)
    x0 = left + gap + (room_x - across * wide - (across - 1) * gap) // 2
    y0 = top + gap + (room_y - down * (tall + caption) - (down - 1) * gap) // 2
    return [
        (x0 + k % across * (wide + gap), y0 + k // across * (tall + caption + gap), wide, tall + caption)
        for k in range(count)
    ]


def _captioned(
    sheet: NDArray[np.uint8], panels: list[Panel], boxes: list[tuple[int, int, int, int]], style: Style
) -> NDArray[np.uint8]:  # fmt: skip
    from PIL import Image

    image, font = Image.fromarray(sheet), style.font(1.0)
    for panel, (x, y, wide, _) in zip(panels, boxes):
        words = cut(style.text(panel.title), font, wide, style)
        set_type(image, (x, y + round(1.3 * style.unit)), words, font, INK, "ls")
    return np.asarray(image, np.uint8).copy()


def _furnished(
    sheet: NDArray[np.uint8], cover: NDArray[np.bool_], scene: Scene, picture: Picture, title: str | None, note: str
) -> NDArray[np.uint8]:  # fmt: skip
    assert picture.tint is not None
    depth = picture.depth.astype(np.float64)
    seen = sampled(depth, *depth.shape), depth[:, depth.shape[1] // 2]
    pieces = furniture_of(scene, Drawn(picture.tint, picture.facts["shown"], bool(visible(scene.data.layers)), *seen))
    for key in scene.keys:
        pieces["note"] = pieces["note"].replace(f"{key.note} · ", "") if key.note else pieces["note"]
    pieces["note"] = pieces["note"].replace("scale at the picture's middle · ", "")
    pieces |= {"metres_per_pixel": None, "north": None, "note": f"{pieces['note']} · {note}"}
    if title is not None:
        pieces["title"] = title
    return furnish(sheet, **pieces, ground=cover)


def _note(panels: list[Panel], each: str) -> str:
    if each == "data":
        return "each panel with a scale of its own"
    if panels[0].plan:
        return "map and relief"
    day = str(panels[0].data[0].time).partition("T")[0] if len(panels[0].title) == len("00:00") else ""
    of = f"time on {day} (UTC)" if each.startswith("time") and day else each.partition("=")[0]
    return f"one panel for each {of}, one scale"
