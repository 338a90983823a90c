"""A store that is replaced while it is looked at: the window opens the new one, and goes on."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
from affine import Affine

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from hand import Hand
from rendercanvas.offscreen import RenderCanvas

from conftest import CELL, EAST, NORTH, heights
from orograph import store
from orograph.dem import Dem
from orograph.geo import Grid
from orograph.viewer import replacing
from orograph.viewer.app import renderer_of
from orograph.viewer.bookmarks import Bookmarks
from orograph.viewer.replacing import moved
from orograph.viewer.session import Session
from orograph.viewer.window import Window

HERE = Affine(CELL, 0, EAST - CELL / 2, 0, -CELL, NORTH + CELL / 2)


def dem(z: np.ndarray, transform: Affine = HERE, crs: str = "EPSG:32633") -> Dem:
    return Dem(z.astype(np.float32), Grid(z.shape, transform, pyproj.CRS(crs)), name="plain")


def build(path: Path, what: Dem) -> None:
    store.build(what, path, overwrite=True, shard=64, chunk=32).close()


@pytest.fixture
def looked_at(device: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Path, Window, Hand]]:
    """A store, and a window on it that rests."""
    monkeypatch.setattr("orograph.viewer.session.SHOWN", 600.0)
    monkeypatch.setattr(replacing, "EVERY", 0.05)
    path = tmp_path / "plain.oro"
    build(path, dem(heights()))
    session = Session(store.open(path), size=(640, 480), tolerance=4.0)
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20), device=device)
    hand = Hand(window)
    hand.rest()
    yield path, window, hand
    window.canvas.close()
    window.gui.close()


def said(window: Window) -> str:
    return " ".join(m.text for m in window.session.messages.shown)


def taken(window: Window, hand: Hand, before: Any) -> None:
    hand.until(lambda: window.session.terrain is not before)
    hand.rest()
    assert "The store was replaced, and the new one was opened" in said(window)
    assert not [m.text for m in window.session.messages.shown if m.error]
    assert hand.frames(2)[:, : int(window.area[2])].std() > 10


@pytest.mark.stress
def test_the_window_goes_on_with_the_new_store(looked_at):
    """Nothing is touched meanwhile; camera, settings, kept views, tour and what is measured stay."""
    path, window, hand = looked_at
    session = window.session
    hand.key("o")
    hand.rest()
    session.keep_view("4")
    session.stretch(1.5)
    session.settings.sun.azimuth = 90.0
    window.touring.add()
    window.tools.toggle()
    window.tools.choose("pick")
    window.tools.points = [(EAST + 3000.0, NORTH - 5000.0, 500.0)]
    window.tools.measure()
    hand.until(lambda: window.tools.result is not None)
    assert window.tools.result.height == pytest.approx(500.0, abs=0.1)
    hand.rest()
    view, old = session.view, session.terrain
    build(path, dem(heights() + 40.0))
    taken(window, hand, old)
    assert session.view == view and session.settings.exaggeration == 1.5 and session.settings.sun.azimuth == 90.0
    assert session.bookmarks.get("4") is not None and len(window.touring.stops) == 1
    hand.until(lambda: window.tools.result is not None)
    assert window.tools.result.height == pytest.approx(540.0, abs=0.1)
    assert session.terrain.height_range[0] == pytest.approx(540.0)
    hand.until(lambda: window.plan.view is not None and not window.plan.busy)
    build(path, dem(heights()))  # and once more
    taken(window, hand, session.terrain)
    assert session.terrain.height_range[0] == pytest.approx(500.0)


@pytest.mark.stress
def test_the_new_store_may_lie_elsewhere(looked_at):
    path, window, hand = looked_at
    session = window.session
    hand.key("o")
    hand.rest()
    session.keep_view("4")
    old = session.terrain
    z = np.add.outer(np.arange(90.0), 3 * np.arange(140.0))
    build(path, dem(z, Affine(10, 0, 600_000, 0, -12, 5_200_000), "EPSG:25832"))
    taken(window, hand, old)
    assert session.terrain.grid.shape == (90, 140)
    assert session.view == session.nav.home and "camera" in said(window)
    assert session.bookmarks.get("4") is None
    assert 600_000 < session.view.target[0] < 601_400
    assert session.settings.sun.place[0] == pytest.approx(10.3, abs=0.1)
    hand.move(300, 300)
    hand.until(lambda: session.probe.hit is not None)
    assert 0 <= session.probe.hit.height <= 506


@pytest.mark.stress
def test_the_same_place_in_another_crs(looked_at):
    path, window, hand = looked_at
    session = window.session
    hand.key("t")
    hand.rest()
    view, old = session.view, session.terrain
    to = pyproj.Transformer.from_crs("EPSG:32633", "EPSG:32632", always_xy=True).transform
    east, north = to(EAST, NORTH - 128 * CELL)
    build(path, dem(heights(), Affine(CELL, 0, east, 0, -CELL, north + 128 * CELL), "EPSG:32632"))
    taken(window, hand, old)
    assert session.view.target[:2] == pytest.approx(to(*view.target[:2]), abs=0.1)
    assert session.view != session.nav.home


@pytest.mark.stress
def test_what_cannot_be_opened_is_said_and_the_last_picture_stays(looked_at):
    path, window, hand = looked_at
    session = window.session
    before, old = hand.frames(1), session.terrain
    spare = path.with_name("spare.oro")
    build(spare, dem(heights() + 40.0))
    record = (spare / "zarr.json").read_text()
    (spare / "zarr.json").write_text(record[:-40])
    shutil.rmtree(path)
    shutil.copytree(spare, path)
    old.watch.replaced = True  # as a read finds that sees another array
    hand.until(lambda: "cannot be shown" in said(window))
    assert "zarr.json is damaged" in said(window) and "`" not in said(window)
    hand.key("o")
    after = hand.frames(2)
    corner = np.s_[300:500, 20:300]
    assert np.abs(after[corner].astype(int) - before[corner]).mean() < 40
    (path / "zarr.json").write_text(record)
    taken(window, hand, old)
    assert session.terrain.height_range[0] == pytest.approx(540.0)


@pytest.mark.stress
def test_a_store_at_a_url(device, monkeypatch):
    """There a read that fails tells."""
    monkeypatch.setattr(replacing, "EVERY", 0.05)
    url = "memory://replaced/window.oro"
    z = np.pad(heights(), ((0, 143), (0, 143)), mode="edge")  # of two levels: the finer one is read again and again
    store.build(dem(z), url, overwrite=True, shard=64, chunk=32).close()
    session = Session(store.open(url, cache_bytes=0), size=(640, 480), tolerance=4.0)
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20), device=device)
    hand = Hand(window)
    hand.rest()
    old = session.terrain
    store.build(dem(z + 40.0), url, overwrite=True, shard=64, chunk=32).close()
    hand.move(300, 420)
    hand.until(lambda: session.terrain is not old)
    hand.rest()
    assert session.terrain.height_range[0] == pytest.approx(540.0)
    window.canvas.close()
    window.gui.close()


def test_views_find_their_place():
    here, there = Grid((257, 257), HERE, pyproj.CRS("EPSG:32633")), Grid((90, 140), Affine(10, 0, 0, 0, -10, 0), None)
    from orograph.viewpoint import View

    view = View((EAST, NORTH, 3000.0), (EAST + 10, NORTH - 10, 500.0))
    assert moved(view, here, here) == view
    assert moved(view, here, there) is None


def test_kept_views_of_another_terrain_last_until_the_window_closes(tmp_path):
    from orograph.viewpoint import View

    a, b = View((0, 0, 9), (0, 1, 0)), View((1, 0, 9), (1, 1, 0))
    grids = [Grid((9, 9), Affine(s, 0, 0, 0, -s, 0), None) for s in (1, 2)]
    first, second = (Bookmarks(grid, "x", tmp_path) for grid in grids)
    first.keep("1", a)
    first.keep("2", b)
    second.keep("1", b)
    second.carry(first, lambda view: view)
    assert second.get("1") == b and second.get("2") == b
    assert Bookmarks(grids[1], "x", tmp_path).get("2") is None
