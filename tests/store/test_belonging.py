"""A shard that lies where it does not belong is named when it is first read, and by ``check``."""

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
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.digests import Digests, digest_of, tail_length
from orograph.store.layout import array_specs
from orograph.store.storage import FolderStorage

HEIGHTS = rough((300, 280), 4, hole=True)
SIZES = {"shard": 128, "chunk": 32}


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    path = tmp_path_factory.mktemp("belonging") / "area.oro"
    store.build(source(HEIGHTS), path, **SIZES).close()
    return path


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """The same place, one sample higher by a metre."""
    path = tmp_path_factory.mktemp("foreign") / "area.oro"
    other = HEIGHTS.copy()
    other[5, 5] += 1
    store.build(source(other), path, **SIZES).close()
    return path


@pytest.fixture
def area(pristine, tmp_path):
    return shutil.copytree(pristine, tmp_path / "area.oro")


def swap(a, b):
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)


def read_all(terrain):
    for spec in array_specs(terrain.record):
        ShardedArray(spec, terrain.storage, terrain.record.digests, ChunkCache(0)).read(
            0, spec.shape[0], 0, spec.shape[1]
        )


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("heights/0/height/c/0/0", "heights/0/height/c/1/0"),
        ("tiles/0/minimum/c/0/0", "tiles/0/maximum/c/0/0"),
        ("heights/1/height/c/0/0", "heights/0/height/c/0/0"),
        ("heights/1/height/c/0/0", "mean/1/height/c/0/0"),
        ("diamonds/0/exact/c/0/1", "diamonds/0/radius/c/0/1"),
        ("patches/1/exact/c/0/0", "heights/1/height/c/0/0"),
    ],
)
def test_swapped_shards(area, one, other):
    swap(area / one, area / other)
    with store.open(area) as terrain:
        assert terrain.check() == [key for key in (_order(terrain)) if key in (one, other)]
        with pytest.raises(DamagedChunkError, match=f"it is the shard ({one}|{other}), of this store or another"):
            read_all(terrain)
        with pytest.raises(DamagedChunkError, match=f"({one}|{other}) is damaged: it is the shard"):
            for level in range(terrain.levels):
                h, w = terrain.shape(level)
                terrain.read(level, 0, h, 0, w)
                h, w = terrain.mean_shape(level)
                terrain.read_mean(level, 0, h, 0, w)
                terrain.tiles(level)
                h, w = terrain.diamond_shape(level)
                terrain.derived("diamonds", error="exact").read(level, 0, h, 0, w)
                terrain.derived("patches", error="exact", legs=16).read(level, 0, h, 0, w)


def _order(terrain):
    for spec in array_specs(terrain.record):
        yield from (spec.key((i, j)) for i in range(spec.shards[0]) for j in range(spec.shards[1]))


def test_a_shard_of_another_store(area, foreign):
    key = "heights/0/height/c/0/0"
    shutil.copy(foreign / key, area / key)
    with store.open(area) as terrain:
        with pytest.raises(
            DamagedChunkError, match=f"{key} is damaged: it belongs to another store, or to another version"
        ):
            terrain.read(0, 0, 9, 0, 9)
        assert terrain.check() == [key]
        assert np.isfinite(terrain.read(0, 200, 209, 200, 209)).all()


def test_equal_shards_are_equal_wherever_they_come_from(area, foreign):
    """Neither the store's path nor the time is in a shard: what does not differ may come from a copy."""
    key = "heights/0/height/c/2/2"
    assert (foreign / key).read_bytes() == (area / key).read_bytes()
    shutil.copy(foreign / key, area / key)
    with store.open(area) as terrain:
        assert terrain.check() == []


def test_a_chunk_of_another_shard(area):
    """A copy that was put together from parts: the chunk is sound, and so is the index, but they are of two shards."""
    rng = np.random.default_rng(1)  # samples that do not compress, so that their chunks are equally long
    heights = [rng.integers(0, 2**32, (128, 128), np.uint32).view(np.float32) for _ in range(2)]
    spec, storage = ArraySpec("a", (128, 128), 128, 64), FolderStorage(area)
    digests = Digests()
    (*ours, end), digest = spec.encode((0, 0), heights[0])
    (*theirs, _), _ = spec.encode((0, 0), heights[1])
    assert [len(part) for part in ours] == [len(part) for part in theirs]
    digests.put("a", (1, 1), (0, 0), digest)
    storage.put("a/c/0/0", [*ours[:2], *theirs[2:], end])
    array = ShardedArray(spec, storage, digests, ChunkCache(0))
    np.testing.assert_array_equal(array.read(0, 64, 0, 64), heights[0][:64, :64])
    with pytest.raises(DamagedChunkError, match=re.escape("a/c/0/0[0,1] is damaged: it belongs to another shard")):
        array.read(0, 64, 0, 128)


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_two_shards(pristine, area, data):
    """Exchanged, they are found by ``check``, unless they are equal; put back, all is well."""
    keys = list(_order(store.open(pristine)))
    one, other = (data.draw(st.sampled_from(keys)) for _ in range(2))
    swap(area / one, area / other)
    found = store.open(area).check()
    assert sorted(found) == (sorted({one, other}) if one != other else [])
    swap(area / one, area / other)
    assert store.open(area).check() == []


