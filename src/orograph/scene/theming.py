"""Turn a theme into parts that every backend draws: data into painted layers, priorities into light, lines and tint.

A priority sets only those of the scene's options that are not given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import UsageError
from orograph.scene.contours import Contours, round_number
from orograph.scene.parts import made_of
from orograph.scene.silhouettes import Silhouettes

if TYPE_CHECKING:
    from orograph.geo.grid import Grid
    from orograph.geovis.data.dataset import Dataset
    from orograph.geovis.data.painting import Shown
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.data.standing import Things
    from orograph.scene.aids import Aids
    from orograph.store.terrain import Terrain

FINER, LEAST, MOST = 1.6, 1024, 3072
"""Texels along the longer side of painted data: this many per pixel of the picture, within these bounds."""

CASED, INK = 0.6, (0.17, 0.13, 0.10)
"""Opacity of the casing of lines over data, and the colour of contour lines of terrain without priority."""

PAPER = "#e4e0d4"
"""The tint of ground under data: a little darker than the paper around, so that the terrain's extent is seen."""


@dataclass(frozen=True, slots=True)
class Themed:
    """A theme turned into options.

    Attributes:
        options: the scene's, with its data as layers. things: standing on its ground, or None. painted: the content of
            its data layers, bottom to top.
    """

    options: dict[str, Any]
    things: Things | None = None
    painted: tuple[Shown, ...] = ()


def themed(options: Mapping[str, Any], terrain: Terrain, size: tuple[int, int]) -> Themed:
    """A scene's options with its theme applied.

    Args:
        size: pixels (width, height) of the picture; sets the resolution of painted data.

    Raises:
        ReadError, UsageError: data cannot be read, or do not fit here.
    """
    from orograph.geovis.data.bivariate import pairs
    from orograph.geovis.data.painted import painted
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.data.shared import once
    from orograph.geovis.data.standing import Things
    from orograph.geovis.layers import layers_of

    made = dict(options)
    data = made_of("data", options.get("data"), terrain)
    given = made_of("priority", options.get("priority"), terrain)
    aids = made_of("aids", options.get("aids"), terrain)
    if not data and given is None:
        return Themed(made, _walls(terrain, (), None, Priority()) if aids is not None and aids.walls else None)
    for one in data:
        if one.uncertainty is not None and one.uncertainty.style == "members":
            raise UsageError(
                "Members in turn are seen in films.", path=one.called,
                remedy='In a picture they stand side by side (`each="member"`), or choose another style.',
            )  # fmt: skip
    priority = given or Priority(data=True)
    around = [one for one in data if one.style == "walls"]
    if len(around) > 1:
        raise UsageError("Walls can show only one volume.", remedy="Give one of the data another style: curtains.")
    inside = tuple(one for one in data if one.style != "walls")
    stretch = float(options.get("exaggeration") or 1.0)
    aspects = priority.data, priority.uncertainty, max(size), stretch, id(terrain)

    def read(one: Dataset | tuple[Dataset, Dataset]) -> Shown | Things:
        return once("data", (one, aspects), lambda: _read(one, terrain, max(size), priority, stretch))

    found = [read(one) for one in pairs(inside)]
    standing = [_named(one, data) for one, data in zip(found, pairs(inside)) if isinstance(one, Things)]
    flat = [one for one in found if not isinstance(one, Things)]
    covered = any(not one.cased for one in flat)  # lines keep the colours of the ground
    usual = ({} if priority.terrain else _lines()) | (_ground() if covered or not priority.terrain else {})
    made = usual | {k: v for k, v in made.items() if k not in usual or not _usual(k, v)}
    if flat:
        made |= _cased(made, terrain)
    made["layers"] = (
        *layers_of(options.get("layers")),
        *(once("painted", id(one), partial(painted, one)) for one in flat),
    )
    things = Things.joined(standing) if standing else None
    if things is not None and aids is not None and aids.standing:
        things = _aided(things, aids, terrain)
    if around or (aids is not None and aids.walls):
        beside = _walls(terrain, flat, around[0] if around else None, priority, stretch)
        things = Things.joined([*([things] if things is not None else []), beside])
    return Themed(made | {"data": data, "priority": priority}, things, tuple(flat))


def _named(things: Things, dataset: Dataset | tuple[Dataset, Dataset]) -> Things:
    """Wrap things with the meaning of their values."""
    from orograph.geovis.data.standing import Variable

    key = things.legend
    if key.scales:
        return things.but(shows=(Variable(key.scales[0].label, key.scales[0].unit),), which=None)
    one = dataset if not isinstance(dataset, tuple) else dataset[0]
    classes = tuple(name for name, _ in key.classes)
    alike = one.name or one.variable or ("class" if len(classes) > 1 else "".join(classes))
    return things.but(shows=(Variable(alike.replace("_", " "), "", classes),), which=None)


