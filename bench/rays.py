"""Ground drawn by rays, by patches, and by both: GPU time without light, in turns.

    python bench/rays.py [--terrain california|synthetic-16385|PATH…] [--tolerance 2] [--size 1280x720] [--views 3]
        [--times 12] [--folder FOLDER]

Some views of each flight of ``bench/view.py`` are drawn with all their tiles by patches, rays and the hybrid of both,
in turns, so that other load affects all alike. Printed are the fastest and the median of ``--times``, ms, until the GPU
is done; the number of patches; the windows of the rays, their samples, and their coarsest and finest level; for the
hybrid, the share of the blocks that rays draw, its patches, and its time relative to the better of the two, of the
fastest and in the median of the turns. The same is printed in processor time, which depends less on other load with a
software adapter; and the hybrid's estimates for patches and for rays alone, beyond an empty picture. Last come the
hybrid's measured costs of triangles, pixels, rays and ray steps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
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


def timed(device: Device, draw: Callable[[Any], None]) -> tuple[float, float]:
    """Milliseconds of what a function records with an encoder: by the clock, and of the processors."""
    begun, worked = time.perf_counter(), time.process_time()
    encoder = device.handle.create_command_encoder()
    draw(encoder)
    device.queue.submit([encoder.finish()])
    device.wait()
    return (time.perf_counter() - begun) * 1e3, (time.process_time() - worked) * 1e3


def asked(description: str | None, views: int, times: int) -> argparse.Namespace:
    """What the command line asks for. Args: views, times: the defaults."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--terrain", nargs="+", default=["california"])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--folder", type=Path, help="where synthetic stores are kept; default: the cache")
    parser.add_argument("--tolerance", type=float, default=2.0)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--views", type=int, default=views, help="of each flight")
    parser.add_argument("--times", type=int, default=times)
    options = parser.parse_args()
    options.size = tuple(int(v) for v in options.size.split("x"))
    return options


def main() -> None:
    options = asked(__doc__, views=3, times=12)
    width, height = options.size
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
            patches = ground.choose(plain, None, options.tolerance, wait=False)  # as in a frame
            both = scene.but(method="hybrid")
            for wait in (True, False):  # (the first reads, the second decides by the device's costs)
                hybrid = ground.choose(both, None, options.tolerance, wait=wait)
            shares = ground._mixer._last.shares
            write(device, camera, camera_of(view, terrain, 1.0))  # (measuring uses others)
            ways = {"patches": patches, "rays": rays, "hybrid": hybrid}
            took: dict[str, list[tuple[float, float]]] = {method: [] for method in ways}
            for k in range(options.times + 1):
                for method, chosen in ways.items():
                    ms = timed(device, lambda encoder, chosen=chosen: ground.draw(encoder, targets, chosen))
                    took[method] += [ms] if k else []  # the first compiles the kernels
            windows, by_rays = rays.rays.windows, hybrid.selection.cast.by_rays
            least = {method: np.min(times, 0) for method, times in took.items()}
            over, worked = least["hybrid"] / np.minimum(least["patches"], least["rays"])
            better = min(("patches", "rays"), key=lambda method: np.median(took[method], 0)[1])
            turns, by_turns = np.median(np.array(took["hybrid"]) / np.array(took[better]), 0)
            ms = {m: f"{least[m][0]:6.2f} ms ({np.median(took[m], 0)[0]:.2f}; cpu {least[m][1]:.0f})" for m in ways}
            print(
                f"  {name:5}  {len(patches.patches.instances):6,} patches {ms['patches']}   rays {ms['rays']}, "
                f"{len(windows)} windows, {windows.samples:,} samples, levels {windows[0].level} to "
                f"{windows[-1].level}   hybrid {ms['hybrid']}, {by_rays.mean():.0%} by rays, "
                f"{len(hybrid.selection.instances):,} patches, × {over:.2f} (cpu × {worked:.2f}), in the median of "
                f"turns × {turns:.2f} (cpu × {by_turns:.2f})"
                + (f"; expected of patches {shares.patches / 1e6:.2f}, rays {shares.rays / 1e6:.2f}" if shares else ""),
                flush=True,
            )
    for costs in mixer._COSTS.values():
        print("  ns, as the hybrid has measured them: " + ", ".join(f"{k} {v:.3g}" for k, v in costs._asdict().items()))
    renderer.close()


if __name__ == "__main__":
    main()
