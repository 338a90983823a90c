"""Compiled loops over samples for what is visible from the ground: rays through the caster, walks along azimuths.

*Rays* start slightly above their sample (so that they are on its lit side) and meet the surface itself, cells cut along
their diagonals, as the caster defines it. The N directions of a sample are a Fibonacci lattice of the unit square,
shifted at random by a hash of (row, column, seed) (Cranley & Patterson 1976): stratified, unbiased, and independent of
blocks and threads. Directions are metres (east, north, up); t is metres.

*Walks* follow one azimuth from a sample over every edge of the triangulation that it crosses. Between edges the surface
is straight, so nothing is sampled: a walk is exact for its azimuth. The crossed edges are the same for all samples of
one parity of (row + column), and come as a table.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf
from orograph.raycast.kernels import ray

GOLDEN = 0.6180339887498949
LEVEL = 2
"""The level of the caster's pyramid at which a ray begins: low, because most occluders are near."""


class Samples(NamedTuple):
    """A block of samples at which rays begin.

    Attributes:
        heights: (rows, cols) float32, metres. gx, gy: (rows, cols) float32, rise per metre east and north.
        row0, col0: of the first one, in the caster's coordinates.
        inverse: (2, 2), samples per metre east and north. lift: how far above the ground rays begin, metres.
    """

    heights: NDArray[np.float32]
    gx: NDArray[np.float32]
    gy: NDArray[np.float32]
    row0: int
    col0: int
    inverse: NDArray[np.floating]
    lift: float


class Edges(NamedTuple):
    """The edges of the triangulation that a walk in one azimuth crosses, by distance.

    Attributes:
        starts: (3,) where the edges of even and of odd samples begin, and the end.
        rows1, cols1, rows2, cols2: (n,) int64, an edge's two samples, as offsets from the one where the walk begins.
        part: (n,) float64, where between them, 0 … 1. metres: (n,) float64, how far away.
    """

    starts: NDArray[np.int64]
    rows1: NDArray[np.int64]
    cols1: NDArray[np.int64]
    rows2: NDArray[np.int64]
    cols2: NDArray[np.int64]
    part: NDArray[np.float64]
    metres: NDArray[np.float64]


