"""The expected cost of building a planet on a cluster: a simulation with measured unit costs.

    python bench/cluster_plan.py [--data ../shared/data] [--tiles 9]

One process builds California, and each task is timed by itself: seconds of processor time, bytes written, and the time
that the building process takes to merge its result. This is done once shard by shard, and once for each size of groups,
because larger groups hand on less. The simulation is an event queue with these tasks, scaled to the samples of the
planet. The scheduler takes 1 ms per task, a worker (one thread) runs one task at a time and moves its bytes at 100
MB/s, the building process merges the results one by one, and stages follow each other. Nothing here has run on such a
cluster. Printed are the unit costs, the table of docs/clusters.md, and the work of the building process by kind.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import importlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from orograph import store
from orograph.progress import Progress
from orograph.store.clusters import EACH
from orograph.store.executing import ShardStage
from orograph.store.groups import MOST

SHARD = 2048
SCHEDULER = 1e-3
BUCKET = 100e6
PRICE = 0.05
"""Dollars per hour and worker of one thread."""

PLANETS = {
    "ASTER, 22,600 tiles": (22_600 * 3601 * 3601, 750e9),
    "GLO-30, 26,000 tiles": (26_000 * 3600 * 3600, 26_000 * 3600 * 3600 * 2.4),
}
"""Samples, and bytes to read."""

WORKERS = (1, 4, 16, 64, 128, 256, 512)

GROUPED = ("heights", "errors")
"""Stages whose tasks are groups of shards, if there are enough groups for all workers."""


class Cost(NamedTuple):
    """The cost of a stage, per sample of level 0.

    Attributes:
        work: seconds of a worker.
        add: seconds of the building process to merge results.
        finish: seconds of the building process at the end.
        written: bytes.
    """

    work: float
    add: float
    finish: float
    written: float


class Timed:
    """An executor that runs tasks one by one and records their cost. Args: levels: of groups; 0: none."""

    def __init__(self, levels: int) -> None:
        self.costs: dict[str, Cost] = {}
        self.levels = levels
        self.samples = 0

    def groups(self, stage: str, shape: Any, shard: int) -> int:
        self.samples = shape[0] * shape[1]
        return self.levels

    def run(self, stage: ShardStage[Any], progress: Progress) -> None:
        work = add = written = 0.0
        put = stage.writer.storage.put

        def counted(key: str, parts: Sequence[bytes]) -> None:
            nonlocal written
            written += sum(map(len, parts))
            put(key, parts)

        stage.writer.storage.put = counted  # type: ignore[method-assign]
        for spot in stage.tasks():
            t0 = time.process_time()
            stage.make(spot)
            t1 = time.process_time()
            found = stage.found(spot, proof=False)
            assert found is not None
            stage.add(spot, found)
            work, add = work + t1 - t0, add + time.process_time() - t1
        t0 = time.process_time()
        stage.finish()
        finish = time.process_time() - t0
        stage.writer.storage.put = put  # type: ignore[method-assign]
        before = self.costs.get(stage.name, Cost(0, 0, 0, 0))
        found_now = (work, add, finish, written)
        self.costs[stage.name] = Cost(*(a + b / self.samples for a, b in zip(before, found_now, strict=True)))


def measured(files: list[str], levels: int) -> tuple[dict[str, Cost], int]:
    """Unit costs by stage, with groups of so many levels (the lower of two builds), and the number of samples."""
    timed = Timed(levels)

    @contextlib.contextmanager
    def executor(*_: Any) -> Iterator[Timed]:
        yield timed

    building: Any = importlib.import_module("orograph.store.build")  # the package has the function under this name
    own = building.executor_of
    building.executor_of = executor
    try:
        with tempfile.TemporaryDirectory() as folder:
            runs = []
            for name in ("one", "two"):
                timed.costs = {}
                store.build(files, Path(folder) / name, shard=SHARD, jobs=1, progress=False).close()
                runs.append(timed.costs)
    finally:
        building.executor_of = own
    return {name: Cost(*map(min, cost, runs[1][name])) for name, cost in runs[0].items()}, timed.samples


class Outcome(NamedTuple):
    """A simulation's seconds, the busy share of each party, and the building process's seconds by kind of work."""

    seconds: float
    busy: dict[str, float]
    combined: dict[str, float]


def simulated(costs: list[dict[str, Cost]], samples: int, read: float, workers: int) -> Outcome:
    """Simulate a build with so many workers. Args: costs: by levels of groups."""
    now, busy = 0.0, dict.fromkeys(("workers compute", "workers move bytes", "scheduler", "combining"), 0.0)
    combined: dict[str, float] = {}
    for name in costs[0]:
        levels = len(costs) - 1 if name in GROUPED else 0
        while levels and samples / (SHARD**2 * 4**levels) < EACH * workers:
            levels -= 1  # smaller groups, as builds choose
        cost = costs[levels][name]
        tasks = max(1, round(samples / (SHARD**2 * 4**levels)))
        compute = cost.work * samples / tasks
        move = (read_by(name, samples, read) + cost.written * samples) / tasks / BUCKET
        add = cost.add * samples / tasks
        free = [now] * workers
        given = added = now
        for _ in range(tasks):
            given = max(given, free[0]) + SCHEDULER
            done = given + compute + move
            heapq.heapreplace(free, done)
            added = max(added, done) + add
        took = (compute / workers, move / workers, SCHEDULER, add)
        for what, seconds in zip(busy, took, strict=True):
            busy[what] += tasks * seconds
        busy["combining"] += cost.finish * samples
        combined |= {f"{name}, tasks": tasks * add, f"{name}, finish": cost.finish * samples}
        now = max(added, *free) + cost.finish * samples
    return Outcome(now, {what: took / now for what, took in busy.items()}, combined)


def read_by(stage: str, samples: float, read: float) -> float:
    """Bytes that a stage reads: those of the files, or heights of the store."""
    return 5.0 * samples if stage == "errors" else read


def tell_costs(costs: list[dict[str, Cost]], samples: int) -> None:
    """Print the unit costs per sample, task and megabyte."""
    for levels, found in enumerate(costs):
        for name, cost in found.items():
            if levels and name not in GROUPED:
                continue
            each = SHARD**2 * 4**levels
            moved = read_by(name, each, 2.4 * each) + cost.written * each
            print(
                f"{name}, {'shards' if not levels else f'groups of {4**levels} shards'}: {1e9 * cost.work:.0f} ns a "
                f"sample of a worker, {1e9 * cost.add:.2f} + {1e9 * cost.finish:.2f} of the process that builds, "
                f"{cost.written:.2f} bytes written; a task {cost.work * each:.1f} s and {moved / 1e6:.0f} MB, a shard "
                f"{cost.work * SHARD**2:.2f} s and {1e3 * cost.add * SHARD**2:.0f} ms, a megabyte moved "
                f"{1e9 * cost.work * each / moved:.0f} ms"
            )
    for levels in (0, len(costs) - 1):
        of = [costs[levels if name in GROUPED else 0][name] for name in costs[0]]
        print(
            f"All of it, {'shards' if not levels else f'groups of {4**levels} shards'}: "
            f"{1e9 * sum(cost.work for cost in of):.0f} ns a sample of workers, "
            f"{1e9 * sum(cost.add + cost.finish for cost in of):.1f} of the process that builds, "
            f"{sum(cost.written for cost in of):.1f} bytes written; measured on {samples / 1e6:.1f} M samples"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--tiles", type=int, default=9, help="tiles of California to build")
    given = parser.parse_args()
    files = sorted(map(str, (given.data / "california-3s-tiles").glob("*.tif")))
    if not files:
        raise SystemExit(f"No tiles in {given.data / 'california-3s-tiles'}.")
    files = files[: given.tiles]
    measured(files[:2], 1)  # compiles the kernels
    found = [measured(files, levels) for levels in range(MOST + 1)]
    costs, samples = [each for each, _ in found], found[0][1]
    tell_costs(costs, samples)
    print("\n| workers | " + " | ".join(f"{name}: hours | dollars" for name in PLANETS) + " | busiest |")
    print("|---" * (2 + 2 * len(PLANETS)) + "|")
    for workers in WORKERS:
        runs = [simulated(costs, *planet, workers) for planet in PLANETS.values()]
        hours = [run.seconds / 3600 for run in runs]
        cells = " | ".join(f"{each:.1f} | {each * workers * PRICE:.0f}" for each in hours)
        busy = runs[0].busy
        most = max(busy, key=busy.__getitem__)
        print(f"| {workers} | {cells} | {most} ({100 * busy[most]:.0f} %) |")
    print(f"\nOf the work of the process that builds, {workers} workers, {next(iter(PLANETS))}:")
    spent = runs[0].combined
    for what, seconds in sorted(spent.items(), key=lambda each: -each[1]):
        print(f"{what}: {seconds:.0f} s, {seconds / sum(spent.values()):.0%}")


if __name__ == "__main__":
    main()
