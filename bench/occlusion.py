"""Ambient occlusion: every way of getting L beside 4,096 rays per sample, with time and error.

Run: ``python bench/occlusion.py [DEM] [--size 128] [--radius 600]``. Without a DEM the terrain is a
fractal at 30 m. Errors are over samples more than a few cells from the border of the cut-out; times are on one thread,
processor seconds per million samples. Of 4,096 rays a second set (another seed) says how far the reference can be
trusted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from orograph.light.occlusion import ambient_occlusion

LINEAR = np.array([[30.0, 0.0], [0.0, -30.0]])


def ground(path: str | None, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights (size, size) out of the middle of a file, or a fractal; and the cells."""
    if path is None:
        from horizon import fractal

        return fractal(size), LINEAR
    import rasterio
    from rasterio.windows import Window

    with rasterio.open(path) as file:
        at = Window((file.width - size) // 2, (file.height - size) // 2, size, size)
        heights, t = file.read(1, window=at).astype(np.float32), file.transform
    return heights, np.array([[t.a, t.b], [t.d, t.e]])


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """A result and the processor time of its second run (the first compiles)."""
    start = time.process_time()
    made = work()
    if time.process_time() - start < 20:
        start = time.process_time()
        made = work()
    return made, time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--radius", type=float, default=600.0)
    args = parser.parse_args()
    h, linear = ground(args.dem, args.size)
    inner = np.s_[3:-3, 3:-3]
    print(f"{args.size}² samples, {np.ptp(h):.0f} m of relief, R = {args.radius:g} m")
    cases: list[tuple[str, float | None]] = [("step", args.radius), ("linear", args.radius), ("step", None)]
    for rho, radius in cases:
        print(f"\nρ {rho}, R {'unlimited' if radius is None else f'{radius:g} m'}\n")
        print("| L by | s per Mpx | mean error | mean abs. error | largest |\n|---|---|---|---|---|")

        def run(how: dict[str, object], rho: str = rho, radius: float | None = radius) -> tuple[np.ndarray, float]:
            return timed(lambda: ambient_occlusion(h, linear, rho=rho, radius=radius, jobs=1, **how))  # type: ignore[arg-type]

        truth, seconds = run({"method": "rays", "rays": 4096})
        rows = [("4,096 rays", truth, seconds)]
        rows += [("4,096 other rays", *run({"method": "rays", "rays": 4096, "seed": 1}))]
        rows += [(f"{n:,} rays", *run({"method": "rays", "rays": n})) for n in (16, 64, 256, 1024)]
        name = "sweeps" if radius is None else "walks"
        rows += [(f"{name} in {n} azimuths", *run({"azimuths": n})) for n in (8, 16, 32, 64, 128)]
        for label, made, spent in rows:
            d = (made.astype(float) - truth)[inner]
            values = (
                "| – | – | –"
                if made is truth
                else f"| {d.mean():+.5f} | {np.abs(d).mean():.5f} | {np.abs(d).max():.4f}"
            )
            print(f"| {label} | {spent / h.size * 1e6:.2f} {values} |", flush=True)


if __name__ == "__main__":
    main()
