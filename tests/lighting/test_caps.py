"""Overlaps of caps against quadrature, and the limits between which Oat & Sander interpolate."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.lighting.caps import cap_area, exact_overlap, smooth_overlap


def quadrature(distance: float, a: float, b: float) -> float:
    """Ring by ring of the second cap: the part of each ring that lies in the first is an arc of elementary length."""
    r = (np.arange(20000) + 0.5) * (b / 20000)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (math.cos(a) - np.cos(r) * math.cos(distance)) / (np.sin(r) * math.sin(distance))
    arc = 2 * np.arccos(np.clip(x, -1, 1))
    return float((arc * np.sin(r)).sum() * b / 20000)


@settings(max_examples=150, deadline=None)
@given(st.floats(0.01, 3.1), st.floats(0.004, math.pi / 2), st.floats(0.004, math.pi / 2))
def test_the_closed_form(distance, a, b):
    got = exact_overlap(distance, a, b)
    assert got == pytest.approx(quadrature(distance, a, b), abs=2e-3 * cap_area(min(a, b)) + 1e-9)
    assert got == pytest.approx(exact_overlap(distance, b, a), abs=1e-9)
    assert 0 <= got <= cap_area(min(a, b)) * (1 + 1e-12)


@settings(max_examples=150, deadline=None)
@given(st.floats(0.0, 3.14), st.floats(0.0, math.pi / 2), st.floats(0.0, math.pi / 2))
def test_the_smoothstep_has_the_same_ends(distance, a, b):
    small, exact, smooth = cap_area(min(a, b)), exact_overlap(distance, a, b), smooth_overlap(distance, a, b)
    if distance <= abs(a - b) or distance >= a + b:
        assert smooth == pytest.approx(exact, abs=1e-9 + 1e-9 * small)
    assert 0 <= smooth <= small * (1 + 1e-12)


def test_how_far_the_smoothstep_is_from_the_lens():
    """Of the smaller cap: 0.04 for a sun's disc at any aperture's rim, more for discs as wide as apertures."""
    worst = {}
    for disc in (0.265, 5.0, 15.0, 40.0):
        b = math.radians(disc)
        worst[disc] = max(
            abs(smooth_overlap(d, a, b) - exact_overlap(d, a, b)) / cap_area(min(a, b))
            for a in np.radians([20.0, 45.0, 60.0, 80.0, 90.0])
            for d in np.linspace(abs(a - b), a + b, 101)
        )
    assert worst[0.265] < 0.041 and worst[5.0] < 0.06 and worst[15.0] < 0.12 and worst[40.0] < 0.13
    assert worst[40.0] > 0.1


def test_areas():
    assert cap_area(math.pi / 2) == pytest.approx(2 * math.pi)
    assert cap_area(0.0) == 0
    assert exact_overlap(math.pi / 2, math.pi / 2, 0.1) == pytest.approx(cap_area(0.1) / 2)
    assert exact_overlap(0.3, 0.0, 0.5) == 0 == smooth_overlap(0.3, 0.0, 0.5)
