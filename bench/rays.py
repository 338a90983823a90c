"""Ground by rays beside ground by patches: what drawing it alone takes a GPU, without light, in turns.

    python bench/rays.py [--terrain california|synthetic-16385|PATH…] [--tolerance 2] [--size 1280x720] [--views 3]
        [--times 12] [--folder FOLDER]

Of each flight of ``bench/view.py`` some views, with all that they want there: patches and rays are drawn in turns, so
that other programs hold up both. Told are the fastest and the median of ``--times``, ms, until the GPU is done; of
patches how many, of rays the windows, their samples, and the levels of the coarsest and the finest.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from orograph.gpu.device import Device, open_device
from orograph.gpu.recording import write
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.targets import Targets
from orograph.scene.scene import Scene
from view import FLIGHTS, terrain_of


def drawn(device: Device, ground: Any, targets: Targets, chosen: Any) -> float:
    """Milliseconds of a draw of the ground alone."""
    begun = time.perf_counter()
    encoder = device.handle.create_command_encoder()
    ground.draw(encoder, targets, chosen)
    device.queue.submit([encoder.finish()])
    device.wait()
    return (time.perf_counter() - begun) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--terrain", nargs="+", default=["california"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--folder", type=Path, help="where synthetic stores are kept; default: the cache")
    parser.add_argument("--tolerance", type=float, default=2.0)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--views", type=int, default=3, help="of each flight")
    parser.add_argument("--times", type=int, default=12)
    options = parser.parse_args()
    width, height = (int(v) for v in options.size.split("x"))
    terrain, device = terrain_of(options.terrain, options), open_device()
    renderer, targets = Renderer(device, terrain), Targets(device, width, height)
    ground, camera = renderer._ground, renderer._camera
    rows, cols = terrain.grid.shape
    print(f"{device.adapter.name}: {rows} × {cols} samples, {width} × {height} pixels, {options.tolerance:g} px")
    for name in ("orbit", "low", "jump"):
        for view in FLIGHTS[name](terrain, (width, height), 20 * options.views)[::20]:
            scene = Scene.of(terrain, view, tolerance=options.tolerance, method="raycast")
            write(device, camera, camera_of(view, terrain, 1.0))
            rays = ground.choose(scene, None, options.tolerance, wait=True)
            plain = scene.but(method="auto")
            ground.choose(plain, None, options.tolerance, wait=True)
            patches = ground.choose(plain, None, options.tolerance, wait=False)  # as a frame has them
            ways = {"patches": patches, "rays": rays}
            took: dict[str, list[float]] = {method: [] for method in ways}
            for k in range(options.times + 1):
                for method, chosen in ways.items():
                    ms = drawn(device, ground, targets, chosen)
                    took[method] += [ms] if k else []  # the first compiles
            (least, middle), (fastest, usual) = ((min(v), np.median(v)) for v in took.values())
            windows = rays.rays.windows
            print(
                f"  {name:5}  {len(patches.patches.instances):6,} patches {least:7.1f} ({middle:.1f}) ms   rays "
                f"{fastest:7.1f} ({usual:.1f}) ms, {len(windows)} windows, {windows.samples:10,} samples, levels "
                f"{windows[0].level} to {windows[-1].level}",
                flush=True,
            )
    renderer.close()


if __name__ == "__main__":
    main()
