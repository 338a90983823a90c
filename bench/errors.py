"""The cost per sample of the errors and spheres of all diamonds: in memory, and out of core through a store.

    python bench/errors.py [DEM...] [--size 4097] [--rounds 3] [--threads 1 2] [--missing 0.03]

Without a DEM, a synthetic one of ``--size`` is used: whole, and with a share ``--missing`` of its samples in holes. In
memory: ``error.diamonds`` over an array. Out of core: the stage of ``orograph build`` that reads heights back from the
store, surveys them, encodes, compresses and writes. Times are processor time per sample, whatever the number of
threads; the best of the rounds counts. The table also has the bytes per sample of the codes in the store, and how many
more triangles result from rounding the codes up, as the number of diamonds whose error exceeds a tolerance.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orograph import store
from orograph.error import KINDS
from orograph.error.diamonds import diamonds
from orograph.progress import SILENT
from orograph.store.diamonds import NESTED, surface
from orograph.store.executing import Threads
from orograph.store.levels import subsample
from orograph.store.survey import Errors
from orograph.store.writer import ShardWriter


def best(work: Callable[[], object], rounds: int) -> float:
    """Processor seconds of all threads in the best of some rounds, after one that may compile.

    Small rasters get as many rounds as fit into a quarter of a second.
    """
    work()
    times: list[float] = []
    while len(times) < rounds or sum(times) < 0.25:
        started = time.process_time()
        work()
        times.append(time.process_time() - started)
    return min(times)


def with_holes(terrain: store.MemoryTerrain, share: float) -> store.MemoryTerrain:
    """The terrain with so much of it missing: holes with radii of 3 to 40 samples, anywhere."""
    rng, heights = np.random.default_rng(1), terrain.heights.copy()
    rows, cols = heights.shape
    while np.isnan(heights).mean() < share:
        for _ in range(20):
            row, col, radius = rng.integers(rows), rng.integers(cols), rng.integers(3, 40)
            i, j = np.ogrid[max(row - 40, 0) : row + 41, max(col - 40, 0) : col + 41]
            window = heights[max(row - 40, 0) : row + 41, max(col - 40, 0) : col + 41]
            disc = (i - row) ** 2 + (j - col) ** 2 < radius**2
            window[disc[: window.shape[0], : window.shape[1]]] = np.nan
    return store.MemoryTerrain(heights, terrain.grid, f"{terrain.name} with holes")


def in_memory(terrain: store.MemoryTerrain, threads: list[int], rounds: int) -> None:
    heights, samples = terrain.heights, terrain.heights.size
    ground = surface(terrain.grid, terrain.tiles(0).minimum, terrain.height_range[0])
    nested = subsample(heights, NESTED)

    def run(kinds, radii, jobs):
        def work():
            for _ in diamonds(lambda a, b, c, d: heights[a:b, c:d], nested, ground, kinds, radii=radii, jobs=jobs):
                pass

        return best(work, rounds) / samples * 1e9

    for kind in KINDS[::-1]:
        plain = [run((kind,), False, jobs) for jobs in threads]
        print(f"  {kind:10}" + "".join(f"{ns:10.1f}" for ns in plain) + "   ns/sample")
    both = [run(("exact",), True, jobs) for jobs in threads]
    print("  + spheres " + "".join(f"{b - p:10.1f}" for b, p in zip(both, plain, strict=True)) + "   ns/sample")


def out_of_core(terrain: store.MemoryTerrain, folder: Path, threads: list[int], rounds: int) -> None:
    samples = terrain.heights.size
    built = store.build(source_of(terrain), folder / "s", errors=KINDS)
    for kind in KINDS[::-1]:
        times = []
        for jobs in threads:

            def work(kind=kind, jobs=jobs):
                record = built.record
                writer = ShardWriter(built.storage)
                writer.digests = record.digests  # through which the heights are read back
                stage = Errors(built.grid, writer, record.shard, record.chunk, built.tiles(0), (kind,))
                Threads(jobs, False).run(stage, SILENT)

            times.append(best(work, rounds) / samples * 1e9)
        print(f"  {kind:10}" + "".join(f"{ns:10.1f}" for ns in times) + "   ns/sample, with spheres, into the store")
    for name in (*KINDS, "radius"):
        size = sum(p.stat().st_size for p in (folder / "s/diamonds").glob(f"*/{name}/c/*/*"))
        print(f"  {name:10}{size / samples:10.2f}   bytes per sample on disk (codes: 1.33)")
    heights = sum(p.stat().st_size for p in (folder / "s/heights").glob("*/height/c/*/*"))
    print(f"  {'heights':10}{heights / samples:10.2f}   bytes per sample on disk (samples: 5.33)")
    tolerances(terrain, built)


def source_of(terrain: store.MemoryTerrain) -> store.ArraySource:
    return store.ArraySource(terrain.heights, terrain.grid, terrain.name, terrain.vertical)


def tolerances(terrain: store.MemoryTerrain, built: store.StoredTerrain) -> None:
    """Diamonds above a tolerance, by stored errors and by true ones; they stand for a uniform mesh's triangles."""
    low, high = terrain.height_range
    for share in (2**-5, 2**-8, 2**-11):
        counts = []
        for one in (terrain, built):
            total = 0
            for level in range(one.levels):
                rows, cols = one.diamond_shape(level)
                total += int(
                    (
                        one.derived("diamonds", error="exact").read(level, 0, rows, 0, cols)[0] > (high - low) * share
                    ).sum()
                )
            counts.append(total)
        more = 100 * (counts[1] / max(counts[0], 1) - 1)
        print(f"  error > {(high - low) * share:8.3f} m: {counts[0]:9} diamonds, {more:+.1f} % with stored errors")


def measure(terrain: store.MemoryTerrain, folder: Path, threads: list[int], rounds: int) -> None:
    rows, cols = terrain.grid.shape
    print(f"{terrain.name}: {rows} × {cols}, {100 * terrain.valid_fraction:.4g} % valid")
    print(f"  {'':10}" + "".join(f"{f'{jobs} thread(s)':>10}" for jobs in threads))
    in_memory(terrain, threads, rounds)
    folder.mkdir()
    out_of_core(terrain, folder, threads, rounds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem", nargs="*")
    parser.add_argument("--size", type=int, default=4097)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--missing", type=float, default=0.03)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = args.dem
        if not files:
            files = [str(folder / "dem.tif")]
            line = [sys.executable, "-m", "orograph", "synth", "-o", files[0], "--size", str(args.size), "--seed", "7"]
            subprocess.run(line, check=True, capture_output=True)
        for index, file in enumerate(files):
            from orograph.dem.mosaic import Mosaic

            terrain = store.terrain(Mosaic.open([file]))
            measure(terrain, folder / str(index), args.threads, args.rounds)
            if not args.dem and args.missing:
                measure(with_holes(terrain, args.missing), folder / f"{index}-holes", args.threads, args.rounds)


if __name__ == "__main__":
    main()
