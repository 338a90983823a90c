"""Sources that other processes open again: with what took long to make of them, and wherever the store is made."""

from __future__ import annotations

import contextlib
import importlib
import pickle
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from buckets import ENVIRONMENT, bucket_server
from test_in_parts import files

from orograph import store
from orograph.dem import openers
from orograph.dem.gridding import PointRaster
from orograph.errors import StoreError
from orograph.store import handing
from orograph.store.addresses import storage_at
from orograph.store.build_state import BuildState, recipe_of
from orograph.store.places import PLAN

SIZES = {"shard": 64, "chunk": 16, "jobs": 1, "progress": False, "resolution": 4, "assume_crs": "EPSG:32633"}


class NewEachTime:
    """Stands for a cluster whose workers die after each task: nothing is known to them but what lies in files."""

    here = 0

    def __init__(self, recipe):
        self.text = pickle.dumps(recipe)

    def groups(self, *_):
        return 0

    def run(self, stage, progress):
        stage.hand_over()
        for spot in stage.tasks():
            BuildState(pickle.loads(self.text)).stage(stage.name, stage.number).make(spot)
            found = stage.found(spot, proof=False)
            assert found is not None
            stage.add(spot, found)
        stage.finish()


@pytest.fixture
def by_workers(monkeypatch):
    """Builds that name workers are done by ``NewEachTime``, which do not triangulate; the sizes of their recipes."""
    sizes = []

    @contextlib.contextmanager
    def executor_of(raster, storage, options, plan, coding, at_once, *_):
        made = NewEachTime(recipe_of(raster, storage, options, plan, coding, PLAN, at_once.task, at_once.base))
        sizes.append(len(made.text))
        monkeypatch.setattr(PointRaster, "open", None)
        yield made

    monkeypatch.setattr(importlib.import_module("orograph.store.build"), "executor_of", executor_of)
    return sizes


@pytest.fixture
def points(tmp_path):
    rng = np.random.default_rng(4)
    rows = np.c_[rng.uniform(500_000, 500_900, 500), rng.uniform(0, 700, 500), rng.normal(0, 9, 500)].round(2)
    path = tmp_path / "p.csv"
    path.write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in rows))
    return str(path)


@pytest.mark.parametrize("area", [{}, {"bbox": (15.0005, -0.0005, 15.006, 0.007)}], ids=["whole", "an area"])
def test_workers_take_over_the_triangulation(tmp_path, points, area, request):
    store.build(points, tmp_path / "whole", **SIZES, **area).close()
    sizes = request.getfixturevalue("by_workers")
    store.build(points, tmp_path / "s", **SIZES, **area).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")
    assert sizes[0] < 20_000  # what goes through the scheduler


RASTERS = {"shard": 64, "chunk": 16, "jobs": 1, "progress": False, "vertical_unit": "ft"}


@pytest.fixture
def tiles(tmp_path, monkeypatch):
    """Four rasters, which are enough for what they say to be handed over."""
    rng, paths = np.random.default_rng(1), [tmp_path / "tiles" / f"t{i}.tif" for i in range(4)]
    (tmp_path / "tiles").mkdir()
    for i, path in enumerate(paths):
        with rasterio.open(
            path, "w", driver="GTiff", width=70, height=90, count=1, dtype="int16", nodata=-1, crs="EPSG:32632",
            transform=Affine(30, 0, 500_000 + 30 * 70 * i, 0, -30, 5_000_000),
        ) as file:  # fmt: skip
            file.write(rng.integers(-1, 900, (90, 70)).astype(np.int16), 1)
    monkeypatch.setattr(handing, "SEVERAL", 4)
    return paths


@pytest.fixture
def opens(monkeypatch):
    """The files that are opened for their headers."""
    seen, plain = [], openers.open_named

    def opened(path, *how, **more):
        seen.append(path)
        return plain(path, *how, **more)

    monkeypatch.setattr(openers, "open_named", opened)
    return seen


def test_workers_take_over_what_the_headers_say(tmp_path, tiles, opens, monkeypatch, request):
    store.build(tiles, tmp_path / "whole", **RASTERS).close()
    request.getfixturevalue("by_workers")
    opens.clear()
    monkeypatch.chdir(tmp_path)
    store.build([f"tiles/{one.name}" for one in tiles], tmp_path / "s", **RASTERS).close()
    assert len(opens) == 4  # by the process that builds
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_parts_take_over_what_the_headers_say(tmp_path, tiles, opens):
    store.build(tiles, tmp_path / "whole", **RASTERS).close()
    opens.clear()
    for index in (2, 1):
        store.build(tiles, tmp_path / "s", part=(index, 2), **RASTERS)
    store.build(tiles, tmp_path / "s", finish=True, **RASTERS).close()
    assert len(opens) == 4  # by the first part
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.parametrize("area", [{}, {"bbox": (15.0005, -0.0005, 15.006, 0.007)}], ids=["whole", "an area"])
def test_parts_take_over_the_triangulation(tmp_path, points, area, monkeypatch):
    how = {**SIZES, **area}
    store.build(points, tmp_path / "whole", **how).close()
    store.build(points, tmp_path / "s", part=(2, 3), **how)
    with monkeypatch.context() as patch:
        patch.setattr(PointRaster, "open", None)
        store.build(points, tmp_path / "s", part=(3, 3), **how)
        store.build(points, tmp_path / "s", part=(1, 3), **how)
        store.build(points, tmp_path / "s", finish=True, **how).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_points_that_have_changed_are_triangulated_anew(tmp_path, points):
    store.build(points, tmp_path / "s", part=(1, 2), **SIZES)
    with Path(points).open("a") as file:
        file.write("500450,350,80\n")
    with pytest.raises(StoreError, match="Another build of this store was begun"):
        store.build(points, tmp_path / "s", part=(2, 2), **SIZES)


@pytest.mark.stress
def test_in_a_bucket(tmp_path, points, monkeypatch, request):
    pytest.importorskip("obstore")
    pytest.importorskip("moto.server")
    store.build(points, tmp_path / "whole", **SIZES).close()
    with bucket_server() as server:
        for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}.items():
            monkeypatch.setenv(name, value)
        store.build(points, "s3://terrain/q.oro", part=(1, 2), **SIZES)
        request.getfixturevalue("by_workers")
        store.build(points, "s3://terrain/p.oro", **SIZES).close()
        store.build(points, "s3://terrain/q.oro", part=(2, 2), **SIZES)
        store.build(points, "s3://terrain/q.oro", finish=True, **SIZES).close()
        for name in ("p", "q"):
            place = storage_at(f"s3://terrain/{name}.oro")
            assert {name: place.get(name) for name in place.listed()} == files(tmp_path / "whole")
