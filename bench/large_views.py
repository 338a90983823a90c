"""Methods out of core: four views of a large store, each selected twice with little memory, and what that reads.

    python bench/large_views.py STORE --method NAME[,key=value…]… [--tolerance 1] [--allowed 512MiB] [--no-referee]

The views of 1280 × 720 pixels: all of the terrain from afar, grazing (800 m above the ground), near (60 m above it),
and straight down from 3 km. Each method works in a process of its own, on one thread. A first selection makes or reads
what the view needs, a second one finds it. The table gives triangles and batches (patches, TINs or blocks), processor
milliseconds of both selections and of the triangles made from the second, megabytes that the process requested from the
system by then, the largest error in pixels by the referee, against every sample in view, and the defects it found. Then
the peak of anonymous memory before the referee, and with it. Needs /proc.
"""

from __future__ import annotations

import argparse
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orograph import store, verify
from orograph.folders import parse_bytes
from orograph.lod.method import Goal, Resources
from orograph.lod.registry import chosen
from orograph.store.terrain import Terrain
from orograph.viewpoint import Camera, View
from out_of_core import memory


def views(terrain: Terrain) -> Iterator[tuple[str, View]]:
    """The four views; the near ones stand over the middle of the terrain."""
    rows, cols = terrain.grid.shape
    row, col = rows // 2, cols // 2
    x, y = (float(v) for v in terrain.grid.xy(col, row))
    z = float(terrain.read(0, row, row + 1, col, col + 1)[0, 0])
    west, north = terrain.grid.xy(0, 0)
    extent = 2 * max(abs(x - west), abs(north - y))
    size = {"width": 1280, "height": 720, "fov_y": 45.0}
    yield "all of it, from afar", View((x, y - extent, z + 0.6 * extent), (x, y, z), **size)
    yield "grazing, 800 m above the ground", View((x, y, z + 800.0), (x + 8000.0, y + 8000.0, z + 600.0), **size)
    yield "near, 60 m above the ground", View((x, y, z + 60.0), (x + 300.0, y + 200.0, z), **size)
    yield "straight down, from 3 km", View((x, y, z + 3000.0), (x, y, z), **size)


def spent(work: Callable[[], Any]) -> tuple[Any, float]:
    """What ``work`` returns, and milliseconds of the processor."""
    began = time.process_time()
    return work(), 1e3 * (time.process_time() - began)


def read_so_far() -> int:
    """Bytes this process has requested from the system."""
    said = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(said["rchar"])


class Peak:
    """The most anonymous memory of this process, in bytes, while it is watched."""

    def __init__(self) -> None:
        self.bytes = 0
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            self.bytes = max(self.bytes, memory()[0])
            time.sleep(0.02)


def measure(place: str, label: str, tolerance: float, allowed: int, referee: bool) -> None:
    """One method, in this process: rows of the table."""
    terrain = store.open(place, cache_bytes=allowed // 4, jobs=1)
    peak = Peak()
    method, ms = spent(partial(chosen(label).make, terrain, Resources(allowed, 1)))
    print(f"\n`{label}`: made in {ms:,.0f} ms of the processor.\n", flush=True)
    print(
        "| view | triangles | batches | first, ms | again, ms | its triangles, ms | read, MB | largest px | defects |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    memories, last = [], read_so_far()
    for name, view in views(terrain):
        camera, goal = Camera.over(terrain.grid, view), Goal(tolerance)
        _, first = spent(partial(method.select, camera, goal))
        found, again = spent(partial(method.select, camera, goal))
        mesh, making = spent(found.tessellation)
        now = read_so_far()
        memories.append(peak.bytes)
        worst, defects = "–", "–"
        if referee:
            report = verify.judge_mesh(mesh, terrain, view, jobs=1)
            worst, defects = f"{report.largest:.3f}", str(sum(report.defects.values()))
        batches = next((found.stats[key] for key in ("patches", "blocks", "chunks") if key in found.stats), "–")
        print(
            f"| {name} | {len(mesh.triangles):,} | {batches} | {first:.1f} | {again:.1f} | {making:.0f} "
            f"| {(now - last) / 1e6:.1f} | {worst} | {defects} |", flush=True,
        )  # fmt: skip
        last = read_so_far()
    print(f"\nAnonymous memory: {np.max(memories) / 2**20:.0f} MiB, with the referee {peak.bytes / 2**20:.0f} MiB.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store")
    parser.add_argument("--method", action="append", required=True, metavar="NAME[,key=value…]")
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--allowed", default="512MiB", help="memory of a method")
    parser.add_argument("--no-referee", action="store_true")
    given = parser.parse_args()
    for label in given.method:
        how = given.store, label, given.tolerance, parse_bytes(given.allowed), not given.no_referee
        process = multiprocessing.get_context("spawn").Process(target=measure, args=how)
        process.start()
        process.join()


if __name__ == "__main__":
    main()
