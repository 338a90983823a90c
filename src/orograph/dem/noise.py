"""Noise on the integer plane: gradient noise, and gullies that follow the slope.

Gradient noise is Perlin's (SIGGRAPH 2002, quintic fade), its gradients taken from an integer hash of lattice point and
seed; ``fractal`` sums octaves of it. ``gullies`` adds the furrows that running water cuts down a slope: around each
position the jittered feature points of a lattice carry a plane wave across the slope there, and the blend of these
waves is a furrow pattern that runs downhill (after C. John, *Eroded Terrain Noise*, 2020, and R. S. Johansen, *Erosion
filter*, 2025). Added octave by octave, each on the slopes the last one left, furrows branch. Only +, −, ×, ÷, floor and
square roots are used, so values are the same to the bit on every machine, and depend on position and seed alone. Units:
lattice cells, heights.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel

Floats = NDArray[np.float64]

JITTER = 0.7  # width of the square that contains a feature point, as a part of its cell
REACH = 1.0 + (1.0 - JITTER) / 2  # feature points outside the 3 × 3 cells around a position are farther than this

# Taylor coefficients of sin(2πt) about 0; at t = 1/4 the error is below 1e-7.
_S1, _S3, _S5 = 2 * math.pi, -((2 * math.pi) ** 3) / 6, (2 * math.pi) ** 5 / 120
_S7, _S9, _S11 = -((2 * math.pi) ** 7) / 5040, (2 * math.pi) ** 9 / 362880, -((2 * math.pi) ** 11) / 39916800


@inlined
def hashed(i: int, j: int, seed: int) -> int:
    """32 well mixed bits of two integers and a seed (the finaliser of C. Wellons' hash prospector)."""
    h = (i * 0x9E3779B1 + j * 0x85EBCA77 + seed * 0xC2B2AE3D) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 0x21F0AAAD) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x735A2D97) & 0xFFFFFFFF
    h ^= h >> 15
    return h


@inlined
def _corner(i: int, j: int, seed: int, x: float, y: float) -> float:
    """Product of a lattice point's random gradient, of length up to √2, and the offset from the point."""
    h = hashed(i, j, seed)
    product: float = ((h & 0xFFFF) / 32767.5 - 1.0) * x + ((h >> 16) / 32767.5 - 1.0) * y
    return product


@kernel
def gradient_noise(x: float, y: float, seed: int) -> float:
    """Gradient noise with one feature per unit: about −1 … 1, mean 0, standard deviation near 0.3."""
    left, top = math.floor(x), math.floor(y)
    i, j, s, t = int(left), int(top), x - left, y - top
    fs, ft = s * s * s * (s * (s * 6 - 15) + 10), t * t * t * (t * (t * 6 - 15) + 10)
    a, b = _corner(i, j, seed, s, t), _corner(i + 1, j, seed, s - 1, t)
    c, d = _corner(i, j + 1, seed, s, t - 1), _corner(i + 1, j + 1, seed, s - 1, t - 1)
    upper, lower = a + (b - a) * fs, c + (d - c) * fs
    value: float = (upper + (lower - upper) * ft) * 1.3
    return value


@kernel
def fractal(x: Floats, y: Floats, octaves: int, gain: float, seed: int, out: Floats) -> None:
    """Sum of octaves of gradient noise at positions (x, y), each twice as fine and ``gain`` as high as the last.

    Octaves are rotated against each other (by atan 3/4), so that their lattices do not line up.
    """
    for n in range(x.size):
        u, v, height, total = x.flat[n], y.flat[n], 1.0, 0.0
        for octave in range(octaves):
            total += height * gradient_noise(u, v, seed + 7919 * octave)
            u, v = 1.6 * u - 1.2 * v + 17.3, 1.2 * u + 1.6 * v - 9.1
            height *= gain
        out.flat[n] = total


@inlined
def _sine(t: float) -> float:
    """sin(2πt) for |t| ≤ 1/2."""
    if t > 0.25:
        t = 0.5 - t
    elif t < -0.25:
        t = -0.5 - t
    q = t * t
    return t * (_S1 + q * (_S3 + q * (_S5 + q * (_S7 + q * (_S9 + q * _S11)))))


@kernel
def feature_points(i0: int, j0: int, seed: int, px: Floats, py: Floats) -> None:
    """Positions of the feature points of the lattice cells from (i0, j0) on: two (rows, cols) arrays."""
    for j in range(px.shape[0]):
        for i in range(px.shape[1]):
            h = hashed(i + i0, j + j0, seed)
            px[j, i] = i + i0 + 0.5 + JITTER * ((h & 0xFFFF) / 65535 - 0.5)
            py[j, i] = j + j0 + 0.5 + JITTER * ((h >> 16) / 65535 - 0.5)


@kernel
def gullies(
    heights: Floats,
    row0: int,
    col0: int,
    wavelength: float,
    turn: tuple[float, float],
    points: tuple[Floats, Floats, int, int],
    depth: float,
    gentle: float,
    steep: float,
    out: Floats,
) -> None:
    """Cut one octave of furrows into a surface.

    Args:
        heights: (h + 2, w + 2), in units of the distance between its samples.
        row0, col0: global index of ``heights[1, 1]``.
        wavelength: of the furrows, in samples.
        turn: cosine and sine of the angle by which the lattice of feature points is turned.
        points: x, y, and the indices of the first: ``feature_points`` of all lattice cells the positions lie in, and
            one around them.
        depth: of the furrows, per wavelength and slope.
        gentle: the slope at which hillsides are so gentle that furrows are half as deep.
        steep: the slope at which hillsides are so steep that furrows deepen only half as much.
        out: (h, w), overwritten: the surface with furrows.
    """
    turn_cos, turn_sin = turn
    px, py, i0, j0 = points
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            h = heights[r + 1, c + 1]
            gx = (heights[r + 1, c + 2] - heights[r + 1, c]) * 0.5
            gy = (heights[r + 2, c + 1] - heights[r, c + 1]) * 0.5
            slope = math.sqrt(gx * gx + gy * gy)
            if slope < 1e-9:
                out[r, c] = h
                continue
            # Position and the direction across the slope, in the turned lattice of feature points.
            col, row = (c + col0) / wavelength, (r + row0) / wavelength
            x, y = turn_cos * col - turn_sin * row, turn_sin * col + turn_cos * row
            nx = (turn_cos * -gy - turn_sin * gx) / slope
            ny = (turn_sin * -gy + turn_cos * gx) / slope
            i, j = math.floor(x) - i0, math.floor(y) - j0
            total, weights = 0.0, 0.0
            for dj in range(-1, 2):
                for di in range(-1, 2):
                    ox, oy = x - px[j + dj, i + di], y - py[j + dj, i + di]
                    w = 1.0 - (ox * ox + oy * oy) / (REACH * REACH)
                    if w > 0:
                        w *= w
                        phase = ox * nx + oy * ny + 0.25
                        total += w * _sine(phase - math.floor(phase + 0.5))
                        weights += w
            deep = depth * slope / (slope + gentle) / (1.0 + slope / steep)
            out[r, c] = h + deep * wavelength * slope * total / weights
