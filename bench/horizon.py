"""Horizon sweeps: samples × azimuths per second on one thread and two, whole maps of light, and peers.

Run: ``python bench/horizon.py [DEM or STORE] [--size 2048] [--map] [--azimuths 32] [--threads] [--priority]
[--peer-python PYTHON]``. Without a DEM, the terrain is a fractal. ``--map`` makes the sky-view factor of the whole
terrain as ``orograph light`` does, in a separate process, and prints the time per million samples and the peak memory.
Rates on one thread are per second of processor time, so other load does not count. The gain of a second thread
(``--threads``: only that) is wall time. Each round also times two sweeps that share nothing but the machine, and a
kernel that does only arithmetic: their gains are the machine's own limits at that moment. ``--priority`` asks the
system to run this process before all others, so that they do not affect the result (Linux, needs the privilege).

Peers (``horizon_peers.py``) run under ``--peer-python``, the interpreter of an environment that has them: topocalc
(Dozier 2022, horizons over the whole raster) and rvt-py (Zakšek et al. 2011, a search within 100 pixels).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np

from machine import before_all
from orograph._numba import kernel
from orograph.lighting.horizon import horizon, sky_view
from orograph.parallel import map_ordered

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
        both = rate(lambda: sky_view(heights, LINEAR, 16, measure=measure, jobs=2), 16 * n, time.process_time, 2)  # type: ignore[arg-type] # noqa: B023
        print(f"  {measure:14s} × 16  1 thread  {one:7.1f}   2 threads {both:7.1f}, both per second of processor time")


@kernel
def spin(count: int) -> float:
    """Arithmetic in registers."""
    x = 1.0
    for _ in range(count):
        x = x * 1.0000001 + 1e-9
        if x > 2.0:
            x -= 1.0
    return x


def at_once(work: Callable[[np.ndarray], object], items: list[np.ndarray]) -> None:
    """Run a thread for each item."""
    started = [threading.Thread(target=work, args=(item,)) for item in items[1:]]
    for thread in started:
        thread.start()
    work(items[0])
    for thread in started:
        thread.join()


def threads(heights: np.ndarray, rounds: int = 9) -> None:
    """How much faster two threads are than one, by wall time.

    Three cases: horizons shared between them; two whole sweeps at once, which share nothing but the machine; and
    arithmetic alone.
    """
    other = heights.copy()

    def clocked(work: Callable[[], object]) -> float:
        start = time.perf_counter()
        work()
        return time.perf_counter() - start

    def arithmetic(jobs: int) -> None:
        deque(map_ordered(spin, [40_000_000 // jobs] * jobs, jobs), maxlen=0)

    spin(1)
    gained = []
    for _ in range(rounds):
        time.sleep(0.1)
        alone = clocked(lambda: arithmetic(1)) / clocked(lambda: arithmetic(2))
        # Less than a second at a time: the system pauses a prioritised process that runs longer.
        one = clocked(lambda: sky_view(heights, LINEAR, 12, jobs=1))
        time.sleep(0.1)
        shared = one / clocked(lambda: sky_view(heights, LINEAR, 12, jobs=2))
        time.sleep(0.1)
        beside = 2 * one / clocked(lambda: at_once(lambda h: sky_view(h, LINEAR, 12, jobs=1), [heights, other]))
        gained.append((shared, beside, alone))
    names = "horizons", "two sweeps beside each other", "arithmetic"
    for name, found in zip(names, np.sort(gained, axis=0).T, strict=True):
        print(f"  two threads, {name}: {np.median(found):.2f} times one ({found[0]:.2f} to {found[-1]:.2f})")


def peers(heights: np.ndarray, python: str) -> None:
    part = np.ascontiguousarray(heights[:1025, :1025])
    items = 16 * part.size
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "heights.npy", part)
        script = str(Path(__file__).with_name("horizon_peers.py"))
        done = subprocess.run(
            [python, script, str(Path(folder) / "heights.npy"), "30", "16", "100"], check=True, capture_output=True
        )
    result = json.loads(done.stdout)
    for name, ways in (
        ("topocalc", (("sky-view-slope", None, "unlimited"),)),
        ("rvt-py", (("visible-sky", 3000.0, "within 100 samples too"), ("visible-sky", None, "unlimited"))),
    ):
        if isinstance(result[name], str):
            print(f"  {name} is missing: {result[name]}")
            continue
        theirs = items / result[name]["seconds"] / 1e6
        for measure, radius, what in ways:
            ours = rate(
                lambda: sky_view(part, LINEAR, 16, measure=measure, radius=radius, jobs=1),  # type: ignore[arg-type] # noqa: B023
                items,
                time.process_time,
            )
            reach = "unlimited" if name == "topocalc" else "within 100 samples"
            print(
                f"  1025² × 16: {name} {result[name]['version']} {reach} {theirs:.2f}, orograph {what} {ours:.1f}: "
                f"{ours / theirs:.1f} times"
            )


def whole_map(path: str, azimuths: int) -> None:
    """Run the verb in a separate process."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "sky.tif"
        command = [sys.executable, "-m", "orograph", "--quiet", "light", path, "--product", "sky-view-factor", "--json"]
        began = time.perf_counter()
        done = subprocess.run(
            [*command, "-o", str(out), "--azimuths", str(azimuths)], check=True, capture_output=True, text=True
        )
        seconds = time.perf_counter() - began
        result = json.loads(done.stdout)
        million = result["shape"][0] * result["shape"][1] / 1e6
        print(
            f"  sky-view-factor of {million:.1f} million samples, {azimuths} azimuths, as a COG: {seconds:.1f} s, "
            f"{seconds / million:.2f} s per million, peak memory {result['peak_memory_bytes'] / 2**20:.0f} MiB"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=2048)
    parser.add_argument("--map", action="store_true", help="also make the whole map")
    parser.add_argument("--azimuths", type=int, default=32)
    parser.add_argument("--threads", action="store_true", help="only the gain of a second thread")
    parser.add_argument("--priority", action="store_true", help="run before all other programs")
    parser.add_argument("--peer-python", metavar="PYTHON", help="an interpreter that has topocalc and rvt-py")
    options = parser.parse_args()
    if options.priority:
        before_all()
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
    if options.threads:
        threads(heights, 15)
        return
    if options.peer_python:
        peers(heights, options.peer_python)
    sweeps(heights)
    threads(heights)


if __name__ == "__main__":
    main()
