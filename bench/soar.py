"""SOAR against plain C++: triangles per second of the same refinement, in the same process, in turns.

    python bench/soar.py [--size 4097] [--tolerance 0.1] [--rounds 25] [--seed 7] [--priority]

A synthetic terrain (``orograph synth``) is seen as a whole, culled, at a tolerance that makes over 500,000 triangles.
g++ -O3 -march=native compiles ``bench/soar.cpp``; its triangle count must be equal. Ours is all of ``Soar.mesh`` (on
one thread and on two, with the same bound over spheres as C++; and with look-ahead). C++ is the loop alone: over one
dense row-major array of structs, over our pages, and over our pages with our prefetches. Every round runs each once.
Printed are medians, the best, and how many times faster ours is, in processor time of the thread (with two threads: in
wall time).

The gain from two threads is wall time on both sides, and depends on the machine. So every round also runs the same
arithmetic, which touches no memory, on one thread and then on two at once; the last lines tell how much of two
processors there was (less than 2 with two halves of one core, or with other load). ``--priority`` asks the system to
run this process before all others, so that they do not affect the result (Linux, needs the privilege).
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machine import before_all
from orograph._numba import kernel
from orograph.error.screen import CameraParameters
from orograph.lod.method import Goal, Resources
from orograph.lod.soar import Soar
from orograph.scene import camera
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera
from synthetic import synthetic

WORK = 4_000_000
"""Rounds of the arithmetic: some milliseconds, as long as a pass."""


def pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@kernel
def arithmetic(count: int) -> float:
    """Eight independent sums; on a core of its own, a thread is as fast as without a neighbour."""
    a = b = c = d = e = f = g = h = 1.0
    for _ in range(count):
        a, b, c, d = a * 0.999 + 1e-9, b * 0.999 + 2e-9, c * 0.999 + 3e-9, d * 0.999 + 4e-9
        e, f, g, h = e * 0.999 + 5e-9, f * 0.999 + 6e-9, g * 0.999 + 7e-9, h * 0.999 + 8e-9
    return a + b + c + d + e + f + g + h


def at_once(count: int) -> None:
    """Run the arithmetic on two threads at once."""
    other = threading.Thread(target=arithmetic, args=(count,))
    other.start()
    arithmetic(count)
    other.join()


def compiled(folder: Path) -> ctypes.CDLL:
    library = folder / "soar.so"
    source = Path(__file__).with_suffix(".cpp")
    flags = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
    subprocess.run(["g++", *flags, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def page_aligned(*shape: int) -> NDArray[np.float32]:
    """A float32 array that begins at a page of memory, with huge pages if there are any, like the method's own."""
    size = int(np.prod(shape))
    room = np.empty(size + 1024, np.float32)
    skip = -room.ctypes.data % 4096 // 4
    return room[skip : skip + size].reshape(shape)


def flat(camera: CameraParameters) -> NDArray[np.float64]:
    """The camera as one vector, in the order that ``soar.cpp`` reads."""
    return np.concatenate(
        [
            camera.right, camera.up, camera.depth,
            [camera.focal, camera.tolerance, camera.near, camera.stretch, camera.exaggeration, 0.0, 0.0, 0.0],
            camera.planes.ravel(), [camera.color_tolerance, camera.texel], camera.motion_x, camera.motion_y,
            [camera.largest_lean],
        ]
    )  # fmt: skip


