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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined
from orograph.errors import UsageError
from orograph.viewpoint import Camera

ANISOTROPIC, ISOTROPIC, WEDGIE, ISOTROPIC_PUBLISHED, ANISOTROPIC_PUBLISHED, LOCALISED = 0, 1, 2, 3, 4, 5


class CameraParameters(NamedTuple):
    """A view as kernels see it: camera coordinates, planes and tolerances over (column, row, height).

    Camera coordinates are stretched metres: x right, y up, w depth. Each is a row of four numbers, by column, by row,
    by metre of height, and at the origin; number 2 of each is the (a, b, c) of the module's page.

    Attributes:
        right, up, depth: 4 numbers each, the rows of x, y and w.
        motion_x, motion_y: 3 numbers each, by column, by row, at the origin: the vector (a·w − c·x, b·w − c·y), which
            does not depend on the height.
        largest_lean: the most that vector over depth is long in view.
        focal: focal length, pixels; 0 in a plan, where heights displace nothing.
        near: the least depth in view.
        exaggeration: factor on heights, |(a, b, c)|.
        stretch: factor on radii of spheres, max(1, exaggeration).
        tolerance: pixels.
        color_tolerance: γ, ΔE.
        texel: the size of a pixel at unit depth, in a plan at any depth, stretched metres.
        planes: (24,) float64, the frustum: six planes of four numbers, positive inside. One that is not there is (0, 0,
            0, ∞). See ``plane_of``.
    """

    right: tuple[float, float, float, float]
    up: tuple[float, float, float, float]
    depth: tuple[float, float, float, float]
    motion_x: tuple[float, float, float]
    motion_y: tuple[float, float, float]
    largest_lean: float
    focal: float
    near: float
    exaggeration: float
    stretch: float
    tolerance: float
    color_tolerance: float
    texel: float
    planes: NDArray[np.float64]


CAMERA = np.dtype(
    [("right", "f8", 4), ("up", "f8", 4), ("depth", "f8", 4), ("motion_x", "f8", 3), ("motion_y", "f8", 3)]
    + [(name, "f8") for name in CameraParameters._fields[5:-1]]
    + [("planes", "f8", 24)]
)
"""``CameraParameters`` as a record: for kernels that hand it on to functions that are not inlined, which then get an
address in place of 35 numbers. The functions below take either."""


class Frustum(NamedTuple):
    """The planes of ``CameraParameters`` alone, for ``outside``."""

    planes: NDArray[np.float64]


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


def camera_parameters(
    camera: Camera,
    *,
    tolerance: float = 1.0,
    color_tolerance: float = math.inf,
) -> CameraParameters:
    """A camera over flat terrain as kernels see it.

    Args:
        camera: perspective or plan.
        tolerance: pixels.
        color_tolerance: γ, ΔE.
    """
    view, chart, exaggeration = camera.view, camera.affine, camera.exaggeration
    # In plain numbers, as the chart's planes are.
    a, b, c, d, e, f = chart.grid.samples[:6]
    plan = view.projection == "plan"
    x, y = view.target[:2] if plan else view.eye[:2]
    z = view.eye[2] * exaggeration
    # A vector in stretched space → along a column, a row, a metre of height, and to the first sample from the eye.
    right, up, depth = (
        (p * a + q * d, p * b + q * e, r * exaggeration, p * (c - x) + q * (f - y) - r * z)
        for p, q, r in view.plain_axes(exaggeration)
    )
    planes = chart.planes(view.frustum(exaggeration).tolist(), exaggeration)
    planes += [(0.0, 0.0, 0.0, math.inf)] * (6 - len(planes))  # one that is not there has everything inside
    focal = 0.0 if plan else 1.0 / view.pixel_slope
    (a, b, h, c), (d, e, i, f), (u, v, w, o) = right, up, depth  # (a, b, c of the page above are h, i, w here)
    lean = 0.0
    if not plan:
        # (Of a tile the whole picture's: its own frustum may lie wholly to one side, and tiles must judge alike.)
        _, _, width, height = view.frame
        half_x, half_y = view.pixel_slope * width / 2, view.pixel_slope * height / 2
        # (The margin holds a sample on the picture's very edge.)
        lean = math.hypot(abs(h) + abs(w) * half_x, abs(i) + abs(w) * half_y) * (1 + 1e-12)
    return CameraParameters(
        right=right, up=up, depth=depth,
        motion_x=(h * u - w * a, h * v - w * b, h * o - w * c),
        motion_y=(i * u - w * d, i * v - w * e, i * o - w * f),
        largest_lean=float(lean), focal=float(focal), near=float(view.near), exaggeration=float(exaggeration),
        stretch=max(1.0, float(exaggeration)), tolerance=float(tolerance), color_tolerance=float(color_tolerance),
        texel=float(view.pixel_metres if plan else 1.0 / focal), planes=np.array(planes).ravel(),
    )  # fmt: skip


