"""Light through baked caps under a picture: beside NumPy hit by hit, and whatever the order of hits."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.lighting.aperture_kernels import LightTables
from orograph.lighting.field import LightField, light_caps
from orograph.lighting.relief import Windows, _gradients

SIZE = 96
AMBIENT, BOUNCE = np.array([0.5, 0.6, 0.9]), np.array([0.1, 0.05, 0.02])


def windows(values: np.ndarray, boxes: list[tuple[int, int, int, int]]) -> Windows:
    """Box means of values (SIZE, SIZE, …) as nested windows: the whole at a block of 2^k for the
    first of k boxes, then each box (row0, row1, col0, col1, of samples) twice as fine as the one before."""
    pool, shapes, places = [], [], []
    for n, (row0, row1, col0, col1) in enumerate(boxes):
        block = 2 ** (len(boxes) - 1 - n)
        cut = values[row0:row1, col0:col1]
        rows, cols = (row1 - row0) // block, (col1 - col0) // block
        means = cut.reshape(rows, block, cols, block, -1).mean((1, 3))
        pool.append(means.reshape(rows * cols, -1))
        shapes.append((rows, cols))
        holds = [col0 + 2.0 * block, col1 - 3.0 * block, row0 + 2.0 * block, row1 - 3.0 * block]
        places.append([block, *(holds if n else [-np.inf, np.inf, -np.inf, np.inf]), col0 / block, row0 / block, 0, 0])
    return Windows.of(np.concatenate(pool).astype(np.float32), shapes, places)


@pytest.fixture(scope="module")
def looked_at():
    """A field of caps, the relief (in other windows), and hits all over, the same in other orders."""
    rng = np.random.default_rng(3)
    rows, cols = np.mgrid[0:SIZE, 0:SIZE].astype(np.float64)
    heights = 6 * np.sin(cols / 9) * np.cos(rows / 7) + rng.normal(0, 0.3, (SIZE, SIZE))
    caps = np.stack(
        [0.3 * np.sin(rows / 5), 0.3 * np.cos(cols / 6), np.ones((SIZE, SIZE)), 0.4 + 0.2 * np.sin(cols)], -1
    )
    caps[40:44, 40:50] = np.nan
    field = windows(caps, [(0, SIZE, 0, SIZE), (0, 64, 16, 80), (16, 48, 32, 64)])
    means = windows(heights, [(0, SIZE, 0, SIZE), (32, 96, 0, 64), (48, 80, 16, 48)])
    n = 3000
    points = np.stack([*rng.uniform(-1, SIZE, (2, n)), rng.uniform(0, 9, n)], 1)
    points[::17] = np.nan
    width = np.exp(rng.uniform(-1, 2.5, n))
    return field, means._replace(pool=means.pool[:, 0].copy()), points, width


def lit(looked_at, order) -> np.ndarray:
    field, relief, points, width = looked_at
    lights = LightTables(np.zeros((0, 10)), np.zeros((0, 6)), AMBIENT)
    out = np.zeros((len(order), 3), np.float32)
    light_caps(
        field, relief, points[order], width[order], np.eye(2), 1.3, 1.0, lights, BOUNCE, np.eye(2), out
    )  # fmt: skip
    return out


@pytest.mark.stress
def test_hits_do_not_depend_on_those_before(looked_at):
    """Windows found for one hit serve the next: in any order, or alone, the same to the bit."""
    _, _, points, width = looked_at
    n = len(points)
    together = lit(looked_at, np.arange(n))
    for order in (
        np.arange(n)[::-1],
        np.argsort(points[:, 0]),
        np.argsort(width),
        np.argsort(width + points[:, 1] // 16),
    ):
        assert (lit(looked_at, order) == together[order]).all()
    for k in range(0, n, 7):
        assert (lit(looked_at, np.array([k])) == together[k]).all()


def test_beside_numpy(looked_at):
    """The cap of the nearest level and the slope between two, under a sky without suns."""
    field, relief, points, width = looked_at
    slope = np.zeros((len(points), 2))
    _gradients(relief, points, width, slope, 0, len(points))
    cap = LightField(field).values(points, width).astype(np.float64)
    cap[np.isnan(cap).any(1)] = 0, 0, 1, 0
    seen = np.isfinite(points[:, 0])
    direction = cap[:, :3] / np.linalg.norm(cap[:, :3], axis=1, keepdims=True)
    normal = np.column_stack([-1.3 * slope, np.ones(len(slope))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rim2 = cap[:, 3:] ** 2
    sky = np.maximum((direction * normal).sum(1, keepdims=True), 0) * (1 - rim2)
    expected = sky * AMBIENT + rim2 * BOUNCE
    got = lit(looked_at, np.arange(len(points)))
    assert np.abs(got - expected)[seen].max() < 3e-3  # what the parabola in place of a logarithm may be off
    assert np.abs(got - expected)[seen].mean() < 3e-4
    assert (got[~seen] == 0).all()
    assert got[seen].std() > 0.05
