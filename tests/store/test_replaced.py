"""A reader that is open while its store is replaced is told so, and never gets heights of another store."""

from __future__ import annotations

import time

import numpy as np
import pytest
from surfaces import rough, source
from webserver import serving

from orograph import store
from orograph.errors import StoreError, StoreReplacedError
from orograph.lighting.bake import bake
from orograph.lighting.products import Options
from orograph.store.watch import EVERY

OLD, NEW = rough((300, 280), 1), rough((300, 280), 2)
SIZES = {"shard": 64, "chunk": 32}
READS = {
    "read": lambda t: t.read(0, 0, 300, 0, 280),
    "the top": lambda t: t.read(t.levels - 1, 0, 9, 0, 9),
    "read_mean": lambda t: t.read_mean(1, 0, 99, 0, 99),
    "tiles": lambda t: t.tiles(0),
    "diamonds": lambda t: t.derived("diamonds", error="exact").read(0, 0, 99, 0, 99),
    "patches": lambda t: t.derived("patches", error="exact", legs=16).read(1, 0, 99, 0, 99),
}


@pytest.mark.cases(4)
@pytest.mark.parametrize("seen", [True, False], ids=["read before", "first read"])
@pytest.mark.parametrize("read", READS.values(), ids=READS)
def test_the_next_read_says_so(tmp_path, read, seen):
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with store.open(tmp_path / "s") as terrain:
        if seen:
            read(terrain)
        store.build(source(NEW), tmp_path / "s", overwrite=True, **SIZES).close()
        for _ in range(2):
            with pytest.raises(StoreReplacedError, match=r"replaced since it was opened.*reopen"):
                read(terrain)
        again = terrain.reopen()
        np.testing.assert_array_equal(again.read(0, 0, 300, 0, 280), NEW)
        read(again)


@pytest.mark.parametrize("again", [False, True], ids=["cached", "decoded anew"])
def test_between_two_looks_nothing_is_mixed(tmp_path, monkeypatch, again):
    """However the moment is chosen: heights of the store that was opened, or an error."""
    monkeypatch.setattr("orograph.store.watch.EVERY", 1e9)
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with store.open(tmp_path / "s", cache_bytes=0 if again else 1 << 26) as terrain:
        terrain.read(0, 0, 100, 0, 100)
        store.build(source(NEW), tmp_path / "s", overwrite=True, **SIZES).close()
        if again:
            terrain.storage.close()  # as if many other files had been read in between
        told = 0
        for row in range(0, 300, 30):
            try:
                np.testing.assert_array_equal(terrain.read(0, row, row + 30, 0, 280), OLD[row : row + 30])
            except StoreReplacedError:
                told += 1
        assert told >= 6


def test_at_a_url(tmp_path):
    url = "memory://replaced/s"
    store.build(source(OLD), url, **SIZES)
    with store.open(url, cache_bytes=0) as terrain:
        terrain.read(0, 0, 50, 0, 50)
        store.build(source(NEW), url, overwrite=True, **SIZES)
        for window in ((0, 50, 0, 50), (200, 300, 200, 280)):
            with pytest.raises(StoreReplacedError):
                terrain.read(0, *window)
        np.testing.assert_array_equal(terrain.reopen().read(0, 0, 300, 0, 280), NEW)


def test_at_a_url_from_memory_alone(monkeypatch):
    """All tiles are held, so that no shard is read any more: the look at the root tells."""
    monkeypatch.setattr("orograph.store.watch.EVERY_REMOTE", 0.05)
    url = "memory://replaced/u"
    store.build(source(OLD), url, **SIZES)
    with store.open(url) as terrain:
        terrain.read(0, 0, 50, 0, 50)
        time.sleep(0.1)
        np.testing.assert_array_equal(terrain.read(0, 0, 50, 0, 50), OLD[:50, :50])
        store.build(source(NEW), url, overwrite=True, **SIZES)
        time.sleep(0.1)
        for _ in range(2):
            with pytest.raises(StoreReplacedError):
                terrain.read(0, 0, 50, 0, 50)
        np.testing.assert_array_equal(terrain.reopen().read(0, 0, 300, 0, 280), NEW)


def test_a_server_that_is_gone_takes_nothing_that_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr("orograph.store.watch.EVERY_REMOTE", 0.05)
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with serving(tmp_path) as web:
        terrain = store.open(f"{web.url}/s")
        terrain.read(0, 0, 50, 0, 50)
    time.sleep(0.1)
    np.testing.assert_array_equal(terrain.read(0, 0, 50, 0, 50), OLD[:50, :50])


def test_at_a_url_while_it_is_built(monkeypatch):
    url = "memory://replaced/t"
    store.build(source(OLD), url, **SIZES)
    terrain = store.open(url)
    terrain.storage.remove("zarr.json")
    terrain.storage.remove("heights/0/height/c/0/0")
    with pytest.raises(StoreReplacedError):
        terrain.read(0, 0, 50, 0, 50)


def test_the_same_store_built_again_is_no_other(tmp_path):
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with store.open(tmp_path / "s") as terrain:
        terrain.read(0, 0, 50, 0, 50)
        store.build(source(OLD), tmp_path / "s", overwrite=True, **SIZES).close()
        time.sleep(2 * EVERY)
        np.testing.assert_array_equal(terrain.read(0, 0, 300, 0, 280), OLD)


def test_a_bake_replaces_layers_and_not_the_terrain(tmp_path):
    store.build(source(OLD), tmp_path / "s", errors=(), **SIZES).close()
    bake(tmp_path / "s", ["visible-sky"], Options(azimuths=4)).close()
    with store.open(tmp_path / "s") as terrain:
        terrain.read(0, 0, 50, 0, 50)
        bake(tmp_path / "s", ["visible-sky"], Options(azimuths=5)).close()
        time.sleep(2 * EVERY)
        np.testing.assert_array_equal(terrain.read(0, 0, 300, 0, 280), OLD)
        with pytest.raises(StoreReplacedError):
            terrain.layer("visible-sky").read(0, 0, 50, 0, 50)
        assert terrain.reopen().layer("visible-sky").options["azimuths"] == 5


def test_between_the_renames_the_folders_are_named(tmp_path):
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with store.open(tmp_path / "s") as terrain:
        terrain.read(0, 0, 50, 0, 50)
        (tmp_path / "s").rename(tmp_path / "s.replaced")
        time.sleep(2 * EVERY)
        with pytest.raises(StoreError, match=r"s\.replaced holds the store"):
            terrain.read(0, 0, 50, 0, 50)


def test_what_is_checked_meanwhile_is_not_called_damaged(tmp_path):
    store.build(source(OLD), tmp_path / "s", **SIZES).close()
    with store.open(tmp_path / "s") as terrain:
        store.build(source(NEW), tmp_path / "s", overwrite=True, **SIZES).close()
        with pytest.raises(StoreReplacedError):
            terrain.check()
