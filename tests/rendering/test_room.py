"""Automatic cameras show all that stands: drawn with twice the field of view, nothing more appears."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rasterio.transform import from_origin

import orograph
from orograph.cli import cli
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.standing import Kind, Things
from orograph.geovis.keys import Legend
from orograph.rendering.standing import extent, extent_of, stand
from orograph.scene.camera import MARGIN
from orograph.scene.scene import Scene
from orograph.verbs.ways import WAY, tour_of
from orograph.viewer.session import Session

SIZE = (240, 160)


def ground() -> Any:
    row, col = np.mgrid[:60, :90]
    heights = 40 * np.sin(row / 9) * np.cos(col / 13)
    return orograph.terrain(heights, crs="EPSG:32632", transform=from_origin(500_000, 5_600_000, 10, 20))


def columns(terrain: Any, **more: list[float]) -> dict[str, Any]:
    """A table of places near the terrain's corners and in its middle."""
    x, y = terrain.grid.xy(np.array([2.0, 87, 87, 2, 45]), np.array([2.0, 2, 57, 57, 30]))
    return {"x": x, "y": y, "value": [1.0, 2, 3, 4, 5], **more}


def pictured(terrain: Any, kind: str) -> dict[str, Any]:
    """Options of pictures with things that reach high above the ground, or deep below it."""
    up = [900.0, 800, 950, 700, 1200]
    table = {
        "bars": Dataset(columns(terrain), variable="value", style="bars", size=700.0),
        "spheres": Dataset(columns(terrain, agl=up), variable="value", above="agl", size=200.0),
        "quakes": Dataset(columns(terrain, deep=up), variable="value", depth="deep", size=150.0),
        "logs": Dataset(columns(terrain, top=[0.0] * 5, low=up, name=list("abcde")), variable="value",
                        depth="top+low", group="name", style="logs", size=800.0),
        "curtain": Dataset({"type": "LineString", "coordinates": np.transpose(terrain.grid.xy(
            np.array([3.0, 80]), np.array([50.0, 5]))).tolist(), "crs": {"type": "name", "properties": {
                "name": "EPSG:32632"}}}, style="curtains", size=900.0),
    }  # fmt: skip
    return {"exaggeration": 2.0} | ({"aids": "walls"} if kind == "walls" else {"data": table[kind]})


def wider(view: Any) -> Any:
    """The same camera with a margin of half a picture on every side, in pixels of the same size."""
    fov = math.degrees(2 * math.atan(2 * math.tan(math.radians(view.fov_y) / 2)))
    return replace(view, fov_y=fov, width=2 * view.width, height=2 * view.height)


