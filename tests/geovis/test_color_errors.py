"""Color errors: CIELAB against published values, the bound against brute force over every sample of every diamond."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.geovis.color_errors import ColorErrors, lab
from orograph.store.memory import MemoryTerrain


def terrain(rows: int, cols: int, seed: int = 0, holes: bool = False) -> MemoryTerrain:
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 30, (rows, cols)).cumsum(0).cumsum(1).astype(np.float32)
    if holes:
        heights[rows // 3 : rows // 2, cols // 4 : cols // 3] = np.nan
    return MemoryTerrain(heights, Grid((rows, cols), Affine(30, 0, 5e5, 0, -30, 4e6), None), "colors")


def test_lab_of_the_srgb_primaries() -> None:
    # Values of the sRGB primaries in CIELAB (D65) as colour science tables have them (e.g. Lindbloom's calculator).
    linear = np.array([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], np.float64)
    known = [
        [100, 0, 0],
        [53.2408, 80.0925, 67.2032],
        [87.7347, -86.1827, 83.1793],
        [32.2970, 79.1875, -107.8602],
        [0, 0, 0],
    ]
    np.testing.assert_allclose(lab(linear), known, atol=0.02)
    grey = lab(np.full((1, 3), 0.18418652))[0]  # the luminance of L* = 50
    np.testing.assert_allclose(grey, [50, 0, 0], atol=0.01)


def corners(row: int, col: int) -> tuple[int, list[tuple[int, int]]]:
    """Octave of a diamond, and its hypotenuse's ends and two apexes."""
    low = (row | col) & -(row | col)
    s, odd_row, odd_col = low, row // low % 2, col // low % 2
    if odd_row and odd_col:
        nw, ne, sw, se = (row - s, col - s), (row - s, col + s), (row + s, col - s), (row + s, col + s)
        falling = ((row - s) // (2 * s) + (col - s) // (2 * s)) % 2 == 0
        return low.bit_length() - 1, [nw, se, ne, sw] if falling else [ne, sw, nw, se]
    if odd_col:
        return low.bit_length() - 1, [(row, col - s), (row, col + s), (row - s, col), (row + s, col)]
    return low.bit_length() - 1, [(row - s, col), (row + s, col), (row, col - s), (row, col + s)]


def true_error(colors: np.ndarray, row: int, col: int) -> float:
    """The largest ΔE of a sample from its colour on the diamond's two triangles, by barycentric coordinates."""
    size = len(colors)
    worst = 0.0
    _, (a, b, p, q) = corners(row, col)
    for apex in (p, q):
        if not (0 <= apex[0] < size and 0 <= apex[1] < size):
            continue
        t = np.array([a, b, apex])
        low, high = t.min(0), t.max(0)
        y, x = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
        m = np.linalg.inv(np.vstack([t.T, np.ones(3)]))
        w = m @ np.stack([y.ravel(), x.ravel(), np.ones(y.size)])
        inside = w.min(0) > -1e-9
        drawn = w[:, inside].T @ np.array([colors[tuple(v)] for v in t], np.float64)
        worst = max(worst, float(np.linalg.norm(colors[y.ravel()[inside], x.ravel()[inside]] - drawn, axis=-1).max()))
    return worst


def test_bound_of_every_sample_and_not_much_more() -> None:
    t = terrain(33, 33)
    found = ColorErrors(t, jobs=1)
    colors = found.colors(0, 33, 0, 33)
    table = found(0, 0, 33, 0, 33)
    close: dict[tuple[int, int], float] = {}
    vertices = [(r, c) for r in range(33) for c in range(33) if r % 32 or c % 32]

    def level(v: tuple[int, int]) -> int:
        octave = corners(*v)[0]
        return 2 * octave + (v[0] >> octave & v[1] >> octave & 1)

    for row, col in sorted(vertices, key=level):
        octave, _ = corners(row, col)
        s, square = 1 << octave, (row >> octave) & (col >> octave) & 1
        h = s // 2
        children = (
            [(row - s, col), (row + s, col), (row, col - s), (row, col + s)]
            if square
            else ([(row - h, col - h), (row - h, col + h), (row + h, col - h), (row + h, col + h)] if octave else [])
        )
        truth = true_error(colors, row, col)
        close[row, col] = max([truth, *(close[c] for c in children if c in close)])
        assert table[row, col] >= truth - 1e-4
        assert all(table[row, col] >= table[c] for c in children if c in close)
    slack = np.array([table[v] - 3**0.5 * close[v] for v in vertices])
    assert slack.max() < 0.1 + 2 / 15.9 * np.sqrt(table.max())  # three channels' maxima, and a step of the code


@pytest.mark.parametrize("shape", [(33, 33), (70, 45), (2, 9)])
def test_threads_and_odd_sizes(shape: tuple[int, int]) -> None:
    one, many = (ColorErrors(terrain(*shape, holes=shape[0] > 40), jobs=jobs) for jobs in (1, 3))
    for level in range(one.terrain.levels):
        a = one(level, 0, 10**6, 0, 10**6)
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, many(level, 0, 10**6, 0, 10**6))


def test_one_color_has_no_error_and_light_alone_has() -> None:
    flat = MemoryTerrain(np.full((33, 33), 7, np.float32), Grid((33, 33), Affine(1, 0, 0, 0, -1, 0), None), "flat")
    assert ColorErrors(flat)(0, 0, 33, 0, 33).max() < 0.1
    rough = terrain(33, 33, 4)
    lit = ColorErrors(rough, colormap="grey", sun=(315, 30))(0, 0, 33, 0, 33)
    unlit = ColorErrors(rough, colormap="grey", sun=None)(0, 0, 33, 0, 33)
    assert lit[16, 16] > 2 * unlit[16, 16]
