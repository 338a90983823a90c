"""Threshold spheres: a diamond is split while the eye is inside of its sphere, and few spheres have to be looked at.

Blow 2000, *Terrain Rendering at High Levels of Detail* (GDC); lecture, slide *Thresholding Screen Space Error – Blow*.
With an error e in any direction, ‖x − eye‖ > c·e/τ =: r_T says that a triangle is accurate: around each diamond lies a
sphere whose surface the eye crosses when the diamond is to be split or merged. Made to enclose the children's from the
bottom up, the spheres nest, and the mesh conforms. The spheres are gathered into clusters, those into larger ones. A
cluster is looked into only when the eye has come so far that it may have crossed the surface of one of its spheres; at
a small step hardly any is. Corrected:

- *The sphere of a diamond* has to hold for all samples under its triangles, not for its point alone: its radius is
  λ·e_i and that of the ball that holds them. As printed, ground may be off by more than τ at the rim of a diamond whose
  point is far enough away. (The printed 0 of leaves is that of the finest triangles, which are not split.)
- *λ* is printed c/τ, which holds on the axis of view. In the picture's corner, at angle θ from the axis, the same
  movement is seen 1/cos² θ times as large: λ = c / (τ·cos² θ) + 1 / cos θ, the last term for samples that move towards
  the eye (docs/methods/threshold-spheres.md).

The clusters are ours: spheres of one level that lie side by side, and how far the eye may go before one is crossed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

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
    """Spheres side by side, of one level; or a single one.

    Attributes:
        parts: the two smaller clusters that it is made of; none for a single sphere.
        diamond, centre, radius: of a single sphere.
        until: the way of the eye, metres, up to which it cannot have crossed the surface of any.
    """

    parts: list[Cluster]
    diamond: Vertex
    centre: Point
    radius: float
    until: float = 0.0

    @classmethod
    def of(cls, ground: Ground, radii: dict[Vertex, float], these: list[Vertex]) -> Cluster:
        """The cluster of these diamonds, cut in half along the side on which it is longer, and so on."""
        first, parts = these[0], []
        if len(these) > 1:
            axis = max((0, 1), key=lambda k: max(v[k] for v in these) - min(v[k] for v in these))
            ordered, half = sorted(these, key=lambda v: v[axis]), len(these) // 2
            parts = [cls.of(ground, radii, ordered[:half]), cls.of(ground, radii, ordered[half:])]
        return cls(parts, first, ground[first].point, radii[first])

    def looked_at(self, eye: Point, way: float) -> Iterator[Cluster]:
        """This one and those in it whose surfaces the eye may have crossed, after it has come so far in all."""
        if way < self.until:
            return
        yield self
        for part in self.parts:
            yield from part.looked_at(eye, way)
        if self.parts:
            self.until = min(part.until for part in self.parts)
        else:
            self.until = way + abs(math.dist(eye, self.centre) - self.radius) * (1 - 1e-9)  # (for roundings)


class ThresholdSpheres:
    """The mesh of a terrain for one λ, from eye to eye.

    Attributes:
        T: the triangles.
        split: the diamonds whose sphere the eye is in.
        way: how far the eye has come, metres.
        looked_at: how many clusters and spheres the last update looked at.
    """

    def __init__(self, ground: Ground, threshold: float) -> None:
        self.n, self.T = ground.n, set(roots(ground.n))
        self.split: set[Vertex] = set()
        self.eye: Point | None = None
        self.way, self.looked_at = 0.0, 0
        radii = nested_spheres(ground, threshold)
        levels: dict[int, list[Vertex]] = {}
        for i in radii:
            levels.setdefault(self.level(i), []).append(i)
        self.clusters = [Cluster.of(ground, radii, these) for these in levels.values()]

    def level(self, diamond: Vertex) -> int:
        """That of its top."""
        return level(top(diamond, self.n)[0], self.n)

    def update(self, eye: Point) -> set[Triangle]:
        """Move the eye: merge what it has left, the finest first, and split what it has entered, the coarsest first."""
        self.way += math.dist(eye, self.eye or eye)
        self.eye = eye
        seen = [cluster for whole in self.clusters for cluster in whole.looked_at(eye, self.way)]
        self.looked_at = len(seen)
        spheres = [c for c in seen if not c.parts]
        inside = {c.diamond for c in spheres if math.dist(eye, c.centre) < c.radius}
        entered, left = inside - self.split, ({c.diamond for c in spheres} - inside) & self.split
        for i in sorted(left, key=self.level, reverse=True):
            self.T.difference_update(bottom(i, self.n))
            self.T.update(top(i, self.n))
        for i in sorted(entered, key=self.level):
            self.T.difference_update(top(i, self.n))
            self.T.update(bottom(i, self.n))
        self.split = self.split - left | entered
        return self.T
