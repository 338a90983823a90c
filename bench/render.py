"""Whole commands, from the raw file to the picture: seconds and peak memory, with a cold store and a kept store.

    python bench/render.py [--data ../shared/data] [--runs 3] [--big big.tif] [--size 16385]

Three inputs: a geographic tile of 1201², the 40 tiles of California (13201 × 4801, degrees), and a projected float32
raster of 16385² (made by ``orograph synth`` if --big is missing). Kernels are compiled before the first timed run.
"first": the cache of stores is empty; "again": it holds the store that the first run made. If pyvista is installed, it
draws the tile too, after reprojection by GDAL, in the same run. ``--sides STORE`` times only rays: a store's whole
terrain from eight sides, as in an orbit, on one thread, per ray and per hit.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

OROGRAPH = [sys.executable, "-m", "orograph", "--quiet"]

PYVISTA = """
import sys, numpy as np, rasterio, pyvista
from rasterio.warp import calculate_default_transform, reproject, Resampling
with rasterio.open(sys.argv[1]) as f:
    t, w, h = calculate_default_transform(f.crs, "EPSG:32619", f.width, f.height, *f.bounds)
    z = np.zeros((h, w), np.float32)
    reproject(rasterio.band(f, 1), z, dst_transform=t, dst_crs="EPSG:32619", resampling=Resampling.bilinear)
x, y = np.meshgrid(t.c + t.a * np.arange(w), t.f + t.e * np.arange(h))
p = pyvista.Plotter(off_screen=True, window_size=(1280, 720))
p.add_mesh(pyvista.StructuredGrid(x, y, z), scalars=z.ravel(order="F"), cmap="gist_earth", smooth_shading=True)
p.enable_shadows()
p.screenshot(sys.argv[2])
"""


def timed(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall seconds and peak resident MiB of one process."""
    began = time.perf_counter()
    child = subprocess.Popen(command, env={**os.environ, "OROGRAPH_CACHE": str(cache)}, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    seconds = time.perf_counter() - began
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"failed ({child.returncode}): {' '.join(command)}")
    return seconds, usage.ru_maxrss / 1024


def sides(store: str) -> None:
    """Nanoseconds of processor time per ray of 1280 × 720 first hits, from all sides."""
    import numpy as np

    import orograph
    from orograph.rendering.cpu.ground import Ground
    from orograph.scene import camera
    from orograph.scene.scene import Scene

    print("| seen from | ns per ray | ns per hit |\n|---|---|---|")
    with orograph.open(store) as terrain:
        views = {"the default view": camera.whole(terrain, (1280, 720))}
        for side in range(0, 360, 45):
            views[f"{side}°"] = camera.around(terrain, (1280, 720), azimuth=side, pitch=35, distance=None)
        for name, view in views.items():
            rays = Ground.load(Scene.of(terrain, view, jobs=1)).rays
            best, depth = np.inf, np.empty(0)
            for _ in range(4):
                began = time.process_time()
                depth, _, _ = rays.first((0, 720, 0, 1280))
                best = min(best, time.process_time() - began)
            hits = np.isfinite(depth).sum()
            print(f"| {name} | {best / depth.size * 1e9:.0f} | {best / hits * 1e9:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--big", type=Path, help="a projected raster of --size samples a side")
    parser.add_argument("--size", type=int, default=16385, help="side of the raster made without --big, samples")
    parser.add_argument("--sides", metavar="STORE", help="only time rays at a store, from all sides")
    options = parser.parse_args()
    if options.sides:
        sides(options.sides)
        return
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        picture = str(work / "picture.png")
        cases = []
        tile = options.data / "n44w072-hgt" / "N44W072.hgt"
        tiles = sorted(map(str, (options.data / "california-3s-tiles").glob("*.tif")))
        if tile.is_file():
            cases.append(("tile 1201², degrees", [str(tile)], []))
        if tiles:
            cases.append(("40 tiles 13201 × 4801, degrees", tiles, ["--max-memory", "1GiB"]))
        if len(cases) < 2:
            print(f"(not all of the data is at {options.data}; what is missing is left out)")
        big = options.big or work / "big.tif"
        if not big.exists():
            timed([*OROGRAPH, "synth", "-o", str(big), "--size", str(options.size), "--seed", "7"], work)
        cases.append((f"{options.size}² float32, metres", [str(big)], ["--max-memory", "1.5GiB"]))
        timed([*OROGRAPH, "demo", "-o", str(work / "warm")], work / "none")
        timed([*OROGRAPH, "render", *cases[0][1], "-o", picture], work / "none")
        print("| input | first | again | peak memory, first | again |\n|---|---|---|---|---|")
        for name, paths, extra in cases:
            first, again = [], []
            for _ in range(options.runs):
                cache = work / "cache"
                shutil.rmtree(cache, ignore_errors=True)
                for results in (first, again):
                    results.append(timed([*OROGRAPH, "render", *paths, "-o", picture, *extra], cache))
            (s1, m1), (s2, m2) = (tuple(statistics.median(v) for v in zip(*r)) for r in (first, again))
            print(f"| {name} | {s1:.1f} s | {s2:.1f} s | {m1:.0f} MiB | {m2:.0f} MiB |", flush=True)
        if importlib.util.find_spec("pyvista") and tile.is_file():
            command = [sys.executable, "-c", PYVISTA, str(tile), picture]
            timed(command, work)
            s, m = (statistics.median(v) for v in zip(*[timed(command, work) for _ in range(options.runs)]))
            print(f"| tile, PyVista after reprojection by hand | {s:.1f} s | {s:.1f} s | {m:.0f} MiB | |")


if __name__ == "__main__":
    main()
