"""What is built is what is read: by Orograph, and by the other readers of Zarr."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import grid_of, rough, source

from orograph import read, sample, store
from orograph.errors import DamagedChunkError, StoreError
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.digests import tail_length
from orograph.store.layout import array_specs

HEIGHTS = rough((700, 530), 2, missing=0.01, hole=True)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return store.build(source(HEIGHTS), tmp_path_factory.mktemp("store") / "area.oro", shard=64, chunk=16).url


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def same(ours, memory):
    assert (ours.grid, ours.name, ours.vertical) == (memory.grid, memory.name, memory.vertical)
    assert (ours.height_range, ours.valid_fraction) == (memory.height_range, memory.valid_fraction)
    for level in range(memory.levels):
        h, w = memory.shape(level)
        np.testing.assert_array_equal(ours.read(level, 0, h, 0, w), memory.read(level, 0, h, 0, w))
        h, w = memory.mean_shape(level)
        np.testing.assert_array_equal(ours.read_mean(level, 0, h, 0, w), memory.read_mean(level, 0, h, 0, w))
        for name in ("minimum", "maximum", "error", "valid"):
            np.testing.assert_array_equal(getattr(ours.tiles(level), name), getattr(memory.tiles(level), name))


def test_names_of_the_package_are_not_hidden_by_its_modules() -> None:
    for module in ("build", "terrain"):
        importlib.import_module(f"orograph.store.{module}")
    assert all(callable(getattr(store, name)) for name in store.__all__ if name != "TILE")
    assert set(store.__all__) <= set(dir(store))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        store.nothing  # noqa: B018


def test_a_store_is_the_terrain_in_memory(built):
    with store.open(built) as terrain:
        same(terrain, store.MemoryTerrain(HEIGHTS, grid_of(HEIGHTS.shape), "rough", "EGM96 height"))


@pytest.mark.stress
@settings(deadline=None, max_examples=12)
@given(st.integers(1, 300), st.integers(1, 300), st.sampled_from([(32, 8), (64, 64), (256, 32)]), st.integers(1, 3))
def test_any_shape_any_shards(tmp_path_factory, rows, cols, sizes, jobs):
    heights = rough((rows, cols), rows, 0.1)
    shard, chunk = sizes
    url = tmp_path_factory.mktemp("any") / "s"
    terrain = store.build(source(heights, None), url, shard=shard, chunk=chunk, jobs=jobs)
    same(terrain, store.MemoryTerrain(heights, grid_of(heights.shape, None), "rough", "EGM96 height"))


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_any_window(built, data):
    terrain = store.open(built, cache_bytes=data.draw(st.sampled_from([0, 5000, 1 << 20])))
    r0, c0 = data.draw(st.integers(0, 700)), data.draw(st.integers(0, 530))
    r1, c1 = data.draw(st.integers(r0, 700)), data.draw(st.integers(c0, 530))
    for _ in range(2):
        np.testing.assert_array_equal(terrain.read(0, r0, r1, c0, c1), HEIGHTS[r0:r1, c0:c1])


@pytest.mark.stress
def test_the_bytes_do_not_depend_on_the_number_of_threads(tmp_path):
    for jobs in (1, 3):
        store.build(source(HEIGHTS), tmp_path / f"{jobs}", shard=64, chunk=16, jobs=jobs)
    assert files(tmp_path / "1") == files(tmp_path / "3")


def test_chunks_without_valid_samples_are_not_written(tmp_path):
    void = np.full((256, 256), np.nan, np.float32)
    void[200, 200] = 1
    store.build(source(void), tmp_path / "void", shard=128, chunk=64)
    sizes = {p.name: p.stat().st_size for p in (tmp_path / "void/heights/0/height/c").rglob("0")}
    index = tail_length("heights/0/height/c/0/0", 4)
    assert sizes["0"] == index
    assert (tmp_path / "void/heights/0/height/c/1/1").stat().st_size > index


def test_zarr_reads_it(built):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(built, mode="r")
    terrain = store.open(built)
    for level in range(terrain.levels):
        h, w = terrain.shape(level)
        np.testing.assert_array_equal(group[f"heights/{level}/height"][:], terrain.read(level, 0, h, 0, w))
        np.testing.assert_array_equal(group[f"tiles/{level}/valid"][:], terrain.tiles(level).valid)
        np.testing.assert_array_equal(group[f"tiles/{level}/error"][:], terrain.tiles(level).error)
    np.testing.assert_array_equal(group["mean/1/height"][:], terrain.read_mean(1, 0, 350, 0, 265))
    layout = group.attrs["multiscales"]["layout"]
    assert [entry["asset"] for entry in layout] == [f"heights/{k}" for k in range(terrain.levels)]
    assert group.attrs["proj:code"] == "EPSG:32611"


def test_tensorstore_reads_it(built):
    tensorstore = pytest.importorskip("tensorstore")
    path = f"{built}/heights/1/height"
    array = tensorstore.open({"driver": "zarr3", "kvstore": {"driver": "file", "path": path}}).result()
    terrain = store.open(built)
    np.testing.assert_array_equal(array.read().result(), terrain.read(1, 0, array.shape[0], 0, array.shape[1]))


@pytest.mark.parametrize(("kind", "scale"), [("heights/0", 1), ("heights/1", 2), ("mean/1", 2)])
def test_xarray_and_rioxarray_know_where_it_is(built, kind, scale):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("rioxarray")
    data = xarray.open_zarr(built, group=kind).set_coords("spatial_ref")
    assert data.height.rio.crs == "EPSG:32611"
    transform = grid_of(HEIGHTS.shape).transform
    offset = 0 if kind.startswith("mean") else 15 - 15 * scale
    assert data.height.rio.transform()[:6] == (
        30 * scale,
        0,
        transform.c + offset,
        0,
        -30 * scale,
        transform.f - offset,
    )
    assert data.height.rio.resolution() == (30 * scale, -30 * scale)
    if kind == "heights/0":
        np.testing.assert_array_equal(data.height.values, HEIGHTS)
        x, y = grid_of(HEIGHTS.shape).xy(7, 11)
        assert float(data.height.sel(x=x, y=y)) == HEIGHTS[11, 7]


def test_all_that_is_stored_is_read_by_zarr_and_tensorstore(built):
    """Every array, the labels in its shards notwithstanding."""
    zarr = pytest.importorskip("zarr")
    tensorstore = pytest.importorskip("tensorstore")
    group = zarr.open_group(built, mode="r")
    with store.open(built) as terrain:
        specs = array_specs(terrain.record)
        assert {spec.path.split("/")[0] for spec in specs} == {"heights", "mean", "tiles", "diamonds", "patches"}
        for spec in specs:
            ours = ShardedArray(spec, terrain.storage, terrain.record.digests, ChunkCache(0))
            values = ours.read(0, spec.shape[0], 0, spec.shape[1])
            np.testing.assert_array_equal(group[spec.path][:], values)
            kvstore = {"driver": "file", "path": f"{built}/{spec.path}"}
            theirs = tensorstore.open({"driver": "zarr3", "kvstore": kvstore}).result().read().result()
            np.testing.assert_array_equal(theirs, values)


def test_what_others_write_into_a_store_is_told_from_its_own(tmp_path):
    zarr = pytest.importorskip("zarr")
    store.build(source(HEIGHTS), tmp_path / "s", shard=128, chunk=32).close()
    zarr.open_array(tmp_path / "s/heights/0/height", mode="r+")[:128, :128] = HEIGHTS[:128, :128]
    with pytest.raises(DamagedChunkError, match=r"heights/0/height/c/0/0 .*other than Orograph"):
        store.open(tmp_path / "s").read(0, 0, 9, 0, 9)


@pytest.mark.cases(1)
@pytest.mark.parametrize("open_files", [2, 128])
def test_many_readers_at_once(built, monkeypatch, open_files):
    monkeypatch.setattr("orograph.store.storage.OPEN_FILES", open_files)
    terrain = store.open(built, cache_bytes=40_000)
    rng = np.random.default_rng(0)
    corners = rng.integers(0, 400, (400, 2))

    def read(corner):
        r, c = corner
        return np.array_equal(
            terrain.read(0, r, r + 100, c, c + 100), HEIGHTS[r : r + 100, c : c + 100], equal_nan=True
        )

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, corners))
    assert terrain.cache.used <= 40_000


def test_the_cache_keeps_to_its_budget_and_drops_the_oldest():
    cache = ChunkCache(3000)
    for name in "abc":
        cache.put(name, np.zeros(1000, np.uint8))
    assert cache.get("a") is not None
    cache.put("d", np.zeros(1000, np.uint8))
    assert cache.get("b") is None and cache.get("a") is not None and cache.used == 3000
    cache.put("huge", np.zeros(4000, np.uint8))
    assert cache.get("huge") is None and cache.used == 3000
    cache.put("a", np.zeros(10, np.uint8))
    assert cache.used == 2010


def test_reading_a_store_starts_no_compiler_and_no_zarr(built):
    code = f"""
