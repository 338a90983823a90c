"""Light baked in parts into a bucket: the objects that one process makes, whatever happens to parts and server."""

from __future__ import annotations

import contextlib
import importlib

import numpy as np
import pytest
from buckets import ENVIRONMENT, bucket_server
from test_bake_cluster import CASES, Workers, files, made

from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.bake_state import SweepStage
from orograph.lighting.context import Options
from orograph.store import storage as waiting
from orograph.store.addresses import storage_at
from orograph.store.bucket import BucketStorage
from orograph.store.layers import PARTIAL

pytest.importorskip("obstore")
pytest.importorskip("moto.server")

NAMES, OPTIONS = CASES["radius"]
bake_module = importlib.import_module("orograph.lighting.bake")


@pytest.fixture(scope="module")
def server():
    with bucket_server() as running:
        yield running


@pytest.fixture
def s3(server, monkeypatch, tmp_path):
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url, "OROGRAPH_CACHE": str(tmp_path / "c")}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(waiting, "AGAIN", (0.01, 0.02))
    monkeypatch.setattr(waiting, "LONGER", (0.02,) * 6)
    server.well()
    yield server
    server.well()


@pytest.fixture
def area(s3, request):
    return made(f"s3://terrain/{request.node.name}/area.oro")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Files of a store in a folder, baked by one process."""
    folder = made(tmp_path_factory.mktemp("whole") / "s")
    bake(folder, NAMES, OPTIONS, jobs=1).close()
    return files(folder)


def objects(url):
    place = storage_at(url)
    return {name: place.get(name) for name in place.listed()}


@pytest.mark.stress
@pytest.mark.parametrize("fault", [{}, {"refuse": 0.1, "cut": 0.02}])
def test_parts_make_what_one_process_makes(s3, area, whole, tmp_path, fault):
    for name, share in fault.items():
        setattr(s3, name, share)
    for index in (3, 1, 2):
        assert bake(area, NAMES, OPTIONS, part=(index, 3), jobs=2) is None
        with store.open(area) as terrain:
            assert terrain.layers == () and terrain.check() == []
    bake(area, NAMES, OPTIONS, finish=True).close()
    s3.well()
    assert objects(area) == whole
    assert not any((tmp_path / "c" / "bakes").iterdir())  # nothing stays on the machines of parts


@pytest.mark.stress
def test_rays_too(area, tmp_path):
    names, options = CASES["rays"]
    for index in (2, 1):
        bake(area, names, options, part=(index, 2), jobs=2)
    bake(area, names, options, finish=True).close()
    bake(made(tmp_path / "whole"), names, options).close()
    assert objects(area) == files(tmp_path / "whole")


@pytest.mark.stress
def test_a_part_that_is_killed_goes_on_and_missing_ones_are_named(area, whole, monkeypatch):
    swept, put, count = [], BucketStorage.put, [0]

    class Stop(BaseException):
        """Stands for the end of the process."""

    def stop(self, key, parts):
        if key.endswith(".part"):
            count[0] += 1
            if count[0] > 9:
                raise Stop
        put(self, key, parts)

    make = SweepStage.make
    monkeypatch.setattr(SweepStage, "make", lambda self, spot: swept.append(spot) or make(self, spot))
    with monkeypatch.context() as patch:
        patch.setattr(BucketStorage, "put", stop)
        with pytest.raises(Stop):
            bake(area, NAMES, OPTIONS, part=(1, 2), jobs=1)
    bake(area, NAMES, OPTIONS, part=(1, 2), jobs=1)
    assert len(swept) == len(set(swept)) == 12  # nothing is swept twice
    with pytest.raises(StoreError, match=r"Part 2 of 2 is missing") as caught:
        bake(area, NAMES, OPTIONS, finish=True)
    assert caught.value.exit_code == 4
    bake(area, NAMES, OPTIONS, part=(2, 2), jobs=1)
    bake(area, NAMES, OPTIONS, finish=True).close()
    assert objects(area) == whole


@pytest.mark.stress
def test_a_finish_that_is_killed_is_done_again(area, whole, monkeypatch):
    for index in (1, 2):
        bake(area, NAMES, OPTIONS, part=(index, 2))
    copy, count = BucketStorage.copy, [0]

    def stop(self, *args):
        count[0] += 1
        if count[0] > 20:
            raise ZeroDivisionError
        copy(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(BucketStorage, "copy", stop)
        with pytest.raises(ZeroDivisionError):
            bake(area, NAMES, OPTIONS, finish=True)
    bake(area, NAMES, OPTIONS, finish=True).close()
    assert objects(area) == whole


@pytest.mark.stress
def test_another_bake_is_told_and_can_replace_it(area, whole):
    bake(area, NAMES, OPTIONS, part=(1, 3))
    with pytest.raises(StoreError, match=r"Another bake.* was begun in 3 parts.*parts of 3.*`overwrite=True`"):
        bake(area, NAMES, OPTIONS, part=(2, 4))
    with pytest.raises(StoreError, match=r"Another bake"):
        bake(area, NAMES, Options(azimuths=7, radius=800.0), finish=True)
    with pytest.raises(StoreError, match=r"Another bake.* was begun in 3 parts"):
        bake(area, NAMES, OPTIONS)
    bake(area, NAMES, OPTIONS, overwrite=True).close()
    assert not any(name.startswith(PARTIAL) for name in objects(area))
    assert objects(area) == whole
    with pytest.raises(UsageError, match=r"Horizons without a radius"):
        bake(area, *CASES["swept"], part=(1, 2))


@pytest.mark.stress
def test_parts_bake_into_a_version(s3, tmp_path):
    """Where shards are named by their digests, and an older version keeps its own layers."""
    from test_updating import OPTIONS as SIZES
    from test_updating import tile

    (tmp_path / "tiles").mkdir()
    tiles = [tile(tmp_path / "tiles", i, j, 0) for i in range(2) for j in range(2)]
    how = {**SIZES, "errors": (), "shard": 64}
    url = "s3://terrain/version/area.oro"
    store.build(tiles, url, update=True, **how).close()
    bake(url, ["visible-sky"], Options(azimuths=4, radius=400.0), progress=False).close()
    tile(tmp_path / "tiles", 0, 0, 1)
    store.build(tiles, url, update=True, keep=2, **how).close()
    options = Options(azimuths=6, radius=500.0)
    for index in (2, 1):
        bake(url, ["visible-sky"], options, part=(index, 2), progress=False)
    bake(url, ["visible-sky"], options, finish=True, progress=False).close()
    store.build(tiles, tmp_path / "plain.oro", **how).close()
    with (
        bake(tmp_path / "plain.oro", ["visible-sky"], options, progress=False) as wanted,
        store.open(url) as found,
        store.open(f"{url}@1") as old,
    ):
        assert found.check() == old.check() == [] and old.layers == found.layers == ("visible-sky",)
        rows, cols = wanted.grid.shape
        layers = [each.layer("visible-sky").read(0, 0, rows, 0, cols) for each in (wanted, found, old)]
        np.testing.assert_array_equal(layers[0], layers[1])
        assert not np.array_equal(layers[0], layers[2])
    assert not any(name.startswith(PARTIAL) for name in objects(url))


@pytest.mark.stress
@pytest.mark.parametrize("case", [pytest.param("swept", marks=pytest.mark.stress), "rays"])
def test_workers_of_other_machines_make_what_one_process_makes(s3, area, tmp_path, case, monkeypatch):
    names, options = CASES[case][0][:2], CASES[case][1]
    left = [9]

    @contextlib.contextmanager
    def on_workers(recipe, *_):
        assert recipe.folder == ""
        yield Workers(recipe, left[0])

    monkeypatch.setattr(bake_module, "on_workers", on_workers)
    with pytest.raises(StoreError, match="stopped"):
        bake(area, names, options, dask="tcp://elsewhere:8786")
    with store.open(area) as terrain:
        assert terrain.layers == () and terrain.check() == []
    with pytest.raises(StoreError, match=r"by the workers of a cluster was interrupted.*with `dask`.*`overwrite=True`"):
        bake(area, names, options)
    left[0], s3.refuse = None, 0.05
    bake(area, names, options, dask="tcp://elsewhere:8786").close()
    s3.well()
    bake(made(tmp_path / "whole"), names, options).close()
    assert objects(area) == files(tmp_path / "whole")