@inlined
def _mixed(x):
    """A 64-bit hash (SplitMix64's finaliser)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@inlined
def _shift(row, col, seed):
    """Two numbers in [0, 1) for a sample."""
    key = (np.uint64(row) << np.uint64(32)) ^ np.uint64(col)
    a = _mixed(key + np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15))
    b = _mixed(a + np.uint64(0x9E3779B97F4A7C15))
    return np.float64(a >> np.uint64(11)) * 2.0**-53, np.float64(b >> np.uint64(11)) * 2.0**-53


@inlined
def _frame(x, y, z):
    """Two unit vectors perpendicular to a unit vector and to each other (Duff et al. 2017)."""
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return 1.0 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@inlined
def _normal(gx, gy):
    k = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    return -gx * k, -gy * k, k


@inlined
def _rho(table, length, radius):
    """ρ of a free path below R."""
    last = table.shape[0] - 1
    x = min(max(length / radius, 0.0), 1.0) * last
    k = min(np.int64(x), last - 1)
    return table[k] + (table[k + 1] - table[k]) * (x - k)


@inlined
def _first_hit(scene, samples, i, j, e, n, up, far, spans):
    """The distance at which the ray from a sample in a direction meets the surface, metres; inf: not within ``far``."""
    inverse = samples.inverse
    o = np.float64(j + samples.col0), np.float64(i + samples.row0), np.float64(samples.heights[i, j]) + samples.lift
    d = inverse[0, 0] * e + inverse[0, 1] * n, inverse[1, 0] * e + inverse[1, 1] * n, up
    return ray(scene, o, d, 0.0, far, 1, LEVEL, spans)[0]


@kernel
def ray_occlusion(scene, samples, transmission, rays, seed, out):
    """Ambient occlusion of ``Samples`` by cosine-weighted rays: the mean of ρ(L). ``transmission``: ρ."""
    heights, gx, gy = samples.heights, samples.gx, samples.gy
    radius = transmission.radius
    spans = np.empty((scene.ints.shape[0], 2))
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            z = np.float64(heights[i, j])
            if z != z:
                out[i, j] = np.nan
                continue
            nx, ny, nz = _normal(np.float64(gx[i, j]), np.float64(gy[i, j]))
            ax, ay, az, bx, by, bz = _frame(nx, ny, nz)
            u0, v0 = _shift(i + samples.row0, j + samples.col0, seed)
            total = 0.0
            for k in range(rays):
                u, v = (k + u0) / rays, 2.0 * np.pi * (k * GOLDEN + v0)
                r, w = np.sqrt(u), np.sqrt(1.0 - u)
                p, q = r * np.cos(v), r * np.sin(v)
                e, n, up = p * ax + q * bx + w * nx, p * ay + q * by + w * ny, p * az + q * bz + w * nz
                t = _first_hit(scene, samples, i, j, e, n, up, radius, spans)
                if t >= radius:
                    total += transmission.free
                elif not transmission.step:
                    total += _rho(transmission.table, t, radius)
            out[i, j] = total / rays


@kernel
def ray_disc(scene, samples, axis, cosine, weigh, rays, seed, out):
    """The light on ``Samples`` from a cap of directions around ``axis`` (cosine of its radius ``cosine``).

    It is the mean over directions uniform in the cap of whether each is visible; or (``weigh``) of its cosine to the
    normal if it is visible.
    """
    heights, gx, gy = samples.heights, samples.gx, samples.gy
    spans = np.empty((scene.ints.shape[0], 2))
    ax, ay, az, bx, by, bz = _frame(axis[0], axis[1], axis[2])
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            z = np.float64(heights[i, j])
            if z != z:
                out[i, j] = np.nan
                continue
            nx, ny, nz = _normal(np.float64(gx[i, j]), np.float64(gy[i, j]))
            u0, v0 = _shift(i + samples.row0, j + samples.col0, seed)
            total = 0.0
            for k in range(rays):
                w = 1.0 - (1.0 - cosine) * (k + u0) / rays
                v = 2.0 * np.pi * (k * GOLDEN + v0)
                r = np.sqrt(max(1.0 - w * w, 0.0))
                p, q = r * np.cos(v), r * np.sin(v)
                e, n, up = p * ax + q * bx + w * axis[0], p * ay + q * by + w * axis[1], p * az + q * bz + w * axis[2]
                share = max(e * nx + n * ny + up * nz, 0.0) if weigh else 1.0
                if share == 0.0:
                    continue
                if _first_hit(scene, samples, i, j, e, n, up, np.inf, spans) == np.inf:
                    total += share
            out[i, j] = total / rays


@kernel
def ray_cone(scene, samples, radius, rays, seed, out):
    """Moments of the upper hemisphere as seen by ``Samples``.

    ``out`` (4, rows, cols) float64 receives the integral of V·ω (east, north, up) and of V over solid angle. Nothing is
    hit beyond ``radius``.
    """
    heights = samples.heights
    spans = np.empty((scene.ints.shape[0], 2))
    part = 2.0 * np.pi / rays
    for i in range(heights.shape[0]):
        for j in range(heights.shape[1]):
            z = np.float64(heights[i, j])
            u0, v0 = _shift(i + samples.row0, j + samples.col0, seed)
            for k in range(rays if z == z else 0):
                up, v = 1.0 - (k + u0) / rays, 2.0 * np.pi * (k * GOLDEN + v0)
                r = np.sqrt(max(1.0 - up * up, 0.0))
                e, n = r * np.cos(v), r * np.sin(v)
                if _first_hit(scene, samples, i, j, e, n, up, radius, spans) == np.inf:
                    out[0, i, j] += e * part
                    out[1, i, j] += n * part
                    out[2, i, j] += up * part
                    out[3, i, j] += part


@inlined
def _weight(nz, c, t):
    """∫ ⟨ω, n⟩ cos θ dθ from the horizon to the elevation of tangent t, for an azimuth in which n leans by c."""
    square = 1.0 / (1.0 + t * t)
    return 0.5 * (nz * t * t * square + c * (np.arctan(t) + t * square))


@inlined
def _zenith(nz, c):
    """``_weight`` up to the zenith."""
    return 0.5 * nz + 0.25 * np.pi * c


@kernel
def add_sky(slope, gx, gy, east, north, row0, col0, out):
    """Add the light of the sky above horizons from one azimuth to ``out``: 2π/π ∫ ⟨ω, n⟩ cos θ dθ above ``slope``.

    slope, gx, gy: (rows, cols) of a window of ``out`` that begins at (row0, col0).
    """
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            g, h = np.float64(gx[i, j]), np.float64(gy[i, j])
            nx, ny, nz = _normal(g, h)
            c = nx * east + ny * north
            t = max(np.float64(slope[i, j]), g * east + h * north)
            out[i + row0, j + col0] += np.float32(2.0 * (_zenith(nz, c) - _weight(nz, c, t)))


@leaf
def _clip(sa, za, sb, zb, radius):
    """Fractions of a piece of profile between which it lies within R of the origin; empty if the first is larger."""
    ds, dz = sb - sa, zb - za
    a, b, c = ds * ds + dz * dz, sa * ds + za * dz, sa * sa + za * za - radius * radius
    d = b * b - a * c
    if d < 0.0:
        return 1.0, 0.0
    d = np.sqrt(d)
    return max((-b - d) / a, 0.0), min((-b + d) / a, 1.0)


@inlined
def _reach(s0, z0, s1, z1, t):
    """The distance along a ray of slope t at which it meets a piece of profile, clamped to the piece's ends."""
    steep = (z1 - z0) - t * (s1 - s0)
    f = min(max((t * s0 - z0) / steep, 0.0), 1.0) if steep != 0.0 else 0.5
    return (s0 + f * (s1 - s0)) * np.sqrt(1.0 + t * t)


