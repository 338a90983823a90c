"""Builds in parts, for job arrays: processes that know nothing of each other, on any number of machines.

``part`` I of N builds its share of the heights, whole groups of shards (``groups``), and ends. Parts run in any order,
or concurrently, and never wait for each other. They share the store's lock, which is restricted to parts with the same
plan and N. A killed part resumes where it stopped when it is run again. When all are complete, ``finish`` makes the
levels above them and all that depends on the heights, and publishes the store.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from orograph.errors import StoreError, UsageError
from orograph.progress import Progress
from orograph.store.coding import Coding
from orograph.store.digests import Spot
from orograph.store.executing import Executor, Stage
from orograph.store.groups import Groups, group_levels
from orograph.store.layout import dumps
from orograph.store.lock import alone
from orograph.store.places import PLAN, ROOT, begun, is_store, missing, occupied, remove_unbegun
from orograph.store.pyramid import Finest, Pyramid
from orograph.store.shards import go_through
from orograph.store.source import HeightSource
from orograph.store.storage import FolderStorage, Storage
from orograph.store.terrain import Shape
from orograph.store.writer import ShardWriter

EACH = 4
"""Minimum number of groups in a part, if there are so many: parts are then about equally large."""

Part = tuple[int, int]
"""I and N: part I of N, from 1 to N."""


def part_of(part: str | Sequence[int]) -> Part:
    """Parse a part: "3/64", or (3, 64).

    Raises:
        UsageError: it is not a part.
    """
    if isinstance(part, str):
        found = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", part)
        numbers = [int(number) for number in found.groups()] if found else []
    else:
        numbers = [int(number) for number in part]
    if len(numbers) != 2 or not 1 <= numbers[0] <= numbers[1]:
        raise UsageError(f"A part must be I/N with I from 1 to N, such as 3/64, not {part!r}.")
    return numbers[0], numbers[1]


def levels_of(shape: Shape, shard: int, count: int) -> int:
    """Levels of the groups of a build in ``count`` parts."""
    return group_levels(shape, shard, EACH * count)


def share(tasks: Sequence[Spot], part: Part) -> Sequence[Spot]:
    """The tasks of a part, which are consecutive."""
    index, count = part
    return tasks[len(tasks) * (index - 1) // count : len(tasks) * index // count]


def build_part(
    raster: HeightSource, final: Storage, storage: Storage, plan: dict[str, Any], coding: Coding | None,
    part: Part, jobs: int, overwrite: bool, progress: Progress, leave: Callable[[Storage], None],
) -> None:  # fmt: skip
    """Build a part of a store.

    Args:
        final: where the store will be. storage: where it is built.
        plan: the build's plan. coding: how heights are encoded. jobs: threads.
        overwrite: whether the finished store may replace an existing one.
        leave: stores beside the build what other parts can reuse of the source.

    Raises:
        StoreError: a store, or another build, is there; or the sources have changed meanwhile.
        ReadError: a source cannot be read.
    """
    count = part[1]
    plan = {**plan, "parts": count}
    data = dumps(plan)
    with alone(final, "building this store in parts", shared=hashlib.blake2b(data, digest_size=16).hexdigest()) as last:
        _begin(final, storage, data, count, overwrite)
        if isinstance(storage, FolderStorage):
            storage = FolderStorage(storage.path, many=True)
        try:
            leave(storage)
            _make(raster, storage, plan, coding, part, jobs, progress)
        except Exception:
            if last():
                remove_unbegun(storage)
            raise
        if raster.fingerprint() != plan["source"]:
            raise StoreError(
                "Its sources changed while a part of it was built.", path=final.url,
                remedy=f"Remove {storage.url} and build all parts again when they are complete.",
            )  # fmt: skip
        storage.close()


def _make(
    raster: HeightSource, storage: Storage, plan: dict[str, Any], coding: Coding | None, part: Part, jobs: int,
    progress: Progress,
) -> None:  # fmt: skip
    """Do the tasks of a part."""
    index, count = part
    finest = Finest(raster, ShardWriter(storage), plan["shard"], plan["chunk"], coding)
    levels = levels_of(raster.grid.shape, plan["shard"], count)
    stage: Stage[Any] = Groups(finest, levels) if levels else Pyramid(finest)

    def do(spot: Spot) -> None:
        if stage.found(spot) is None:
            stage.make(spot)

    go_through(f"Building part {index} of {count}", share(stage.tasks(), part), do, jobs, progress)


def _begin(final: Storage, storage: Storage, plan: bytes, count: int, overwrite: bool) -> None:
    """Write the plan where the store is built, or check that the plan there is the same."""
    there = storage.get(PLAN)
    if there is not None:
        if there != plan:
            parts = count_of(there)
            other = f" It is in {parts} parts." if parts not in (None, count) else ""
            raise StoreError(
                f"Another build of this store was begun, with other files or options.{other}", path=final.url,
                remedy=f"Run the parts with its files and options, or remove {storage.url} to start again.",
            )  # fmt: skip
        return
    if begun(storage):
        raise missing(final)  # complete, except for its last rename
    if is_store(final) and not (overwrite and not final.remote):
        remedy = "Use `overwrite=True` in all parts to replace it in the end." if not final.remote else "Remove it."
        raise StoreError("A store is there already.", path=final.url, remedy=remedy)
    if not is_store(final) and occupied(final):
        raise StoreError(
            "Something is there that is not an Orograph store.", path=final.url, remedy="Choose another place."
        )
    storage.put(PLAN, [plan])


def count_of(plan: bytes) -> int | None:
    """The number of parts in which work is done, by its plan; None if it is not in parts."""
    try:
        found = json.loads(plan).get("parts")
    except (ValueError, AttributeError):
        return None
    return found if isinstance(found, int) else None


def parts_begun(final: Storage, storage: Storage) -> int:
    """The number of parts of the build that was begun; 0 if all of it is done (except for the last rename).

    Raises:
        StoreError: none was begun, or it is not in parts.
    """
    count = count_of(storage.get(PLAN) or b"")
    if storage.exists(ROOT) or (is_store(final) and not begun(storage)):
        return 0
    if count is None:
        what = "A build was begun there that is not in parts." if begun(storage) else "No part of it was built."
        remedy = "Finish it with `resume=True`." if begun(storage) else "Build its parts first: `part=(1, N)`."
        raise StoreError(what, path=final.url, remedy=remedy)
    return count


class Gathering:
    """Runs the stages of a build whose heights were made in parts.

    Args:
        url: the store's. count: the number of parts. then: runs the other stages.
    """

    def __init__(self, url: str, count: int, then: Executor) -> None:
        self.url, self.count, self.then, self.here = url, count, then, then.here

    def groups(self, stage: str, shape: Shape, shard: int) -> int:
        return levels_of(shape, shard, self.count) if stage == Pyramid.name else self.then.groups(stage, shape, shard)

    def run(self, stage: Stage[Any], progress: Progress) -> None:
        """Run a stage, as all executors do.

        Raises:
            StoreError: parts are missing.
        """
        if stage.name == Pyramid.name:
            gather([stage], self.count, self.url, progress)
        else:
            self.then.run(stage, progress)


def gather(stages: Sequence[Stage[Any]], count: int, url: str, progress: Progress) -> None:
    """Combine the results of parts, and finish the stages.

    Args:
        stages: stages with the same tasks, which the parts have shared. count: the number of parts. url: of the
            result, for errors.

    Raises:
        StoreError: parts are missing, or their results are damaged; the message names all of them.
    """
    tasks = stages[0].tasks()
    left = {spot for stage in stages for spot in tasks if not stage.kept(spot)}
    if left:
        raise missing_parts(tasks, left, count, url)

    def take(stage: Stage[Any], spot: Spot) -> None:
        found = stage.found(spot, proof=False)
        if found is None:
            left.add(spot)
        else:
            stage.add(spot, found)

    for stage in stages:
        go_through("Gathering the parts", tasks, partial(take, stage), 1, progress)
        if not left:
            stage.finish()
    if left:
        raise missing_parts(tasks, left, count, url)


def missing_parts(tasks: Sequence[Spot], left: set[Spot], count: int, url: str) -> StoreError:
    """The error that lists which of ``count`` parts have tasks left."""
    parts = [i for i in range(1, count + 1) if left.intersection(share(tasks, (i, count)))]
    many = len(parts) > 1
    return StoreError(
        f"{'Parts' if many else 'Part'} {_runs(parts)} of {count} {'are' if many else 'is'} missing, "
        "or not complete.", path=url, remedy=f"Run {'them' if many else 'it'} again, then finish.",
    )  # fmt: skip


def _runs(numbers: Sequence[int]) -> str:
    """Numbers in ascending order, abbreviated: "1-3, 7"."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)
