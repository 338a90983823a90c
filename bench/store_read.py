"""Random 257² tiles and large windows from a store: Orograph, zarr-python and tensorstore on the same files.

    python bench/store_read.py [STORE | --size 8193]

*cold*: no decoded data is kept (the files are in the system's cache, as they are after a build); *cached*: every tile
has been read before. Each reader uses its default number of threads unless the column says otherwise.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from orograph import store
from orograph.parallel import cpu_count

SECONDS = 2.0
TILE = 256


def rate(read: Callable[[int, int], object], corners: np.ndarray, threads: int = 1) -> float:
    """Tiles per second, for at least SECONDS or all corners."""
    jobs = [corners[k::threads] for k in range(threads)]

    def work(part: np.ndarray) -> int:
        end = time.perf_counter() + SECONDS
        done = 0
        for row, col in part:
            read(int(row), int(col))
            done += 1
            if time.perf_counter() > end:
                break
        return done

    started = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        done = sum(pool.map(work, jobs))
    return done / (time.perf_counter() - started)


def synthetic(size: int, folder: Path) -> str:
    """A store of smooth hills with noise."""
    from affine import Affine
    from pyproj import CRS

    from orograph.geo.grid import Grid

    rng = np.random.default_rng(0)
    heights = np.zeros((size, size), np.float32)
    for k in range(3, 12):
        knots = rng.standard_normal(2**k + 1).astype(np.float32) * 2000 / 2**k
        at = np.linspace(0, 2**k, size)
        wave = np.interp(at, np.arange(2**k + 1), knots).astype(np.float32)
        heights += wave[:, None] + np.roll(wave, size // 3)[None] + np.outer(wave, wave) / 500
    heights += rng.standard_normal(heights.shape, dtype=np.float32) * np.float32(0.05)
    grid = Grid(heights.shape, Affine(10, 0, 0, 0, -10, 0), CRS.from_epsg(32611))
    return store.build(store.ArraySource(heights, grid, "hills"), folder / "hills.oro").url


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", nargs="?")
    parser.add_argument("--size", type=int, default=8193)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        url = args.store or synthetic(args.size, Path(folder))
        report(url)


def report(url: str) -> None:
    import tensorstore
    import zarr

    both = cpu_count()
    first = store.open(url, cache_bytes=0)
    rows, cols = (side // TILE for side in (first.grid.rows - 1, first.grid.cols - 1))
    rng = np.random.default_rng(1)
    corners = TILE * np.stack(np.unravel_index(rng.permutation(rows * cols), (rows, cols)), axis=-1)
    corners = np.tile(corners, (200, 1))
    few = np.tile(corners[:100], (500, 1))
    path = f"{url}/heights/0/height"

    def orograph(cache: int) -> Callable[[int, int], object]:
        terrain = store.open(url, cache_bytes=cache)
        return lambda r, c: terrain.read(0, r, r + 257, c, c + 257)

    def with_tensorstore(cache: int) -> Callable[[int, int], object]:
        spec = {
            "driver": "zarr3",
            "kvstore": {"driver": "file", "path": path},
            "context": {"cache_pool": {"total_bytes_limit": cache}},
            "recheck_cached_data": "open",
        }
        array = tensorstore.open(spec).result()
        return lambda r, c: array[r : r + 257, c : c + 257].read().result()

    array = zarr.open_array(path, mode="r")
    plain: Callable[[int, int], object] = lambda r, c: array[r : r + 257, c : c + 257]  # noqa: E731

    print(f"{url}: {first.grid.rows} × {first.grid.cols}; tiles of 257² per second")
    print(f"{'':14}{'cold':>10}{f'cold, {both} threads':>18}{'cached':>10}{f'cached, {both} threads':>20}")
    half = 1 << 29
    rows_of_table = [
        ("orograph", orograph(0), orograph(half)),
        ("tensorstore", with_tensorstore(0), with_tensorstore(half)),
        ("zarr-python", plain, None),
    ]
    for name, cold, cached in rows_of_table:
        figures = [rate(cold, corners), rate(cold, corners, both)]
        if cached is not None:
            for row, col in few[:100]:
                cached(int(row), int(col))
            figures += [rate(cached, few), rate(cached, few, both)]
        cells = [f"{figure:,.0f}" for figure in figures] + ["—"] * (4 - len(figures))
        print(f"{name:14}{cells[0]:>10}{cells[1]:>18}{cells[2]:>10}{cells[3]:>20}")

    side = min(4096, *first.grid.shape)
    print(f"\nOne window of {side}²: GB/s of heights")
    opened = tensorstore_array(path)
    windows: list[tuple[str, Callable[[], object]]] = [
        ("orograph", lambda: first.read(0, 0, side, 0, side)),
        ("tensorstore", lambda: opened[:side, :side].read().result()),
        ("zarr-python", lambda: array[:side, :side]),
    ]
    for name, read in windows:
        best = min(timed(read) for _ in range(3))
        print(f"{name:14}{side * side * 4 / best / 1e9:10.2f}")


def tensorstore_array(path: str) -> Any:
    import tensorstore

    return tensorstore.open({"driver": "zarr3", "kvstore": {"driver": "file", "path": path}}).result()


def timed(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
