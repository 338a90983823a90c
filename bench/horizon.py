"""Horizon sweeps: samples times azimuths per second on one thread and two, whole maps of light, and peers beside them.

Run: ``python bench/horizon.py [DEM or STORE] [--size 2048] [--map] [--azimuths 32]``. Without a DEM the terrain is a
fractal. ``--map`` makes the sky-view factor of all of it as ``orograph light`` does, in a process of its own, and tells
the time per million samples and the largest memory. Rates on one thread are per second of processor time (other work on
the machine does not count), on more threads per second of the clock. Peers, where they are installed: topocalc (Dozier
2022, horizons of the whole raster), rvt-py (Zakšek et al. 2011, a search within 100 pixels).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orograph.light.horizon import horizon, sky_view

LINEAR = np.array([[30.0, 0.0], [0.0, -30.0]])


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


def sweeps(heights: np.ndarray) -> None:
    n = heights.size
    print(f"{heights.shape[1]} × {heights.shape[0]} samples; millions of samples × azimuths per second")
    for azimuth in (0.0, 22.5, 45.0, 70.0, 90.0, 200.0):
        one = rate(lambda: horizon(heights, LINEAR, azimuth, jobs=1), n, time.process_time)  # noqa: B023
        near = rate(lambda: horizon(heights, LINEAR, azimuth, radius=3000.0, jobs=1), n, time.process_time, 2)  # noqa: B023
        print(f"  horizon {azimuth:5.1f}°      1 thread  {one:7.1f}   within 100 samples {near:7.1f}")
    for measure in ("sky-view", "visible-sky", "sky-view-slope"):
        one = rate(lambda: sky_view(heights, LINEAR, 16, measure=measure, jobs=1), 16 * n, time.process_time, 2)  # type: ignore[arg-type] # noqa: B023
        two = rate(lambda: sky_view(heights, LINEAR, 16, measure=measure, jobs=2), 16 * n, time.perf_counter, 2)  # type: ignore[arg-type] # noqa: B023
        both = rate(lambda: sky_view(heights, LINEAR, 16, measure=measure, jobs=2), 16 * n, time.process_time, 2)  # type: ignore[arg-type] # noqa: B023
        print(
            f"  {measure:14s} × 16  1 thread  {one:7.1f}   2 threads {two:7.1f} by the clock, "
            f"{both:7.1f} per second of processor time"
        )


def peers(heights: np.ndarray) -> None:
    part = heights[:1025, :1025]
    n = part.size
    try:
        from topocalc.viewf import viewf
    except ImportError:
        print("  topocalc is not installed: not compared")
    else:
        theirs = rate(lambda: viewf(part.astype(np.float64), 30.0, nangles=16), 16 * n, time.process_time, 1)
        ours = rate(lambda: sky_view(part, LINEAR, 16, measure="sky-view-slope", jobs=1), 16 * n, time.process_time)
        print(f"  1025² × 16, unlimited: topocalc {theirs:.2f}, orograph {ours:.1f}: {ours / theirs:.0f} times")
    try:
        import rvt.vis
    except ImportError:
        print("  rvt-py is not installed: not compared")
    else:
        theirs = rate(
            lambda: rvt.vis.sky_view_factor(part, 30.0, svf_n_dir=16, svf_r_max=100), 16 * n, time.process_time, 1
        )
        for radius, name in ((3000.0, "within 100 samples too"), (None, "unlimited")):
            ours = rate(
                lambda: sky_view(part, LINEAR, 16, measure="visible-sky", radius=radius, jobs=1),  # noqa: B023
                16 * n,
                time.process_time,
            )
            print(f"  1025² × 16: rvt-py within 100 samples {theirs:.2f}, orograph {name} {ours:.1f}: ", end="")
            print(f"{ours / theirs:.1f} times")


def whole_map(path: str, azimuths: int) -> None:
    """The verb, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "sky.tif"
        command = [sys.executable, "-m", "orograph", "--quiet", "light", path, "--product", "sky-view-factor", "--json"]
        began = time.perf_counter()
        done = subprocess.run(
            [*command, "-o", str(out), "--azimuths", str(azimuths)], check=True, capture_output=True, text=True
        )
        seconds = time.perf_counter() - began
        told = json.loads(done.stdout)
        million = told["shape"][0] * told["shape"][1] / 1e6
        print(
            f"  sky-view-factor of {million:.1f} million samples, {azimuths} azimuths, as a COG: {seconds:.1f} s, "
            f"{seconds / million:.2f} s per million, peak memory {told['peak_memory_bytes'] / 2**20:.0f} MiB"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=2048)
    parser.add_argument("--map", action="store_true", help="make the whole map, too")
    parser.add_argument("--azimuths", type=int, default=32)
    options = parser.parse_args()
    if options.dem and options.map:
        whole_map(options.dem, options.azimuths)
        return
    if options.dem:
        import orograph

        heights = orograph.read(options.dem).heights
    else:
        heights = fractal(options.size)
    for measure in ("sky-view", "visible-sky", "sky-view-slope"):
        sky_view(heights[:64, :64], LINEAR, 4, measure=measure)  # type: ignore[arg-type]
    horizon(heights[:64, :64], LINEAR, 20.0, radius=300.0)
    sweeps(heights)
    peers(heights)


if __name__ == "__main__":
    main()
