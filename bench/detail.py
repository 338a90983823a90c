"""Detail beyond the data compared with the truth: 1 m lidar is coarsened, refined again, and compared with itself.

    python bench/detail.py lidar.tif [--coarser 16] [--picture FILE.png]

The northern half of the lidar is the truth, and every N-th sample of it is the data; the southern half is the example.
For the truth, the data smoothly interpolated, and both kinds of detail, the table gives the rms distance from the truth
(metres); quantiles of slopes; and the power at wavelengths finer than the data (radially averaged, with a Hann window),
as a multiple of the truth's.
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise

import numpy as np
from affine import Affine
from numpy.typing import NDArray

import orograph
from orograph.geo.grid import Grid
from orograph.synthesis.detailed import Detailed, steering_of
from orograph.synthesis.refining import Data, Doubled, Lattice, Range, Smooth, metres

Floats = NDArray[np.float64]


def spectrum(heights: Floats, spacing: float, edges: list[float]) -> list[float]:
    """Mean power of the bands between wavelengths (metres, falling)."""
    rows, cols = heights.shape
    window = np.hanning(rows)[:, None] * np.hanning(cols)[None, :]
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : cols * 1j]
    plane = np.stack([np.ones(heights.size), x.ravel(), y.ravel()], 1)
    flat = heights - (plane @ np.linalg.lstsq(plane, heights.ravel(), rcond=None)[0]).reshape(heights.shape)
    power = np.abs(np.fft.fft2(flat * window)) ** 2
    wave = np.hypot(np.fft.fftfreq(rows, spacing)[:, None], np.fft.fftfreq(cols, spacing)[None, :])
    return [float(power[(wave >= 1 / a) & (wave < 1 / b)].mean()) for a, b in pairwise(edges)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lidar")
    parser.add_argument("--coarser", type=int, default=16)
    parser.add_argument("--picture")
    args = parser.parse_args()
    dem, times = orograph.read(args.lidar), args.coarser
    doublings, spacing, rows = round(math.log2(times)), max(dem.grid.spacing), dem.grid.rows // 2
    high, wide = (rows - 1) // times * times + 1, (dem.grid.cols - 1) // times * times + 1
    truth = dem.heights[:high, :wide].astype(np.float64)
    data = truth[::times, ::times].astype(np.float32)
    grid = Grid(data.shape, Affine(spacing * times, 0, 0, 0, -spacing * times, 0), dem.grid.crs)
    terrain = orograph.terrain(orograph.Dem(data, grid), progress=False)
    example = dem.heights[dem.grid.rows - rows :]
    lidar = orograph.Dem(example, Grid(example.shape, Affine(spacing, 0, 0, 0, -spacing, 0), dem.grid.crs))
    steering, _ = steering_of(terrain, lidar, 1)
    smooth: Lattice = Data(terrain)
    for _ in range(doublings):
        smooth = Doubled(smooth, Smooth())
    made = {
        "truth": truth,
        "interpolated": metres(smooth.read(Range(0, high, 0, wide)), smooth.quantum),
        "fractal": Detailed(terrain, doublings).read(0, 0, high, 0, wide).astype(np.float64),
        "by example": Detailed(terrain, doublings, 1, steering).read(0, 0, high, 0, wide).astype(np.float64),
    }
    edges = [spacing * times * 2 / 2**n for n in range(doublings + 1)]
    own = spectrum(truth, spacing, edges)
    bands = " | ".join(f"{a:g}–{b:g} m" for a, b in pairwise(edges))
    print(f"{args.lidar}: {high} × {wide} samples {spacing:g} m apart, data every {times}")
    print(f"| | rms from the truth | slope 50 % | 90 % | 99 % | power at {bands} |")
    for name, heights in made.items():
        slope = np.hypot(*np.gradient(heights, spacing))
        quantiles = " | ".join(f"{v:.3f}" for v in np.quantile(slope, [0.5, 0.9, 0.99]))
        power = " | ".join(f"{a / b:.2g}" for a, b in zip(spectrum(heights, spacing, edges), own))
        print(f"| {name} | {np.sqrt(((heights - truth) ** 2).mean()):.3f} m | {quantiles} | {power} |")
    if args.picture:
        from PIL import Image

        shaded = []
        for heights in made.values():
            south, east = np.gradient(heights, spacing)
            light = (1.2 + 1.5 * (east + south)) / np.sqrt(1 + 2.25 * (east**2 + south**2)) / math.sqrt(3.44)
            shaded.append(np.pad((255 * np.clip(light, 0, 1)).astype(np.uint8), 3, constant_values=255))
        Image.fromarray(np.block([shaded[:2], shaded[2:]])).save(args.picture)


if __name__ == "__main__":
    main()
