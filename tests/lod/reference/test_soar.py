"""The strip against the front of the active diamonds; nested errors and spheres; what the printed forms do."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph.hierarchy import diamonds
from orograph.lod.reference import children as hrt
from orograph.lod.reference import soar, stateless
from orograph.lod.reference.camera import Camera
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.terrain import Ground


def turn(a, b, c) -> int:
    """Twice the area of a triangle, its sign the way it turns."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])


@pytest.mark.parametrize("n", range(6))
def test_the_strip_has_each_triangle_once_and_turned_one_way(n):
    rng = np.random.default_rng(n)
    for share in (0.0, 0.001, 0.02, 0.3, 1.0):
        active = diamonds.closure(rng.random((2**n + 1,) * 2) < share)
        strip = soar.mesh_refine(n, lambda v, active=active: bool(active[v[1], v[0]]))
        expected = stateless.refine(n, lambda v, active=active: bool(active[v[1], v[0]]))
        found = strip.triangles()
        assert len(found) == len(expected)
        assert {frozenset(t) for t in found} == {frozenset(hrt.corners(t)) for t in expected}
        turns = [turn(*t) * (-1) ** k for k, t in enumerate(zip(strip.V, strip.V[1:], strip.V[2:]))]
        assert min(turns) >= 0 or max(turns) <= 0


def test_strip_vertices_per_triangle_tend_to_five_thirds():
    lengths = [len(soar.mesh_refine(n, lambda v: True).V) / (2 * 4**n) for n in (3, 5)]
    assert 5 / 3 < lengths[1] < lengths[0] < 1.7


def test_without_the_swap_of_left_and_right_the_strip_is_wrong(monkeypatch):
    def printed(V, i, j, l, active):  # noqa: E741
        if l > 0 and active(i):
            printed(V, j, soar.c_l(i, j), l - 1, active)
            V.tstrip_append(i, l % 2)
            printed(V, j, soar.c_r(i, j), l - 1, active)

    expected = {frozenset(hrt.corners(t)) for t in stateless.refine(3, lambda v: True)}
    monkeypatch.setattr(soar, "submesh_refine", printed)
    found = {frozenset(t) for t in soar.mesh_refine(3, lambda v: True).triangles()}
    assert (len(found), len(found & expected), len(expected)) == (159, 64, 128)


def test_nested_errors_and_radii_are_the_store_s():
    rng = np.random.default_rng(1)
    t = plain.unrounded(plain.terrain(plain.rough(rng, (33, 33)), angle=20.0, stretch=2.0))
    ground = Ground.of(t, "midpoint")
    errors, radii = soar.nested_errors(ground), soar.nested_radii(ground)
    for i in hrt.diamonds(ground.n):  # (float32, rounded up)
        assert errors[i] <= ground[i].error * (1 + 1e-6) and ground[i].error == pytest.approx(errors[i], rel=1e-6)
        assert radii[i] <= ground[i].radius == pytest.approx(radii[i], rel=2e-6)


def test_radius_0_of_leaves_culls_triangles_that_are_in_view():
    """Printed: 0 if i is a leaf. The triangles of a leaf reach beyond its point."""
    rng = np.random.default_rng(2)
    t = plain.terrain(plain.rough(rng, (17, 17), amplitude=5.0))
    ground = Ground.of(t)
    leaves = [i for i in hrt.diamonds(ground.n) if not hrt.diamond_children(i, ground.n)]
    printed = Ground(ground.n, ground.samples | {i: ground[i]._replace(radius=0.0) for i in leaves})
    lost = 0
    for _ in range(20):
        view = plain.random_view(rng, t, fov_y=15.0)
        spheres = Spheres(ground, Camera.of(view))
        fine = stateless.refine(ground.n, lambda v: True)
        kept = plain.drawn(ground, fine, spheres)
        missing = kept - plain.drawn(printed, fine, Spheres(printed, Camera.of(view)))
        for corners in missing:
            lost += any(min(spheres.camera.depths(spheres.camera.to_camera(ground[v].point))) > 0 for v in corners)
    assert lost > 0
