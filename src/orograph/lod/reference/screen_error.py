"""From metres to pixels: how far an object-space error moves the picture.

Lecture, slides *Maximum Project Length Error Vectors (ROAM 1997)* to the nested diamond balls; Duchaineau et al. 1997,
sec. 6; Blow 2000; Lindstrom & Pascucci 2001. With p = (x, y, w) in camera coordinates and (a, b, c) the vertical ẑ
there, a point that moves δ metres along the vertical moves on the screen by exactly

    f · |δ| · N / (w · (w + c·δ)),     N = ‖(a·w − c·x, b·w − c·y)‖

A *bound* takes e, the largest |δ|, and the worst place in a ball or a triangle. Corrected:

- *Isotropic*, printed s = λ·e/d with the distance d: right on the axis of view. A flat screen stretches by 1/cos² of
  the angle θ off the axis, and w = d·cos θ: f·e·d/w² pixels. At θ = 45° the printed value is 2 times too small.
- *Anisotropic*, printed with the factor 1 − |⟨ẑ, v̂⟩|. A vertical seen along v̂ is foreshortened by the sine of their
  angle, sqrt(1 − ⟨ẑ, v̂⟩²). At 10° from straight down that is 0.1736, the printed factor 0.0152: 11.4 times too small.
- *The largest value over a ball* is printed as that at the point nearest to the eye. This holds for the isotropic form
  only: for a ball straight below the eye the sine is 0 there, and more at the ball's sides.
- *ROAM's identity* for a wedgie needs r > |c|: where the wedgie reaches the plane of the eye, the error is unbounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from orograph.lod.reference.camera import Camera
from orograph.lod.reference.terrain import Point

Bound = Callable[[Camera, Point, float, float], float]
"""(camera, centre p of a ball in camera coordinates, error e, radius r) → pixels."""


def numerator(camera: Camera, p: Point) -> float:
    """N; it is linear in p before the norm, and does not change along the vertical."""
    (a, b, c), (x, y, w) = camera.vertical, p
    return math.hypot(a * w - c * x, b * w - c * y)


def pixels(e: float, per_metre: float, divisor: float) -> float:
    """e · per_metre / divisor; infinite where the divisor says that the eye, or its plane, is reached."""
    if e == 0:
        return 0.0
    return e * per_metre / divisor if divisor > 0 else math.inf


def displacement(camera: Camera, p: Point, delta: float) -> float:
    """What p moves by exactly, if it is moved by delta along the vertical."""
    w, moved = p[2], p[2] + camera.vertical[2] * delta
    return pixels(abs(delta), camera.focal * numerator(camera, p), w * moved if w > 0 else 0.0)


def isotropic_printed(camera: Camera, p: Point, e: float, r: float) -> float:
    """c · e / (‖p − eye‖ − r), the lecture's c being f. No bound off the axis."""
    return pixels(e, camera.focal, math.hypot(*p) - r)


def isotropic(camera: Camera, p: Point, e: float, r: float) -> float:
    """The same, held off the axis: the ball's largest distance, and its least depth twice."""
    nearest = max(p[2] - r, camera.near)
    return pixels(e, camera.focal * (math.hypot(*p) + r), nearest * max(nearest - e, 0.0))


def anisotropic_printed(camera: Camera, p: Point, e: float, r: float) -> float:
    """c · sqrt(1 − ⟨ẑ, v̂⟩²) · e / (‖p − eye‖ − r): with the sine, and yet no bound, off the axis or over a ball."""
    (a, b, c), (x, y, w) = camera.vertical, p
    cosine = (a * x + b * y + c * w) / math.hypot(*p)
    return math.sqrt(max(0.0, 1.0 - cosine * cosine)) * isotropic_printed(camera, p, e, r)


def anisotropic(camera: Camera, p: Point, e: float, r: float) -> float:
    """A bound over a ball that is monotonic: no larger for a ball inside, with an error no larger (docs/metrics.md).

    N/w, the *lean*, depends on the place on the screen alone: it is |c| times its distance from the point where all
    verticals vanish. In view it is at most what it is in a corner of the picture; in the ball, what it is at p and |c|
    times the size of the ball on the screen.
    """
    (a, b, c), w = camera.vertical, p[2]
    wide, high = camera.slopes
    lean = math.hypot(abs(a) + abs(c) * wide, abs(b) + abs(c) * high)
    if w > r:
        lean = min(lean, numerator(camera, p) / w + abs(c) * r * math.hypot(*p) / (w * (w - r)))
    return pixels(e, camera.focal * lean, max(w - r, camera.near) - e * abs(c))


def wedgie(camera: Camera, corners: list[Point], e: float) -> float:
    """ROAM's corner bound for samples within e of a triangle: the largest N of a corner, the least depth of all."""
    nearest = min(w for _, _, w in corners)
    moved = nearest - e * abs(camera.vertical[2])
    return pixels(e, camera.focal * max(numerator(camera, p) for p in corners), nearest * max(moved, 0.0))


def wedgie_printed(camera: Camera, corners: list[Point], e: float) -> float:
    """2/(r² − c²) · sqrt((ar − cp)² + (br − cq)²), each factor at its worst corner.

    It is how far the wedgie's upper face is from its lower one, 2e; a sample is only e away from the mesh. So it is
    about twice ``wedgie``. (The lecture's (a, b, c) are e·ẑ, and its (p, q, r) are in pixels.)
    """
    nearest, c = min(w for _, _, w in corners), e * abs(camera.vertical[2])
    divisor = nearest**2 - c**2 if nearest > c else 0.0
    return pixels(e, 2 * camera.focal * max(numerator(camera, p) for p in corners), divisor)
