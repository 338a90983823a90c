"""Ambient occlusion: every way to compute L compared with 4,096 rays per sample, with time and error.

Run: ``python bench/occlusion.py [DEM] [--size 128] [--radius 600] [--only WORDS] [--figures FOLDER]``. Without a DEM,
the terrain is a fractal with a spacing of 30 m. Errors are over samples more than a few cells from the border of the
cut-out. Times are processor seconds per million samples on one thread; for methods on the GPU, wall seconds, or with a
software adapter processor seconds of all its threads. A second set of 4,096 rays (another seed) shows how accurate the
reference is. Screen-space occlusion is judged where a picture sees the ground (from straight above, as a map, and from
the south), against 4,096 rays from the same points.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orograph.lighting.gpu.cone_tracing import cones
from orograph.lighting.occlusion import ambient_occlusion

if TYPE_CHECKING:
    from PIL import Image

LINEAR = np.array([[30.0, 0.0], [0.0, -30.0]])


def ground(path: str | None, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights (size, size) from the middle of a file, or of a fractal; and the cells."""
    if path is None:
        from horizon import fractal

        return fractal(size), LINEAR
    import rasterio
    from rasterio.windows import Window

    with rasterio.open(path) as file:
        at = Window((file.width - size) // 2, (file.height - size) // 2, size, size)
        heights, t = file.read(1, window=at).astype(np.float32), file.transform
    return heights, np.array([[t.a, t.b], [t.d, t.e]])


def timed(work: Callable[[], np.ndarray], clock: Callable[[], float] = time.process_time) -> tuple[np.ndarray, float]:
    """A result and the time of its second run (the first compiles)."""
    start = clock()
    made = work()
    if clock() - start < 20:
        start = clock()
        made = work()
    return made, clock() - start


def gpu_clock() -> Callable[[], float] | None:
    """The clock for the GPU, or None if there is no GPU."""
    from orograph.gpu.device import NoAdapterError, open_device

    try:
        adapter = open_device().adapter
    except NoAdapterError as error:
        print(f"Without the GPU's methods: {error}")
        return None
    print(f"GPU: {adapter.name}, {adapter.backend}")
    return time.process_time if adapter.software else time.perf_counter


def methods(rho: str, radius: float | None, gpu: bool) -> list[tuple[str, dict[str, object], bool]]:
    """The methods to compare: a label, the arguments, whether it runs on the GPU."""
    rows = [("4,096 other rays", {"method": "rays", "rays": 4096, "seed": 1}, False)]
    rows += [(f"{n:,} rays", {"method": "rays", "rays": n}, False) for n in (16, 64, 256, 1024)]
    name = "sweeps" if radius is None else "walks"
    rows += [(f"{name} in {n} azimuths", {"azimuths": n}, False) for n in (8, 16, 32, 64, 128)]
    if gpu:
        rows += [(f"{n:,} shadow maps", {"method": "shadow-maps", "rays": n}, True) for n in (64, 256, 1024)]
        rows += [(f"{len(cones(n)[0])} cones", {"method": "cone-tracing", "cones": n}, True) for n in (10, 24, 40, 64)]
    return rows


def seen(
    h: np.ndarray, linear: np.ndarray, size: tuple[int, int] = (640, 400), above: bool = False
) -> tuple[np.ndarray, ...]:
    """A picture of the ground from the south, or from straight above with a pixel on every sample.

    Returns:
        depth (height, width), points (n, 3), normals, slope of a pixel.
    """
    from orograph.lighting.normal import normals
    from orograph.raycast.caster import Caster
    from orograph.viewpoint import View

    rows, cols = h.shape
    width, height = (cols, rows) if above else size
    middle = linear @ [(cols - 1) / 2, (rows - 1) / 2]
    across = float(np.linalg.norm(linear @ [cols, 0]))
    low = float(np.nanmean(h))
    eye, target = (middle[0], middle[1] - 0.75 * across, low + 0.55 * across), (*(middle - [0, 0.02 * across]), low)
    fov, up = 38.0, (0.0, 0.0, 1.0)
    if above:  # so far away that it is a map
        eye, target, up = (*middle, low + 40 * across), (*middle, low), (0.0, 1.0, 0.0)
        fov = 2 * np.degrees(np.arctan(np.linalg.norm(linear @ [0, rows]) / 2 / (40 * across)))
    view = View(eye, target, up, fov_y=float(fov), width=width, height=height)
    right, up, forward = view.axes()
    _, _, _, d0, du, dv = view.ray_basis()
    inverse = np.linalg.inv(linear)

    def samples(v: np.ndarray) -> np.ndarray:
        return np.array([*(inverse @ v[:2]), v[2]])

    eye, *basis = (samples(np.asarray(v, np.float64)) for v in (view.eye, d0, du, dv))
    depth, _ = Caster.of(h, 1).cast_pinhole(eye, *basis, (height, width))
    py, px = np.mgrid[:height, :width] + 0.5
    points = eye + depth[..., None] * (basis[0] + px[..., None] * basis[1] + py[..., None] * basis[2])
    field = normals(h, linear, 1)
    world = np.stack([between(field[..., k], points) for k in range(3)], axis=-1)
    world /= np.linalg.norm(world, axis=-1, keepdims=True)
    facing = world @ np.stack([right, up, forward], axis=1)
    return depth, points, facing, np.float64(view.pixel_slope)


def between(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A raster at points (…, 3), linear between samples; NaN outside."""
    from scipy.ndimage import map_coordinates

    at = np.nan_to_num(points[..., [1, 0]], nan=-9.0)
    return map_coordinates(values.astype(float), np.moveaxis(at, -1, 0), order=1, cval=np.nan)


def screen(h: np.ndarray, linear: np.ndarray, truth: np.ndarray, radius: float, clock: Callable[[], float]) -> None:
    """Compare the screen-space occlusion of pictures with the true occlusion of the ground."""
    from orograph.rendering.gpu.shade.ssao import Quality, screen_occlusion

    for where, above in (("from straight above", True), ("from the south", False)):
        depth, points, facing, slope = seen(h, linear, above=above)
        known = between(truth, points)
        print(f"\nScreen space {where}, {depth.shape[1]} × {depth.shape[0]}, R {radius:g} m\n")
        print("| slices × steps a side | s per Mpx | mean error | mean abs. error | largest |\n|---|---|---|---|---|")
        for quality in (Quality(2, 6), Quality(), Quality(16, 64, falloff=0.02, most=4096)):
            made, spent = timed(
                lambda q=quality, d=depth, n=facing, s=slope: screen_occlusion(d, n, float(s), radius, quality=q), clock
            )
            d = (made - known)[3:-3, 3:-3]
            d = d[np.isfinite(d)]
            how = f"| {quality.slices} × {quality.steps} | {spent / depth.size * 1e6:.1f}"
            print(f"{how} | {d.mean():+.4f} | {np.abs(d).mean():.4f} | {np.abs(d).max():.2f} |", flush=True)


def grey(values: np.ndarray, low: float = 0.45) -> np.ndarray:
    return np.uint8(255 * np.clip((np.nan_to_num(values, nan=1.0) - low) / (1 - low), 0, 1)[..., None].repeat(3, -1))


def redblue(values: np.ndarray, most: float = 0.2) -> np.ndarray:
    """White is 0, red too light, blue too dark, full at ±``most``."""
    x = np.clip(np.nan_to_num(values) / most, -1, 1)
    rgb = np.ones((*x.shape, 3))
    rgb[x > 0] -= x[x > 0, None] * [0.1, 0.85, 0.8]
    rgb[x < 0] += x[x < 0, None] * [0.85, 0.65, 0.1]
    return np.uint8(255 * rgb)


def sheet(columns: list[list[tuple[str, np.ndarray]]], gap: int = 8, head: int = 24) -> Image.Image:
    """Named pictures in columns, each under its name."""
    from PIL import Image, ImageDraw, ImageFont

    tall = max(sum(len(p) + head + gap for _, p in column) for column in columns) - gap
    out = Image.new("RGB", (sum(c[0][1].shape[1] + gap for c in columns) - gap, tall), "white")
    draw, font, x = ImageDraw.Draw(out), ImageFont.load_default(14), 0
    for column in columns:
        y = 0
        for name, pixels in column:
            draw.text((x + 2, y + 3), name, (40, 40, 40), font)
            out.paste(Image.fromarray(pixels), (x, y + head))
            y += len(pixels) + head + gap
        x += column[0][1].shape[1] + gap
    return out


def figures(dem: str | None, size: int, radius: float, folder: Path) -> None:
    """The manual's pictures: methods and laws, maps of the methods with their errors, screen space from the south."""
    from orograph.lighting.normal import gradient
    from orograph.lighting.surface import hillshade_of
    from orograph.rendering.gpu.shade.ssao import screen_occlusion

    h, linear = ground(dem, size * 5 // 3)

    def made(**how: object) -> np.ndarray:
        return ambient_occlusion(h, linear, **how)  # type: ignore[arg-type]

    laws = {
        f"16 rays, R = {radius:g} m": made(method="rays", rays=16, radius=radius),
        f"32 walks, step, R = {radius:g} m": made(radius=radius),
        f"32 walks, linear, R = {radius:g} m": made(radius=radius, rho="linear"),
        "32 sweeps, any distance": made(),
    }
    sheet([[(name, grey(values))] for name, values in laws.items()]).save(folder / "occlusion.jpg", quality=88)
    h, linear = ground(dem, size)
    truth = made(radius=radius, azimuths=64)
    depth, _, facing, slope = seen(h, linear, above=True)
    ways = {
        "256 shadow maps": made(radius=radius, method="shadow-maps", rays=256),
        "64 cones": made(radius=radius, method="cone-tracing"),
        "64 rays": made(radius=radius, method="rays", rays=64),
        "screen space": screen_occlusion(depth, facing, float(slope), radius),
    }
    relief = grey(hillshade_of(*gradient(h, linear), [(315.0, 45.0, 1.0)])[0], 0.0)
    columns = [[("64 walks (the reference)", grey(truth)), ("relief", relief)]]
    columns += [[(name, grey(v)), ("error, full at 0.1", redblue(v - truth, 0.1))] for name, v in ways.items()]
    sheet(columns).save(folder / "occlusion-gpu.jpg", quality=88)
    depth, points, facing, slope = seen(h, linear)
    known = between(truth, points)
    there = np.isfinite(depth) & np.isfinite(known)
    got = np.where(there, screen_occlusion(depth, facing, float(slope), radius), np.nan)
    south = {"64 walks": grey(known), "screen space": grey(got), "difference, full at 0.2": redblue(got - known)}
    sheet([[one] for one in south.items()]).save(folder / "occlusion-screen.jpg", quality=88)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--radius", type=float, default=600.0)
    parser.add_argument("--only", default="", help="comma-separated words; only rows that contain one run")
    parser.add_argument("--figures", type=Path, help="a folder: write the manual's pictures instead")
    args = parser.parse_args()
    if args.figures:
        figures(args.dem, args.size, args.radius, args.figures)
        return
    h, linear = ground(args.dem, args.size)
    clock = gpu_clock()
    inner = np.s_[3:-3, 3:-3]
    words = [w.strip() for w in args.only.split(",")]
    print(f"{args.size}² samples, {np.ptp(h):.0f} m of relief, R = {args.radius:g} m")
    cases: list[tuple[str, float | None]] = [("step", args.radius), ("linear", args.radius), ("step", None)]
    for rho, radius in cases:
        print(f"\nρ {rho}, R {'unlimited' if radius is None else f'{radius:g} m'}\n")
        print("| L by | s per Mpx | mean error | mean abs. error | largest |\n|---|---|---|---|---|")
        law = {"rho": rho, "radius": radius, "jobs": 1}
        truth = ambient_occlusion(h, linear, method="rays", rays=4096, **law)  # type: ignore[arg-type]
        for label, how, on_gpu in methods(rho, radius, clock is not None):
            if not any(word in label for word in words):
                continue
            ticks = clock if on_gpu and clock else time.process_time
            made, spent = timed(lambda how=how, law=law: ambient_occlusion(h, linear, **law, **how), ticks)
            d = (made.astype(float) - truth)[inner]
            values = f"{d.mean():+.5f} | {np.abs(d).mean():.5f} | {np.abs(d).max():.4f}"
            print(f"| {label} | {spent / h.size * 1e6:.2f} | {values} |", flush=True)
        if clock and radius and rho == "step" and any(word in "screen space" for word in words):
            screen(h, linear, truth, radius, clock)


if __name__ == "__main__":
    main()
