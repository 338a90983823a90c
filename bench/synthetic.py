"""The benchmarks' synthetic terrain, in memory or as a store: that of ``orograph synth --size SIZE --seed SEED``.

    python bench/synthetic.py SIZE [--folder FOLDER] [--jobs N]

builds the store ``synthetic-SIZE.oro`` straight from the terrain's formula, block by block, without writing a raster
(one of 65537² samples would be a file of 17 GB). The next call finishes an interrupted build.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path

import numpy as np
from affine import Affine

from orograph import store
from orograph.dem.synth import Synth
from orograph.errors import OutputError
from orograph.folders import cache_folder
from orograph.geo.grid import Grid
from orograph.progress import SILENT, Progress
from orograph.store.memory import MemoryTerrain
from orograph.store.stored import StoredTerrain

SEED, CELL = 7, 30.0

LEFT = 15 << 30
"""Bytes to leave free on the disk."""

PER_SAMPLE = 4.5
"""Bytes of a store per sample, at most: heights, means and errors, compressed."""


def synthetic(size: int, seed: int = SEED, cell: float = CELL) -> MemoryTerrain:
    """A square of so many samples a side, ``cell`` metres apart, in memory."""
    grid = Grid((size, size), Affine(cell, 0, 0, 0, -cell, 0), None)
    synth = Synth(grid.shape, seed)
    parts = [synth.read(row, min(row + 512, size), 0, size) for row in range(0, size, 512)]
    return MemoryTerrain(np.concatenate(parts), grid, "synthetic")


def synthetic_store(
    size: int, folder: Path | None = None, *, jobs: int | None = None, progress: Progress = SILENT
) -> StoredTerrain:
    """The same as a store in ``folder`` (default: the cache), built unless it is there.

    Raises:
        OutputError: the disk is full.
    """
    place = (folder or cache_folder()) / f"synthetic-{size}.oro"
    if place.is_dir():
        return store.open(place)
    place.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(place.parent).free
    if free - PER_SAMPLE * size * size < LEFT:
        raise OutputError(
            f"A store of {size}² samples may take {PER_SAMPLE * size * size / 1e9:.0f} GB, and {free / 1e9:.0f} GB "
            "are free.", path=place, remedy="Give another folder.",
        )  # fmt: skip
    source = Synth((size, size), SEED, spacing=CELL)
    source.prepare()
    return store.build(source, place, resume=True, jobs=jobs, progress=progress)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("size", type=int)
    parser.add_argument("--folder", type=Path, help="default: the cache")
    parser.add_argument("--jobs", type=int)
    options = parser.parse_args()
    begun, processor = time.perf_counter(), time.process_time()
    terrain = synthetic_store(options.size, options.folder, jobs=options.jobs)
    place = Path(terrain.url)
    size = sum(f.stat().st_size for f in place.rglob("*") if f.is_file())
    print(
        f"{place}: {size / 1e9:.2f} GB, {size / options.size**2:.2f} bytes per sample; "
        f"{time.perf_counter() - begun:.0f} s, {time.process_time() - processor:.0f} s of processors"
    )


if __name__ == "__main__":
    main()
