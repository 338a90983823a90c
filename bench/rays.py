"""Ground by rays beside ground by patches, and by both: what drawing it alone takes a GPU, without light, in turns.

    python bench/rays.py [--terrain california|synthetic-16385|PATH…] [--tolerance 2] [--size 1280x720] [--views 3]
        [--times 12] [--folder FOLDER]

Of each flight of ``bench/view.py`` some views, with all that they want there: patches, rays and the hybrid of both are
drawn in turns, so that other programs hold up all. Told are the fastest and the median of ``--times``, ms, until the
GPU is done; of patches how many, of rays the windows, their samples, and the levels of the coarsest and the finest; of
the hybrid the part of the blocks that rays draw, its patches, and its time over that of the better of the two; so,
too, by the time of the processors, which on software does not depend on how busy the machine is; and what it expects
of patches and of rays alone, beyond what a picture of nothing takes. At last what it has measured that triangles,
pixels, rays and their steps take.
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
from orograph.rendering.gpu.surface import mixer
from orograph.rendering.gpu.targets import Targets
from orograph.scene.scene import Scene
from view import FLIGHTS, terrain_of


def drawn(device: Device, ground: Any, targets: Targets, chosen: Any) -> tuple[float, float]:
    """Milliseconds of a draw of the ground alone: by the clock, and of the processors."""
    begun, worked = time.perf_counter(), time.process_time()
    encoder = device.handle.create_command_encoder()
    ground.draw(encoder, targets, chosen)
    device.queue.submit([encoder.finish()])
    device.wait()
    return (time.perf_counter() - begun) * 1e3, (time.process_time() - worked) * 1e3


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
            both = scene.but(method="hybrid")
            for wait in (True, False):  # (the first reads, the second decides by what the device takes)
                hybrid = ground.choose(both, None, options.tolerance, wait=wait)
            shares = ground._mixer._last.shares
            write(device, camera, camera_of(view, terrain, 1.0))  # (measuring has others)
            ways = {"patches": patches, "rays": rays, "hybrid": hybrid}
            took: dict[str, list[tuple[float, float]]] = {method: [] for method in ways}
            for k in range(options.times + 1):
                for method, chosen in ways.items():
                    ms = drawn(device, ground, targets, chosen)
                    took[method] += [ms] if k else []  # the first compiles
            windows, by_rays = rays.rays.windows, hybrid.selection.cast.by_rays
            least = {method: np.min(times, 0) for method, times in took.items()}
            over, worked = least["hybrid"] / np.minimum(least["patches"], least["rays"])
            ms = {m: f"{least[m][0]:6.2f} ms ({np.median(took[m], 0)[0]:.2f}; cpu {least[m][1]:.0f})" for m in ways}
            print(
                f"  {name:5}  {len(patches.patches.instances):6,} patches {ms['patches']}   rays {ms['rays']}, "
                f"{len(windows)} windows, {windows.samples:,} samples, levels {windows[0].level} to "
                f"{windows[-1].level}   hybrid {ms['hybrid']}, {by_rays.mean():.0%} by rays, "
                f"{len(hybrid.selection.instances):,} patches, × {over:.2f} (cpu × {worked:.2f})"
                + (f"; expected of patches {shares.patches / 1e6:.2f}, rays {shares.rays / 1e6:.2f}" if shares else ""),
                flush=True,
            )
    for costs in mixer._COSTS.values():
        print("  ns, as the hybrid has measured them: " + ", ".join(f"{k} {v:.3g}" for k, v in costs._asdict().items()))
    renderer.close()


if __name__ == "__main__":
    main()
