"""Horizon sweeps: samples times azimuths per second, on one thread and two, and beside topocalc where it is installed.

Run: ``python bench/horizon.py [DEM] [--size 2048]``. Without a DEM the terrain is a fractal. Rates on one thread are
per second of processor time (other work on the machine does not count), on more threads per second of the clock.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from orograph.light.horizon import horizon, sky_view


def fractal(size: int) -> np.ndarray:
    """Terrain-like heights with a power spectrum of 1/f²."""
    rng = np.random.default_rng(7)
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None])
    f[0, 0] = 1
    spectrum = (rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)) / f**2
    h = np.fft.irfft2(spectrum, (size, size))
    return ((h - h.min()) / np.ptp(h) * size * 4).astype(np.float32)


def rate(work: Callable[[], object], items: int, clock: Callable[[], float], repeat: int = 3) -> float:
    """The best of ``repeat`` rates, millions of items per second."""
    best = 0.0
    for _ in range(repeat):
        start = clock()
        work()
        best = max(best, items / (clock() - start) / 1e6)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=2048)
    options = parser.parse_args()
    if options.dem:
        import orograph

        heights = orograph.read(options.dem).heights
    else:
        heights = fractal(options.size)
    linear = np.array([[30.0, 0.0], [0.0, -30.0]])
    sky_view(heights[:64, :64], linear, 4)
    sky_view(heights[:64, :64], linear, 4, measure="sky-view-slope")
    n = heights.size
    print(f"{heights.shape[1]} × {heights.shape[0]} samples; millions of samples × azimuths per second")
    for azimuth in (0.0, 22.5, 45.0, 70.0, 90.0, 200.0):
        one = rate(lambda: horizon(heights, linear, azimuth, jobs=1), n, time.process_time)  # noqa: B023
        print(f"  horizon {azimuth:5.1f}°      1 thread  {one:7.1f}")
    for measure in ("sky-view", "visible-sky", "sky-view-slope"):
        one = rate(lambda: sky_view(heights, linear, 16, measure=measure, jobs=1), 16 * n, time.process_time, 1)  # type: ignore[arg-type] # noqa: B023
        two = rate(lambda: sky_view(heights, linear, 16, measure=measure, jobs=2), 16 * n, time.perf_counter, 1)  # type: ignore[arg-type] # noqa: B023
        print(f"  {measure:14s} × 16  1 thread  {one:7.1f}   2 threads {two:7.1f}")
    try:
        from topocalc.viewf import viewf
    except ImportError:
        print("  topocalc is not installed: not compared")
        return
    part = heights[:1025, :1025].astype(np.float64)
    theirs = rate(lambda: viewf(part, 30.0, nangles=16), 16 * part.size, time.perf_counter, 1)
    ours = rate(lambda: sky_view(part, linear, 16, measure="sky-view-slope", jobs=1), 16 * part.size, time.perf_counter)
    print(f"  1025² × 16 sky-view-slope: topocalc {theirs:.2f}, orograph {ours:.1f}: {ours / theirs:.0f} times")


if __name__ == "__main__":
    main()
