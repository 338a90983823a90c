"""Builds on the workers of a Dask cluster: the same bytes as in one process; what fails is told."""

from __future__ import annotations

import math
import sys
from collections import Counter

import numpy as np
import pytest
import rasterio
from affine import Affine
from surfaces import rough, source
from test_in_parts import files

from orograph import store
from orograph.errors import DamagedChunkError, ReadError, StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.context import Options
from orograph.store import clusters, workforce
from orograph.store.stored import StoredTerrain

SIZES = {"shard": 64, "chunk": 16, "jobs": 1}


def written(path, seed=3, shape=(700, 530)):
    """A DEM in degrees, which has to be resampled."""
    heights = rough(shape, seed).astype(np.float32)
    place = Affine(0.0003, 0, -120, 0, -0.0003, 38)
    profile = {"driver": "GTiff", "width": shape[1], "height": shape[0], "count": 1, "dtype": "float32"}
    profile["crs"] = "EPSG:4326"
    with rasterio.open(path, "w", transform=place, **profile) as file:
        file.write(heights, 1)
    return str(path)


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def test_a_cluster_is_started_again_if_a_worker_dies_as_it_starts(monkeypatch):
    distributed, begun = pytest.importorskip("distributed"), []

    def dying(times):
        def made(**options):
            begun.append(options)
            if len(begun) <= times:
                raise RuntimeError("Nanny failed to start.")
            return "a cluster"

        monkeypatch.setattr(distributed, "LocalCluster", made)

    dying(2)
    assert workforce._started(2) == "a cluster" and len(begun) == 3
    begun.clear()
    dying(9)
    with pytest.raises(StoreError, match="died as they started: Nanny failed"):
        workforce._started(2)


@pytest.mark.stress
@pytest.mark.parametrize(
    "kept",
    [
        pytest.param({}, id="lossless"),
        pytest.param({"codec": "progressive", "max_error": 0.05}, id="progressive", marks=pytest.mark.stress),
    ],
)
def test_workers_make_what_one_process_makes(tmp_path, client, kept):
    dem = written(tmp_path / "a.tif")
    how = SIZES | kept
    store.build(dem, tmp_path / "whole", **how).close()
    built = store.build(dem, tmp_path / "s", dask=client, **how)
    assert isinstance(built, StoredTerrain) and built.samples is not None
    built.close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")
    store.build(dem, tmp_path / "parts", part=(1, 1), **how)
    store.build(dem, tmp_path / "parts", finish=True, dask=client, **how).close()
    assert files(tmp_path / "parts") == files(tmp_path / "whole")


@pytest.mark.stress
def test_workers_make_what_follows_from_heights(tmp_path, client, monkeypatch):
    dem = written(tmp_path / "a.tif")
    how = SIZES | {"errors": ("exact", "midpoint"), "chunked": (32, 0)}
    store.build(dem, tmp_path / "whole", **how).close()
    done = Counter()
    hear = clusters._Round._hear
    monkeypatch.setattr(
        clusters._Round, "_hear", lambda self, found: (done.update([self.stage.name]), hear(self, found))[1]
    )
    store.build(dem, tmp_path / "s", dask=client, **how).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")
    assert {"heights", "source", "errors", "patches", "chunks"} <= set(done)


@pytest.mark.cases(1)
@pytest.mark.parametrize("area", [{}, {"bbox": (15.0005, -0.0005, 15.006, 0.007)}], ids=["whole", "an area"])
def test_workers_grid_points_as_one_process_does(tmp_path, client, area):
    rng = np.random.default_rng(4)
    rows = np.c_[rng.uniform(500_000, 500_900, 500), rng.uniform(0, 700, 500), rng.normal(0, 9, 500)].round(2)
    path = tmp_path / "p.csv"
    path.write_text("x,y,z,depth\n" + "".join(f"{a},{b},{c},{-c}\n" for a, b, c in rows))
    how = {**SIZES, **area, "resolution": 4, "assume_crs": "EPSG:32633", "height_column": "depth"}
    how["max_edge"] = 90 if area else math.inf
    store.build(str(path), tmp_path / "whole", **how).close()
    store.build(str(path), tmp_path / "s", dask=client, **how).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole") and len(files(tmp_path / "s")) > 9


def damaged(path):
    """A DEM that lacks its end."""
    written(path)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - 300_000)
    return path


def test_files_that_workers_cannot_have(tmp_path, client):
    with pytest.raises(UsageError, match="not in files"):
        store.build(source(rough((200, 200), 1)), tmp_path / "s", dask=client, **SIZES)
    assert not list(tmp_path.iterdir())


def test_a_damaged_file_is_an_error_of_that_file(tmp_path, client):
    """One message, as a build by threads has it; no tracebacks of Dask; and nothing is left."""
    dem = damaged(tmp_path / "a.tif")
    with pytest.raises(ReadError) as alone:
        store.build(dem, tmp_path / "s", **SIZES | {"shard": 1024})
    with pytest.raises(ReadError) as caught:
        store.build(dem, tmp_path / "s", dask=client, **SIZES | {"shard": 1024})
    assert str(caught.value) == str(alone.value)
    assert not any("Compute Failed" in line for log in client.get_worker_logs().values() for _, line in log)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif"]


@pytest.mark.stress
def test_a_damaged_chunk_is_an_error_of_that_chunk(tmp_path, client):
    store.build(written(tmp_path / "a.tif"), tmp_path / "s", errors=(), **SIZES).close()
    chunk = tmp_path / "s" / "heights/0/height/c/2/1"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 3] ^= 255
    chunk.write_bytes(data)
    with pytest.raises(DamagedChunkError) as alone:
        bake(tmp_path / "s", "openness", Options(azimuths=4), jobs=1)
    with pytest.raises(DamagedChunkError) as caught:
        bake(tmp_path / "s", "openness", Options(azimuths=4), dask=client)
    assert str(caught.value) == f"{alone.value} What was done is kept: run the same again to go on."


def test_several_damaged_blocks_are_listed(tmp_path, client):
    dem = damaged(tmp_path / "a.tif")
    expected = r"^\S+s.partial: \d+ tasks of 'Building.*given up after 4 tries: .*block.*resume=True"
    with pytest.raises(ReadError, match=expected) as caught:
        store.build(dem, tmp_path / "s", dask=client, **SIZES)
    assert ".." not in str(caught.value)


@pytest.mark.stress
def test_what_was_given_up_is_told_and_resumed(tmp_path, client):
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole", **SIZES).close()
    (tmp_path / "s.partial/heights/0/height/c").mkdir(parents=True)

    def spoil():  # a folder where a shard is to be
        (tmp_path / "s.partial/heights/0/height/c/0/0").mkdir(parents=True)

    def mend():
        (tmp_path / "s.partial/heights/0/height/c/0/0").rmdir()

    with pytest.MonkeyPatch.context() as patch:
        run = clusters.Cluster.run
        patch.setattr(clusters.Cluster, "run", lambda self, *args: (spoil(), run(self, *args))[1])
        with pytest.raises(StoreError, match=r"1 tasks? .*given up after 4 tries.*could not be written") as caught:
            store.build(dem, tmp_path / "s", dask=client, overwrite=True, **SIZES)
    assert caught.value.exit_code == 4
    mend()
    store.build(dem, tmp_path / "s", dask=client, resume=True, **SIZES).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_without_dask(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"orograph\[cluster\]"):
        store.build(written(tmp_path / "a.tif"), tmp_path / "s", workers=2, **SIZES)