import sys
from orograph import store
store.open({built!r}).read(0, 0, 50, 0, 50)
print(*[name for name in ("numba", "zarr", "tensorstore", "fsspec", "rasterio", "scipy") if name in sys.modules])
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == ""


def test_what_is_not_a_store_is_said_to_be_none(tmp_path, built):
    with pytest.raises(StoreError, match="no such store"):
        store.open(tmp_path / "nothing")
    (tmp_path / "folder").mkdir()
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(tmp_path / "folder")
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(tmp_path / "file")
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(f"{built}/heights/0")
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(f"{built}/heights/0/height")


def test_a_newer_format_is_refused(tmp_path):
    store.build(source(rough((20, 20))), tmp_path / "s")
    root = tmp_path / "s/zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["orograph"]["format"] = 99
    root.write_text(json.dumps(document))
    with pytest.raises(StoreError, match=r"format 99.*Update Orograph"):
        store.open(tmp_path / "s")


def test_degrees_are_refused(tmp_path):
    with pytest.raises(Exception, match="degrees"):
        store.build(source(rough((5, 5)), "EPSG:4326"), tmp_path / "s")
    assert not list(tmp_path.iterdir())


def test_a_store_of_files_has_its_own_name_and_one_of_heights_theirs(tmp_path):
    path = sample.write_jacksboro(tmp_path)
    assert path.stem != "area" and store.build(str(path), tmp_path / "area.oro").name == "area"
    assert store.build(read(path), tmp_path / "other.oro").name == read(path).name
