"""HyperBlock-QuadTIN compared with QuadTIN on a flight: triangles and time up to the strips, by block size and levels.

    python bench/hyperblock.py [DEM | --size 1025] [--cell 30] [--frames 60] [--speed 100] [--tolerance 1]

The flight is that of ``bench/roam.py``: 300 m above the ground, 60 frames a second, turning. Times are milliseconds of
processor time per frame, from the view to its strip: median and 95th percentile, without the first ten frames, which
compile. *Made* is the share of blocks triangulated in a frame, *ready* the size of the blocks triangulated in advance,
and *build* the seconds to make the method, including the hierarchy that both have.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from orograph.lod.hyperblock_blocks import joined
from orograph.lod.method import Resources
from orograph.lod.registry import chosen
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View
from roam import flight, load
from synthetic import synthetic

FIRST = 10
RUNS = (
    "quadtin", "hyperblock", "hyperblock,cache=no", "hyperblock,cells=8", "hyperblock,cells=16",
    "hyperblock,cells=64", "hyperblock,cells=128", "hyperblock,levels=1", "hyperblock,levels=4",
)  # fmt: skip


def fly(terrain: MemoryTerrain, label: str, views: list[View], tolerance: float) -> str:
    """A row of the table."""
    began = time.process_time()
    method: Any = chosen(label).make(terrain, Resources(jobs=1))
    build = time.process_time() - began
    took, triangles, made, blocks = [], [], [], 0
    for view in views:
        camera = Camera.over(terrain.grid, view)
        began = time.process_time()
        refined = method._refine(camera, tolerance)
        if refined.strip is None:
            joined(method.tree.corners[refined.leaves])
        took.append(1e3 * (time.process_time() - began))
        triangles.append(len(refined.leaves))
        blocks = refined.stats.get("blocks", 0)
        made.append(refined.stats.get("triangulated", 0) / max(1, blocks))
    ready = sum(one.nbytes for one in method.ready.values()) / 1e6 if blocks else 0.0
    method.close()
    middle, most = np.percentile(took[FIRST:], [50, 95])
    cells = [f"{blocks:,}", f"{100 * np.mean(made[FIRST:]):.1f} %", f"{ready:.1f}"] if blocks else ["–", "–", "–"]
    count = np.mean(triangles[FIRST:])
    return f"| `{label}` | {count:,.0f} | {' | '.join(cells)} | {middle:.2f} | {most:.2f} | {build:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=1025)
    parser.add_argument("--cell", type=float, default=30.0, help="metres, of the DEM")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument("--tolerance", type=float, default=1.0)
    given = parser.parse_args()
    terrain = load(given.dem, given.cell) if given.dem else synthetic(given.size)
    views = flight(terrain, given.frames, given.speed)
    print(
        "| | triangles | blocks | made | ready, MB | ms, median | 95th | build, s |\n|---|--:|--:|--:|--:|--:|--:|--:|"
    )
    for label in RUNS:
        print(fly(terrain, label, views, given.tolerance), flush=True)


if __name__ == "__main__":
    main()