def _read(
    dataset: Dataset | tuple[Dataset, Dataset], terrain: Terrain, pixels: int, priority: Priority, stretch: float
) -> Shown | Things:
    """How a dataset is shown: painted, or as standing things.

    Args:
        pixels: along the longer side of the picture. stretch: of its heights.
    """
    from orograph.geovis.data.bivariate import shown_pair
    from orograph.geovis.data.events import happened
    from orograph.geovis.data.features import has_features, read_features
    from orograph.geovis.data.painting import shown
    from orograph.geovis.data.points import is_table, read_points
    from orograph.geovis.data.shape_painting import shown_shapes
    from orograph.geovis.data.standing import stands, things_of
    from orograph.geovis.data.standing_columns import STYLES as PROFILES
    from orograph.geovis.data.standing_columns import things_of_profiles
    from orograph.geovis.data.standing_lines import things_of_lines
    from orograph.geovis.data.standing_sections import curtains

    grid, texels = terrain.grid, int(min(MOST, max(LEAST, FINER * pixels)))
    if isinstance(dataset, tuple):
        return shown_pair(*dataset, grid, texels)
    if dataset.style in ("tubes", "paths") and (moving := _tracks(dataset, terrain, stretch)) is not None:
        return moving
    features = read_features(dataset, grid) if has_features(dataset.source) else None
    if dataset.derived and (features is not None or is_table(dataset.source)):
        raise UsageError(
            "value= and exceeds= need rasters with several members or times.", path=dataset.called,
            remedy="Leave them out.",
        )  # fmt: skip
    pointed = is_table(dataset.source) if features is None else features.kind == "points"
    if not pointed and dataset.leveled is not None:
        raise UsageError(
            f"{dataset.leveled}= gives the heights of points, and these are not points.", path=dataset.called,
            remedy="Leave it out; lines float at their own z.",
        )  # fmt: skip
    if features is not None and features.kind != "points" and stands(dataset):
        return things_of_lines(dataset, features, grid, priority)
    if features is not None and features.kind != "points":
        return shown_shapes(dataset, features, grid, texels, texels / pixels, priority)
    if features is not None or is_table(dataset.source):
        dataset, points, when = happened(dataset, read_points(dataset, grid, features))
        if dataset.style in PROFILES:
            return things_of_profiles(dataset, points, grid, _ground_at(terrain, points.x, points.y))
        if dataset.leveled in ("above", "depth") and points.level is not None:
            base = _ground_at(terrain, points.x, points.y).reshape(-1, *[1] * (points.level.ndim - 1))
            points = replace(points, level=base + points.level * (-1.0 if dataset.depth is not None else 1.0))
        return things_of(dataset, points, grid, priority, dataset.unit or "", when)
    if dataset.style == "curtains":
        return curtains(dataset, grid, lambda x, y: _ground_at(terrain, x, y), stretch, priority.uncertainty)
    if stands(dataset):
        return _on_lattice(dataset, grid, priority)
    return shown(dataset, grid, texels, priority, lambda over: _heights(terrain, over))


def _tracks(dataset: Dataset, terrain: Terrain, stretch: float) -> Things | None:
    """The things that show tracks; None: a source of lines without times.

    Raises:
        UsageError: heights were requested as times.
    """
    from orograph.geovis.data.standing_tracks import things_of_tracks
    from orograph.geovis.data.times import seconds_of
    from orograph.geovis.data.tracks import read_tracks, rows_of

    rows = rows_of(dataset, terrain.grid)
    if rows is None and dataset.style == "tubes":
        return None
    if rows is None:
        raise UsageError("Its lines have no times.", path=dataset.called, remedy="Give points with times, or GPX.")
    moment = None if dataset.time is None else float(seconds_of([dataset.time], "time=", "value")[0])
    found = read_tracks(dataset.but(time=None), rows, terrain.grid)
    if dataset.above is not None or dataset.depth is not None:
        turn = 1.0 if dataset.above is not None else -1.0
        at = found.at.copy()
        at[:, 2] = _ground_at(terrain, at[:, 0], at[:, 1]) + turn * at[:, 2]
        found = found._replace(at=at)
    return things_of_tracks(dataset, found, terrain.grid, terrain.height_range[1], stretch, moment)


def _heights(terrain: Terrain, over: Grid) -> Any:
    """Heights (rows, cols) at the samples of a grid over a terrain; NaN where there are none.

    They come from the coarsest level that is fine enough.
    """
    from orograph.geovis.data.sampling import bilinear

    coarser, level = max(over.spacing) / max(terrain.grid.spacing), 0
    while level < terrain.levels - 1 and 2.0 ** (level + 1) <= coarser:
        level += 1
    (rows, cols), step = terrain.shape(level), 2.0**level
    values = terrain.read(level, 0, rows, 0, cols)
    col, row = terrain.grid.index(*over.xy(*np.meshgrid(np.arange(over.cols), np.arange(over.rows))))
    return bilinear(values, np.clip(col / step, 0, cols - 1), np.clip(row / step, 0, rows - 1)).astype(np.float64)