@inlined
def to_camera(camera, col, row, z):
    """Camera coordinates (right, up, depth), stretched metres, of a vertex."""
    right, up, depth = camera.right, camera.up, camera.depth
    x = right[0] * col + right[1] * row + right[2] * z + right[3]
    y = up[0] * col + up[1] * row + up[2] * z + up[3]
    w = depth[0] * col + depth[1] * row + depth[2] * z + depth[3]
    return x, y, w


@inlined
def image_motion(camera, x, y, w):
    """(a·w − c·x, b·w − c·y): how a point at (x, y, w) moves on the screen by a metre of height, times depth²."""
    return camera.right[2] * w - camera.depth[2] * x, camera.up[2] * w - camera.depth[2] * y


@inlined
def plane_of(camera, plane):
    """The four numbers of a plane of the frustum."""
    planes, at = camera.planes, 4 * plane
    return planes[at], planes[at + 1], planes[at + 2], planes[at + 3]


@inlined
def plane_distance(camera, plane, col, row, z):
    """The signed distance of a vertex from a plane of the frustum, stretched metres, positive inside."""
    planes, at = camera.planes, 4 * plane
    return planes[at] * col + planes[at + 1] * row + planes[at + 2] * z + planes[at + 3]


@inlined
def in_frustum(camera, col, row, z):
    """Whether a vertex is inside all planes of the frustum."""
    inside = True
    for plane in range(6):
        inside = inside and plane_distance(camera, plane, col, row, z) >= 0.0
    return inside


@inlined
def sphere_exceeds(camera, metric, x, y, w, e, r):
    """Whether the bound over the sphere of (stretched) radius r around (x, y, w) exceeds the tolerance; no division."""
    focal = camera.focal
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return False
    tolerance = camera.tolerance
    if metric == ANISOTROPIC:
        depth = w - r
        moved = max(depth, camera.near) - e * abs(camera.depth[2])
        if not moved > 0.0:
            return True
        if focal * e * camera.largest_lean <= tolerance * moved:
            return False
        p, q = image_motion(camera, x, y, w)
        rest = tolerance * w * depth * moved - focal * e * r * abs(camera.depth[2]) * np.sqrt(x * x + y * y + w * w)
        reach = focal * e * depth
        return depth <= 0.0 or rest < 0.0 or reach * reach * (p * p + q * q) > rest * rest
    e *= camera.exaggeration
    d = np.sqrt(x * x + y * y + w * w)
    if metric == ISOTROPIC:
        nearest = max(w - r, camera.near)
        return not (nearest > e and focal * e * (d + r) <= tolerance * nearest * (nearest - e))
    if metric == ANISOTROPIC_PUBLISHED:
        along = abs(camera.right[2] * x + camera.up[2] * y + camera.depth[2] * w)
        e *= 1.0 - along / max(d * camera.exaggeration, 1e-300)
    return not focal * e <= tolerance * (d - r)


@inlined
def anisotropic_exceeds(camera, col, row, z, e, r):
    """(``sphere_exceeds`` of the anisotropic metric for a vertex, its depth), straight from the ground, without a root.

    A root would keep the processor waiting.
    With G the numerator's vector at the centre, D the distance times |c|, d = w − r and t = τ·w·d·(d − e·|c|)/(f·e),
    the bound exceeds τ if |G|·d + r·D > t; squared twice, and decided by signs where a side is negative.
    """
    w = camera.depth[0] * col + camera.depth[1] * row + camera.depth[2] * z + camera.depth[3]
    p = camera.motion_x[0] * col + camera.motion_x[1] * row + camera.motion_x[2]
    q = camera.motion_y[0] * col + camera.motion_y[1] * row + camera.motion_y[2]
    up = camera.exaggeration
    depth = w - r
    pixels = camera.focal * e
    moved = max(depth, camera.near) - e * abs(camera.depth[2])
    goal = camera.tolerance * moved
    square = p * p + q * q
    away = square + w * (w * (up * up) - 2.0 * (camera.right[2] * p + camera.up[2] * q))
    reach = pixels * depth
    spread = pixels * r
    a = w * depth * goal
    aa = a * a
    bq = spread * spread * abs(away)
    rest = aa + bq - reach * reach * square
    far = (depth <= 0.0) | (aa < bq) | (rest < 0.0) | (4.0 * aa * bq > rest * rest)
    far &= pixels * camera.largest_lean > goal
    return (pixels > 0.0) & (far | ~(moved > 0.0)) | (e == np.inf), w


