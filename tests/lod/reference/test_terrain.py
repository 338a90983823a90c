"""What the references read of a terrain: the values of ``Terrain.diamonds``, closed also where there is no ground."""

from __future__ import annotations

import math

import numpy as np
import plain
import pytest

from orograph.lod.reference.children import diamond_children, diamonds
from orograph.lod.reference.terrain import Ground


@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_vertices_are_those_of_the_terrain_and_closed(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100)])
    z = plain.rough(rng, shape, gaps=gaps)
    t = plain.terrain(z, angle=30.0, stretch=2.0)
    p, ground = plain.Plain(t), Ground.of(t, exaggeration=2.0)
    assert len(ground.samples) == t.side**2
    for (x, y), sample in ground.samples.items():
        assert sample.place == (p.j[y, x], p.i[y, x])
        assert np.allclose(sample.point, p.at[y, x] * [1, 1, 2])
        assert sample.known == (not np.isnan(p.z[y, x]))
    for i in diamonds(ground.n):
        x, y = i
        here = ground[i]
        assert here.empty == (p.r[y, x] < 0)
        if not here.empty:
            assert here.error == 2 * p.e[y, x] and here.radius == 2 * p.r[y, x]
        for j in diamond_children(i, ground.n):
            child = ground[j]
            assert here.error >= child.error
            if not (child.empty and child.radius < 1e-20):
                assert here.radius * (1 + 1e-6) >= math.dist(here.point, child.point) + child.radius
