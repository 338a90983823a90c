"""Boreholes and what lies below the ground: where their parts are, by closed forms, and what is seen of them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.points import Points, read_points
from orograph.geovis.data.standing import Kind
from orograph.geovis.data.standing_columns import parts_of
from orograph.scene.theming import themed

UTM = "EPSG:32630"


def slope(rows: int = 40, cols: int = 50):
    """Ground 100 m high at its north-west corner, 2 m higher each column and 1 m each row; cells of 20 by 10 m."""
    heights = 100 + np.add.outer(np.arange(rows), 2 * np.arange(cols)).astype(np.float32)
    return orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, 20, 10), crs=UTM)


def flat():
    return orograph.terrain(np.zeros((60, 80), np.float32), transform=from_origin(500_000, 5_600_000, 10, 10), crs=UTM)


def things(data, ground=None, **options):
    found = themed({"data": data, **options}, ground or slope(), (300, 200)).things
    assert found is not None
    return found


def points(level, hole=None):
    n = len(level)
    return Points(np.zeros(n), np.zeros(n), np.arange(float(n)), None, "v", level=np.array(level, float),
                  group=None if hole is None else np.array(hole))  # fmt: skip


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 500), min_size=2, max_size=9, unique=True))
def test_samples_reach_halfway_to_their_neighbours(depths):
    parts = parts_of(points(depths))
    ordered = sorted(depths)
    edges = [(a + b) / 2 for a, b in pairwise(ordered)]
    edges = [2 * ordered[0] - edges[0], *edges, 2 * ordered[-1] - edges[-1]]
    assert sorted(zip(parts.start[:, 2], parts.end[:, 2])) == sorted(pairwise(edges))
    for begin, end, of in zip(parts.start[:, 2], parts.end[:, 2], parts.of):
        assert begin <= depths[of] <= end


def test_holes_are_told_by_their_name_and_those_of_one_sample_are_left_out():
    parts = parts_of(points([0, 10, 0, 4, 7], [0, 0, 1, 1, 2]))
    assert parts.alone == 1
    found = sorted(zip(parts.hole, parts.start[:, 2], parts.end[:, 2]))
    assert found == [(0, -5, 5), (0, 5, 15), (1, -2, 2), (1, 2, 6)]


def borehole(x, y, **more):
    return {"x": [x] * 3, "y": [y] * 3, "from": [0, 5, 20], "to": [5, 20, 45], **more}


def test_columns_are_in_the_ground_and_pass_their_values_on(tmp_path):
    ground = slope()
    x, y = ground.grid.xy(10.0, 6.0)  # 126 m
    made = Dataset(borehole(x, y, grain=[1.0, 2.0, 3.0]), variable="grain", depth="from+to", style="columns", size=8)
    found = things(made, ground)
    assert set(found.kind) == {Kind.COLUMN} and set(found.radius) == {4.0}
    np.testing.assert_allclose(found.ends[:, 0], [121, 106, 81])
    np.testing.assert_allclose(found.ends[:, 3], [126, 121, 106])
    assert found.values.tolist() == [1, 2, 3] and set(found.hidden) == {0.65}
    assert "1 hole" in found.legend.note
    # Texts of a table are classes; depths in other units; what is not upright is made of tubes.
    file = tmp_path / "holes.csv"
    file.write_text(f"x,y,id,km,rock\n{x},{y},a,0,clay\n{x + 30},{y},a,0.02,sand\n{x + 60},{y},a,0.04,clay\n")
    leaning = things(Dataset(str(file), variable="rock", depth="km:km", group="id", style="columns"), ground)
    assert [name for name, _ in leaning.legend.classes] == ["clay", "sand"]
    assert set(leaning.kind) == {Kind.TUBE} and leaning.values.tolist() == [0, 1, 0]
    np.testing.assert_allclose(leaning.x + leaning.ends[:, 1], [2 * x, 2 * x + 60, 2 * x + 120])
    # Nothing is above the ground that has a depth.
    assert leaning.ends[:, 3].max() <= 126 + 1e-6


def test_logs_stand_on_the_ground_with_one_scale_of_depth():
    ground = slope()
    x, y = ground.grid.xy(np.array([10.0, 30.0]), np.array([6.0, 20.0]))
    first, second = borehole(x[0], y[0]), borehole(x[1], y[1])
    table = {k: [*first[k], *second[k][:2]] for k in first} | {"v": [1, 2, 3, 4, 5]}
    found = things(Dataset(table, variable="v", depth="from+to", style="logs", size=90), ground)
    np.testing.assert_allclose(found.height, [10, 30, 50, 10, 30])
    np.testing.assert_allclose(found.lift, [80, 50, 0, 30, 0])
    assert set(found.kind) == {Kind.CYLINDER} and found.ends is None
    assert "deepest 45 m" in found.legend.note


def test_ascents_are_over_the_ground():
    ground = slope()
    x, y = ground.grid.xy(10.0, 6.0)
    table = {"x": [x] * 3, "y": [y] * 3, "z": [200, 400, 600], "t": [9.0, 8.0, 7.0]}
    found = things(Dataset(table, variable="t", above="z", style="columns"), ground)
    np.testing.assert_allclose(sorted(found.ends[:, 0]), [226, 426, 626])
    flat = things(Dataset(table, variable="t", height="z", style="columns"), ground)
    np.testing.assert_allclose(sorted(flat.ends[:, 3]), [300, 500, 700])
    assert set(flat.hidden) == {0.0}


@pytest.mark.parametrize("hidden", [0.0, 0.5, 1.0])
def test_what_is_below_the_ground_is_seen_through_it_with_its_opacity(hidden):
    ground = flat()
    x, y = ground.grid.xy(40.0, 30.0)
    options = {"view": orograph.camera.plan(ground, (200, 150)), "sun": "0,90", "water": "none", "samples": 4}
    bare = orograph.render(ground, **options)
    quake = Dataset({"x": [x], "y": [y], "z": [0.3], "m": [2.0]}, variable="m", depth="z:km", size=160, range=(0, 2),
                    hidden=hidden, colormap="gray")  # fmt: skip
    shown = orograph.render(ground, data=quake, **options)
    (u, v), _ = shown.view.project(np.array([x, y, 0.0]), 1.0)
    at = int(v), int(u)
    under = srgb_to_linear(bare.pixels[at] / 255)
    # White, under light from straight above.
    expected = linear_to_srgb(under * (1 - hidden) + hidden) * 255
    np.testing.assert_allclose(shown.pixels[at], expected, atol=2)
    assert (shown.pixels[2, 2] == bare.pixels[2, 2]).all()
    if hidden:
        assert "seen through the ground" in shown.describe()


def test_what_is_below_and_in_front_of_it_is_drawn_once():
    """A sphere half in the ground: the half above is opaque."""
    ground = flat()
    x, y = ground.grid.xy(40.0, 30.0)
    made = Dataset({"x": [x], "y": [y], "z": [0.0], "m": [2.0]}, variable="m", depth="z", size=160, range=(0, 2))
    solid = made.but(depth=None, height="z", hidden=0.0)
    a, b = (
        orograph.render(ground, orograph.camera.plan(ground, (200, 150)), data=one, sun="0,90", water="none")
        for one in (made, solid)
    )
    np.testing.assert_array_equal(a.pixels, b.pixels)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"depth": None}, "Nothing gives the depth"),
        ({"depth": "to"}, "has no length"),
        ({"depth": "from+nowhere"}, "no attribute 'nowhere'"),
        ({"depth": "from+to+grain"}, "two ends"),
        ({"depth": "from:mi"}, "not a unit"),
        ({"depth": None, "height": "to", "style": "logs"}, "has no length"),
        ({"group": "name"}, "no attribute 'name'"),
        ({"height": "to"}, "Give one of them|all say"),
        ({"uncertainty": "grain", "style": "bars"}, "stand on the ground"),
    ],
)
def test_what_makes_no_hole_is_refused(change, words):
    ground = slope()
    x, y = ground.grid.xy(np.array([10.0, 12.0, 14.0]), np.array([6.0, 7.0, 8.0]))
    table = {"x": x, "y": y, "from": [0, 5, 20], "to": [5, 20, 45], "grain": [1.0, 2.0, 3.0]}
    with pytest.raises((UsageError, ReadError), match=words):
        things(Dataset(table, variable="grain", depth="from+to", style="columns").but(**change), ground)


def test_points_of_intervals_are_at_their_middles_and_lines_have_no_columns():
    ground = slope()
    x, y = ground.grid.xy(10.0, 6.0)
    found = things(Dataset(borehole(x, y, v=[1, 2, 3]), variable="v", depth="from+to"), ground)
    np.testing.assert_allclose(sorted(found.ends[:, 0]), [126 - 32.5, 126 - 12.5, 126 - 2.5])
    line = {"type": "LineString", "coordinates": [[-3.0, 50.5], [-2.99, 50.55]]}
    with pytest.raises((UsageError, ReadError)):
        things(Dataset(line, style="columns"), ground)


def test_rows_without_a_depth_are_left_out():
    grid = slope().grid
    x, y = grid.xy(10.0, 6.0)
    table = borehole(x, y, v=[1, 2, 3]) | {"to": [5, None, 45]}
    found = read_points(Dataset(table, variable="v", depth="from+to"), grid)
    assert found.values.tolist() == [1, 3]
