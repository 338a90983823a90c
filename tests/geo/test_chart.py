"""The affine chart against plain vector arithmetic in the world."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.geo.chart import AffineChart
from orograph.geo.grid import Grid
from orograph.viewpoint import Camera, View

PLACES = [Affine(30, 0, 5e5, 0, -30, 4e6), Affine(20, 0, 0, 0, 25, 100), Affine(8, 3, 10, 2, -9, 20)]
"""North up, south up with rectangular cells, turned and sheared."""
NUMBERS = st.floats(-1e4, 1e4)


@pytest.fixture(params=PLACES, ids=["north up", "south up", "sheared"])
def chart(request: pytest.FixtureRequest) -> AffineChart:
    return AffineChart(Grid((40, 50), request.param))


def test_the_frame_is_the_derivative_of_the_way_to_the_world(chart: AffineChart) -> None:
    here = np.array([3.0, 4.0, 5.0])
    for i in range(3):
        step = chart.to_world(here + np.eye(3)[i]) - chart.to_world(here)
        assert chart.frame(here)[:, i] == pytest.approx(step, rel=1e-9, abs=1e-9)
    assert chart.frame(here)[:2, :2].tolist() == chart.linear.tolist()


def test_vectors_of_the_world_become_differences_of_samples(chart: AffineChart) -> None:
    a, b = np.array([[1.0, 2.0, 3.0], [40.0, 7.0, -9.0]])
    assert chart.vectors_from_world(chart.to_world(b) - chart.to_world(a)) == pytest.approx(b - a, rel=1e-9)


@given(plane=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), place=st.tuples(NUMBERS, NUMBERS, NUMBERS))
@pytest.mark.parametrize("transform", PLACES)
def test_a_plane_has_the_same_side_in_samples(transform: Affine, plane: tuple[float, ...], place: tuple[float, ...]):
    chart = AffineChart(Grid((40, 50), transform))
    x, y, z = chart.to_world(place)
    world = np.array([x, y, 2.5 * z, 1.0]) * plane
    samples = np.array([*place, 1.0]) * chart.planes([plane], 2.5)[0]
    assert samples.sum() == pytest.approx(world.sum(), rel=1e-9, abs=1e-9 * np.abs(world).sum() + 1e-9)


def test_no_step_between_samples_is_shorter_than_the_least(chart: AffineChart) -> None:
    across, down = chart.least_steps
    rng = np.random.default_rng(1)
    for col, row in rng.normal(size=(200, 2)):
        metres = np.hypot(*(chart.linear @ (col, row)))
        assert metres >= np.hypot(col * across, row * down) * (1 - 1e-12)


def test_a_curved_chart_is_refused_by_what_draws_flat_terrain() -> None:
    class Curved:
        to_world = from_world = frame = None

    view = View((0.0, 0.0, 9.0), (5.0, 5.0, 0.0))
    with pytest.raises(UsageError, match="flat terrain only"):
        _ = Camera(view, Curved()).affine  # type: ignore[arg-type]