def _aided(things: Things, aids: Aids, terrain: Terrain) -> Things:
    """Things with aids that show where the floating ones are."""
    from orograph.geovis.data import standing_aids as made
    from orograph.geovis.data.standing import Things

    grid = terrain.grid
    at = made.floating(things, grid)
    ground = _ground_at(terrain, at.x, at.y)
    highest = float(np.nanmax(at.level - ground, initial=0.0))
    found = [things]
    if aids.drops:
        found.append(made.drops(at, ground, grid))
    if aids.poles is not None and highest > 0:
        step = round_number(highest / made.BANDS) if aids.poles == "auto" else float(aids.poles)
        found.append(made.poles(at, ground, step, grid))
    if aids.shadows and (below := made.shadows(things, _ground_at(terrain, *made.middles(things)))) is not None:
        found.append(below)
    return Things.joined(found)


def _walls(
    terrain: Terrain, painted: Sequence[Shown], volume: Dataset | None, priority: Priority, stretch: float = 1.0
) -> Things:
    """Sections on walls around a terrain, with a volume's values.

    They have the colours of the uppermost painted data that are numbers everywhere.
    """
    from orograph.geovis.data import standing_walls as made
    from orograph.geovis.data.sampling import values_at
    from orograph.geovis.data.standing_sections import Filling, middle_lines

    def ground(x: Any, y: Any) -> Any:
        return _ground_at(terrain, x, y)

    low, high = terrain.height_range
    filling = None
    if volume is not None:
        filling = Filling(volume, terrain.grid, ground, middle_lines(terrain.grid, made.COLUMNS),
                          priority.uncertainty)  # fmt: skip
        low, high = min(low, filling.span[0]), max(high, filling.span[1])
    below = [one for one in painted if one.cover is None and one.classes is None and one.square is None]

    def paint(x: Any, y: Any) -> Any:
        bare = made.plain(x, y)
        if not below:
            return bare
        one = below[-1]
        values = values_at(one.field.shown, one.field, terrain.grid, x, y)
        return np.where(np.isfinite(values)[:, None], one.scale.color(values), bare)

    step = round_number(max(high - low, 1e-3) / 5)
    return made.walls(terrain.grid, (low, max(high, low + 1e-3)), step, ground, paint, filling, stretch)


def _ground_at(terrain: Terrain, x: Any, y: Any) -> Any:
    """Heights (n,) of the surface at places in its CRS; NaN where there are none."""
    from orograph.measuring.ground import heights

    col, row = terrain.grid.index(x, y)
    rows, cols = terrain.grid.shape
    inside = (col >= 0) & (row >= 0) & (col <= cols - 1) & (row <= rows - 1)
    return np.where(inside, heights(terrain, np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1)), np.nan)


def _on_lattice(dataset: Dataset, grid: Grid, priority: Priority) -> Things:
    """The things that show a raster's values, on a lattice."""
    from orograph.geovis.data.derived import deviations, read_data
    from orograph.geovis.data.painting import as_shown
    from orograph.geovis.data.points import Points
    from orograph.geovis.data.sampling import values_at
    from orograph.geovis.data.standing import lattice_points, things_of

    field = read_data(dataset, grid)
    dataset = as_shown(dataset)
    if dataset.derived:
        dataset = dataset.but(name=field.name, unit=field.unit)
    x, y, dataset = lattice_points(dataset, grid)
    values = values_at(field.shown, field, grid, x, y)
    found = deviations(dataset, field, grid)
    sigma = None if found is None else values_at(found[1], found[0], grid, x, y)
    known = np.isfinite(values) & (np.isfinite(sigma) if sigma is not None else True)
    points = Points(x[known], y[known], values[known], None if sigma is None else sigma[known], field.name)
    return things_of(dataset, points, grid, priority, dataset.unit or field.unit, field.chosen)


def _ground() -> dict[str, Any]:
    """Ground without colours of its own, which would mix with those of data."""
    from orograph.geovis.tables import Table

    red, green, blue = (int(PAPER[i : i + 2], 16) for i in (1, 3, 5))
    return {"colormap": Table("paper", bytes((red, green, blue, 255)) * 2), "water": None}


def _lines() -> dict[str, Any]:
    """Options for terrain without priority: lines, and no shading."""
    return {"light": "none", "contours": Contours(color=INK, opacity=0.85), "silhouettes": Silhouettes(opacity=0.9)}


def _cased(options: dict[str, Any], terrain: Terrain) -> dict[str, Any]:
    """The options of lines, with a casing that keeps them legible over data of any colour."""
    found = {name: made_of(name, options.get(name), terrain) for name in ("contours", "silhouettes")}
    plain = {name: lines for name, lines in found.items() if lines is not None and lines.casing is None}
    return {name: replace(lines, casing=CASED) for name, lines in plain.items()}


def _usual(name: str, value: Any) -> bool:
    """Whether an option has its default value."""
    from orograph.scene.parts import OPTIONS

    return value is None or bool(value == OPTIONS[name].default)
