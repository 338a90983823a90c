"""The interactive view off screen: a flight over a large terrain, frame by frame, on whatever GPU there is.

    python bench/view.py [PATH...] [--tolerance 2] [--size 1280x720] [--frames 120] [--kind orbit|flight]

Without a PATH: the 40 tiles of California (13201 × 4801), built into a store in the cache first. Every frame is drawn
as the window draws it (tiles stream in meanwhile, shadows and sky on) and then waited for. Told are, as median and
worst: ms of Python (selection within it), ms until the GPU is done, patches and triangles, tiles loaded, MB uploaded,
and the largest error in pixels with the tiles that were there. ``--waited`` waits for all tiles in each frame.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from orograph.gpu.device import open_device
from orograph.gpu.frame import FrameStats
from orograph.gpu.renderer import Renderer
from orograph.picture.camera import around
from orograph.picture.prepare import prepare
from orograph.picture.scene import Scene
from orograph.store.terrain import Terrain
from orograph.view import View


def orbit(terrain: Terrain, size: tuple[int, int], count: int) -> list[View]:
    """Once around the middle of the terrain, all of it in view, half a degree a frame."""
    return [around(terrain, size, azimuth=200 + 0.5 * k, pitch=30, distance=None) for k in range(count)]


def flight(terrain: Terrain, size: tuple[int, int], count: int) -> list[View]:
    """A straight low flight across the terrain, looking ahead and down, at 1/2 of its width in all."""
    cols, rows = terrain.grid.cols, terrain.grid.rows
    spacing = float(np.mean(terrain.grid.spacing))
    level = terrain.levels - 1
    r, c = terrain.shape(level)
    coarse = terrain.read(level, 0, r, 0, c)
    views = []
    for k in range(count):
        at = 0.25 + 0.5 * k / max(count - 1, 1)
        x, y = (float(v) for v in terrain.grid.xy(at * cols, 0.5 * rows))
        window = coarse[max(0, r // 2 - 2) : r // 2 + 3, max(0, int(at * c) - 2) : int(at * c) + 3]
        ground = float(np.nanmax(window)) if np.isfinite(window).any() else 0.0
        eye = (x, y, ground + 25 * spacing)
        views.append(View(eye, (x + 400 * spacing, y + 60 * spacing, ground), width=size[0], height=size[1]))
    return views


def row(name: str, values: list[float], form: str = "{:.1f}") -> str:
    middle, worst = float(np.median(values)), max(values)
    return f"  {name:28} median {form.format(middle):>10}   worst {form.format(worst):>10}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("paths", nargs="*")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--tolerance", type=float, default=2.0)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--kind", choices=["orbit", "flight"], default="orbit")
    parser.add_argument("--waited", action="store_true")
    options = parser.parse_args()
    width, height = (int(v) for v in options.size.split("x"))
    paths = options.paths or sorted(map(str, (options.data / "california-3s-tiles").glob("*.tif")))
    terrain = prepare(paths)
    device = open_device()
    begun = time.perf_counter()
    renderer = Renderer(device, terrain)
    opened = time.perf_counter() - begun
    views = (orbit if options.kind == "orbit" else flight)(terrain, (width, height), options.frames)
    texture = device.texture((width, height), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    scene = Scene(terrain, views[0], sky=True, tolerance=options.tolerance)
    begun = time.perf_counter()
    renderer.draw(target, "rgba8unorm", scene)
    device.wait()
    first = time.perf_counter() - begun
    renderer.draw(target, "rgba8unorm", scene, wait=True)  # compiles what is left
    frames: list[tuple[float, float, FrameStats]] = []
    for view in views:
        begun = time.perf_counter()
        stats = renderer.draw(target, "rgba8unorm", replace(scene, view=view), wait=options.waited)
        python = time.perf_counter()
        device.wait()
        done = time.perf_counter()
        frames.append(((python - begun) * 1e3, (done - begun) * 1e3, stats))
    renderer.close()
    rows, cols = terrain.grid.shape
    print(
        f"{device.adapter.name}: {rows} × {cols} samples, {width} × {height} pixels, {options.tolerance:g} px, "
        f"{options.kind}"
    )
    print(f"  renderer opened in {opened * 1e3:.0f} ms, first frame {first * 1e3:.0f} ms")
    print(row("ms a frame", [f[1] for f in frames]))
    print(row("ms of Python", [f[2].cpu_ms for f in frames]))
    print(row("ms of selection", [f[2].select_ms for f in frames]))
    print(row("patches", [f[2].patches for f in frames], "{:,.0f}"))
    print(row("triangles", [f[2].triangles for f in frames], "{:,.0f}"))
    print(row("M triangles a second", [f[2].triangles / f[1] / 1e3 for f in frames]))
    print(row("tiles loaded", [f[2].tiles_loaded for f in frames], "{:.0f}"))
    print(row("MB uploaded", [f[2].bytes_uploaded / 1e6 for f in frames]))
    finite = [f[2].error_px for f in frames if math.isfinite(f[2].error_px)]
    print(row("px of error, bound", finite or [math.inf], "{:.2f}"))


if __name__ == "__main__":
    main()
