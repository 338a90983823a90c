"""Arbitrary rays: the caster against every ray with every triangle (``brute``), on small fields of every kind."""

from __future__ import annotations

import brute
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.raycast.caster import Caster

KINDS = ("above", "inside", "horizontal", "axis", "edge", "vertex", "diagonal", "down", "up", "beneath", "far", "wall")


def field(rng: np.random.Generator, rows: int, cols: int, kind: str) -> np.ndarray:
    h = rng.normal(0, 2, (rows, cols))
    if kind == "integer":
        h = np.round(h)
    elif kind == "plateau":
        h = np.where(rng.random((rows, cols)) < 0.6, 1.0, h)
    elif kind == "holes":
        h[rng.random((rows, cols)) < 0.15] = np.nan
    elif kind == "steep":
        h *= 300
    elif kind == "flat":
        h[:] = 3.0
    return h.astype(np.float32)


def rays(rng: np.random.Generator, h: np.ndarray, kind: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """n rays of a kind, (n, 3) each: positions in samples, heights in the field's own range."""
    rows, cols = h.shape
    finite = h[np.isfinite(h)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    size = max(high - low, 1.0)
    corner, span = np.array([0.0, 0.0, low]), np.array([cols - 1.0, rows - 1.0, size])
    o = corner + rng.random((n, 3)) * span
    d = rng.normal(0, 1, (n, 3)) * [1, 1, size / 4]
    if kind == "above":
        o[:, 2] = high + rng.random(n) * size + 0.1
        d[:, 2] = -np.abs(d[:, 2])
        o[:, :2] -= d[:, :2] * 3
    elif kind == "horizontal":
        d[:, 2] = 0
        if rng.random() < 0.5:
            o[:, 2] = np.round(o[:, 2])
    elif kind in ("axis", "edge", "vertex", "diagonal"):
        steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]) if kind in ("axis", "edge") else None
        if kind == "diagonal":
            steps = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
        if kind != "axis":
            o[:, :2] = np.round(o[:, :2])
        if steps is not None:
            d[:, :2] = steps[rng.integers(0, 4, n)]
        else:  # through vertices, at many angles
            d[:, :2] = rng.integers(-3, 4, (n, 2))
            d[(d[:, :2] == 0).all(1), 0] = 1
        o[:, :2] -= d[:, :2] * rng.integers(0, 4, (n, 1))
        o[:, 2] += size * (rng.random(n) - 0.3)
        d[:, 2] = np.where(rng.random(n) < 0.3, 0.0, d[:, 2] * 0.3)
    elif kind in ("down", "up"):
        d[:] = [0, 0, -1 if kind == "down" else 1]
        o[:, 2] = high + 1 if kind == "down" else low - 1
        whole = rng.random(n) < 0.5
        o[whole, :2] = np.round(o[whole, :2] * 2) / 2
    elif kind == "beneath":
        o[:, 2] = low - 0.1 - rng.random(n) * size
        d[:, 2] = np.abs(d[:, 2])
        o[:, :2] -= d[:, :2]
    elif kind == "far":  # starts beyond the field and looks away, or back across it
        o[:, 0] += np.where(rng.random(n) < 0.5, cols, -cols)
    elif kind == "wall":  # enters by a side, between the lowest and the highest ground
        target = corner + rng.random((n, 3)) * span
        o[:, 0] = np.where(rng.random(n) < 0.5, -2.0, cols + 1.0)
        d = target - o
    return o, d


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(2, 17),
    cols=st.integers(2, 33),
    ground=st.sampled_from(["rough", "integer", "plateau", "holes", "steep", "flat"]),
    kind=st.sampled_from(KINDS),
)
def test_first_hits(seed: int, rows: int, cols: int, ground: str, kind: str) -> None:
    rng = np.random.default_rng(seed)
    h = field(rng, rows, cols, ground)
    o, d = rays(rng, h, kind, 12)
    t, which = Caster.of(h, 1).cast(o, d)
    brute.check(h, o, d, t)
    assert ((which == 0) == np.isfinite(t)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_many_first_hits(kind: str) -> None:
    rng = np.random.default_rng(3)
    for ground in ("rough", "holes", "integer"):
        h = field(rng, 17, 24, ground)
        o, d = rays(rng, h, kind, 150)
        sure = brute.check(h, o, d, Caster.of(h, 1).cast(o, d)[0])
        if kind not in ("far",) and ground == "rough":
            assert sure.sum() > 10  # the comparison compared something


def test_near_and_far_limit_what_counts() -> None:
    rng = np.random.default_rng(5)
    h = field(rng, 17, 17, "rough")
    caster = Caster.of(h, 1)
    o, d = rays(rng, h, "wall", 300)
    for near, far in ((0.3, 0.9), (0.0, 0.5), (0.7, 5.0)):
        t, _ = caster.cast(o, d, near, far)
        brute.check(h, o, d, t, near, far)
        assert np.isfinite(t).sum() > 30


def test_diagonals_are_those_of_the_definition() -> None:
    """Rays straight down at the middles of cells meet the diagonals' heights; the other cut gives other ones."""
    h = np.random.default_rng(1).normal(0, 10, (7, 8)).astype(np.float32)
    r, c = np.mgrid[0:6, 0:7]
    even = (r + c) % 2 == 0
    expected = np.where(even, (h[:-1, :-1] + h[1:, 1:].astype(float)) / 2, (h[:-1, 1:] + h[1:, :-1].astype(float)) / 2)
    o = np.stack([c.ravel() + 0.5, r.ravel() + 0.5, np.full(42, 100.0)], 1)
    t, _ = Caster.of(h, 1).cast(o, np.tile([0.0, 0.0, -1.0], (42, 1)))
    np.testing.assert_allclose(100 - t, expected.ravel(), atol=1e-9)
    flipped = brute.intersections(brute.triangles(h, flipped=True), o, np.tile([0.0, 0.0, -1.0], (42, 1))).min(1)
    assert (np.abs(flipped - t) > 1e-3).all()


def test_what_lies_beyond_a_hole_is_seen_through_it() -> None:
    h = np.zeros((9, 9), np.float32)
    h[:, 6:] = 50  # a wall behind
    h[3:6, 3] = np.nan
    caster = Caster.of(h, 1)
    # Straight down into the hole: nothing; through it, from above, against the underside of the wall: something.
    down, through = np.array([[3.0, 4.0, 10.0]]), np.array([[1.0, 4.0, 2.0]])
    assert np.isnan(caster.cast(down, np.array([[0.0, 0.0, -1.0]]))[0][0])
    direction = np.array([[2.0, 0.0, -2.5]])
    t = caster.cast(through, direction)[0]
    brute.check(h, through, direction, t)
    assert np.isnan(t[0])
    up = np.array([[1.0, 4.0, -5.0]]), np.array([[2.0, 0.0, 6.0]])  # up through the hole, then into the wall's face
    t = caster.cast(*up)[0]
    brute.check(h, *up, t)
    assert np.isfinite(t[0]) and 3 < up[0][0, 0] + t[0] * 2 < 6.01


def test_surface_is_the_height_at_a_point() -> None:
    h = field(np.random.default_rng(9), 6, 9, "holes")
    caster = Caster.of(h, 1)
    rng = np.random.default_rng(2)
    for x, y in rng.random((60, 2)) * [8, 5]:
        expected = float(brute.height(h, np.array(x), np.array(y)))
        np.testing.assert_allclose(caster.surface(x, y), expected, atol=1e-6)
    assert np.isnan(caster.surface(-0.1, 2)) and np.isnan(caster.surface(3, 5.1))


def test_threads_do_not_change_anything() -> None:
    rng = np.random.default_rng(11)
    h = field(rng, 40, 50, "holes")
    o, d = rays(rng, h, "above", 40000)
    one, two = Caster.of(h, 1).cast(o, d), Caster.of(h, 2).cast(o, d)
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])
