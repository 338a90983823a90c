"""The codec *progressive*: levels that follow from each other, each within the error, no sample twice."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import rough, source

from orograph import store
from orograph.errors import DamagedChunkError
from orograph.store import smallest
from orograph.store.coding import coding_of
from orograph.store.progressive import Scheme, coarse_of, residuals
from orograph.store.progressive import rebuilt as rebuilt_chunk
from orograph.store.pyramid import Finest, tasks
from orograph.store.storage import FolderStorage
from orograph.store.writer import ShardWriter

MISSING = -(2**31)


def filled(line):
    """Missing samples are the nearest before them, else the first that is there; None if none is."""
    there = [v for v in line if v != MISSING]
    if not there:
        return None
    now, found = there[0], []
    for v in line:
        now = v if v != MISSING else now
        found.append(now)
    return found


def between(line):
    """16 times what lies half-way behind each sample."""
    slope = [line[1] - line[0], line[-1] - line[-2]] if len(line) > 1 else [0, 0]
    line = [line[0] - slope[0], *line, line[-1] + slope[1], line[-1] + 2 * slope[1]]
    return [-a + 9 * b + 9 * c - d for a, b, c, d in zip(line, line[1:], line[2:], line[3:], strict=False)]


def predicted(coarse, rows, cols):
    """What docs/codec.md says of a chunk, by a dictionary of places."""
    found = {}
    for i, row in enumerate(coarse):
        line = filled(row)
        for j in range(cols // 2):
            found[2 * i, 2 * j + 1] = (between(line)[j] + 8) // 16 if line else 0
    for j in range(len(coarse[0])):
        line = filled([row[j] for row in coarse])
        for i in range(rows // 2):
            found[2 * i + 1, 2 * j] = (between(line)[i] + 8) // 16 if line else 0
    across, last = [], None
    for line in map(filled, coarse):
        last = between(line) if line else last
        across.append(last)
    across = [line or next((x for x in across if x), [0] * len(coarse[0])) for line in across]
    for j in range(cols // 2):
        for i, v in enumerate(between([line[j] for line in across])[: rows // 2]):
            found[2 * i + 1, 2 * j + 1] = (v + 128) // 256
    return found


def rebuilt(stored, coarse, chunk, factor, exact):
    """A level of numbers, of what is stored of it and the level above."""
    rows, cols = stored.shape
    found = np.full(stored.shape, MISSING, np.int64)
    for top in range(0, rows, chunk):
        for left in range(0, cols, chunk):
            r, c = min(chunk, rows - top), min(chunk, cols - left)
            own = coarse[top // 2 : top // 2 + (r + 1) // 2, left // 2 : left // 2 + (c + 1) // 2].tolist()
            said = predicted(own, r, c)
            end_row, end_col = (at + n == side and side % 2 == 0 for at, n, side in ((top, r, rows), (left, c, cols)))
            if end_row:  # the last row of the level above is this one
                line = filled(coarse[rows // 2, left // 2 : left // 2 + (c + 1) // 2].tolist())
                for j in range(c // 2):
                    said[r - 1, 2 * j + 1] = (between(line)[j] + 8) // 16 if line else 0
            if end_col:
                line = filled(coarse[top // 2 : top // 2 + (r + 1) // 2, cols // 2].tolist())
                for i in range(r // 2):
                    said[2 * i + 1, c - 1] = (between(line)[i] + 8) // 16 if line else 0
            for i in range(r):
                for j in range(c):
                    y, x = top + i, left + j
                    above = [(at // 2 if at % 2 == 0 else (at + 1) // 2 if end and k == n - 1 else None)
                             for at, k, n, end in ((y, i, r, end_row), (x, j, c, end_col))]  # fmt: skip
                    if None not in above:
                        found[y, x] = coarse[above[0], above[1]]
                    elif stored[y, x] != MISSING:
                        p = said[i, j]
                        p = (p + factor // 2) // factor * factor if exact else p
                        found[y, x] = p + factor * stored[y, x]
    return found


@settings(deadline=None, max_examples=12)
@given(
    st.integers(1, 90), st.integers(1, 700), st.sampled_from([(16, 16), (32, 16), (64, 16)]),
    st.sampled_from([0.01, 0.1, 0.7]), st.sampled_from([0.0, 0.1, 0.8]),
)  # fmt: skip
def test_it_is_as_documented_and_zarr_reads_it(tmp_path_factory, rows, cols, sizes, error, missing):
    zarr = pytest.importorskip("zarr")
    zarr.registry.register_codec("orograph.smallest", __import__("orograph.store.zarr_codec").store.zarr_codec.Smallest)
    heights, url = rough((rows, cols), cols, missing), tmp_path_factory.mktemp("any") / "s"
    terrain = store.build(
        source(heights), url, codec="progressive", max_error=error, errors=(), shard=sizes[0], chunk=sizes[1]
    )
    coding, top = terrain.record.coding, terrain.levels - 1
    arrays = [zarr.open_array(url / f"heights/{level}/height", mode="r") for level in range(top + 1)]
    numbers = arrays[top][:].astype(np.int64)
    numbers[numbers != MISSING] *= coding.factor
    for level in range(top, -1, -1):
        if level < top:
            said = dict(arrays[level].attrs["prediction"])
            assert said["from"] == f"heights/{level + 1}/height" and said["step"] == coding.step
            stored = arrays[level][:].astype(np.int64)
            assert not stored[::2, ::2][stored[::2, ::2] != MISSING].any()  # no sample twice
            numbers = rebuilt(stored, numbers, sizes[1], said["factor"], said["exact"])
        shown = terrain.read(level, 0, numbers.shape[0], 0, numbers.shape[1])
        np.testing.assert_array_equal(np.where(numbers == MISSING, np.nan, numbers * coding.step), shown)
    assert np.nanmax(np.abs(terrain.read(0, 0, rows, 0, cols).astype(np.float64) - heights), initial=0) <= error


@pytest.mark.parametrize(("shape", "shard"), [((600, 50), 16), ((301, 600), 64), ((2, 2000), 32), ((1100, 1), 16)])
def test_every_level_is_within_the_error_and_nests(tmp_path, shape, shard):
    """Also where most levels are coarser than a shard, and where none is."""
    heights = rough(shape, 5, missing=0.01, hole=True)
    how = {"codec": "progressive", "max_error": 0.1, "errors": (), "shard": shard, "chunk": 16}
    terrain = store.build(source(heights), tmp_path / "s", **how)
    kept = terrain.read(0, 0, shape[0], 0, shape[1])
    memory = store.MemoryTerrain(kept, terrain.grid, "rough", "")
    rng = np.random.default_rng(0)
    for level in range(terrain.levels):
        h, w = memory.shape(level)
        whole = memory.read(level, 0, h, 0, w)
        np.testing.assert_array_equal(terrain.read(level, 0, h, 0, w), whole)
        for _ in range(5):
            (a, b), (c, d) = np.sort(rng.integers(0, h + 1, 2)), np.sort(rng.integers(0, w + 1, 2))
            np.testing.assert_array_equal(terrain.read(level, a, b, c, d), whole[a:b, c:d])
    assert np.nanmax(np.abs(kept.astype(np.float64) - heights)) <= 0.1


def test_a_finished_shard_is_read_back_before_coarser_levels_are_written(tmp_path):
    """An interrupted build goes on from there."""
    heights = source(rough((150, 134), 3, 0.02))
    writer = ShardWriter(FolderStorage(tmp_path))
    finest = Finest(heights, writer, 64, 16, coding_of(heights, "progressive", 0.1))
    for spot in tasks((150, 134), 64):
        made, _ = finest.make(spot)
        found = finest.found(spot)
        assert found is not None
        np.testing.assert_array_equal(found[0], made)


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node")
def test_the_decoder_for_browsers(tmp_path):
    """Chunks of any shape, within an array and at its end, with and without missing samples, as Python has them."""
    rng, wholes, told = np.random.default_rng(4), [], []
    for k, (rows, cols, last, exact) in enumerate([
        (33, 40, (0, 0), False), (34, 40, (1, 1), True), (16, 16, (0, 0), True), (16, 21, (1, 0), False),
        (9, 2, (0, 1), False), (1, 1, (0, 0), True), (1, 30, (0, 1), False), (2, 1, (1, 0), True),
        (40, 38, (1, 1), False),
    ]):  # fmt: skip
        numbers = np.cumsum(rng.integers(-60, 61, (rows, cols)), 1).astype(np.int32) * (3000 if k == 2 else 1)
        if k in (1, 3, 8):
            numbers[rng.random(numbers.shape) < 0.4] = MISSING
            numbers[4:6] = MISSING
        scheme, coarse = Scheme(17, exact), coarse_of(numbers, last)
        stored = residuals(numbers, last, scheme)
        wholes.append(rebuilt_chunk(stored, coarse, last, scheme))
        (tmp_path / f"{k}.chunk").write_bytes(smallest.compressed(stored, nested=True))
        (tmp_path / f"{k}.coarse").write_bytes(coarse.astype("<i4").tobytes())
        told.append([rows, cols, {"factor": 17, "exact": exact, "lastRow": bool(last[0]), "lastCol": bool(last[1])}])
    for script in Path(store.__file__).parent.joinpath("browser").glob("*.js"):
        shutil.copy(script, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "all.js").write_text(
        "import { decode } from './progressive.js'; import { readFileSync, writeFileSync } from 'fs';\n"
        f"for (const [k, [rows, cols, how]] of {json.dumps(told)}.entries()) {{\n"
        "  const data = new Uint8Array(readFileSync(`${k}.chunk`)), raw = readFileSync(`${k}.coarse`);\n"
        "  const coarse = new Int32Array(raw.buffer.slice(raw.byteOffset, raw.byteOffset + raw.length));\n"
        "  writeFileSync(`${k}.out`, decode(data, rows, cols, coarse, how));\n"
        "  let told = 0;\n"
        "  for (const wrong of [[data, new Int32Array(coarse.length + 1)], [data.subarray(1), coarse]])\n"
        "    try { decode(wrong[0], rows, cols, wrong[1], how) } catch (e) { if (e instanceof RangeError) told++ }\n"
        "  if (told != 2) throw new Error(`${k}: ${told}`);\n"
        "}\n"
    )
    subprocess.run(["node", "all.js"], cwd=tmp_path, check=True, timeout=120)
    for k, whole in enumerate(wholes):
        found = np.frombuffer((tmp_path / f"{k}.out").read_bytes(), "<i4").reshape(whole.shape)
        np.testing.assert_array_equal(found, whole)


def test_smooth_ground_takes_far_less_than_its_lattice(tmp_path):
    y, x = np.mgrid[:1025, :1025] / 1025
    heights = (300 * np.sin(7 * x + 3 * y) * np.cos(5 * y)).astype(np.float32)
    taken = {}
    for codec in ("smallest", "progressive"):
        terrain = store.build(source(heights), tmp_path / codec, codec=codec, max_error=0.1, errors=())
        taken[codec] = sum(p.stat().st_size for p in (tmp_path / codec / "heights").rglob("c/*/*"))
        assert terrain.record.coding.largest <= 0.1
    assert taken["progressive"] < 0.5 * taken["smallest"]


def test_damage_above_is_named_where_it_is(tmp_path):
    heights = rough((300, 260), 9)
    area = tmp_path / "s"
    store.build(source(heights), area, codec="progressive", max_error=0.1, errors=(), shard=64, chunk=16)
    content = bytearray((area / "heights/1/height/c/0/1").read_bytes())
    content[40] ^= 4
    (area / "heights/1/height/c/0/1").write_bytes(content)
    with store.open(area) as terrain:
        assert terrain.check() == ["heights/1/height/c/0/1[0,0]"]
        with pytest.raises(DamagedChunkError, match=r"heights/1/height/c/0/1\[0,0\].*fails its checksum"):
            terrain.read(0, 0, 300, 0, 260)
        terrain.read(0, 0, 64, 0, 64)  # (what does not hang on it is read)


def test_windows_of_a_store_at_a_url(tmp_path):
    heights, how = rough((300, 260), 9, missing=0.05), {"codec": "progressive", "max_error": 0.1, "errors": ()}
    here = store.build(source(heights), tmp_path / "s", shard=64, chunk=16, **how).read(0, 0, 300, 0, 260)
    there = store.build(source(heights), "memory://progressive", shard=64, chunk=16, overwrite=True, **how)
    assert there.storage.remote
    rng = np.random.default_rng(2)
    for _ in range(10):
        r, c = rng.integers(0, 230, 2)
        np.testing.assert_array_equal(there.read(0, r, r + 30, c, c + 30), here[r : r + 30, c : c + 30])


def test_the_indices_of_several_shards_at_a_url_are_asked_for_at_once(tmp_path, monkeypatch):
    how = {"codec": "compact", "max_error": 0.1, "errors": (), "shard": 64, "chunk": 16, "overwrite": True}
    heights = rough((128, 128), 9)
    here = store.build(source(heights), tmp_path / "s", **how).read(0, 0, 128, 0, 128)
    store.build(source(heights), "memory://indices", **how)
    with store.open("memory://indices") as there:
        together, tail = threading.Barrier(4, timeout=20), type(there.storage).tail

        def waiting(storage, key, length):
            if "heights/0" in key:
                together.wait()  # (asked for one after another they would wait for ever)
            return tail(storage, key, length)

        monkeypatch.setattr(type(there.storage), "tail", waiting)
        np.testing.assert_array_equal(there.read(0, 60, 70, 60, 70), here[60:70, 60:70])


def test_the_record_says_what_it_is(tmp_path):
    terrain = store.build(source(rough((40, 40), 1)), tmp_path / "s", codec="progressive", max_error=0.1)
    said = json.loads((tmp_path / "s/zarr.json").read_text())["attributes"]["orograph"]["codec"]
    assert said["name"] == "progressive" and said["step"] == 12 / 1024 and terrain.record.coding.factor == 17
