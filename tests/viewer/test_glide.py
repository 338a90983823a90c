"""Flights between views: the metric of van Wijk & Nuij, numerically, and what a camera must do on its way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orograph.viewer.glide import RHO, Glide, Path
from orograph.viewer.navigation import Limits, heading_pitch
from orograph.viewpoint import View

SIZES = st.floats(1.0, 1e5)


@given(st.floats(0.0, 1e6), SIZES, SIZES)
def test_paths_join_their_ends(distance, start, end):
    path = Path(distance, start, end)
    assert path(0.0) == pytest.approx((0.0, start), rel=1e-6, abs=1e-6 * (start + distance))
    assert path(path.length) == pytest.approx((distance, end), rel=1e-6, abs=1e-6 * (start + distance))


@pytest.mark.parametrize(("distance", "start", "end"), [(1000, 50, 80), (1e5, 100, 100), (3.0, 1000, 10), (0, 10, 900)])
def test_paths_have_unit_speed_in_the_metric(distance, start, end):
    """ds² = ρ²/w² du² + 1/(ρ² w²) dw², by differences."""
    path = Path(distance, start, end)
    s = np.linspace(0, path.length, 20_001)
    u, w = np.array([path(v) for v in s]).T
    middle = 0.5 * (w[1:] + w[:-1])
    speed = np.sqrt((RHO * np.diff(u) / middle) ** 2 + (np.diff(w) / (RHO * middle)) ** 2) / np.diff(s)
    assert np.allclose(speed, 1.0, rtol=1e-4)


def test_paths_are_the_shortest():
    """Against a hundred paths beside it, which join the same ends."""
    path = Path(2000.0, 100.0, 300.0)
    s = np.linspace(0, path.length, 2001)
    u, w = np.array([path(v) for v in s]).T

    def length(u, w):
        middle = 0.5 * (w[1:] + w[:-1])
        return np.sqrt((RHO * np.diff(u) / middle) ** 2 + (np.diff(w) / (RHO * middle)) ** 2).sum()

    rng = np.random.default_rng(1)
    shape = np.sin(np.outer([1, 2, 3], np.pi * np.linspace(0, 1, len(s))))
    for _ in range(100):
        a, b = rng.normal(size=(2, 3))
        assert length(u + 20 * a @ shape, w * np.exp(0.05 * b @ shape)) > length(u, w)


A = View((0.0, -2000.0, 1500.0), (0.0, 0.0, 0.0), fov_y=30.0)
B = View((9000.0, 9500.0, 900.0), (9400.0, 9400.0, 700.0), fov_y=60.0)


def test_a_glide_begins_and_ends_and_is_smooth():
    glide = Glide(A, B)
    assert glide.at(0.0).eye == pytest.approx(A.eye)
    assert glide.at(glide.seconds) is B
    assert glide.at(glide.seconds - 1e-6).eye == pytest.approx(B.eye, abs=1e-3)
    steps = np.linspace(0, glide.seconds, 2001)
    eyes = np.array([glide.at(t).eye for t in steps])
    jumps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    assert jumps.max() < 0.005 * jumps.sum()
    assert eyes[:, 2].max() > 2500  # a long way goes up first
    turns = np.unwrap(np.radians([heading_pitch(glide.at(t))[0] for t in steps]))
    assert abs(turns[-1] - turns[0]) <= math.pi + 1e-6  # the shorter way round
    assert np.abs(np.diff(turns)).max() < 0.02


def test_a_glide_keeps_above_the_ground():
    wall = Limits(lambda x, y: 5000.0 if 4000 < x < 5000 else 0.0)
    glide = Glide(A, B, wall)
    for t in np.linspace(0, glide.seconds, 500):
        x, y, z = glide.at(t).eye
        assert z >= wall.ground(x, y) + 2.0 - 1e-6


@pytest.mark.parametrize("exaggeration", [0.5, 4.0])
def test_a_glide_in_stretched_space(exaggeration):
    glide = Glide(A, B, exaggeration=exaggeration)
    assert glide.at(0.0).eye == pytest.approx(A.eye)
    assert glide.at(glide.seconds * (1 - 1e-9)).eye == pytest.approx(B.eye, abs=1e-3)


def test_to_where_one_is():
    glide = Glide(A, replace(A, fov_y=40.0))
    assert glide.at(0.1).eye == pytest.approx(A.eye)
    assert 30 < glide.at(0.12).fov_y < 40
