"""A build by workers compared with threads, an idle cluster, and the memory of all processes over thousands of tasks.

    python bench/cluster_processor.py [--data ../shared/data] [--tiles 9] [--workers 2] [--tasks 3000]

Threads and the same number of workers run the same build; starting and compiling are not counted. The times are
processor seconds of all processes, which depend little on other load, and wall seconds. Before that come builds of
small shards, one after another, and the memory of every process after each number of tasks.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from orograph import store
from orograph.store import clusters
from orograph.store.executing import Threads
from orograph.store.groups import group_levels
from orograph.store.workforce import workforce

ALL: dict[str, Any] = {"shard": 1024, "errors": ("exact", "midpoint"), "tins": 16, "chunked": (32, 0)}
SMALL: dict[str, Any] = {"shard": 128, "chunk": 64}


def spent(processes: list[psutil.Process]) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def everybody(client: Any) -> list[psutil.Process]:
    """This process and the workers."""
    return [psutil.Process(), *(psutil.Process(pid) for pid in client.run(__import__("os").getpid).values())]


def idle(client: Any, seconds: float = 10.0) -> None:
    processes = everybody(client)
    before = spent(processes)
    time.sleep(seconds)
    print(f"idle for {seconds:.0f} s: {spent(processes) - before:.2f} s of processors", flush=True)


@contextmanager
def by_stage(processes: list[psutil.Process]) -> Iterator[dict[str, tuple[float, float]]]:
    """Processor seconds of each stage of a build: of this process, and of the workers."""
    found: dict[str, tuple[float, float]] = {}
    runs = {kind: kind.run for kind in (Threads, clusters.Cluster)}

    def timed(kind: type) -> Any:
        def run(self: Any, stage: Any, progress: Any) -> None:
            before = spent(processes[:1]), spent(processes[1:])
            runs[kind](self, stage, progress)
            own, rest = found.get(stage.name, (0.0, 0.0))
            found[stage.name] = own + spent(processes[:1]) - before[0], rest + spent(processes[1:]) - before[1]

        return run

    for kind in runs:
        kind.run = timed(kind)  # type: ignore[method-assign]
    try:
        yield found
    finally:
        for kind, run in runs.items():
            kind.run = run  # type: ignore[method-assign]


def beside_threads(files: list[str], folder: Path, client: Any, workers: int) -> None:
    idle(client)
    found = []
    for what, how in ((f"{workers} threads", {"jobs": workers}), (f"{workers} workers", {"dask": client, "jobs": 1})):
        store.build(files[:1], folder / "warm", overwrite=True, progress=False, **ALL, **how).close()
        processes, began = everybody(client), time.perf_counter()
        before = spent(processes)
        with by_stage(processes) as stages:
            store.build(files, folder / what, progress=False, **ALL, **how).close()
        found.append((spent(processes) - before, time.perf_counter() - began))
        print(f"{what}: {found[-1][0]:.1f} s of processors, {found[-1][1]:.1f} s on the clock", flush=True)
        print(
            "of it: " + ", ".join(f"{name} {own:.1f} + {rest:.1f}" for name, (own, rest) in stages.items()), flush=True
        )
    (work, clock), (others, other) = found
    print(f"workers take {others / work:.2f} times the processor time, {other / clock:.2f} times as long", flush=True)


@contextmanager
def counted() -> Iterator[list[int]]:
    """The number of tasks done."""
    done, lock, hear = [0], threading.Lock(), clusters._Round._hear

    def heard(self: Any, found: Any) -> None:
        with lock:
            done[0] += 1
        hear(self, found)

    clusters._Round._hear = heard  # type: ignore[method-assign]
    try:
        yield done
    finally:
        clusters._Round._hear = hear  # type: ignore[method-assign]


def memory(files: list[str], folder: Path, client: Any, least: int) -> None:
    processes = everybody(client)
    with counted() as done:
        while done[0] < least:
            store.build(files, folder / "small", overwrite=True, dask=client, progress=False, **SMALL).close()
            sizes = ", ".join(f"{process.memory_info().rss / 2**20:.0f}" for process in processes)
            print(f"after {done[0]} tasks, MiB of this process and the workers: {sizes}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--tiles", type=int, default=9)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--tasks", type=int, default=3000)
    given = parser.parse_args()
    files = sorted(map(str, (given.data / "california-3s-tiles").rglob("*.tif")))
    with tempfile.TemporaryDirectory() as name, workforce(given.workers, None, 1, 4 << 30, 0) as client:
        clusters.group_levels = lambda *_: 0  # shard by shard: as many tasks as there can be
        memory(files[:2], Path(name), client, given.tasks)
    clusters.group_levels = group_levels
    with tempfile.TemporaryDirectory() as name, workforce(given.workers, None, 1, 4 << 30, 0) as client:
        beside_threads(files[: given.tiles], Path(name), client, given.workers)


if __name__ == "__main__":
    main()