def outside(scene: Scene) -> int:
    """Pixels with things beyond the picture; −1: there are hardly any within it."""
    scene = scene.but(view=wider(scene.view), samples=1)
    blank = np.zeros((scene.view.height, scene.view.width, 3), np.uint8)
    assert scene.theme.things is not None
    seen = stand(scene.theme.things, blank, np.full(blank.shape[:2], np.nan), scene).which >= 0
    inner = np.zeros_like(seen)
    height, width = SIZE[1], SIZE[0]
    inner[height // 2 : height // 2 + height, width // 2 : width // 2 + width] = True
    return int((seen & ~inner).sum()) if (seen & inner).sum() > 20 else -1


@pytest.mark.parametrize("kind", ["bars", "spheres", "quakes", "logs", "curtain", "walls"])
def test_all_that_stands_is_in_the_picture(kind: str) -> None:
    terrain = ground()
    options = pictured(terrain, kind)
    picture = orograph.render(terrain, size=SIZE, samples=1, **options)
    scene = Scene.of(terrain, picture.view, **options)
    assert outside(scene) == 0
    bare = Scene.of(terrain, orograph.camera.whole(terrain, SIZE, exaggeration=2.0), **options)
    assert outside(bare) != 0  # (else this would prove nothing)
    points = extent_of(scene)
    assert points is not None
    pixels, _ = picture.view.project(points, 2.0)
    reach = np.abs(pixels / [SIZE[0] / 2, SIZE[1] / 2] - 1).max()
    assert reach == pytest.approx(MARGIN, abs=0.05)  # no farther away than needed


def test_cameras_that_are_given_and_pictures_without_things_stay() -> None:
    terrain = ground()
    view = orograph.camera.whole(terrain, SIZE)
    assert orograph.render(terrain, size=SIZE, samples=1).view == view
    assert orograph.render(terrain, view, samples=1, **(pictured(terrain, "bars") | {"exaggeration": 1.0})).view == view


def test_what_is_under_ground_and_not_seen_needs_no_room() -> None:
    terrain = ground()
    hidden = pictured(terrain, "quakes")["data"].but(hidden=0.0)
    scene = Scene.of(terrain, orograph.camera.whole(terrain, SIZE), data=hidden)
    assert scene.theme.things is not None
    assert len(extent(scene.theme.things, terrain, 1.0)) == 0 and extent_of(scene) is None


def test_of_many_things_neighbours_have_one_box() -> None:
    """It contains the boxes of all, and is not much larger."""
    terrain, rng = ground(), np.random.default_rng(4)
    count = 20_000
    x, y = terrain.grid.xy(rng.uniform(0, 89, count), rng.uniform(0, 59, count))
    one = np.ones(count)
    many = Things.plain(Legend()).but(
        kind=np.full(count, Kind.BAR, np.int8), x=x, y=y, lift=0 * one, radius=one, height=rng.uniform(0, 50, count),
        rgb=np.zeros((count, 3), np.float32), values=one,
    )  # fmt: skip
    boxes = extent(many, terrain, 1.0)
    assert len(boxes) < count
    few = [
        extent(many.but(**{name: getattr(many, name)[k : k + 4000] for name in
                           ("kind", "x", "y", "lift", "radius", "height", "rgb", "values")}), terrain, 1.0)
        for k in range(0, count, 4000)
    ]  # fmt: skip
    exact = np.concatenate(few)
    np.testing.assert_allclose(boxes.min(0), exact.min(0))
    np.testing.assert_allclose(boxes.max(0), exact.max(0))
    for way in rng.normal(size=(50, 3)):  # a box reaches no farther than a cell and a bar
        far = (exact @ way).max()
        assert far - 1e-6 <= (boxes @ way).max() <= far + np.abs(way) @ [900 / 48 + 3, 1200 / 48 + 3, 90]


@pytest.mark.parametrize("kind", ["orbit", "still"])
def test_tours_keep_in_view_what_stands(kind: str) -> None:
    terrain = ground()
    scene = Scene.of(terrain, orograph.camera.whole(terrain, SIZE), **pictured(terrain, "bars"))
    points = extent_of(scene)
    way = dict.fromkeys(WAY) | {kind: True}
    tour = tour_of(terrain, SIZE, way, (315.0, 45.0), 2.0, also=points)
    for time in np.linspace(0, tour.duration, 9):
        pixels, depth = tour.at(time).project(points, 2.0)
        assert (depth > 0).all() and (np.abs(pixels / [SIZE[0] / 2, SIZE[1] / 2] - 1) <= 1).all()


def test_the_window_begins_with_all_that_stands() -> None:
    terrain = ground()
    session = Session(terrain, size=SIZE, **pictured(terrain, "bars"))
    try:
        assert outside(session.scene()) == 0
        session.stretch(5.0)
        assert outside(session.scene()) == 0
    finally:
        session.close()


def test_pictures_drawn_by_the_command_line_leave_the_same_room(tmp_path: Any) -> None:
    terrain = ground()
    picture = orograph.render(terrain, size=SIZE, samples=1, aids="walls", exaggeration=2.0)
    path = tmp_path / "dem.tif"
    orograph.export(terrain, path)
    out = CliRunner().invoke(
        cli, ["render", str(path), "-o", str(tmp_path / "a.png"), "--size", "240x160", "--aids", "walls",
               "--exaggeration", "2", "--samples", "1", "--json"],
    )  # fmt: skip
    assert out.exit_code == 0, out.output
    told = json.loads(out.stdout.splitlines()[-1])
    assert told["view"]["eye"] == pytest.approx(picture.view.eye)
