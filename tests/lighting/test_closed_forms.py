"""The middle of shapes whose horizon is known in every azimuth: each product of it is a formula.

With the horizon φ the same all around, level ground sees cos² φ of the sky's light (and so does ambient occlusion),
1 − sin φ of its solid angle, is open by 90° − φ, and its aperture is the cap of that radius. Before an endless wall of
height H at distance d, tan φ = H cos a / d in the half of azimuths a that face it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from orograph.lighting.arrays import context_of
from orograph.lighting.context import Options
from orograph.lighting.products import compute

MIDDLE, SIDE = 60, 121
CELLS = {"square": np.diag([10.0, -10.0]), "rectangular": np.diag([10.0, -6.0]), "south-up": np.diag([10.0, 10.0])}


def away(cells):
    """Metres east and north of the middle sample."""
    row, col = np.mgrid[:SIDE, :SIDE] - MIDDLE
    return cells[0, 0] * col, cells[1, 1] * row


def cone(cells, slope):
    """A cone whose tip is round: the finest triangles would make a pyramid of a sharp one."""
    r = np.hypot(*away(cells))
    return slope * np.minimum(r, r * r / 100.0)


def hemisphere(cells, radius):
    """A pit of that radius in level ground: 45° from its bottom to its rim."""
    return radius - np.sqrt(np.maximum(radius**2 - np.hypot(*away(cells)) ** 2, 0))


def wall(cells, distance, height):
    return np.where(away(cells)[0] >= distance, height, 0.0)


def middle(heights, cells, name, azimuths=64, **more):
    options = Options(azimuths=azimuths, more=more)
    return compute(context_of(heights.astype(np.float32), cells, options), name)[:, MIDDLE, MIDDLE]


@pytest.mark.parametrize("cells", CELLS.values(), ids=CELLS)
@pytest.mark.parametrize(("shape", "horizon"), [("cone", 20.0), ("cone", 50.0), ("hemisphere", 45.0)])
def test_the_bottom_of_cones_and_of_a_hemispherical_pit(shape, horizon, cells):
    phi = math.radians(horizon)
    heights = cone(cells, math.tan(phi)) if shape == "cone" else hemisphere(cells, 300.0)
    # Between samples a cone is cut straight across; of a pit's rim up to one sample is missed.
    degrees, part = (0.35, 0.006) if shape == "cone" else (0.9, 0.016)
    around = middle(heights, cells, "horizon")
    assert around.mean() == pytest.approx(horizon, abs=degrees) and np.abs(around - horizon).mean() < 0.7
    if shape == "cone":
        assert around[::16] == pytest.approx(horizon, abs=0.001)  # along rows and columns
    assert middle(heights, cells, "openness")[0] == pytest.approx(90 - horizon, abs=degrees)
    for name in ("sky-view-factor", "sky-view-horizontal", "ambient-occlusion"):
        assert middle(heights, cells, name)[0] == pytest.approx(math.cos(phi) ** 2, abs=part), name
    assert middle(heights, cells, "visible-sky")[0] == pytest.approx(1 - math.sin(phi), abs=part)
    east, north, up, radius = middle(heights, cells, "aperture")
    assert (east, north, up) == pytest.approx((0, 0, 1), abs=0.01) and radius == pytest.approx(
        90 - horizon, abs=degrees
    )
    assert middle(-heights, cells, "openness-negative")[0] == pytest.approx(90 - horizon, abs=degrees)


def test_before_an_endless_wall():
    """A step seen from its foot, of which the raster holds as much as matters."""
    cells, distance, height = CELLS["square"], 50.0, 40.0
    heights = wall(cells, distance, height)
    phi = math.atan2(height, distance)
    found = middle(heights, cells, "horizon", 8)
    assert found[2] == pytest.approx(math.degrees(phi), abs=0.01)  # east
    assert found[1] == found[3] == pytest.approx(math.degrees(math.atan(height * math.sqrt(0.5) / distance)), abs=0.01)
    assert found[4:].max() == found[0] == 0
    for name in ("sky-view-factor", "ambient-occlusion"):
        assert middle(heights, cells, name, 128)[0] == pytest.approx((1 + math.cos(phi)) / 2, abs=0.002), name
    a = np.radians(np.arange(-89.95, 90, 0.1))
    seen = np.arctan(math.tan(phi) * np.cos(a))
    assert middle(heights, cells, "visible-sky", 128)[0] == pytest.approx(1 - np.sin(seen).mean() / 2, abs=0.004)
    assert middle(heights, cells, "openness", 128)[0] == pytest.approx(90 - np.degrees(seen).mean() / 2, abs=0.25)
    lean = middle(heights, cells, "aperture", 128)
    assert lean[0] < -0.1 and lean[1] == pytest.approx(0, abs=1e-3)  # away from the wall, nowhere else


def test_a_wall_shades_as_far_as_it_is_high_over_the_suns_tangent():
    cells, height = CELLS["square"], 40.0
    heights = np.where(np.abs(away(cells)[0]) < 5, height, 0.0)
    for altitude in (15.0, 30.0, 60.0):
        options = Options(sun=(90.0, altitude), more={"diameter": 0.0})
        code = compute(context_of(heights.astype(np.float32), cells, options), "shadow")[1, MIDDLE]
        shaded = np.flatnonzero(code[:MIDDLE] >= 3)  # by the wall, or the last one as its foot
        assert len(shaded) == math.floor(height / math.tan(math.radians(altitude)) / 10)
        assert (np.diff(shaded) == 1).all() and shaded[-1] == MIDDLE - 1
