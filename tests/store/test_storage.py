"""Stores elsewhere: file and memory URLs, and a web server that gives ranges (buckets: ``test_buckets``)."""

from __future__ import annotations

import numpy as np
import pytest
from breaking import broken_off
from hypothesis import given
from hypothesis import strategies as st
from surfaces import rough, source
from webserver import serving

from orograph import store
from orograph.errors import DamagedChunkError, StoreError
from orograph.store.addresses import storage_at
from orograph.store.fsspec_storage import FsspecStorage
from orograph.store.ranges import merged
from orograph.store.storage import FolderStorage

HEIGHTS = rough((290, 260), 21, hole=True)
SIZES = {"shard": 128, "chunk": 32}


def check(terrain):
    np.testing.assert_array_equal(terrain.read(0, 0, 290, 0, 260), HEIGHTS)
    np.testing.assert_array_equal(terrain.read(0, 30, 90, 20, 101), HEIGHTS[30:90, 20:101])
    assert terrain.height_range == (np.nanmin(HEIGHTS), np.nanmax(HEIGHTS))
    assert terrain.tiles(1).valid.shape == (1, 1)
    assert terrain.check() == []


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    path = tmp_path_factory.mktemp("local") / "area.oro"
    store.build(source(HEIGHTS), path, **SIZES)
    return path


def objects(storage, folder):
    names = [str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()]
    return {name: (storage.get(name), (folder / name).read_bytes()) for name in names}


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 300), st.integers(1, 60)), min_size=1))
def test_neighbouring_ranges_are_fetched_together(wanted):
    storage = FsspecStorage("memory://orograph-ranges")
    data = {key: np.random.default_rng(ord(key)).bytes(400) for key in "ab"}
    for key, content in data.items():
        storage.put(key, [content])
    ranges = [(key, start, start + length) for key, start, length in wanted]
    assert storage.ranges(ranges) == [data[key][start:stop] for key, start, stop in ranges]


def test_far_ranges_are_fetched_apart():
    near, far = ("a", 0, 10), ("a", 1 << 20, (1 << 20) + 5)
    assert merged([far, near, ("a", 12, 20), ("b", 0, 4)]) == [("a", 0, 20), far, ("b", 0, 4)]
    assert len(merged([("a", i << 20, (i + 1) << 20) for i in range(10)])) == 3


def test_file_urls_are_folders(tmp_path):
    path = tmp_path / "a b.oro"
    check(store.build(source(HEIGHTS), path.as_uri(), **SIZES))
    assert isinstance(storage_at(path.as_uri()), FolderStorage)
    check(store.open(path.as_uri()))
    check(store.open(str(path) + "/"))


def test_memory_urls(local):
    url = "memory://orograph-test/area.oro"
    terrain = store.build(source(HEIGHTS), url, **SIZES)
    check(terrain)
    assert all(a == b for a, b in objects(terrain.storage, local).values())
    assert terrain.size_bytes == FolderStorage(local).size()  # nothing is left over
    with pytest.raises(StoreError, match="there already"):
        store.build(source(HEIGHTS), url, **SIZES)
    other = store.build(source(HEIGHTS + 1), url, overwrite=True, **SIZES)
    np.testing.assert_array_equal(other.read(0, 0, 5, 0, 5), HEIGHTS[:5, :5] + 1)
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open("memory://orograph-test/nothing")


def test_an_interrupted_build_at_a_url_is_resumed(local):
    url = "memory://orograph-test/resumed"
    with broken_off(FsspecStorage, 30):
        store.build(source(HEIGHTS), url, jobs=1, **SIZES)
    with pytest.raises(StoreError, match=r"incomplete.*resume=True"):
        store.open(url)
    with pytest.raises(StoreError, match="interrupted build"):
        store.build(source(HEIGHTS), url, **SIZES)
    terrain = store.build(source(HEIGHTS), url, resume=True, **SIZES)
    check(terrain)
    assert all(a == b for a, b in objects(terrain.storage, local).values())


def test_an_unknown_protocol_says_what_to_install():
    with pytest.raises(StoreError, match="cannot be opened"):
        store.open("gopher://example.org/area.oro")


@pytest.fixture
def web(local):
    with serving(local.parent) as server:
        yield server.url


def test_http(web, local, tmp_path):
    pytest.importorskip("obstore")
    terrain = store.open(f"{web}/area.oro")
    np.testing.assert_array_equal(terrain.read(0, 0, 290, 0, 260), HEIGHTS)
    assert terrain.tiles(0).valid.shape == (2, 2)
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(f"{web}/other.oro")
    with pytest.raises(StoreError, match="could not be written"):
        store.build(source(HEIGHTS), f"{web}/new.oro", **SIZES)


def test_a_folder_that_is_gone_is_no_damage(tmp_path):
    """A store that is renamed while it is read says so, and is read again when it is back."""
    path, away = tmp_path / "here.oro", tmp_path / "there.oro"
    store.build(source(HEIGHTS), path, **SIZES).close()
    with store.open(path) as terrain:
        path.rename(away)
        with pytest.raises(StoreError, match=r"no longer exists.*where it is now") as told:
            check(terrain)
        assert not isinstance(told.value, DamagedChunkError)
        away.rename(path)
        check(terrain)
    for shard in (path / "heights" / "0").rglob("*"):
        if shard.is_file() and shard.name != "zarr.json":
            shard.unlink()
    with store.open(path) as terrain, pytest.raises(DamagedChunkError):
        check(terrain)
