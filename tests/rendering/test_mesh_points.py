"""Heights of a mesh at points against SciPy's interpolation in its own triangles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from orograph.rendering.mesh_points import mesh_heights
from orograph.tessellation import Tessellation


@pytest.mark.stress
def test_heights_are_those_of_the_triangle_each_point_lies_in() -> None:
    rng = np.random.default_rng(0)
    flat = rng.uniform(0, 300, (500, 2))
    found = Delaunay(flat)
    z = rng.uniform(0, 900, 500)
    mesh = Tessellation(np.column_stack([flat, z]), found.simplices.astype(np.int32))
    x, y = rng.uniform(-40, 340, (2, 5000))
    truth = LinearNDInterpolator(found, z)(x, y)
    np.testing.assert_allclose(mesh_heights(mesh, x, y), truth, atol=1e-6)
    assert 500 < np.isnan(truth).sum() < 2500


def test_few_points_and_no_triangles() -> None:
    mesh = Tessellation(np.array([[0.0, 0, 1], [4, 0, 5], [0, 4, 9]]), np.array([[0, 1, 2]], np.int32))
    assert mesh_heights(mesh, np.array([1.0]), np.array([1.0])).tolist() == [4.0]
    assert mesh_heights(mesh, np.zeros(0), np.zeros(0)).shape == (0,)
    none = Tessellation(mesh.vertices, np.zeros((0, 3), np.int32))
    assert np.isnan(mesh_heights(none, np.ones(3), np.ones(3))).all()