WIDE = 0.1
"""Radians of elevation over which one parabola approximates ρ along a piece of profile."""


@leaf
def _lost(table, free, radius, nz, c, slope, s0, z0, s1, z1):
    """∫ (ρ(R) − ρ(L)) ⟨ω, n⟩ cos θ dθ over elevations from ``slope`` up that the piece (s0, z0) → (s1, z1) ends."""
    t1 = z1 / s1
    w0, w1 = _weight(nz, c, slope), _weight(nz, c, t1)
    if s0 <= 0.0:  # the facet at the sample's foot
        return (w1 - w0) * (free - table[0])
    if z0 != z0:  # behind a hole: counts as a wall
        return (w1 - w0) * (free - _rho(table, s1 * np.sqrt(1.0 + t1 * t1), radius))
    below = slope * s0 - z0
    if below > 0.0:  # its first part is hidden
        f = below / (below + z1 - slope * s1)
        s0, z0 = s0 + f * (s1 - s0), z0 + f * (z1 - z0)
    # Simpson's rule over the weight, in parts of at most WIDE; the ray of slope t meets the piece at distance s.
    low, high = np.arctan(slope), np.arctan(t1)
    parts = 1 + np.int64((high - low) / WIDE)
    lost = 0.0
    ta, wa, ra = slope, w0, _rho(table, s0 * np.sqrt(1.0 + slope * slope), radius)
    for k in range(1, parts + 1):
        last = k == parts
        tb = t1 if last else np.tan(low + (high - low) * k / parts)
        wb = w1 if last else _weight(nz, c, tb)
        tm = 0.5 * (ta + tb) if parts == 1 else np.tan(low + (high - low) * (k - 0.5) / parts)
        wm = _weight(nz, c, tm)
        rm = _rho(table, _reach(s0, z0, s1, z1, tm), radius)
        rb = _rho(table, _reach(s0, z0, s1, z1, tb), radius)
        a, b = wm - wa, wb - wm
        whole = a + b
        mean = 0.5 * (ra + rb)
        if a > 1e-9 * whole and b > 1e-9 * whole:
            mean = ((2.0 - b / a) * ra + whole * whole / (a * b) * rm + (2.0 - a / b) * rb) / 6.0
        lost += whole * (free - mean)
        ta, wa, ra = tb, wb, rb
    return lost


