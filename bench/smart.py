"""SMART on a flight: the gain from keeping strips by ranges of errors, and what ranges and blocks cost in triangles.

    python bench/smart.py [DEM | --size 4097] [--frames 120] [--speed 100] [--tolerance 1]

The flight is that of ``bench/roam.py``: 300 m above the ground, 60 frames a second, turning. Times are of a frame
(``mesh``), in ms of processor time, without the first ten frames, which read and compile: median and 95th percentile.
*Made* is the share of blocks whose strip was not kept. SOAR and the restricted quadtree fly the same way.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from orograph.lod.method import Goal, Resources
from orograph.lod.registry import chosen
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View
from roam import flight, load
from synthetic import synthetic

FIRST = 10
RUNS = (
    "soar", "soar,metric=anisotropic", "restricted-quadtree", "smart", "smart,cache=no",
    "smart,cells=16", "smart,cells=16,cache=no", "smart,cells=64", "smart,cells=64,cache=no",
    "smart,ranges=1", "smart,ranges=2", "smart,ranges=7", "smart,boxes=no",
)  # fmt: skip


def fly(terrain: MemoryTerrain, label: str, views: list[View], tolerance: float) -> str:
    """A row of the table."""
    method: Any = chosen(label).make(terrain, Resources(jobs=1))
    took, triangles, made = [], [], []
    for view in views:
        camera = Camera.over(terrain.grid, view)
        began = time.process_time()
        mesh, _ = method.mesh(camera, Goal(tolerance))
        took.append(1e3 * (time.process_time() - began))
        triangles.append(mesh.triangles)
        made.append(mesh.stats.get("triangulated", 0) / max(1, mesh.stats.get("blocks", 1)))
    method.close()
    share = f"{100 * np.mean(made[FIRST:]):.1f} %" if "blocks" in mesh.stats else "–"
    blocks = mesh.stats.get("blocks", "–")
    middle, most = np.percentile(took[FIRST:], [50, 95])
    count = np.mean(triangles[FIRST:])
    return f"| `{label}` | {count:,.0f} | {blocks} | {share} | {middle:.2f} | {most:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=4097)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--speed", type=float, default=100.0)
    parser.add_argument("--tolerance", type=float, default=1.0)
    given = parser.parse_args()
    if given.dem:
        terrain = load(given.dem, 30.0)
    else:
        terrain = synthetic(given.size)
    views = flight(terrain, given.frames, given.speed)
    print("| | triangles | blocks | made | ms, median | 95th |\n|---|--:|--:|--:|--:|--:|")
    for label in RUNS:
        print(fly(terrain, label, views, given.tolerance), flush=True)


if __name__ == "__main__":
    main()