def row_major(terrain: MemoryTerrain) -> NDArray[np.float32]:
    """(2^n + 1, 2^n + 1, 4): height, error, radius, color error of every vertex."""
    side, top = terrain.side, terrain.levels - 1
    if terrain.grid.shape != (side, side):
        raise SystemExit("The row-major array is made for rasters of 2^n + 1 samples a side.")
    whole = page_aligned(side, side, 4)
    whole[..., 0], whole[..., 3] = terrain.heights, 0.0
    for level in range(top, -1, -1):
        rows, cols = terrain.diamond_shape(level)
        errors, radii = terrain.derived("diamonds", error="exact").read(level, 0, rows, 0, cols)
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
    parser.add_argument("--priority", action="store_true", help="run before all other programs, with short rests")
    given = parser.parse_args()
    if given.priority:
        before_all()

    terrain = synthetic(given.size, given.seed)
    view = camera.around(terrain, (1280, 720), azimuth=180, pitch=30, distance=None)

    one, two = (Soar(terrain, resources=Resources(jobs=jobs), metric="anisotropic") for jobs in (1, 2))
    ahead = Soar(terrain, resources=Resources(jobs=1))
    seen, goal = Camera.over(terrain.grid, view), Goal(given.tolerance)
    two.field = ahead.field = one.field
    began = time.perf_counter()
    mesh, _ = one.mesh(seen, goal)
    cold = time.perf_counter() - began
    rounds, count = mesh.stats["rounds"], mesh.triangles
    lens = flat(one._lens(seen, given.tolerance))
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

        fewer = ahead.mesh(seen, goal)[0].triangles

        def looking() -> int:
            """Like ``one``, but computes the look-ahead afresh (a method keeps that of the last view)."""
            ahead._ahead = None
            made = ahead.mesh(seen, goal)[0].triangles
            return count if made == fewer else made

        runs: dict[str, Callable[[], int]] = {
            "Soar.mesh, 1 thread": lambda: one.mesh(seen, goal)[0].triangles,
            "Soar.mesh, 2 threads": lambda: two.mesh(seen, goal)[0].triangles,
            "Soar.mesh, looking ahead": looking,
            "C++, row-major": rows,
            "C++, our pages": lambda: paged(0),
            "C++, our pages, prefetched": lambda: paged(1),
        }
        took: dict[str, list[float]] = {name: [] for name in runs}
        walls: dict[str, list[float]] = {name: [] for name in runs}
        processors = []
        arithmetic(1)
        for _ in range(given.rounds + 2):
            if given.priority:
                time.sleep(0.03)  # the system pauses a prioritised process that never sleeps
            for name, run in runs.items():
                start, clock = time.perf_counter(), time.thread_time()
                made = run()
                walls[name].append(time.perf_counter() - start)
                took[name].append(walls[name][-1] if "2 threads" in name else time.thread_time() - clock)
                if made != count:
                    raise SystemExit(f"{name} makes {made} triangles, Soar {count}.")
            start = time.perf_counter()
            arithmetic(WORK)
            middle = time.perf_counter()
            at_once(WORK)
            processors.append(2 * (middle - start) / (time.perf_counter() - middle))
    ours = float(np.median(took["Soar.mesh, 1 thread"][2:]))
    print(
        f"{given.size}² samples, {given.tolerance} px: {count:,} triangles ({fewer:,} looking ahead); "
        f"cold: {cold * 1e3:.0f} ms, {rounds} rounds"
    )
    print(f"{'':28}{'ms':>8}{'best':>8}{'Mtri/s':>8}{'Soar is':>9}")
    for name, seconds in took.items():
        median, best = float(np.median(seconds[2:])), min(seconds)
        print(f"{name:28}{median * 1e3:8.1f}{best * 1e3:8.1f}{count / median / 1e6:8.1f}{median / ours:8.2f}×")
    gains = np.divide(walls["Soar.mesh, 1 thread"], walls["Soar.mesh, 2 threads"])[2:]
    print(
        f"Two threads: {np.median(gains):.2f}× as fast as one (median of {len(gains)}, best {gains.max():.2f}×); "
        f"arithmetic alone: {np.median(processors):.2f}× (from {min(processors):.2f}× to {max(processors):.2f}×)"
    )
    whole = np.array(processors[2:]) > 1.9
    if 0 < whole.sum() < len(gains):
        print(f"In the {whole.sum()} rounds in which arithmetic gained over 1.9×: {np.median(gains[whole]):.2f}×")


if __name__ == "__main__":
    main()
