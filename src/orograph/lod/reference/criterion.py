"""Which diamonds and triangles are accurate, and which are drawn.

Lecture, slides *Refinement Criterion*, *Priority* and *View Frustum Culling*: a criterion maps each triangle or diamond
to accurate or inaccurate, a priority says how urgent its split is. Here the priority is the bound of the screen-space
error in pixels, −1 if nothing of it is in view; inaccurate is what exceeds the tolerance τ. There are two:

- ``Spheres``, of diamonds, over the nested balls (Lindstrom & Pascucci 2001). Balls nest and errors never grow on the
  way down, so it is *monotonic*: the parents of an inaccurate diamond are inaccurate.
- ``Prisms``, of triangles ± their error (Duchaineau et al. 1997). They are tighter, for no ball fits a triangle well;
  they are not monotonic, so they need forced splits.

Corrected: the lecture gives the diamonds of leaves the radius 0. Then the balls do not hold the corners of their
triangles, and culling leaves out triangles that are in view; the radii of ``terrain.Ground`` hold them. The papers draw
the coarse triangle where a ball is out of view; here it is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orograph.lod.reference.camera import Camera, dot
from orograph.lod.reference.children import Triangle, Vertex, corners, is_finest
from orograph.lod.reference.screen_error import Bound, anisotropic, wedgie
from orograph.lod.reference.terrain import Ground, Point, diamond_of


@dataclass(frozen=True)
class Spheres:
    """The criterion of diamonds, by a bound over their balls; ``cull``: whether what is out of view is accurate."""

    ground: Ground
    camera: Camera
    bound: Bound = anisotropic
    cull: bool = True

    def is_out_of_view(self, diamond: Vertex) -> bool:
        """Whether the ball is completely outside of a plane of the frustum."""
        sample = self.ground[diamond]
        return self.cull and min(self.camera.depths(self.camera.to_camera(sample.point))) < -sample.radius

    def priority(self, diamond: Vertex) -> float:
        """The bound over the ball, pixels; −1 out of view."""
        sample = self.ground[diamond]
        if self.is_out_of_view(diamond):
            return -1.0
        return self.bound(self.camera, self.camera.to_camera(sample.point), sample.error, sample.radius)

    def is_drawn(self, t: Triangle) -> bool:
        """Whether a triangle of the mesh has ground and all its corners, and its diamond is in view."""
        return self.ground.has_ground(t) and self.ground.is_known(t) and not self.is_out_of_view(diamond_of(t))


@dataclass(frozen=True)
class Prisms:
    """The criterion of triangles, by ROAM's bound over the prism of a triangle ± its error."""

    spheres: Spheres

    @property
    def ground(self) -> Ground:
        """The vertices."""
        return self.spheres.ground

    def error(self, t: Triangle) -> float:
        """That of the triangle's diamond, metres; 0 for a finest one."""
        return 0.0 if is_finest(t) else self.ground[t.diamond].error

    def points(self, t: Triangle) -> list[Point]:
        """The corners in camera coordinates."""
        return [self.spheres.camera.to_camera(self.ground[corner].point) for corner in corners(t)]

    def is_out_of_view(self, t: Triangle) -> bool:
        """Whether the prism, or the diamond's ball, is completely outside of a plane of the frustum."""
        if not is_finest(t) and self.spheres.is_out_of_view(t.diamond):
            return True
        is_squeezed = any(self.ground[corner].place != corner for corner in corners(t))
        if not self.spheres.cull or is_squeezed or not self.ground.is_known(t):
            return False  # (a squeezed triangle need not hold the samples that are its own)
        camera = self.spheres.camera
        deepest = [max(depths) for depths in zip(*map(camera.depths, self.points(t)))]
        reach = [abs(dot((a, b, c), camera.vertical)) * self.error(t) for a, b, c, _ in camera.planes]
        return any(depth + more < 0 for depth, more in zip(deepest, reach))

    def priority(self, t: Triangle) -> float:
        """The bound over the prism, pixels; −1 out of view, without ground, and for finest triangles."""
        if is_finest(t) or not self.ground.has_ground(t) or self.is_out_of_view(t):
            return -1.0
        if not self.ground.is_known(t):
            return math.inf if self.error(t) else 0.0
        return wedgie(self.spheres.camera, self.points(t), self.error(t))

    def is_drawn(self, t: Triangle) -> bool:
        """Whether a triangle of the mesh has ground and all its corners, and is in view."""
        return self.ground.has_ground(t) and self.ground.is_known(t) and not self.is_out_of_view(t)
