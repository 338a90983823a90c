"""The modes of a build: which can be combined, and what runs the tasks of each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from orograph.errors import UsageError
from orograph.parallel import threads_for
from orograph.store.coding import Coding
from orograph.store.executing import Executor, Threads
from orograph.store.places import PLAN, UPDATE, remove_unbegun
from orograph.store.source import HeightSource
from orograph.store.storage import Storage
from orograph.store.terrain import Shape, level_count, level_shape

SHARDS = (2048, 1024, 512)
BASE = 280 << 20  # the interpreter, its libraries and their caches
READER = 160 << 20  # memory of a mosaic while it reads one window


class AtOnce(NamedTuple):
    """How much runs in parallel.

    Attributes:
        jobs: threads of a process. memory: bytes of all processes together. base: what each process takes without
            a task. task: what a task takes.
    """

    jobs: int
    memory: int
    base: int
    task: int


LEAST_CHUNK = 8
"""Samples along a side of the smallest chunk."""


def check_sides(shard: int, chunk: int) -> None:
    """Raise UsageError unless shards and chunks are squares that a store can have."""
    if chunk < LEAST_CHUNK or chunk & (chunk - 1):
        raise UsageError(f"`chunk` must be a power of two, at least {LEAST_CHUNK}, not {chunk}.")
    if shard < chunk or shard & (shard - 1):
        raise UsageError(
            f"`shard` must be a power of two, at least `chunk` ({chunk}), not {shard}.",
            remedy="Make `chunk` smaller, or leave `shard` out: it follows from `max_memory`.",
        )


def check_ways(overwrite: bool, resume: bool, part: object, finish: bool, workers: int | None, dask: object) -> None:
    """Raise UsageError if modes of a build exclude each other."""
    if overwrite and resume:
        raise UsageError("A build either resumes or overwrites, not both.")
    if workers is not None and workers < 1:
        raise UsageError(f"A build needs at least one worker, not {workers}.")
    given = {
        "`part`": part is not None, "`finish`": finish, "`resume`": resume, "`workers`": workers is not None,
        "`dask`": dask is not None,
    }  # fmt: skip
    apart = [("`part`", other) for other in ("`finish`", "`resume`", "`workers`", "`dask`")]
    for one, other in (*apart, ("`workers`", "`dask`")):
        if given[one] and given[other]:
            raise UsageError(f"{one} and {other} exclude each other.")


@contextmanager
def executor_of(
    raster: HeightSource, storage: Storage, storage_options: dict[str, Any] | None, plan: dict[str, Any],
    coding: Coding | None, at_once: AtOnce, going_on: bool, update: bool, workers: int | None, dask: Any,
) -> Iterator[Executor]:  # fmt: skip
    """Enter the executor for the tasks of a build, which leaves nothing there if it fails before a task is done.

    Args:
        storage: where the store is built; its plan is there.
        coding: how heights are encoded.
        going_on: whether earlier work may exist. update: whether later updates reuse the results of tasks.
        workers, dask: as for ``build``.

    Raises:
        UsageError: there is no such cluster, or this terrain cannot be built on one.
    """
    try:
        if workers is None and dask is None:
            yield Threads(at_once.jobs, going_on)
        else:
            with _cluster(raster, storage, storage_options, plan, coding, at_once, update, workers, dask) as cluster:
                yield cluster
    except Exception:
        if not update:
            remove_unbegun(storage)
        raise


@contextmanager
def _cluster(
    raster: HeightSource, storage: Storage, storage_options: dict[str, Any] | None, plan: dict[str, Any],
    coding: Coding | None, at_once: AtOnce, update: bool, workers: int | None, dask: Any,
) -> Iterator[Executor]:  # fmt: skip
    """Enter a cluster that builds a store."""
    from orograph.store.build_state import recipe_of
    from orograph.store.clusters import Cluster, levels_of
    from orograph.store.workforce import workforce

    at = UPDATE if update and storage.remote else PLAN
    recipe = recipe_of(raster, storage, storage_options, plan, coding, at, at_once.task, at_once.base)
    with workforce(workers, dask, at_once.jobs, at_once.memory, at_once.base + at_once.task) as client:
        if not update:  # (an update reuses the results of single shards)
            recipe = recipe._replace(levels=levels_of(client, raster.grid.shape, plan["shard"]))
        with Cluster(client, recipe, recipe.levels) as cluster:
            yield cluster


def sizes(shape: Shape, max_memory: int, jobs: int | None, shard: int | None, kinds: int) -> tuple[int, int]:
    """Return the side of the shards and the number of concurrent tasks that fit the allowed memory."""
    wanted = threads_for(jobs)
    for side in SHARDS if shard is None else (shard,):
        for at_once in range(wanted, 0, -1):
            if memory_of(shape, side, at_once, kinds) <= max_memory:
                return side, at_once
    return shard or SHARDS[-1], 1


def memory_of(shape: Shape, shard: int, jobs: int, kinds: int) -> int:
    """Estimate what a build holds at once: its tasks, and the open coarse shards (two at level 1)."""
    from orograph.store.survey import memory

    unit = 4 * shard * shard
    coarse = 0
    for level in range(1, level_count(shape)):
        rows, cols = level_shape(shape, level)
        coarse += 2 * (2 if level == 1 else 1) * min(unit, 4 * rows * cols)
    heights = jobs * (4 * unit + READER) + coarse
    return BASE + max(heights, READER + memory(shape, shard, jobs, kinds) if kinds else 0)
