"""SOAR against plain C++: triangles per second of the same refinement, in the same process, by turns.

    python bench/soar.py [--size 4097] [--tolerance 0.1] [--rounds 25] [--seed 7]

A synthetic terrain (``orograph synth``) seen as a whole, culled, at a tolerance that makes over 500,000 triangles.
``bench/soar.cpp`` is compiled by g++ -O3 -march=native; its triangle count must be equal. Ours is all of ``Soar.mesh``
(on one thread, on two), C++ the loop alone: over one dense row-major array of structs, over our pages, and over our
pages with our prefetches. Every round takes each once; medians, the best, and how many times faster ours is, in
processor time of the thread (two threads: in wall time).
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.synth import Synth
from orograph.geo.grid import Grid
from orograph.lod.soar import Soar
from orograph.picture import camera
from orograph.store.memory import MemoryTerrain


def pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def compiled(folder: Path) -> ctypes.CDLL:
    library = folder / "soar.so"
    source = Path(__file__).with_suffix(".cpp")
    flags = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
    subprocess.run(["g++", *flags, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def page_aligned(*shape: int) -> NDArray[np.float32]:
    """float32 that begins at a page of memory, with huge pages where there are any, as the engine's own has."""
    size = int(np.prod(shape))
    room = np.empty(size + 1024, np.float32)
    skip = -room.ctypes.data % 4096 // 4
    return room[skip : skip + size].reshape(shape)


def row_major(terrain: MemoryTerrain) -> NDArray[np.float32]:
    """(2^n + 1, 2^n + 1, 4): height, error, radius, color error of every vertex."""
    side, top = terrain.side, terrain.levels - 1
    if terrain.grid.shape != (side, side):
        raise SystemExit("The row-major array is made for rasters of 2^n + 1 samples a side.")
    whole = page_aligned(side, side, 4)
    whole[..., 0], whole[..., 3] = terrain.heights, 0.0
    for level in range(top, -1, -1):
        rows, cols = terrain.diamond_shape(level)
        errors, radii = terrain.diamonds("exact", level, 0, rows, 0, cols)
        target = whole[:: 1 << level, :: 1 << level]
        odd = slice(1, None, 2)
        places = [(slice(None), slice(None))] if level == top else [(odd, slice(None)), (slice(None), odd)]
        for place in places:
            target[place][..., 1], target[place][..., 2] = errors[place], radii[place]
    return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=4097)
    parser.add_argument("--tolerance", type=float, default=0.1)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()

    grid = Grid((given.size, given.size), Affine(30, 0, 0, 0, -30, 0), None)
    synth = Synth(grid.shape, given.seed)
    heights = np.concatenate(
        [synth.read(r, min(r + 512, given.size), 0, given.size) for r in range(0, given.size, 512)]
    )
    terrain = MemoryTerrain(heights, grid, "synthetic")
    view = camera.around(terrain, (1280, 720), azimuth=180, pitch=30, distance=None)

    one, two = Soar(terrain, jobs=1), Soar(terrain, jobs=2)
    two.field = one.field
    began = time.perf_counter()
    mesh, _ = one.mesh(view, tolerance=given.tolerance)
    cold = time.perf_counter() - began
    rounds, count = mesh.stats["rounds"], mesh.triangles
    lens = one._lens(view, given.tolerance)
    entries, pages, n = row_major(terrain), one.field.pages, terrain.n
    corners = np.ascontiguousarray(one.field.corners)
    keys, zs = np.empty(4 * count + 1024, np.int64), np.empty(4 * count + 1024, np.float32)
    counts = np.zeros(3, np.int64)
    out = lens, n, corners, keys, zs, counts

    with tempfile.TemporaryDirectory() as folder:
        library = compiled(Path(folder))

        def rows() -> int:
            library.soar_rows(pointer(entries), *(v if isinstance(v, int) else pointer(v) for v in out))
            return int(counts[1])

        def paged(prefetches: int) -> int:
            tables = (pages.flat, pages.table, pages.base, pages.width, pages.down, pages.across)
            rest = (v if isinstance(v, int) else pointer(v) for v in out)
            library.soar_pages(*map(pointer, tables), terrain.levels - 1, prefetches, *rest)
            return int(counts[1])

        runs: dict[str, Callable[[], int]] = {
            "Soar.mesh, 1 thread": lambda: one.mesh(view, tolerance=given.tolerance)[0].triangles,
            "Soar.mesh, 2 threads": lambda: two.mesh(view, tolerance=given.tolerance)[0].triangles,
            "C++, row-major": rows,
            "C++, our pages": lambda: paged(0),
            "C++, our pages, prefetched": lambda: paged(1),
        }
        took: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(given.rounds + 2):
            for name, run in runs.items():
                clock = time.perf_counter if "2 threads" in name else time.thread_time
                start = clock()
                made = run()
                took[name].append(clock() - start)
                if made != count:
                    raise SystemExit(f"{name} makes {made} triangles, Soar {count}.")
    ours = float(np.median(took["Soar.mesh, 1 thread"][2:]))
    print(
        f"{given.size}² samples, {given.tolerance} px: {count:,} triangles; cold: {cold * 1e3:.0f} ms, {rounds} rounds"
    )
    print(f"{'':28}{'ms':>8}{'best':>8}{'Mtri/s':>8}{'Soar is':>9}")
    for name, seconds in took.items():
        median, best = float(np.median(seconds[2:])), min(seconds)
        print(f"{name:28}{median * 1e3:8.1f}{best * 1e3:8.1f}{count / median / 1e6:8.1f}{median / ours:8.2f}×")


if __name__ == "__main__":
    main()