@inlined
def sphere_bound(camera, metric, x, y, w, e, r):
    """The bound in pixels over the sphere of (stretched) radius r around (x, y, w); ``sphere_exceeds`` with a value."""
    focal = camera.focal
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    if metric == ANISOTROPIC:
        depth = w - r
        moved = max(depth, camera.near) - e * abs(camera.depth[2])
        if not moved > 0.0:
            return np.inf
        lean = camera.largest_lean
        if depth > 0.0:
            p, q = image_motion(camera, x, y, w)
            away = np.sqrt(x * x + y * y + w * w)
            lean = min(lean, (np.sqrt(p * p + q * q) + r * abs(camera.depth[2]) * away / depth) / w)
        return focal * e * lean / moved
    e *= camera.exaggeration
    d = np.sqrt(x * x + y * y + w * w)
    if metric == ISOTROPIC:
        nearest = max(w - r, camera.near)
        return focal * e * (d + r) / (nearest * (nearest - e)) if nearest > e else np.inf
    if metric == ANISOTROPIC_PUBLISHED:
        along = abs(camera.right[2] * x + camera.up[2] * y + camera.depth[2] * w)
        e *= 1.0 - along / max(d * camera.exaggeration, 1e-300)
    return focal * e / (d - r) if d > r else np.inf


@inlined
def loose_bound(camera, x, y, w, e, r):
    """A looser form of the anisotropic ``sphere_bound`` that depends on motion in a simple way (for ROAM's slack).

    The vector in the numerator grows by at most r·|(a, b, c)|: the largest numerator over the least depth.
    """
    focal = camera.focal
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    nearest = max(w - r, camera.near)
    moved = nearest - e * abs(camera.depth[2])
    if not moved > 0.0:
        return np.inf
    p, q = image_motion(camera, x, y, w)
    return focal * e * (np.sqrt(p * p + q * q) + r * camera.exaggeration) / (nearest * moved)


@inlined
def triangle_bound(camera, ax, ay, aw, bx, by, bw, cx, cy, cw, e):
    """ROAM's bound in pixels for samples within e of a triangle on their vertical; corners in camera coordinates."""
    focal = camera.focal
    if e <= 0.0 or (focal == 0.0 and e < np.inf):
        return 0.0
    # One end of the displacement is on the triangle, the other within e; the sample's end is not nearer than ``near``.
    nearest = min(aw, min(bw, cw))
    moved = nearest - e * abs(camera.depth[2])
    if not (nearest > 0.0 and moved > 0.0):
        return np.inf
    p, q = image_motion(camera, ax, ay, aw)
    most = p * p + q * q
    p, q = image_motion(camera, bx, by, bw)
    most = max(most, p * p + q * q)
    p, q = image_motion(camera, cx, cy, cw)
    most = max(most, p * p + q * q)
    return focal * e * np.sqrt(most) / (nearest * moved)


@inlined
def larger_than_pixel(camera, depth, r):
    """Whether a sphere of (stretched) radius r, at least ``depth`` away, may look larger than a pixel."""
    return r > camera.texel * (depth if camera.focal > 0.0 else 1.0)


@inlined
def color_exceeds(camera, c, w, r):
    """Whether a diamond's colours are off by more than γ and it is large enough on the screen for that to be seen."""
    return c > camera.color_tolerance and larger_than_pixel(camera, w - r, r)


@inlined
def color_slack(camera, c, w, r):
    """By how many stretched metres the depth of a diamond may change before ``color_exceeds`` does."""
    return abs(w - r - r / camera.texel) if c > camera.color_tolerance and camera.focal > 0.0 else np.inf


@inlined
def outside(camera, col, row, z, r, inside):
    """Cull a sphere: (whether it is wholly outside a plane, the planes it is wholly inside of, as bits).

    Args:
        inside: bits of planes that an enclosing sphere is known to be inside of; they are not tested again.
    """
    for plane in range(6):
        if inside >> plane & 1:
            continue
        d = plane_distance(camera, plane, col, row, z)
        if d < -r:
            return True, inside
        if d >= r:
            inside |= 1 << plane
    return False, inside
