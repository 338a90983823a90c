"""Ambient apertures compared with ray-traced soft shadows: errors, pictures of them, and the cost per picture.

Run: ``python bench/aperture.py [DEM] [--size 256] [--pictures DIR]``. Without a DEM, the terrain is a fractal with a
spacing of 30 m. The light comes from one sun and is relative to a surface that faces it, so errors are fractions of
full light. For every sun, ``--pictures`` saves the ray-traced picture, the aperture's, and their difference side by
side. The cost of a picture is measured in two ways: whole pictures of 1280 × 720 from a store with baked apertures,
with each kind of light; and the time that the kernel alone adds per hit.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from occlusion import ground
from orograph.lighting.aperture import CapField, Lights, aperture, light, shade
from orograph.lighting.shadow import shadow_rays
from orograph.lighting.sun import Sun

WHITE = (1.0, 1.0, 1.0)


def errors(h: np.ndarray, linear: np.ndarray, rays: int, pictures: Path | None) -> None:
    """Print the table of errors and save the pictures."""
    start = time.process_time()
    caps = aperture(h, linear, azimuths=64, jobs=1)
    print(f"\ncaps out of 64 horizons: {(time.process_time() - start) / h.size * 1e6:.2f} s per Mpx with compiling")
    inner = np.s_[3:-3, 3:-3]
    print("\n| altitude | diameter | light by rays | mean error | mean abs. | rms | 99 % within | wrong by > 0.1 |")
    print("|---|---|---|---|---|---|---|---|")
    for altitude in (5.0, 15.0, 30.0, 50.0):
        for diameter in (0.53, 10.0, 30.0):
            sun = Sun(300.0, altitude, diameter)
            lights = Lights([(sun, WHITE)])
            truth = shadow_rays(h, linear, sun, rays=rays, cosine=True)
            made = shade(caps, h, linear, lights)[..., 0]
            d = (made - truth)[inner]
            off = np.abs(d)
            print(
                f"| {altitude:g}° | {diameter:g}° | {truth[inner].mean():.3f} | {d.mean():+.4f} | {off.mean():.4f} "
                f"| {np.sqrt((d**2).mean()):.4f} | {np.quantile(off, 0.99):.3f} | {100 * (off > 0.1).mean():.1f} % |",
                flush=True,
            )
            if pictures:
                save(pictures / f"aperture-{altitude:g}-{diameter:g}.png", truth, made)


def save(path: Path, truth: np.ndarray, made: np.ndarray) -> None:
    """Rays, aperture, and difference: blue where the aperture is darker, red where it is brighter."""
    from PIL import Image

    grey = [np.clip(a, 0, 1) ** (1 / 2.2) for a in (truth, made)]
    d = np.clip((made - truth) * 2, -1, 1)
    color = np.stack([1 - np.maximum(-d, 0), 1 - np.abs(d), 1 - np.maximum(d, 0)], -1)
    gap = np.ones((len(truth), 6, 3))
    parts = [np.repeat(grey[0][..., None], 3, -1), gap, np.repeat(grey[1][..., None], 3, -1), gap, color]
    Image.fromarray((np.concatenate(parts, 1) * 255).astype(np.uint8)).save(path)


def cost(h: np.ndarray, linear: np.ndarray) -> None:
    """What light through spherical caps adds to a picture of 1280 × 720, on one thread."""
    from orograph.lighting.normal import gradient
    from orograph.raycast.caster import Caster

    rows, cols = h.shape
    caster = Caster.of(h, 1)
    caps = CapField.of(aperture(h, linear, azimuths=16), linear)
    gx, gy = gradient(h, linear)
    inverse = np.linalg.inv(linear)
    spacing = abs(linear[0, 0])
    eye = np.array([cols / 2, rows * 1.3, h.max() + 0.35 * rows * spacing])
    forward = np.array([0.0, 0.55 * rows * spacing, -0.38 * rows * spacing])
    forward /= np.linalg.norm(forward)
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    pixel = 0.6 / 720
    ways = [np.array([*(inverse @ v[:2]), v[2]]) for v in (forward, right * pixel, -up * pixel)]
    d0 = ways[0] - 640 * ways[1] - 360 * ways[2]

    def trace() -> tuple[np.ndarray, np.ndarray]:
        """Find the hits and their slopes, which an unlit picture needs too."""
        t, _ = caster.cast_pinhole(eye, d0, ways[1], ways[2], (720, 1280))
        py, px = np.nonzero(np.isfinite(t))
        points = eye + t[py, px, None] * (d0 + px[:, None] * ways[1] + py[:, None] * ways[2])
        j, i = np.clip(np.rint(points[:, :2]).astype(int), 0, [cols - 1, rows - 1]).T
        return points, np.stack([gx[i, j], gy[i, j]], 1).astype(np.float64)

    lights = Lights([(Sun(300.0, 30.0), WHITE)], ambient=(0.3, 0.3, 0.35))
    points, slopes = trace()
    light(caps, points, slopes, lights, jobs=1)
    traced, lit = [], []
    for _ in range(5):
        start = time.process_time()
        points, slopes = trace()
        traced.append(time.process_time() - start)
        start = time.process_time()
        light(caps, points, slopes, lights, jobs=1)
        lit.append(time.process_time() - start)
    a, b = min(traced), min(lit)
    print(f"\n1280 × 720, {len(points):,} hits: cast {1e3 * a:.0f} ms, light through caps {1e3 * b:.0f} ms,", end=" ")
    print(f"{1e9 * b / len(points):.0f} ns per hit")


def pictures(h: np.ndarray, linear: np.ndarray, rounds: int) -> None:
    """Time pictures of 1280 × 720 from a store with baked apertures, with each light: as a command and in a process."""
    import tempfile

    from affine import Affine

    import orograph
    from orograph.geo.grid import Grid
    from orograph.lighting.bake import bake
    from orograph.store.source import ArraySource

    (a, b), (d, e) = linear
    source = ArraySource(h, Grid(h.shape, Affine(a, b, 0, d, e, 0)), "ground")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ground.oro"
        orograph.build(source, path, errors=()).close()
        bake(path, ["aperture", "ambient-occlusion"]).close()
        lights = ("none", "aperture", "ao", "relief")
        wall, cpu, command, stages = (dict.fromkeys(lights, np.inf) for _ in range(4))
        for light in lights:  # compiles the kernels
            with orograph.open(path) as terrain:
                orograph.render(terrain, size=(64, 36), sun=(300, 30), light=light)
        for _ in range(rounds):
            for light in lights:
                begun, used = time.perf_counter(), time.process_time()
                with orograph.open(path) as terrain:
                    picture = orograph.render(terrain, size=(1280, 720), sun=(300, 30), light=light)
                wall[light] = min(wall[light], time.perf_counter() - begun)
                used = time.process_time() - used
                if used < cpu[light]:
                    cpu[light], stages[light] = used, picture.facts["seconds"]
        for _ in range(max(rounds - 2, 1)):
            for light in lights:
                begun = time.perf_counter()
                given = ["render", str(path), "-o", str(Path(folder) / "a.jpg"), "--sun", "300,30", "--light", light]
                subprocess.run([sys.executable, "-m", "orograph", *given, "--quiet"], check=True, capture_output=True)
                command[light] = min(command[light], time.perf_counter() - begun)
    print("\n| light of a 1280 × 720 picture | command s | beside unlit | in a process, s | | processor s | | stages |")
    print("|---|---|---|---|---|---|---|---|")
    for light in lights:
        cells = (f"{t[light]:.3f} | {t[light] / t['none']:.2f}" for t in (command, wall, cpu))
        print(f"| {light} | {' | '.join(cells)} | {stages[light]} |")


def frames(h: np.ndarray, linear: np.ndarray, rounds: int = 16) -> None:
    """Time frames of 1280 × 720 of the GPU renderer from a store with baked apertures, with each light in turn."""
    import tempfile

    from affine import Affine

    import orograph
    from orograph.geo.grid import Grid
    from orograph.gpu.device import open_device
    from orograph.lighting.bake import bake
    from orograph.rendering.gpu.frame import Overlay
    from orograph.rendering.gpu.renderer import Renderer
    from orograph.scene.camera import whole
    from orograph.scene.scene import Scene
    from orograph.store.source import ArraySource

    device = open_device()
    (a, b), (d, e) = linear
    source = ArraySource(h, Grid(h.shape, Affine(a, b, 0, d, e, 0)), "ground")
    ways: dict[str, dict] = {"none": {}, "relief": {}, "ao": {}, "aperture": {}, "raytraced": {"rays": 64}}
    best = dict.fromkeys(ways, np.inf)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ground.oro"
        orograph.build(source, path).close()
        bake(path, ["aperture", "ambient-occlusion"]).close()
        texture = device.texture((1280, 720), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        target = texture.create_view()
        with orograph.open(path) as terrain:
            view = whole(terrain, (1280, 720))
            drawn = {}
            for light, more in ways.items():  # one renderer for each light, so that they can take turns
                renderer, scene = (
                    Renderer(device, terrain),
                    Scene.of(terrain, view, sun=Sun(300, 30), light=light, tolerance=1.0),
                )
                scene = scene.but(**more)
                drawn[light] = renderer, scene
                renderer.draw(target, "rgba8unorm", scene)
                while renderer.busy:
                    renderer.draw(target, "rgba8unorm", scene)
            for k in range(rounds):
                for light, (renderer, scene) in drawn.items():
                    other = Overlay(reach=1.0 + k)  # the same picture from the start
                    device.wait()
                    begun = time.perf_counter()
                    renderer.draw(target, "rgba8unorm", scene, overlay=other)
                    device.wait()
                    best[light] = min(best[light], time.perf_counter() - begun)
            for renderer, _ in drawn.values():
                renderer.close()
    print(f"\n{device.adapter.name}, a frame of 1280 × 720:")
    print("\n| light | ms | beside unlit |\n|---|---|---|")
    for light, seconds in best.items():
        print(f"| {light} | {1e3 * seconds:.0f} | {seconds / best['none']:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--rounds", type=int, default=7, help="of the pictures; the best counts")
    parser.add_argument("--cost", action="store_true", help="only the cost of a picture")
    parser.add_argument("--gpu", action="store_true", help="only the cost of a frame of the GPU renderer")
    args = parser.parse_args()
    h, linear = ground(args.dem, args.size)
    print(f"{args.size}² samples, {np.ptp(h):.0f} m of relief; {args.rays} rays to each sun")
    if args.gpu:
        frames(h, linear)
        return
    if args.pictures:
        args.pictures.mkdir(parents=True, exist_ok=True)
    pictures(h, linear, args.rounds)
    if args.cost:
        return
    cost(h, linear)
    errors(h, linear, args.rays, args.pictures)


if __name__ == "__main__":
    main()