def test_everything_is_checked(area):
    """One byte of any object, coordinates and metadata included, and every object that is gone."""
    rng = np.random.default_rng(5)
    files = sorted(p for p in area.rglob("*") if p.is_file())
    names = {str(p.relative_to(area)) for p in files}
    assert {"heights/0/x/c/0", "mean/1/spatial_ref/c", "tiles/zarr.json", "zarr.json"} <= names
    for file in files:
        key, content = str(file.relative_to(area)), file.read_bytes()
        if key != "zarr.json":
            broken = bytearray(content)
            broken[int(rng.integers(len(content)))] ^= 1
            file.write_bytes(broken)
            assert [k.partition("[")[0] for k in store.open(area).check()][:1] == [key]
            file.unlink()
            assert store.open(area).check() == [key]
        file.write_bytes(content)
    assert store.open(area).check() == []


def test_the_root_is_checked_beside_its_record(area):
    root = area / "zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["spatial:bbox"][0] += 1
    root.write_text(json.dumps(document))
    assert store.open(area).check() == ["zarr.json"]


def test_the_digests_are_in_the_record_and_under_its_checksum(area):
    root = area / "zarr.json"
    document = json.loads(root.read_text())
    listed = document["attributes"]["orograph"]["digests"]
    shard = (area / "heights/0/height/c/1/2").read_bytes()
    import base64

    ours = base64.b64decode(listed["heights/0/height"])[12 * (3 + 2) : 12 * (3 + 3)]
    assert ours == digest_of(shard[-tail_length("heights/0/height/c/1/2", 16) :])
    assert listed["heights/0/height/zarr.json"] == base64.b64encode(
        digest_of((area / "heights/0/height/zarr.json").read_bytes())
    ).decode()  # fmt: skip
    listed["heights/0/height"] = listed["heights/0/height"][::-1]
    root.write_text(json.dumps(document))
    with pytest.raises(StoreError, match="checksum"):
        store.open(area)


def test_what_the_label_says_is_what_the_manual_says(area):
    """Read by the manual's words alone."""
    import hashlib

    import google_crc32c

    key = "heights/0/height/c/1/2"
    data, n, k = (area / key).read_bytes(), 16, len(key)
    index, label_end = data[-16 * n - 4 : -4], len(data) - 16 * n - 4
    label = data[label_end - 4 * n - k - 2 - 4 - 4 : label_end]
    sums = np.frombuffer(label[: 4 * n], "<u4")
    assert label[4 * n : 4 * n + k].decode() == key
    assert int.from_bytes(label[4 * n + k :][:2], "little") == k and label[-8:-4] == b"oro\x03"
    assert google_crc32c.value(label[:-4] + index) == int.from_bytes(label[-4:], "little")
    for (start, size), check in zip(np.frombuffer(index, "<u8").reshape(-1, 2), sums):
        if start != 2**64 - 1:
            chunk = data[start : start + size]
            assert google_crc32c.value(chunk[:-4]) == int.from_bytes(chunk[-4:], "little") == check
    listed = store.open(area).record.digests.get("heights/0/height", (3, 3), (1, 2))
    assert hashlib.blake2b(data[label_end - len(label) :], digest_size=12).digest() == listed


def test_a_store_that_needs_more_is_refused(area):
    from orograph.store.layout import _checksum

    root = area / "zarr.json"
    document = json.loads(root.read_text())
    record = document["attributes"]["orograph"]
    record["needs"] = ["versions"]
    record["checksum"] = _checksum({k: v for k, v in record.items() if k != "checksum"})
    root.write_text(json.dumps(document))
    with pytest.raises(StoreError, match=r"needs a reader that knows versions.*Update Orograph"):
        store.open(area)
