"""Films drawn by several processes: the same bytes as by one, parts in any order, and what is missing is named."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import orograph
from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.store.lock import alone
from orograph.store.source import ArraySource
from orograph.store.storage import FolderStorage

HOW = {"size": (96, 64), "orbit": True, "seconds": 1.0, "fps": 8, "progress": False}


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    y, x = np.mgrid[:200, :260]
    heights = (300 * np.sin(x / 21) * np.cos(y / 17) + 20 * np.sin(x / 2.3 + y / 3.1)).astype(np.float32)
    grid = Grid(heights.shape, Affine(20, 0, 500_000, 0, -20, 4_000_000), CRS.from_epsg(32611))
    folder = tmp_path_factory.mktemp("film") / "hills.oro"
    store.build(ArraySource(heights, grid, "hills"), folder, jobs=1).close()
    return folder


def frames(folder):
    return {p.name: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def whole(terrain, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    orograph.movie(terrain, folder / "%03d.png", **HOW)
    return frames(folder)


@pytest.mark.stress
def test_parts_make_the_film(terrain, whole, tmp_path):
    out = tmp_path / "f" / "%03d.png"
    with pytest.raises(StoreError, match="No part"):
        orograph.movie(terrain, out, finish=True, **HOW)
    for part in ("3/3", (1, 3)):
        orograph.movie(terrain, out, part=part, **HOW)
    with pytest.raises(StoreError, match="in 3 parts, not in 4"):
        orograph.movie(terrain, out, part=(2, 4), **HOW)
    with pytest.raises(StoreError, match="Part 2 of 3 is missing") as caught:
        orograph.movie(terrain, out, finish=True, **HOW)
    assert caught.value.exit_code == 4
    orograph.movie(terrain, out, part="2/3", **HOW)
    orograph.movie(terrain, out, finish=True, **HOW)
    assert frames(tmp_path / "f") == whole


@pytest.mark.stress
def test_parts_make_the_video(terrain, tmp_path):
    pytest.importorskip("av")
    orograph.movie(terrain, tmp_path / "a.mp4", jobs=1, **HOW)
    for part in ((2, 2), (1, 2)):
        orograph.movie(terrain, tmp_path / "b.mp4", part=part, jobs=1, **HOW)
        assert not (tmp_path / "b.mp4").exists()
    orograph.movie(terrain, tmp_path / "b.mp4", finish=True, jobs=1, **HOW)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]


@pytest.mark.stress
def test_workers_make_the_film(terrain, whole, tmp_path):
    pytest.importorskip("distributed")
    from orograph.store.workforce import workforce

    with workforce(2, None, 1, 4 << 30, 0) as client:
        orograph.movie(terrain, tmp_path / "f" / "%03d.png", dask=client, **HOW)
        assert frames(tmp_path / "f") == whole
        (tmp_path / "f" / "004.png").unlink()
        orograph.movie(terrain, tmp_path / "f" / "%03d.png", dask=client, **HOW)
        assert frames(tmp_path / "f") == whole
        heights = store.open(terrain)
        held = orograph.Dem(heights.read(0, 0, 200, 0, 260), heights.grid)  # of no file: it goes to the workers
        orograph.movie(held, tmp_path / "alone" / "%03d.png", **HOW)
        orograph.movie(held, tmp_path / "held" / "%03d.png", dask=client, **HOW)
        assert frames(tmp_path / "held") == frames(tmp_path / "alone")


def test_one_at_a_time(terrain, tmp_path):
    sign = tmp_path / "f" / ".N.png.film"
    with (
        alone(FolderStorage(sign), "drawing this film"),
        pytest.raises(StoreError, match="Another process is drawing this film"),
    ):
        orograph.movie(terrain, tmp_path / "f" / "%03d.png", part=(1, 2), **HOW)


def test_ways_exclude_each_other(terrain, tmp_path):
    with pytest.raises(UsageError, match="exclude"):
        orograph.movie(terrain, tmp_path / "%03d.png", part=(1, 2), workers=2, **HOW)
    with pytest.raises(UsageError, match="I/N"):
        orograph.movie(terrain, tmp_path / "%03d.png", part="0/2", **HOW)
