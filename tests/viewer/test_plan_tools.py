"""Footprints of cameras in closed form; what measuring says and saves."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio

from orograph import measuring
from orograph.measuring.text import lines
from orograph.store.prepare import prepare
from orograph.viewpoint import View

pytest.importorskip("imgui_bundle")

from orograph.viewer.plan import AROUND, centred, footprint
from orograph.viewer.results import KINDS, paint, rows, save_rgba


@pytest.fixture(scope="module")
def terrain(dem):
    return prepare([str(dem)])


@pytest.mark.parametrize("exaggeration", [1.0, 2.5])
def test_a_footprint_is_what_the_picture_shows(exaggeration):
    view = View((1000.0, 2000.0, 900.0), (1500.0, 3500.0, 100.0), width=400, height=300)
    outline = footprint(view, exaggeration, 1e6)
    assert outline.shape == (4 * AROUND, 2)
    pixels, _ = view.project(np.column_stack([outline, np.full(len(outline), 100.0)]), exaggeration)
    assert pixels[0] == pytest.approx((0, 0), abs=1e-6)
    assert pixels[AROUND] == pytest.approx((400, 0), abs=1e-6)
    assert pixels[2 * AROUND] == pytest.approx((400, 300), abs=1e-6)
    x, y = pixels.T
    assert (np.minimum(np.minimum(x, 400 - x), np.minimum(y, 300 - y)) < 1e-6).all()


def test_a_footprint_ends_where_the_sky_begins():
    view = View((0.0, 0.0, 100.0), (0.0, 1000.0, 90.0), width=400, height=300)
    outline = footprint(view, 1.0, 5000.0)
    assert np.linalg.norm(outline, axis=1).max() == pytest.approx(5000.0)
    up = View((0.0, 0.0, 100.0), (0.0, 1.0, 1100.0), width=400, height=300)
    assert footprint(up, 1.0, 5000.0) is None or np.isfinite(footprint(up, 1.0, 5000.0)).all()


def test_moving_sideways():
    view = View((0.0, 0.0, 100.0), (0.0, 50.0, 0.0))
    moved = centred(view, (300.0, 450.0, 0.0), (0.0, 50.0, 0.0))
    assert moved.eye == (300.0, 400.0, 100.0)
    assert moved.target == (300.0, 450.0, 0.0)


def test_every_measurement_is_said(terrain):
    x, y = (float(v) for v in terrain.grid.xy(100.0, 150.0))
    a, b, c = (x, y), (x + 900.0, y), (x, y - 900.0)
    said = dict(rows("profile", measuring.profile(terrain, [a, b])))
    assert said["climb, descent"] == "+0.00 m, −0.00 m"
    assert said["horizontal"].endswith("m")
    assert dict(rows("pick", measuring.place(terrain, a)))["height"] == "500.000 m"
    assert "surface" in dict(rows("area", measuring.area(terrain, [a, b, c])))
    assert dict(rows("los", measuring.line_of_sight(terrain, a, b)))["visible"] == "yes"
    shed = measuring.viewshed(terrain, a, radius=500.0)
    values = shed.values()
    assert dict(rows("viewshed", (shed, values, None)))["seen"].startswith("100.0%")


def test_the_window_calls_its_tools_and_what_they_tell_as_the_command_line_does(terrain):
    from orograph.cli import measure

    assert tuple(measure.command.commands)[: len(KINDS)] == KINDS  # (what is probable takes long: no tool is)
    x, y = (float(v) for v in terrain.grid.xy(100.0, 150.0))
    a, b, c = (x, y), (x + 900.0, y), (x, y - 900.0)
    found = {
        "pick": measuring.place(terrain, a), "profile": measuring.profile(terrain, [a, b]),
        "area": measuring.area(terrain, [a, b, c]), "los": measuring.line_of_sight(terrain, a, b),
    }  # fmt: skip
    for kind, result in found.items():
        told = {name: value for name, value, _ in lines(result)}
        assert dict(rows(kind, result)) == told, kind


def test_a_painted_viewshed_lies_where_it_was_seen(tmp_path, terrain):
    values = np.array([[1.0, 0.0], [np.nan, 1.0]], np.float32)
    pixels = paint(values)
    assert (pixels[..., 3] > 0).tolist() == [[True, True], [False, True]]
    assert not np.array_equal(pixels[0, 0], pixels[0, 1])
    grid = terrain.grid.window(0, 2, 0, 2)
    save_rgba(tmp_path / "v.tif", pixels, grid)
    with rasterio.open(tmp_path / "v.tif") as file:
        assert file.crs.to_epsg() == 32633
        assert tuple(file.transform)[:6] == pytest.approx(tuple(grid.transform)[:6])
        assert np.array_equal(file.read().transpose(1, 2, 0), pixels)
        assert file.colorinterp[3].name == "alpha"
    assert math.isfinite(grid.bounds()[0])
