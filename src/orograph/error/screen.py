"""From metres of height to pixels: bounds of what an object-space error displaces on the screen.

A point at camera coordinates (x right, y up, w depth), moved by δ along the vertical, whose camera coordinates are
(a, b, c) per metre, moves on the screen by exactly

    f · |δ| · |(a·w − c·x, b·w − c·y)| / (w · (w + c·δ))        pixels, f the focal length in pixels

(Duchaineau et al. 1997, sec. 6.2, whose wedgies move from −e to +e: the delayed division by w). Every metric bounds
this from above, or, the published ones, estimates it, for all points of a bounding volume and all |δ| ≤ e:

* ``anisotropic``: over a sphere of radius r around a diamond's vertex. The vector in the numerator over depth, the
  *lean* G, is how long one metre of height is on the screen at unit depth. It is c times the distance on the screen
  from the point where all verticals vanish, so it grows by at most |c| · the size of the sphere on the screen, and in
  view it is at most what it is in one of the picture's corners; depth falls by at most r. Nested spheres and monotonic
  errors make it monotonic.
* ``isotropic``: the same for a displacement of length e in any direction (Lindstrom & Pascucci 2001), held away from
  the axis too: distance over depth.
* ``wedgie``: over the prism of a triangle ± e. The numerator is convex and does not change along the vertical, depth is
  linear: both are extreme at the triangle's corners (ROAM's corner bound).
* ``localised``: the wedgie's bound over the parts of a triangle, each with what is known of it (``lod.localise``).
* ``isotropic-published``: λ·e / (d − r): right on the axis of view only.
* ``anisotropic-published``: the lecture's λ·e·(1 − |cos|) / (d − r): smaller than the truth, sqrt(1 − cos²).

Where the volume reaches the plane of the eye, the bounds are infinite. Depths below ``near`` are not in view, so depth
is at least that. Coordinates: (col, row, height) of the terrain; float64. Proofs and counter-examples: docs/metrics.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.viewpoint import View

ANISOTROPIC, ISOTROPIC, WEDGIE, ISOTROPIC_PUBLISHED, ANISOTROPIC_PUBLISHED, LOCALISED = 0, 1, 2, 3, 4, 5

# What a lens holds: the camera as one float64 vector, for kernels.
MATRIX, FOCAL, TOLERANCE, NEAR, STRETCH, UP, PLANES, COLOR, TEXEL, SWAY, LEAN, LENGTH = (
    0, 12, 13, 14, 15, 16, 20, 44, 45, 46, 52, 53,
)  # fmt: skip
"""Offsets: 3 × 4 matrix; focal length; tolerance; near; factor on radii; |(a, b, c)|; 6 planes × 4; γ; pixels of γ;
2 × 3: (a·w − c·x, b·w − c·y) by column and row (it does not depend on the height); the largest lean in the picture."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A screen-space metric.

    Attributes:
        name: what it is called.
        number: what kernels call it.
        conservative: whether it is an upper bound for everything in view.
        spheres: whether it works on spheres (and is monotonic), or on triangles.
    """

    name: str
    number: int
    conservative: bool
    spheres: bool


METRICS = {
    m.name: m
    for m in (
        Metric("anisotropic", ANISOTROPIC, True, True),
        Metric("isotropic", ISOTROPIC, True, True),
        Metric("wedgie", WEDGIE, True, False),
        Metric("localised", LOCALISED, True, False),
        Metric("isotropic-published", ISOTROPIC_PUBLISHED, False, True),
        Metric("anisotropic-published", ANISOTROPIC_PUBLISHED, False, True),
    )
}


def metric_of(name: str) -> Metric:
    """A metric by its name.

    Raises:
        UsageError: there is none of that name.
    """
    if name not in METRICS:
        raise UsageError(f"There is no metric {name!r}; there are {', '.join(METRICS)}.")
    return METRICS[name]


def lens(
    view: View,
    grid: Grid,
    *,
    exaggeration: float = 1.0,
    tolerance: float = 1.0,
    color_tolerance: float = math.inf,
    texel: float = 1.0,
) -> NDArray[np.float64]:
    """The camera as kernels want it, (LENGTH,) float64.

    Args:
        view: perspective or plan (in a plan heights displace nothing: the focal length is 0).
        grid: of the terrain.
        exaggeration: factor on heights.
        tolerance: pixels.
        color_tolerance: γ, ΔE.
        texel: the least radius, in pixels, of a diamond whose colours count.
    """
    # In plain numbers: so few take NumPy five times as long, and cameras move at every frame.
    a, b, c, d, e, f = grid.samples[:6]
    plan = view.projection == "plan"
    x, y = view.target[:2] if plan else view.eye[:2]
    z = view.eye[2] * exaggeration
    # A vector in stretched space → along a column, a row, a metre of height, and to the first sample from the eye.
    matrix = [
        (p * a + q * d, p * b + q * e, r * exaggeration, p * (c - x) + q * (f - y) - r * z)
        for p, q, r in view.plain_axes(exaggeration)
    ]
    planes = [
        (p * a + q * d, p * b + q * e, r * exaggeration, p * c + q * f + s)
        for p, q, r, s in view.frustum(exaggeration).tolist()
    ]
    planes += [(0.0, 0.0, 0.0, math.inf)] * (6 - len(planes))  # one that is not there has everything inside
    focal = 0.0 if plan else 1.0 / view.pixel_slope
    (a, b, h, c), (d, e, i, f), (u, v, w, o) = matrix  # (a, b, c of the page above are h, i, w here)
    lean = 0.0
    if not plan:
        # (Of a tile the whole picture's: its own frustum may lie wholly to one side, and tiles must judge alike.)
        _, _, width, height = view.frame
        half_x, half_y = view.pixel_slope * width / 2, view.pixel_slope * height / 2
        # (The margin holds a sample on the picture's very edge.)
        lean = math.hypot(abs(h) + abs(w) * half_x, abs(i) + abs(w) * half_y) * (1 + 1e-12)
        texel /= focal  # pixels of γ are measured with the same focal length
    return np.array(
        [
            *matrix[0], *matrix[1], *matrix[2], focal, tolerance, view.near, max(1.0, exaggeration), exaggeration,
            0.0, 0.0, 0.0, *planes[0], *planes[1], *planes[2], *planes[3], *planes[4], *planes[5],
            color_tolerance, texel,
            h * u - w * a, h * v - w * b, h * o - w * c, i * u - w * d, i * v - w * e, i * o - w * f, lean,
        ]
    )  # fmt: skip


@inlined
def to_camera(lens, col, row, z):
    """Camera coordinates (right, up, depth), stretched metres, of a vertex."""
    x = lens[0] * col + lens[1] * row + lens[2] * z + lens[3]
    y = lens[4] * col + lens[5] * row + lens[6] * z + lens[7]
    w = lens[8] * col + lens[9] * row + lens[10] * z + lens[11]
    return x, y, w


@inlined
def sphere_exceeds(lens, metric, x, y, w, e, r):
    """Whether the bound over the sphere of (stretched) radius r around (x, y, w) exceeds the tolerance; no division."""
    focal = lens[12]
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return False
    tolerance = lens[13]
    if metric == 0:
        depth = w - r
        moved = max(depth, lens[14]) - e * abs(lens[10])
        if not moved > 0.0:
            return True
        if focal * e * lens[52] <= tolerance * moved:
            return False
        p = lens[2] * w - lens[10] * x
        q = lens[6] * w - lens[10] * y
        rest = tolerance * w * depth * moved - focal * e * r * abs(lens[10]) * np.sqrt(x * x + y * y + w * w)
        reach = focal * e * depth
        return depth <= 0.0 or rest < 0.0 or reach * reach * (p * p + q * q) > rest * rest
    e *= lens[16]
    d = np.sqrt(x * x + y * y + w * w)
    if metric == 1:
        nearest = max(w - r, lens[14])
        return not (nearest > e and focal * e * (d + r) <= tolerance * nearest * (nearest - e))
    if metric == 4:
        e *= 1.0 - abs(lens[2] * x + lens[6] * y + lens[10] * w) / max(d * lens[16], 1e-300)
    return not focal * e <= tolerance * (d - r)


@inlined
def anisotropic_exceeds(lens, col, row, z, e, r):
    """(``sphere_exceeds`` of the anisotropic metric for a vertex, its depth), straight from the ground, without a root.

    A root would keep the processor waiting.
    With G the numerator's vector at the centre, D the distance times |c|, d = w − r and t = τ·w·d·(d − e·|c|)/(f·e),
    the bound exceeds τ if |G|·d + r·D > t; squared twice, and decided by signs where a side is negative.
    """
    w = lens[8] * col + lens[9] * row + lens[10] * z + lens[11]
    p = lens[46] * col + lens[47] * row + lens[48]
    q = lens[49] * col + lens[50] * row + lens[51]
    depth = w - r
    pixels = lens[12] * e
    moved = max(depth, lens[14]) - e * abs(lens[10])
    goal = lens[13] * moved
    square = p * p + q * q
    away = square + w * (w * (lens[16] * lens[16]) - 2.0 * (lens[2] * p + lens[6] * q))
    reach = pixels * depth
    spread = pixels * r
    a = w * depth * goal
    aa = a * a
    bq = spread * spread * abs(away)
    rest = aa + bq - reach * reach * square
    far = (depth <= 0.0) | (aa < bq) | (rest < 0.0) | (4.0 * aa * bq > rest * rest)
    far &= pixels * lens[52] > goal
    return (pixels > 0.0) & (far | ~(moved > 0.0)) | (e == np.inf), w


@inlined
def sphere_bound(lens, metric, x, y, w, e, r):
    """The bound in pixels over the sphere of (stretched) radius r around (x, y, w); ``sphere_exceeds`` with a value."""
    focal = lens[12]
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    if metric == 0:
        depth = w - r
        moved = max(depth, lens[14]) - e * abs(lens[10])
        if not moved > 0.0:
            return np.inf
        lean = lens[52]
        if depth > 0.0:
            p = lens[2] * w - lens[10] * x
            q = lens[6] * w - lens[10] * y
            away = np.sqrt(x * x + y * y + w * w)
            lean = min(lean, (np.sqrt(p * p + q * q) + r * abs(lens[10]) * away / depth) / w)
        return focal * e * lean / moved
    e *= lens[16]
    d = np.sqrt(x * x + y * y + w * w)
    if metric == 1:
        nearest = max(w - r, lens[14])
        return focal * e * (d + r) / (nearest * (nearest - e)) if nearest > e else np.inf
    if metric == 4:
        e *= 1.0 - abs(lens[2] * x + lens[6] * y + lens[10] * w) / max(d * lens[16], 1e-300)
    return focal * e / (d - r) if d > r else np.inf


@inlined
def loose_bound(lens, x, y, w, e, r):
    """A looser form of the anisotropic ``sphere_bound`` that depends on motion in a simple way (for ROAM's slack).

    The vector in the numerator grows by at most r·|(a, b, c)|: the largest numerator over the least depth.
    """
    focal = lens[12]
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    nearest = max(w - r, lens[14])
    moved = nearest - e * abs(lens[10])
    if not moved > 0.0:
        return np.inf
    p = lens[2] * w - lens[10] * x
    q = lens[6] * w - lens[10] * y
    return focal * e * (np.sqrt(p * p + q * q) + r * lens[16]) / (nearest * moved)


@inlined
def triangle_bound(lens, ax, ay, aw, bx, by, bw, cx, cy, cw, e):
    """ROAM's bound in pixels for samples within e of a triangle on their vertical; corners in camera coordinates."""
    focal = lens[12]
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    # One end of the displacement is on the triangle, the other within e; the sample's end is not nearer than ``near``.
    nearest = min(aw, min(bw, cw))
    moved = nearest - e * abs(lens[10])
    if not (nearest > 0.0 and moved > 0.0):
        return np.inf
    p, q = lens[2] * aw - lens[10] * ax, lens[6] * aw - lens[10] * ay
    most = p * p + q * q
    p, q = lens[2] * bw - lens[10] * bx, lens[6] * bw - lens[10] * by
    most = max(most, p * p + q * q)
    p, q = lens[2] * cw - lens[10] * cx, lens[6] * cw - lens[10] * cy
    most = max(most, p * p + q * q)
    return focal * e * np.sqrt(most) / (nearest * moved)


@inlined
def color_exceeds(lens, c, w, r):
    """Whether a diamond's colours are off by more than γ and it is large enough on the screen for that to be seen."""
    return c > lens[44] and r > lens[45] * (w - r)


@inlined
def outside(lens, col, row, z, r, inside):
    """Cull a sphere: (whether it is wholly outside a plane, the planes it is wholly inside of, as bits).

    Args:
        inside: bits of planes that an enclosing sphere is known to be inside of; they are not tested again.
    """
    for plane in range(6):
        if inside >> plane & 1:
            continue
        at = 20 + 4 * plane
        d = lens[at] * col + lens[at + 1] * row + lens[at + 2] * z + lens[at + 3]
        if d < -r:
            return True, inside
        if d >= r:
            inside |= 1 << plane
    return False, inside
