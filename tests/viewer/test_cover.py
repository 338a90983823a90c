"""Whether layers hide the colours of heights: extents of images over a terrain whose ground is known."""

from __future__ import annotations

from concurrent.futures import Future

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.geovis.layers import Layer
from orograph.store.prepare import prepare
from orograph.viewer.cover import Cover
from orograph.viewer.session import Session

from .conftest import CELL, EAST, NORTH, SIDE

WHOLE = SIDE * CELL


@pytest.fixture
def session(dem, monkeypatch):
    session = Session(prepare([str(dem)]), size=(200, 150))

    def at_once(work):
        work()
        return Future()

    monkeypatch.setattr(session.probe, "submit", at_once)
    yield session
    session.close()


def image(folder, name, west, north, width, height) -> Layer:
    """An image of so many metres, its upper left corner so far east and south of the terrain's."""
    path = folder / f"{name}.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=10, height=10, count=3, dtype="uint8", crs="EPSG:32633",
        transform=Affine(width / 10, 0, EAST + west, 0, -height / 10, NORTH - north),
    ) as file:  # fmt: skip
        file.write(np.full((3, 10, 10), 90, np.uint8))
    return Layer(str(path))


def test_a_small_layer_leaves_the_colors_in_sight_and_a_whole_one_hides_them(session, tmp_path):
    cover = Cover(session)
    assert not cover.hides()
    small = image(tmp_path, "small", 1000.0, 1000.0, 2000.0, 2000.0)
    whole = image(tmp_path, "whole", -CELL, -CELL, WHOLE + 2 * CELL, WHOLE + 2 * CELL)
    for layers, hidden in (
        ([small], False), ([whole], True), ([small, whole], True),
        ([Layer(whole.path, opacity=0.3)], False), ([Layer(whole.path, blend="multiply")], False),
        ([Layer(whole.path, visible=False)], False),
    ):  # fmt: skip
        session.settings.layers = layers
        cover.hides()  # asks for what is not known
        assert cover.hides() == hidden


def test_layers_that_hide_it_together(session, tmp_path):
    cover = Cover(session)
    west = image(tmp_path, "west", -CELL, -CELL, WHOLE / 2 + 2 * CELL, WHOLE + 2 * CELL)
    east = image(tmp_path, "east", WHOLE / 2, -CELL, WHOLE / 2 + 2 * CELL, WHOLE + 2 * CELL)
    session.settings.layers = [west]
    cover.hides()
    assert not cover.hides()
    session.settings.layers = [west, east]
    cover.hides()
    assert cover.hides()


def test_what_cannot_be_read_hides_nothing(session, tmp_path):
    session.settings.layers = [Layer(str(tmp_path / "gone.tif"))]
    cover = Cover(session)
    cover.hides()
    assert not cover.hides()