@kernel
def walk_occlusion(heights, gx, gy, highest, edges, toward, transmission, window, out):
    """Add to ``out`` what the samples of a window receive from one azimuth: 2π/π ∫ ρ(L) ⟨ω, n⟩ cos θ dθ.

    Going outward, ground that rises above everything before it ends the rays at the elevations in between, at its
    distance. Elevations above everything within R are free.

    Args:
        heights, gx, gy, out: (rows, cols) float32, the neighbourhood, from an even row and column of the terrain;
            metres, rise per metre.
        highest: an upper bound of the heights.
        edges: ``Edges``. toward: (2,) the azimuth's unit vector, east and north. transmission: ρ.
        window: rows and columns, (first, last, left, right).
    """
    starts, rows1, cols1, rows2, cols2, part, metres = edges
    east, north = toward
    table, free, radius, step = transmission
    first, last, left, right = window
    rows, cols = heights.shape
    square = radius * radius
    for i in range(first, last):
        for j in range(left, right):
            g, h = np.float64(gx[i, j]), np.float64(gy[i, j])
            if g != g:
                continue
            base = np.float64(heights[i, j])
            nx, ny, nz = _normal(g, h)
            c = nx * east + ny * north
            slope = g * east + h * north  # the ground's own slope: nothing below it counts
            full = _zenith(nz, c)
            total = free * (full - _weight(nz, c, slope))
            skipped = 0.0  # elevations that end only beyond R
            s0, z0 = 0.0, 0.0  # the edge before, relative to the sample; NaN in a hole
            parity = (i + j) & 1
            for k in range(starts[parity], starts[parity + 1]):
                s1 = metres[k]
                if slope > 0.0 and slope * s1 > highest - base:
                    break
                i1, j1, i2, j2 = i + rows1[k], j + cols1[k], i + rows2[k], j + cols2[k]
                if i1 < 0 or i1 >= rows or j1 < 0 or j1 >= cols or i2 < 0 or i2 >= rows or j2 < 0 or j2 >= cols:
                    break
                z1 = np.float64(heights[i1, j1])
                z1 += (np.float64(heights[i2, j2]) - z1) * part[k] - base
                if z1 > slope * s1:
                    u0, u1 = 0.0, 1.0
                    if s1 * s1 + z1 * z1 > square or s0 * s0 + z0 * z0 > square:
                        u0, u1 = _clip(s0, z0, s1, z1, radius) if z0 == z0 else (1.0, 0.0)
                    if u0 <= u1:
                        sa, za = s0 + u0 * (s1 - s0), z0 + u0 * (z1 - z0)
                        sb, zb = (s1, z1) if u1 == 1.0 else (s0 + u1 * (s1 - s0), z0 + u1 * (z1 - z0))
                        if zb > slope * sb:
                            if u0 > 0.0 and za > slope * sa:
                                if step:
                                    skipped += _weight(nz, c, za / sa) - _weight(nz, c, slope)
                                slope = za / sa
                            if not step:
                                total -= _lost(table, free, radius, nz, c, slope, sa, za, sb, zb)
                            slope = zb / sb
                s0, z0 = s1, z1
            if step:
                total = full - _weight(nz, c, slope) + skipped
            out[i, j] += np.float32(2.0 * total)
