"""A triangulation of samples: one for the vertices, in whatever order they come, and Delaunay."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.triangulation.mesh import begin, insert, locate, new_mesh


def triangulated(points, side):
    """The triangles of samples (column, row) that are inserted in this order, as sets of three."""
    m = new_mesh(side, side)
    m.counts[:] = 0, 0, -1
    begin(m, np.zeros((side, side), np.float32))
    stack = np.empty(64 * side * side, np.int32)
    for x, y in points:
        insert(m, locate(m, 0, x, y), x, y, 0.0, stack)
    corners = m.corner[: 3 * int(m.counts[1])].reshape(-1, 3)
    return {frozenset((int(m.x[v]), int(m.y[v])) for v in c) for c in corners}


@pytest.mark.parametrize("side", [4, 5, 9, 14])
def test_vertices_have_one_triangulation(side):
    """Samples of a lattice, many of which lie on one circle."""
    rng = np.random.default_rng(side)
    ends = {0, side - 1}
    for chance in (0.2, 0.5, 1.0):
        points = [(x, y) for x in range(side) for y in range(side) if rng.random() < chance]
        points = [(x, y) for x, y in points if not {x, y} <= ends]
        made = [triangulated([points[k] for k in rng.permutation(len(points))], side) for _ in range(4)]
        assert made[0] == made[1] == made[2] == made[3]
        corners = [sorted(triangle) for triangle in made[0]]
        used = {at for triangle in corners for at in triangle}
        for (ax, ay), (bx, by), (cx, cy) in corners:
            ax, ay, bx, by = ax - cx, ay - cy, bx - cx, by - cy
            area = 2 * (ax * by - ay * bx)
            assert area != 0
            u = (by * (ax * ax + ay * ay) - ay * (bx * bx + by * by)) / area
            v = (ax * (bx * bx + by * by) - bx * (ax * ax + ay * ay)) / area
            radius = u * u + v * v
            assert all((x - cx - u) ** 2 + (y - cy - v) ** 2 >= radius - 1e-9 for x, y in used)


def test_all_samples_make_the_surface():
    """Each cell is cut from its (even, even) to its (odd, odd) corner."""
    side = 7
    found = triangulated([(x, y) for y in range(side) for x in range(side) if not {x, y} <= {0, side - 1}], side)
    for y in range(side - 1):
        for x in range(side - 1):
            a, b, c, d = (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)
            cut = [(a, b, d), (a, c, d)] if (x + y) % 2 == 0 else [(a, b, c), (b, c, d)]
            assert all(frozenset(triangle) in found for triangle in cut)
