"""The one-sided Hausdorff distance against every sample with every triangle, and against planes and spheres."""

from __future__ import annotations

import math

import broken_meshes as meshes
import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from orograph.tessellation import Tessellation
from orograph.verify import hausdorff


def segment_distance(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    t = np.clip((p - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return float(np.linalg.norm(p - a - t * (b - a)))


def triangle_distance(p: np.ndarray, t: np.ndarray) -> float:
    """By the foot of the perpendicular if it is inside, else by the nearest side."""
    n = np.cross(t[1] - t[0], t[2] - t[0])
    n /= np.linalg.norm(n)
    foot = p - ((p - t[0]) @ n) * n
    turns = [np.cross(t[(i + 1) % 3] - t[i], foot - t[i]) @ n for i in range(3)]
    if min(turns) >= 0:
        return float(abs((p - t[0]) @ n))
    return min(segment_distance(p, t[i], t[(i + 1) % 3]) for i in range(3))


def brute(mesh: Tessellation, terrain: meshes.MemoryTerrain) -> float:
    """The largest over all samples of the surface of the smallest distance over all triangles."""
    grid, heights = terrain.grid, terrain.heights
    corners = mesh.positions(grid)[mesh.triangles]
    surface = {p for t, exists in meshes.units(heights).values() if exists for p in t}
    farthest = 0.0
    for c, r in surface:
        x, y = grid.xy(c, r)
        p = np.array([float(x), float(y), float(heights[r, c])])
        farthest = max(farthest, min((triangle_distance(p, t) for t in corners), default=math.inf))
    return farthest


def test_the_brute_force_itself_finds_the_nearest_point():
    rng = np.random.default_rng(0)
    for _ in range(10):
        t, p = rng.normal(0, 1, (3, 3)), rng.normal(0, 2, 3)
        found = minimize(
            lambda w, t=t, p=p: ((t[0] + w[0] * (t[1] - t[0]) + w[1] * (t[2] - t[0]) - p) ** 2).sum(), [0.3, 0.3],
            bounds=[(0, 1), (0, 1)], constraints={"type": "ineq", "fun": lambda w: 1 - w[0] - w[1]}, method="SLSQP",
            options={"ftol": 1e-14},
        )  # fmt: skip
        assert triangle_distance(p, t) == pytest.approx(math.sqrt(found.fun), rel=1e-5)


@pytest.mark.stress
@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from([(5, 5), (6, 7), (4, 9), (2, 3)]), st.sampled_from(meshes.TRANSFORMS),
    st.sampled_from(["right", "delaunay"]), st.sampled_from([0.0, 0.2]), st.sampled_from([1.0, 30.0]),
    st.integers(0, 4),
)  # fmt: skip
def test_as_every_sample_with_every_triangle(seed, shape, transform, style, missing, steep, removed):
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, steep, shape).astype(np.float32)
    if style == "right":
        heights[rng.random(shape) < missing] = np.nan
    terrain = meshes.terrain_of(heights, transform)
    made = meshes.right_triangles(heights, rng, 0.05) if style == "right" else meshes.delaunay(heights, rng)
    for _ in range(min(removed, len(made) - 1)):
        made = meshes.remove(made, rng, (0, 0))
    mesh = meshes.tessellation(made, terrain)
    found = hausdorff(mesh, terrain)
    assert found.metres == pytest.approx(brute(mesh, terrain), rel=1e-6, abs=1e-9)


def test_a_step_is_nearer_in_space_than_on_the_vertical():
    """A plane tilted by 45° that the mesh leaves 10 m below: the distance is 10·cos 45°."""
    c, _ = np.meshgrid(np.arange(17.0), np.arange(17.0))
    heights = c.copy()
    heights[8, 8] += 10
    terrain = meshes.terrain_of(heights, Affine(1, 0, 4e5, 0, -1, 5e6))
    mesh = meshes.tessellation([((0, 0), (16, 0), (16, 16)), ((0, 0), (0, 16), (16, 16))], terrain)
    found = hausdorff(mesh, terrain)
    assert found.metres == pytest.approx(10 * math.sqrt(0.5), rel=1e-12) and found.sample == (8, 8)


def test_ground_left_out_is_as_far_as_the_rim():
    """Only one corner of a level plain is meshed; the farthest sample is the opposite corner, over several bands."""
    terrain = meshes.terrain_of(np.zeros((700, 300)), Affine(2, 0, 0, 0, -3, 0))
    mesh = meshes.tessellation([((0, 0), (100, 0), (100, 50)), ((0, 0), (0, 50), (100, 50))], terrain)
    found = hausdorff(mesh, terrain)
    assert found.metres == pytest.approx(math.hypot(199 * 2, 649 * 3), rel=1e-12) and found.sample == (299, 699)


def test_no_mesh_is_infinitely_far_and_no_ground_not_at_all():
    terrain = meshes.terrain_of(np.zeros((5, 5)))
    nothing = meshes.tessellation([], terrain)
    assert hausdorff(nothing, terrain).metres == math.inf
    empty = meshes.terrain_of(np.full((5, 5), np.nan))
    assert hausdorff(nothing, empty).metres == 0.0 and hausdorff(nothing, empty).sample is None


def test_vertices_between_samples():
    """Against brute force; and a plane with a vertex between samples pulled down by a known amount."""
    rng = np.random.default_rng(3)
    for fraction in (1, 10):
        terrain = meshes.terrain_of(rng.normal(0, 20, (6, 7)))
        mesh = meshes.tessellation_between(meshes.delaunay_between((6, 7), rng, fraction), terrain, rng)
        assert hausdorff(mesh, terrain).metres == pytest.approx(brute(mesh, terrain), rel=1e-6)
    level = meshes.terrain_of(np.zeros((5, 5)), Affine(10, 0, 0, 0, -10, 0))
    corners = [(0, 0), (4, 0), (4, 4), (0, 4)]
    made = [(corners[i], corners[(i + 1) % 4], (2.5, 2.5)) for i in range(4)]
    mesh = meshes.tessellation_between(made, level, rng)
    mesh.vertices[:, 2] = np.where(mesh.vertices[:, 0] == 2.5, -1.0, 0.0)
    found = hausdorff(mesh, level)
    assert found.sample == (2, 2) and found.metres == pytest.approx(0.8 * 25 / math.hypot(1, 25), rel=1e-12)
