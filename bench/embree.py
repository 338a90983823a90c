"""Primary rays of the caster compared with Embree's: the same triangles and rays, in one process.

    python bench/embree.py [--size 2049] [--data ../shared/data] [--repeat 5]

Prints one row per view and number of threads. Times are processor time of the casting thread (one thread) and wall time
(two), the best of several. Embree uses the faster of its two queries, on single-precision rays that are made
beforehand; the caster's time includes making its rays. With two threads, Embree's rays are split by rows between two
processes that are forked after the scene is built, because its binding holds the GIL. Depths agree within 1e-4.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.raycast.caster import Caster

WIDTH, HEIGHT = 1280, 720
Array = NDArray[np.float64]


def fractal(n: int, relief: float = 2500.0, seed: int = 3) -> NDArray[np.float32]:
    """Rough ground of n × n samples, 0 … ``relief`` metres, spectrum 1/k²."""
    rng = np.random.default_rng(seed)
    k = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None])
    k[0, 0] = np.inf
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n, n))) / k**2, s=(n, n))
    return ((z - z.min()) / np.ptp(z) * relief).astype(np.float32)


def real(data: Path, n: int) -> tuple[NDArray[np.float32], float] | None:
    """A tile of the Sierra Nevada in its UTM zone, resampled to n × n, and its spacing in metres."""
    path = next(iter(sorted(data.glob("california-3s-tiles/*N37W119*"))), None)
    if path is None:
        return None
    from scipy.ndimage import zoom

    from orograph.dem.mosaic import Mosaic

    mosaic = Mosaic.open([path])
    rows, cols = mosaic.grid.shape
    heights = mosaic.read(0, rows, 0, cols)
    side = min(rows, cols) * 9 // 10  # without the empty corners that the projection leaves
    r, c = (rows - side) // 2, (cols - side) // 2
    part = np.nan_to_num(heights[r : r + side, c : c + side], nan=0.0)
    return zoom(part, n / side, order=1)[:n, :n].astype(np.float32), mosaic.grid.spacing[0] * side / n


def scene(heights: NDArray[np.float32], spacing: float) -> tuple[Any, Any]:
    """Embree's scene of the same triangles, and the mesh, which must live as long."""
    from embreex import mesh_construction, rtcore_scene

    rows, cols = heights.shape
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = (v.ravel() for v in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    y, x = np.mgrid[0 : rows - 1, 0 : cols - 1]
    even = ((x + y) % 2 == 0).ravel()[:, None]
    first = np.where(even, np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(even, np.stack([a, d, c], 1), np.stack([b, d, c], 1))
    y, x = np.mgrid[0:rows, 0:cols]
    vertices = np.stack([x * spacing, y * spacing, heights], -1).reshape(-1, 3).astype(np.float32)
    embree = rtcore_scene.EmbreeScene()
    mesh = mesh_construction.TriangleMesh(
        embree, vertices, np.concatenate([first, second], 1).reshape(-1, 3).astype(np.int32)
    )
    return embree, mesh


def camera(eye: Array, target: Array, fov: float = 45.0) -> tuple[Array, Array, Array]:
    """d0, du, dv in metres (x east, y south)."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right /= np.linalg.norm(right)
    up = np.cross(forward, right)
    s = 2 * math.tan(math.radians(fov) / 2) / HEIGHT
    return forward + right * s * (0.5 - WIDTH / 2) - up * s * (0.5 - HEIGHT / 2), right * s, -up * s


def views(heights: NDArray[np.float32], spacing: float) -> dict[str, tuple[Array, Array]]:
    n = len(heights)
    side = n * spacing

    def above(x: float, y: float, metres: float) -> Array:
        return np.array([x * side, y * side, float(heights[int(y * n), int(x * n)]) + metres])

    middle = np.array([side / 2, side / 2, 1000.0])
    return {
        "oblique overview": (np.array([side / 2, -0.25 * side, 0.65 * side]), middle),
        "low flight": (above(0.3, 0.2, 300.0), np.array([0.75 * side, 0.75 * side, 1500.0])),
        "grazing across": (
            np.array([-0.02 * side, 0.4 * side, float(heights.max()) + 200.0]),
            np.array([side, 0.6 * side, 800.0]),
        ),
        "mountain side": (above(0.5, 0.5, 1500.0), above(0.7, 0.65, 0.0)),
        "straight down": (np.array([side / 2, side / 2, 1.45 * side]), np.array([side / 2, side / 2 + 1, 0.0])),
    }


def best(work: Any, repeat: int, clock: Any) -> float:
    times = []
    for _ in range(repeat):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)


def embree_pair(embree: Any, origins: Any, directions: Any, query: str, repeat: int) -> float:
    """Wall time of Embree with half of the rays in each of two forked processes that start together."""
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(2), context.Queue()
    # They take turns of sixteen rows, so that both get as much sky and ground.
    turn = (np.arange(len(origins)) // (16 * WIDTH)) % 2

    def run(part: int) -> None:
        o, d = origins[turn == part], directions[turn == part]
        for _ in range(repeat + 1):
            barrier.wait()
            start = time.perf_counter()
            embree.run(o, d, query=query)
            results.put(time.perf_counter() - start)
            barrier.wait()

    processes = [context.Process(target=run, args=(part,)) for part in (0, 1)]
    for process in processes:
        process.start()
    times = [max(results.get(), results.get()) for _ in range(repeat + 1)]
    for process in processes:
        process.join()
    return min(times[1:])


def compare(name: str, heights: NDArray[np.float32], spacing: float, repeat: int) -> None:
    scale = np.array([1 / spacing, 1 / spacing, 1.0])
    build = best(lambda: Caster.of(heights, 1), repeat + 1, time.thread_time) * 1e3
    casters = {jobs: Caster.of(heights, jobs) for jobs in (1, 2)}
    stack = casters[1].stack.scene
    memory = (heights.nbytes + stack.maxima.nbytes + stack.minima.nbytes + stack.mips.nbytes) / heights.nbytes
    start = time.perf_counter()
    embree, _mesh = scene(heights, spacing)
    embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
    theirs_build = (time.perf_counter() - start) * 1e3
    print(
        f"\n{name}: {heights.shape[0]} × {heights.shape[1]} samples at {spacing:.1f} m; {WIDTH} × {HEIGHT} rays; ",
        end="",
    )
    print(
        f"heights and structure {memory:.3f} × the heights, built in {build:.1f} ms (Embree: {theirs_build:.0f} ms)\n"
    )
    print("| view | threads | hits | Orograph Mrays/s | Embree Mrays/s | ratio | hits equal | depths equal |")
    print("|---|---|---|---|---|---|---|---|")
    py, px = np.mgrid[0:HEIGHT, 0:WIDTH]
    for view, (eye, target) in views(heights, spacing).items():
        d0, du, dv = camera(eye, target)
        d = (d0 + px[..., None] * du + py[..., None] * dv).reshape(-1, 3).astype(np.float32)
        o = np.broadcast_to(eye.astype(np.float32), d.shape).copy()
        # The same rays for both: the eye is rounded to Embree's single precision.
        ours = tuple(v * scale for v in (o[0].astype(np.float64), d0, du, dv))
        t, _ = casters[1].cast_pinhole(*ours, (HEIGHT, WIDTH))
        distance = embree.run(o, d, query="DISTANCE")
        hit = distance < 1e30
        same = hit == np.isfinite(t.ravel())
        both = hit & np.isfinite(t.ravel())
        close = np.abs(distance[both] - t.ravel()[both]) <= 1e-4 * t.ravel()[both]
        theirs = {q: partial(embree.run, o, d, query=q) for q in ("DISTANCE", "INTERSECT")}
        query = min(theirs, key=lambda q: best(theirs[q], 2, time.thread_time))
        for jobs in (1, 2):
            clock = time.thread_time if jobs == 1 else time.perf_counter
            mine = best(partial(casters[jobs].cast_pinhole, *ours, (HEIGHT, WIDTH)), repeat, clock)
            if jobs == 1:
                other = best(theirs[query], repeat, clock)
            else:
                other = embree_pair(embree, o, d, query, repeat)
            rays = len(d) / 1e6
            print(
                f"| {view} | {jobs} | {hit.mean():.0%} | {rays / mine:.1f} | {rays / other:.1f} | {other / mine:.2f} "
                f"| {same.mean():.4%} | {close.mean():.4%} |",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=2049, help="samples along a side")
    parser.add_argument(
        "--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data", help="open data sets"
    )
    parser.add_argument("--repeat", type=int, default=5, help="runs; the best counts")
    given = parser.parse_args()
    compare("Fractal", fractal(given.size), 30.0, given.repeat)
    found = real(given.data, given.size) if given.data.is_dir() else None
    if found is not None:
        compare("Sierra Nevada (california-3s-tiles N37W119)", *found, given.repeat)


if __name__ == "__main__":
    main()
