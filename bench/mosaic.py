"""Reading and resampling mosaics, and synthetic terrain: Orograph compared with GDAL's warper on the same target grid.

    python bench/mosaic.py [--data ../shared/data] [--tiles 40] [--size 16385]

Times are the best of three in one process, with files in the system's cache and kernels compiled. *GDAL* is rasterio:
the same tiles merged in memory and warped with the same number of threads. Its positions are approximate (0.125
samples); ours are within 0.01.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orograph.dem.mosaic import Mosaic
from orograph.dem.synth import Synth
from orograph.parallel import cpu_count, map_ordered

BLOCK = 2048


def best(work: Callable[[], object], times: int = 3) -> float:
    """Seconds of the fastest of some runs."""
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        taken.append(time.perf_counter() - started)
    return min(taken)


def whole(paths: list[Path], jobs: int, **options: object) -> Mosaic:
    """Open the files and read all blocks."""
    mosaic = Mosaic.open(paths, **options)  # type: ignore[arg-type]
    rows, cols = mosaic.grid.shape
    windows = [
        (r, min(r + BLOCK, rows), c, min(c + BLOCK, cols)) for r in range(0, rows, BLOCK) for c in range(0, cols, BLOCK)
    ]
    for _ in map_ordered(lambda w: mosaic.read(*w).shape, windows, jobs):
        pass
    return mosaic


def gdal(paths: list[Path], mosaic: Mosaic, jobs: int) -> None:
    """The same with GDAL: tiles are merged in memory and warped at once."""
    import rasterio
    from rasterio.merge import merge
    from rasterio.warp import Resampling, reproject

    together, transform = merge([str(p) for p in paths])
    with rasterio.open(paths[0]) as first:
        crs, nodata = first.crs, first.nodata
    assert mosaic.grid.crs is not None
    reproject(
        together[0],
        np.empty(mosaic.grid.shape, np.float32),
        src_transform=transform,
        src_crs=crs,
        src_nodata=nodata,
        dst_transform=mosaic.grid.transform,
        dst_crs=mosaic.grid.crs.to_wkt(),
        dst_nodata=np.nan,
        resampling=Resampling.bilinear,
        num_threads=jobs,
    )


def row(what: str, seconds: float, samples: float) -> None:
    print(f"{what:<58} {seconds:7.2f} s  {samples / seconds / 1e6:7.1f} Msamples/s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--tiles", type=int, default=40, help="tiles of California")
    parser.add_argument("--size", type=int, default=16385, help="side of the synthetic terrain")
    options = parser.parse_args()
    jobs = cpu_count()
    print(f"{jobs} threads")
    tiles = sorted((options.data / "california-3s-tiles").glob("*.tif"))[: options.tiles]
    if tiles:
        for what, paths, more in (
            ("one 1201² tile, degrees → UTM", [tiles[len(tiles) // 2]], {}),
            (f"{len(tiles)} tiles (California), degrees → Lambert", tiles, {}),
            ("   cubic", tiles, {"resampling": "cubic"}),
            ("   at 500 m (averaged)", tiles, {"resolution": 500.0}),
        ):
            mosaic = whole(paths, jobs, **more)
            row(what, best(lambda p=paths, m=more: whole(p, jobs, **m)), mosaic.grid.rows * mosaic.grid.cols)
        mosaic = whole(tiles, jobs)
        row("   GDAL, merged and warped", best(lambda: gdal(tiles, mosaic, jobs)), mosaic.grid.rows * mosaic.grid.cols)
    else:
        print(f"(no California tiles at {options.data})")
    samples = options.size**2
    with tempfile.TemporaryDirectory() as folder:
        for compress in ("zstd", "none"):
            path = Path(folder) / f"{compress}.tif"
            seconds = best(lambda p=path, c=compress: Synth((options.size,) * 2, 7).write(p, compress=c), 1)
            row(f"synth {options.size}², {compress}: {path.stat().st_size / 2**20:.0f} MiB", seconds, samples)
            row("   read back", best(lambda p=path: whole([p], jobs)), samples)
            path.unlink()


if __name__ == "__main__":
    main()
