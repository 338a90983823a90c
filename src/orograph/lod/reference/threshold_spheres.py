"""Threshold spheres: a diamond is split while the eye is inside of its sphere, and few spheres have to be looked at.

Blow 2000, *Terrain Rendering at High Levels of Detail* (GDC); lecture, slide *Thresholding Screen Space Error – Blow*.
With an error e in any direction, ‖x − eye‖ > c·e/τ =: r_T says that a triangle is accurate: around each diamond lies a
sphere whose surface the eye crosses when the diamond is to be split or merged. Made to enclose the children's from the
bottom up, the spheres nest, and the mesh conforms. The spheres are gathered into clusters, those into larger ones. If
the eye was outside of all spheres of a cluster and still is, or inside of all and still is, nothing in it is looked at.
Corrected:

- *The sphere of a diamond* has to hold for all samples under its triangles, not for its point alone: its radius is
  λ·e_i and that of the ball that holds them. As printed, ground may be off by more than τ at the rim of a diamond whose
  point is far enough away. (The printed 0 of leaves is that of the finest triangles, which are not split.)
- *λ* is printed c/τ, which holds on the axis of view. In the picture's corner, at angle θ from the axis, the same
  movement is seen 1/cos² θ times as large: λ = c / (τ·cos² θ) + 1 / cos θ, the last term for samples that move towards
  the eye (docs/engines/blow.md).

How Blow clusters his spheres is not told here from his text: ours are those of one level that lie side by side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from orograph.lod.reference.camera import Camera
from orograph.lod.reference.children import Triangle, Vertex, bottom, diamond_children, diamonds, level, roots, top
from orograph.lod.reference.terrain import Ground, Point


def threshold_printed(camera: Camera, tolerance: float) -> float:
    """λ = c/τ."""
    return camera.focal / tolerance


def threshold(camera: Camera, tolerance: float) -> float:
    """λ that holds in the corner of the picture."""
    cosine = 1 / math.hypot(1, *camera.slopes)
    return camera.focal / (tolerance * cosine**2) + 1 / cosine


def nested_spheres(ground: Ground, threshold: float) -> dict[Vertex, float]:
    """r̂_i of all diamonds, metres: max(r_i(τ), max over children j of ‖p_i − p_j‖ + r̂_j), from the bottom up."""
    r: dict[Vertex, float] = {}
    for i in reversed(list(diamonds(ground.n))):
        here = ground[i]
        own = threshold * here.error + here.radius if here.error > 0 else 0.0
        around = [math.dist(here.point, ground[j].point) + r[j] for j in diamond_children(i, ground.n) if r[j] > 0]
        r[i] = max([own, *around])
    return r


@dataclass
class Cluster:
    """Spheres side by side, of one level, as a box around their centres and the least and the largest radius.

    Attributes:
        low, high: corners of the box.
        least, most: radii.
        parts: the smaller clusters that it is made of; none for a single sphere.
        diamond: of a single sphere.
        inside: whether the last eye was in all spheres (True), in none (False), or it depends (None).
    """

    low: Point
    high: Point
    least: float
    most: float
    parts: list[Cluster] = field(default_factory=list)
    diamond: Vertex = (-1, -1)
    inside: bool | None = False

    @classmethod
    def of(cls, ground: Ground, radii: dict[Vertex, float], these: list[Vertex]) -> Cluster:
        """The cluster of these diamonds, cut in half along the side on which it is longer, and so on."""
        if len(these) == 1:
            point, r = ground[these[0]].point, radii[these[0]]
            return cls(point, point, r, r, diamond=these[0])
        axis = max((0, 1), key=lambda k: max(v[k] for v in these) - min(v[k] for v in these))
        ordered = sorted(these, key=lambda v: v[axis])
        halves = ordered[: len(these) // 2], ordered[len(these) // 2 :]
        parts = [cls.of(ground, radii, half) for half in halves]
        low = min(p.low[0] for p in parts), min(p.low[1] for p in parts), min(p.low[2] for p in parts)
        high = max(p.high[0] for p in parts), max(p.high[1] for p in parts), max(p.high[2] for p in parts)
        return cls(low, high, min(p.least for p in parts), max(p.most for p in parts), parts)

    def crossed(self, eye: Point) -> Iterator[Cluster]:
        """The single spheres whose surface lies between the last eye and this one; all that is looked at is yielded."""
        nearest = math.hypot(*(max(a - e, e - b, 0.0) for a, b, e in zip(self.low, self.high, eye)))
        farthest = math.hypot(*(max(e - a, b - e) for a, b, e in zip(self.low, self.high, eye)))
        inside = True if farthest < self.least else False if nearest >= self.most else None
        was, self.inside = self.inside, inside
        yield self
        if inside is None or inside != was:
            for part in self.parts:
                yield from part.crossed(eye)


class ThresholdSpheres:
    """The mesh of a terrain for one λ, from eye to eye.

    Attributes:
        T: the triangles.
        split: the diamonds whose sphere the eye is in.
        looked_at: how many clusters and spheres the last update looked at.
    """

    def __init__(self, ground: Ground, threshold: float) -> None:
        self.n, self.T = ground.n, set(roots(ground.n))
        self.split: set[Vertex] = set()
        self.looked_at = 0
        radii = nested_spheres(ground, threshold)
        self.clusters = []
        levels: dict[int, list[Vertex]] = {}
        for i in radii:
            levels.setdefault(self.level(i), []).append(i)
        for these in levels.values():
            self.clusters.append(Cluster.of(ground, radii, these))

    def level(self, diamond: Vertex) -> int:
        """That of its top."""
        return level(top(diamond, self.n)[0], self.n)

    def update(self, eye: Point) -> set[Triangle]:
        """Move the eye: merge what it has left, the finest first, and split what it has entered, the coarsest first."""
        seen = [cluster for whole in self.clusters for cluster in whole.crossed(eye)]
        self.looked_at = len(seen)
        entered = {c.diamond for c in seen if not c.parts and c.inside} - self.split
        left = {c.diamond for c in seen if not c.parts and not c.inside} & self.split
        for i in sorted(left, key=self.level, reverse=True):
            self.T.difference_update(bottom(i, self.n))
            self.T.update(top(i, self.n))
        for i in sorted(entered, key=self.level):
            self.T.difference_update(top(i, self.n))
            self.T.update(bottom(i, self.n))
        self.split = self.split - left | entered
        return self.T
