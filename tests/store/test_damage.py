"""Damage is reported by the chunk's name when it is read, and never comes out as heights."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from surfaces import rough, source

from orograph import store
from orograph.errors import DamagedChunkError, StoreError
from orograph.store.checking import check

HEIGHTS = rough((300, 280), 4, hole=True)


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    path = tmp_path_factory.mktemp("damage") / "area.oro"
    store.build(source(HEIGHTS), path, shard=128, chunk=32)
    return path


@pytest.fixture
def area(pristine, tmp_path):
    return shutil.copytree(pristine, tmp_path / "area.oro")


def everything(terrain):
    """Every window of 32² of every level, and the tables: what was read, or the error."""
    for level in range(terrain.levels):
        for read, shape in ((terrain.read, terrain.shape(level)), (terrain.read_mean, terrain.mean_shape(level))):
            for row in range(0, shape[0], 32):
                for col in range(0, shape[1], 32):
                    yield read, level, (row, min(row + 32, shape[0]), col, min(col + 32, shape[1]))


@pytest.mark.stress
@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_bit_is_found_or_harmless(pristine, area, data):
    shards = sorted(p for p in pristine.rglob("*") if p.is_file() and re.search(r"(height|tiles/\d/\w+)/c/", str(p)))
    shard = data.draw(st.sampled_from(shards))
    content = bytearray(shard.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= 1 << data.draw(st.integers(0, 7))
    broken = area / shard.relative_to(pristine)
    before = broken.read_bytes()
    broken.write_bytes(content)
    try:
        good, bad = store.open(pristine), store.open(area)
        name = str(shard.relative_to(pristine))
        found = 0
        for (read, level, window), (expected, _, _) in zip(everything(bad), everything(good)):
            try:
                np.testing.assert_array_equal(read(level, *window), expected(level, *window))
            except DamagedChunkError as error:
                assert error.chunk.startswith(name) and name in str(error)
                found += 1
        for level in range(bad.levels):
            try:
                bad.tiles(level)
            except DamagedChunkError as error:
                assert error.chunk.startswith(name)
                found += 1
        assert found  # there is no byte in a shard that nothing depends on
        assert [key.partition("[")[0] for key in bad.check()] == [name] * len(bad.check()) != []
    finally:
        broken.write_bytes(before)


def test_a_sound_store_checks_out(pristine):
    assert store.open(pristine).check() == []


@pytest.mark.parametrize("left", [0, 3, 40, 300])
def test_a_shard_that_is_cut_off_is_damaged(area, left):
    shard = area / "heights/0/height/c/2/1"
    shard.write_bytes(shard.read_bytes()[:left])
    terrain = store.open(area)
    with pytest.raises(DamagedChunkError, match="heights/0/height/c/2/1"):
        terrain.read(0, 256, 300, 128, 256)


def test_a_shard_whose_bytes_are_doubled_is_damaged(area):
    shard = area / "heights/0/height/c/2/1"
    content = shard.read_bytes()
    shard.write_bytes(content + content)
    (damage,) = check(store.open(area))
    assert damage.key == "heights/0/height/c/2/1"
    assert f"{2 * len(content):,} bytes where {len(content):,} were written" in damage.cause


def test_a_shard_that_is_gone_is_damaged_not_missing_terrain(area):
    (area / "heights/0/height/c/1/1").unlink()
    terrain = store.open(area)
    with pytest.raises(DamagedChunkError, match="heights/0/height/c/1/1 is damaged: the file is not there"):
        terrain.read(0, 100, 200, 100, 200)
    assert np.isfinite(terrain.read(0, 0, 20, 0, 20)).all()


def test_a_chunk_is_named_within_its_shard(area):
    shard = area / "heights/0/height/c/0/0"
    content = bytearray(shard.read_bytes())
    content[10] ^= 1
    shard.write_bytes(content)
    with pytest.raises(DamagedChunkError) as caught:
        store.open(area).read(0, 0, 100, 0, 100)
    assert caught.value.chunk == "heights/0/height/c/0/0[0,0]"
    assert caught.value.exit_code == 4


@pytest.mark.parametrize("key", ["transform", "shape", "height_range", "chunk"])
def test_a_damaged_record_is_refused(area, key):
    root = area / "zarr.json"
    document = json.loads(root.read_text())
    values = document["attributes"]["orograph"][key]
    if isinstance(values, list):
        values[0] += 1
    else:
        document["attributes"]["orograph"][key] += 1
    root.write_text(json.dumps(document))
    with pytest.raises(StoreError, match="checksum"):
        store.open(area)


def test_metadata_that_is_no_json_is_refused(area):
    root = area / "zarr.json"
    root.write_bytes(root.read_bytes()[:-50])
    with pytest.raises(StoreError, match=r"zarr\.json is damaged.*overwrite=True"):
        store.open(area)
    store.build(source(HEIGHTS), area, overwrite=True).close()  # as it says
    assert store.open(area).check() == []
