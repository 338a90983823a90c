"""Updating a store: only what depends on changed inputs is rebuilt, to the bytes of a new build.

A store that is built with ``update=True`` keeps the results of its tasks (``parts/``). An update begins a new build
beside the store, puts there whatever no changed input affects (shards of full resolution and parts, as hard links where
the file system has them), and resumes from that as from an interrupted build: existing objects are verified by their
digests, missing ones are built, and everything that depends on them is written. Readers keep the old files until the
new store takes its place. In a bucket both lie below the same key (``bucket_updates``).

Dependencies: the heights of a shard depend on its own samples and a row and a column beyond. The errors of an area
depend on samples within ``REACH``, on the lowest heights of tiles there, and, for octave k ≥ ``SMALL``, on the samples
at multiples of 2^k within 2^(k+1) of it. (The codes depend on the terrain's height range: parts made with another range
do not count, see ``survey``.) Results for a source lattice depend on the samples of the terrain that lie there.
Units: samples.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from orograph.error.diamonds import ALIGNED, REACH, SMALL
from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.store.bucket import BucketStorage
from orograph.store.coding import Coding
from orograph.store.colors import COLORS
from orograph.store.diamond_table import diamond_spec
from orograph.store.digests import Spot
from orograph.store.inputs import inputs_of
from orograph.store.lattices import LatticeRecord
from orograph.store.layers import LAYERS
from orograph.store.layout import Record, dumps, heights_spec
from orograph.store.places import HANDED, PARTS, PLAN, ROOT, begun, is_store
from orograph.store.plan import compared, differing, plan_of
from orograph.store.pyramid import part_key, tasks
from orograph.store.resampling import look_key
from orograph.store.source import HeightSource
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import read_record
from orograph.store.survey import area_of, errors_key
from orograph.store.terrain import TILE, Shape, exponent

ALL_AGAIN = ("patches", "chunks", "tins", "quadtin", HANDED.removeprefix(f"{PARTS}/"))
"""Stages of which an update can reuse nothing: the names in ``parts/`` of their results, and of the data handed to
workers."""

Window = tuple[int, int, int, int]
"""Rows and columns, half-open."""


def check_updatable(final: Storage, ways: dict[str, bool]) -> None:
    """Raise UsageError if an update is combined with options that it excludes, or is not possible there.

    Args:
        said: whether other kinds of builds are requested, by name.
    """
    if ways.pop("part"):
        raise UsageError(
            "`update` and `part` exclude each other: the remaining work depends on what one process takes over "
            "first.", remedy="Use `workers` or `dask`.",
        )  # fmt: skip
    for other, given in ways.items():
        if given:
            raise UsageError(f"`update` and `{other}` exclude each other.")
    if not isinstance(final, FolderStorage | BucketStorage):
        raise UsageError(
            "A store is updated in a folder or a bucket (s3://, gs://, az://).", path=final.url,
            remedy="Update a folder and publish that.",
        )  # fmt: skip


class Begun(NamedTuple):
    """The beginning of an update.

    Attributes:
        plan: the plan to use. going_on: whether parts of it exist. complete: whether there is nothing to do.
    """

    plan: dict[str, Any]
    going_on: bool
    complete: bool = False


def begin(
    final: FolderStorage, storage: FolderStorage, plan: dict[str, Any], raster: HeightSource, coding: Coding | None,
    progress: Progress,
) -> Begun:  # fmt: skip
    """Begin an update, or resume an interrupted one; where there is no store, begin a build.

    Args:
        final: the store. storage: where the new one is built.
        plan: the plan of the new one. raster, coding: its heights, and how they are stored.

    Raises:
        StoreError: something other than a store lies there.
    """
    there = is_store(final)
    if there and not differing(sized(plan, before := plan_of(read_record(final))), before):
        return Begun(plan, False, True)
    if (data := storage.get(PLAN)) is not None and not differing(sized(plan, before := read_plan(data)), before):
        return Begun(sized(plan, before), True)
    if not there and not begun(storage):
        compared(final, storage, plan, True)
    storage.remove(ROOT)  # first, so that a half-removed store does not look complete
    storage.remove()
    found = None
    if there:
        take = partial(_link, final, storage)
        found = seeded(final.url, read_record(final), final.exists(PARTS), take, plan, raster, coding, progress)
    storage.put(PLAN, [dumps(found or plan)])
    return Begun(found or plan, found is not None)


def read_plan(data: bytes) -> dict[str, Any]:
    """Parse a stored plan; empty if it is damaged."""
    try:
        found: dict[str, Any] = json.loads(data)
    except ValueError:
        return {}
    return found


def sized(plan: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """A plan with the shard size of an existing one: the size of new shards depends on the allowed memory."""
    return {**plan, "shard": before.get("shard"), "chunk": before.get("chunk")}


def seeded(
    url: str, record: Record, parts: bool, take: Callable[[Iterable[str]], None], plan: dict[str, Any],
    raster: HeightSource, coding: Coding | None, progress: Progress,
) -> dict[str, Any] | None:  # fmt: skip
    """Take over what has not changed in a store.

    Args:
        url, record: of the store. parts: whether it keeps the results of its tasks.
        take: takes over objects, by their keys; some may not exist.
        plan: the plan of the new one. raster, coding: its heights, and how they are stored.

    Returns:
        The plan to resume with; None if everything is rebuilt, with a note that says why.
    """
    if later := ", ".join([*LAYERS.of(record), *(["color errors"] if COLORS.of(record) else [])]):
        progress.warn(
            f"{url}: data added to the store later belong to the terrain as it was and are not kept: {later}."
        )
    before = {**plan_of(record), "source": None, "name": None}
    going_on = sized(plan, before)
    changed: list[Window] = []
    why = differing({**going_on, "source": None, "name": None}, before)
    why = f"its {why} differ" if why else ""
    if not why:
        why = _unlike(record, parts, raster, coding)
    if not why:
        found = changed_windows(record.inputs or {}, inputs_of(raster) or {})
        why, changed = ("", found) if isinstance(found, list) else (found, [])
    if why:
        progress.note(f"{url}: everything is rebuilt: {why}")
        return None
    shape = record.grid.shape
    every, sides = tasks(shape, record.shard), tasks(shape, area_of(record.shard))
    others = _Windows(changed)
    heights = [spot for spot in every if not others.meet(_grown(spot, record.shard, 1))]
    near = _Windows(_of_errors(shape, changed))
    errors = [spot for spot in sides if not near.meet(_grown(spot, area_of(record.shard), 0))]
    take(_keys(record, heights, errors))
    take(_keys_of_lattices(record, others))
    left = len(every) - len(heights)
    progress.note(
        f"{url}: {left:,} of {len(every):,} shards of heights and {len(sides) - len(errors):,} of "
        f"{len(sides):,} of errors are rebuilt"
    )
    return going_on


def _unlike(record: Record, parts: bool, raster: HeightSource, coding: Coding | None) -> str:
    """Why nothing can be reused of a store with an equal plan; empty if something can."""
    if not parts:
        return "it was built without `update`, and keeps no parts"
    before = record.coding
    if (None if before is None else before.step) != (None if coding is None else coding.step):
        return "the steps of the data have changed"
    lattices = [LatticeRecord.of(lattice) for lattice in getattr(raster, "resampled_from", ())]
    if [each.to_json() for each in lattices] != [each.to_json() for each in record.lattices]:
        return "its sources lie on other lattices, have another data type, or their samples are not kept"
    return ""


def changed_windows(before: dict[str, Any], now: dict[str, Any]) -> list[Window] | str:
    """Where inputs were added, changed or removed; or the reason why that is unknown.

    Args:
        before, now: from ``inputs.inputs_of``.
    """
    if not before or not now or not before.get("windows") or not now["windows"]:
        return "it was not built from raster files, whose windows are known"
    if before["options"] != now["options"] or before.get("geoid") != now.get("geoid"):
        return "its options differ"
    old, new = _by_path(before), _by_path(now)
    if len(old) < len(before["files"]) or len(new) < len(now["files"]):
        return "a file is named twice"
    if [path for path in old if path in new] != [path for path in new if path in old]:
        return "its files have another order"
    if any(state[0]["size"] is None for state in (*old.values(), *new.values())):
        return "it is unknown whether files at URLs have changed (orograph manifest finds out)"
    same = {path for path in old.keys() & new.keys() if old[path] == new[path]}
    return [state[2] for states in (old, new) for path, state in states.items() if path not in same]


def _by_path(inputs: dict[str, Any]) -> dict[str, tuple[dict[str, Any], list[dict[str, Any]], Window]]:
    return {
        file["path"]: (file, beside, tuple(window))
        for file, beside, window in zip(inputs["files"], inputs["beside"], inputs["windows"])
    }


def _of_errors(shape: Shape, changed: Iterable[Window]) -> Iterator[Window]:
    """Where errors depend on samples of windows."""
    for window in changed:
        yield _widened(window, TILE + REACH + ALIGNED)
        for octave in range(SMALL, exponent(shape)):
            step = 1 << octave
            rows, cols = (
                _multiples(window[2 * axis], window[2 * axis + 1], step, shape[axis]) for axis in range(2)
            )  # fmt: skip
            if rows and cols:
                yield _widened((rows[0], rows[1] + 1, cols[0], cols[1] + 1), 2 * step)


def _multiples(first: int, end: int, step: int, size: int) -> tuple[int, int] | None:
    """The first and the last multiple of a step in a span; the raster's last sample counts as one."""
    low, high = -(-first // step) * step, (end - 1) // step * step
    if end >= size:
        low, high = min(low, size - 1), size - 1
    return (low, high) if low <= high else None


def _widened(window: Window, by: int) -> Window:
    return window[0] - by, window[1] + by, window[2] - by, window[3] + by


def _grown(spot: Spot, side: int, beyond: int) -> Window:
    """A task's samples, extended by ``beyond``."""
    row, col = spot[0] * side, spot[1] * side
    return row, row + side + beyond, col, col + side + beyond


class _Windows:
    """A possibly very large set of windows, for intersection tests."""

    def __init__(self, windows: Iterable[Window]) -> None:
        self._ends = np.array(list(windows), np.int64).reshape(-1, 4).T

    def meet(self, one: Window) -> bool:
        """Whether any of them shares a sample with another window."""
        row0, row1, col0, col1 = self._ends
        return bool(((row0 < one[1]) & (row1 > one[0]) & (col0 < one[3]) & (col1 > one[2])).any())


def _keys(record: Record, heights: Iterable[Spot], errors: Iterable[Spot]) -> Iterator[str]:
    """The keys of the objects that tasks wrote, and of their results."""
    shape, sizes = record.grid.shape, (record.shard, record.chunk)
    finest = heights_spec(shape, 0, *sizes, record.coding)
    for spot in heights:
        yield finest.key(spot)
        yield part_key(spot)
    specs = [diamond_spec(shape, 0, name, *sizes) for name in (*plan_of(record)["errors"], "radius")]
    area = area_of(record.shard)
    for spot in errors:
        yield errors_key(spot)
        for spec in specs:
            rows, cols = (range(at * area // spec.shard, (at + 1) * area // spec.shard) for at in spot)
            yield from (spec.key((i, j)) for i in rows for j in cols)


def _keys_of_lattices(record: Record, changed: _Windows) -> Iterator[str]:
    """The same for source lattices; their windows are located on the terrain, with a margin."""
    from affine import Affine

    from orograph.dem.layers import box_of
    from orograph.geo.grid import Grid, compose

    for number, lattice in enumerate(record.lattices):
        spec = lattice.spec(number, record.shard, record.chunk)
        for spot in tasks(spec.shape, spec.shard):
            row0, row1, col0, col1 = spec.window(spot)
            place = compose(lattice.grid.transform, Affine.translation(col0, row0))
            grid = Grid((row1 - row0, col1 - col0), place, lattice.grid.crs)
            if not changed.meet(box_of(grid, record.grid, 17)):
                yield look_key(number, spot)
                yield spec.key(spot)


def _link(final: FolderStorage, storage: FolderStorage, keys: Iterable[str]) -> None:
    """Link files of one store into another; missing ones are skipped."""
    made: set[Path] = set()
    for key in keys:
        source, target = final.path / key, storage.path / key
        if not source.exists():
            continue
        if target.parent not in made:
            target.parent.mkdir(parents=True, exist_ok=True)
            made.add(target.parent)
        try:
            os.link(source, target)
        except OSError:  # (a file system without links)
            shutil.copyfile(source, target)
