"""Heights as numbers of one step: never further off than was stated, and then the terrain itself in every respect."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import grid_of, rough, source

from orograph import store
from orograph.cli import cli
from orograph.errors import DamagedChunkError, StoreError, UsageError
from orograph.progress import Progress
from orograph.store.coding import CODECS, FINEST, OWN_STEPS, Coding, coding_of, floored
from orograph.store.repair import repair
from orograph.store.storage import FolderStorage
from orograph.verbs.info import info

HEIGHTS = rough((300, 260), 9, missing=0.01, hole=True)
SIZES = {"shard": 64, "chunk": 16}


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def rounded(heights, step):
    """The definition: as numbers of steps from 0 m, in float64, and back in float32."""
    return (np.round(heights.astype(np.float64) / step) * step).astype(np.float32)


def full(terrain):
    return terrain.read(0, 0, terrain.grid.rows, 0, terrain.grid.cols)


@pytest.fixture(scope="module", params=CODECS)
def built(request, tmp_path_factory):
    path = tmp_path_factory.mktemp(request.param) / "s"
    return store.build(source(HEIGHTS), path, codec=request.param, max_error=0.1, **SIZES).url


@settings(deadline=None, max_examples=200)
@given(st.floats(2**-11, 1000))
def test_a_step_keeps_the_error_and_is_exact(error):
    step = floored(2 * error)
    assert 2 * error * (1 - 2**-8) - FINEST < step <= 2 * error
    rng = np.random.default_rng(int(error * 1e6))
    heights = rng.uniform(-12_000, 12_000, 2000).astype(np.float32)
    numbers = np.round(heights / np.float64(step))
    kept = (numbers * step).astype(np.float32)
    np.testing.assert_array_equal(kept.astype(np.float64), numbers * step)  # exact
    np.testing.assert_array_equal(kept, numbers.astype(np.float32) * np.float32(step))  # also in float32
    assert np.abs(kept.astype(np.float64) - heights).max() <= error


@pytest.mark.parametrize("codec", ["compact", "smallest"])
@pytest.mark.parametrize(("error", "step"), [(0.05, 0.1), (0.15, 0.25), (0.3, 0.5), (0.6, 1.2)])
def test_coarser_steps_of_the_data_are_kept(codec, error, step, tmp_path):
    """Whole metres stay what they are, and take no more space in finer steps."""
    heights = np.round(HEIGHTS)
    found = store.build(source(heights), tmp_path / "s", codec=codec, max_error=error, **SIZES)
    assert found.record.coding.step == pytest.approx(step, rel=2**-9)
    assert found.record.coding.largest == 0 if step < 1 else error
    if step < 1:
        np.testing.assert_array_equal(full(found), heights)
        store.build(source(heights), tmp_path / "auto", codec=codec, max_error="auto", **SIZES)
        ours, theirs = (
            sum(len(data) for key, data in files(tmp_path / name).items() if key.startswith("heights/0"))
            for name in ("s", "auto")
        )
        assert ours <= theirs + 500  # of metadata


@settings(deadline=None, max_examples=25)
@given(
    st.integers(1, 200), st.integers(1, 200), st.sampled_from([(32, 8), (64, 64), (256, 32)]), st.integers(1, 3),
    st.sampled_from(CODECS), st.sampled_from([0.0005, 0.01, 0.1, 0.5, 3.3, 250.0]), st.sampled_from([0, 0.1, 1]),
)  # fmt: skip
def test_any_shape_any_shards_any_error(tmp_path_factory, rows, cols, sizes, jobs, codec, error, missing):
    heights = rough((rows, cols), rows, missing)
    url = tmp_path_factory.mktemp("any") / "s"
    how = {"codec": codec, "max_error": error, "shard": sizes[0], "chunk": sizes[1], "jobs": jobs}
    terrain = store.build(source(heights), url, **how)
    kept, coding = full(terrain), terrain.record.coding
    if codec != "progressive":
        np.testing.assert_array_equal(kept, rounded(heights, coding.step))
    np.testing.assert_array_equal(np.isnan(kept), np.isnan(heights))
    off = np.abs(kept.astype(np.float64) - heights)[~np.isnan(heights)]
    assert coding.largest == off.max(initial=0) <= error
    assert coding.rms == pytest.approx(math.sqrt(np.square(off).sum() / max(off.size, 1)))
    memory = store.MemoryTerrain(kept, grid_of(heights.shape), "rough", "EGM96 height")
    assert (terrain.height_range, terrain.valid_fraction) == (
        memory.height_range,
        memory.valid_fraction,
    ) or missing == 1
    for level in range(memory.levels):
        h, w = memory.shape(level)
        np.testing.assert_array_equal(terrain.read(level, 0, h, 0, w), memory.read(level, 0, h, 0, w))
        for name in ("minimum", "maximum", "error", "valid"):
            np.testing.assert_array_equal(getattr(terrain.tiles(level), name), getattr(memory.tiles(level), name))
        h, w = memory.mean_shape(level)
        means = memory.read_mean(level, 0, h, 0, w)
        np.testing.assert_allclose(terrain.read_mean(level, 0, h, 0, w), means, rtol=1e-6, atol=coding.means.step / 2)
    assert not terrain.check()


def test_all_that_is_derived_is_of_the_kept_heights(built, tmp_path):
    """Beside a lossless store of them only heights, means and metadata differ."""
    with store.open(built) as terrain:
        store.build(source(full(terrain)), tmp_path / "s", **SIZES)
    ours, theirs = files(store.open(built).storage.path), files(tmp_path / "s")
    others = [key for key in theirs if not key.startswith(("heights/", "mean/")) and key != "zarr.json"]
    assert len(others) > 30
    for key in others:
        assert ours[key] == theirs[key], key


def test_any_window(built):
    terrain = store.open(built, cache_bytes=5000)
    kept = full(store.open(built))
    rng = np.random.default_rng(0)
    for _ in range(30):
        (r0, r1), (c0, c1) = np.sort(rng.integers(0, 301, 2)), np.sort(rng.integers(0, 261, 2))
        np.testing.assert_array_equal(terrain.read(0, r0, r1, c0, c1), kept[r0:r1, c0:c1])


@pytest.mark.cases(2)
@pytest.mark.parametrize("codec", CODECS)
def test_the_bytes_depend_on_no_threads_and_no_interruption(tmp_path, monkeypatch, codec):
    how = {"codec": codec, "max_error": 0.1, **SIZES}
    store.build(source(HEIGHTS), tmp_path / "1", jobs=1, **how)
    store.build(source(HEIGHTS), tmp_path / "3", jobs=3, **how)
    whole = files(tmp_path / "1")
    assert whole == files(tmp_path / "3")
    put, done = FolderStorage.put, [0]

    def stop(self, key, parts):
        done[0] += 1
        if done[0] == 60:
            raise KeyboardInterrupt
        put(self, key, parts)

    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", stop)
        with pytest.raises(KeyboardInterrupt):
            store.build(source(HEIGHTS), tmp_path / "s", jobs=2, **how)
    lossless = {"codec": "portable", "max_error": "lossless"}
    for other in ({"max_error": 0.2}, lossless, *({"codec": c} for c in CODECS if c != codec)):
        with pytest.raises(StoreError, match="codec or largest error differ"):
            store.build(source(HEIGHTS), tmp_path / "s", resume=True, **{**how, **other})
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **how)
    assert files(tmp_path / "s") == whole
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **how)  # complete already


def test_a_lossless_store_says_nothing_of_it(tmp_path):
    terrain = store.build(source(HEIGHTS), tmp_path / "s", **SIZES)
    record = json.loads((tmp_path / "s/zarr.json").read_text())["attributes"]["orograph"]
    assert "codec" not in record and record["needs"] == [] and terrain.record.coding is None
    np.testing.assert_array_equal(full(terrain), HEIGHTS)


def test_neighbours_agree_along_their_border(tmp_path):
    """Whatever else is in a store, a sample becomes the same height."""
    parts = [HEIGHTS[:, :150], HEIGHTS[:, 149:]]
    a, b = (store.build(source(p), tmp_path / str(i), max_error=0.3, **SIZES) for i, p in enumerate(parts))
    np.testing.assert_array_equal(full(a)[:, -1], full(b)[:, 0])


@pytest.mark.parametrize("step", OWN_STEPS)
def test_the_data_s_own_steps(step, tmp_path):
    heights = rounded(rough((300, 260), 3, missing=0.02), step)
    terrain = store.build(source(heights), tmp_path / "s", max_error="auto", errors=(), **SIZES)
    coding = terrain.record.coding
    assert coding.step == step and coding.max_error is None and coding.largest == coding.rms == 0
    np.testing.assert_array_equal(full(terrain), heights)
    assert "every height as it was" in repr(info(str(tmp_path / "s")))


def test_data_without_steps_have_the_finest():
    coding = coding_of(source(HEIGHTS), "portable", "auto")
    assert coding.step == FINEST and coding.max_error is None


def test_data_whose_steps_are_not_everywhere(tmp_path):
    heights = np.round(rough((1700, 1700), 3))
    heights[100, 100] += np.float32(0.25)  # between the windows that are looked at
    warned = []

    class Heard(Progress):
        def warn(self, text: str) -> None:
            warned.append(text)

    terrain = store.build(source(heights), tmp_path / "s", max_error="auto", errors=(), progress=Heard())
    assert terrain.record.coding.largest == 0.25
    assert len(warned) == 1 and "steps of 1 m, but others are not" in warned[0]


def test_what_is_resampled_has_a_tenth_of_its_source_s_step(tmp_path):
    heights = np.round(rough((130, 100), 1, hole=True))
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=100, height=130, count=1, dtype="int16", crs="EPSG:4326",
        transform=Affine(1 / 1200, 0, -71.5, 0, -1 / 1200, 44.5), nodata=-32768,
    ) as file:  # fmt: skip
        file.write(np.where(np.isnan(heights), -32768, heights).astype(np.int16), 1)
    terrain = store.build(tmp_path / "a.tif", tmp_path / "s", max_error="auto", **SIZES)
    exact = store.build(tmp_path / "a.tif", tmp_path / "exact", **SIZES)
    step = terrain.record.coding.step
    assert step == 102 / 1024
    np.testing.assert_array_equal(full(terrain), rounded(full(exact), step))
    assert terrain.resampled != exact.resampled  # (it is of the heights that are drawn)
    assert terrain.resampled.largest == pytest.approx(exact.resampled.largest, abs=step)
    assert files(tmp_path / "s/source") == files(tmp_path / "exact/source")


@pytest.mark.parametrize("more", [None, 1])
def test_losses_are_those_of_a_shard_s_own_samples(more):
    heights, coding = rough((33, 33), 4, missing=0.1), Coding("compact", 0.5, 1.0)
    wanted = rounded(heights, 0.5) + np.float32(0.5 * (more or 0))
    kept = None if more is None else coding.heights.numbers(heights) + more
    found, (largest, squares) = coding.rounded(heights, 32, kept)
    np.testing.assert_array_equal(found, wanted)
    off = (wanted.astype(np.float64) - heights)[:32, :32]
    assert largest == np.nanmax(np.abs(off)) and squares == pytest.approx(np.nansum(off**2), rel=1e-12)


def test_what_cannot_be_kept_is_refused(tmp_path):
    for wrong in (0, -1, 1e-4, math.nan, math.inf, "some", None):
        with pytest.raises(UsageError, match="max_error"):
            store.build(source(HEIGHTS), tmp_path / "s", max_error=wrong)
    with pytest.raises(UsageError, match="codec"):
        store.build(source(HEIGHTS), tmp_path / "s", codec="zip")
    with pytest.raises(UsageError, match=r"compact stores whole numbers of steps, not float32.*auto"):
        store.build(source(HEIGHTS), tmp_path / "s", codec="compact")
    with pytest.raises(UsageError, match=r"1e\+09 m cannot be stored.*larger error"):
        store.build(source(HEIGHTS + np.float32(1e9)), tmp_path / "s", max_error=0.1)


@pytest.mark.cases(1)
def test_damage_is_named_and_mended(built, tmp_path):
    area = shutil.copytree(built, tmp_path / "s")
    whole = files(area)
    for key in (
        "heights/0/height/c/1/1",
        "heights/1/height/c/0/1",
        "mean/1/height/c/0/0",
        "heights/0/height/zarr.json",
    ):
        content = bytearray((area / key).read_bytes())
        content[len(content) // 5] ^= 4
        (area / key).write_bytes(content)
    with store.open(area) as terrain:
        assert {key.partition("[")[0] for key in terrain.check()} == {
            key for key in whole if whole[key] != files(area)[key]
        }
        with pytest.raises(DamagedChunkError, match=r"heights/[01]/height/c/[01]/1\[.*fails its checksum"):
            full(terrain)
    repair(area, source(HEIGHTS))
    assert files(area) == whole


def test_what_passes_its_checksum_but_is_no_chunk_is_damage(built):
    spec = store.open(built)._array("heights", 0).spec
    for data in (b"", b"orograph", bytes(100), b"\xff" * 300):
        with pytest.raises((ValueError, RuntimeError)):
            spec.decompressed(data)


def test_an_older_reader_is_told(built, tmp_path, monkeypatch):
    monkeypatch.setattr("orograph.store.layout.KNOWN", frozenset())
    with pytest.raises(StoreError, match="needs a reader that knows codec"):
        store.open(built)


@pytest.mark.parametrize("error", [0.1, 0.5, "auto"])
def test_other_readers(tmp_path, error):
    zarr, tensorstore, xarray = (pytest.importorskip(name) for name in ("zarr", "tensorstore", "xarray"))
    heights = HEIGHTS if error != "auto" else rounded(HEIGHTS, 0.01)
    terrain = store.build(source(heights), tmp_path / "s", max_error=error, errors=(), **SIZES)
    step = terrain.record.coding.step
    for path, ours in (("heights/0", full(terrain)), ("mean/1", terrain.read_mean(1, 0, 150, 0, 130))):
        opened = xarray.open_zarr(tmp_path / "s", group=path)
        np.testing.assert_array_equal(opened.height.values.astype(np.float32), ours)
        assert opened.sizes == {"y": ours.shape[0], "x": ours.shape[1]}
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(tmp_path / "s" / path / "height")}}
        numbers = tensorstore.open(spec).result().read().result()
        np.testing.assert_array_equal(numbers, zarr.open_group(tmp_path / "s", mode="r")[f"{path}/height"][:])
        said = zarr.open_group(tmp_path / "s", mode="r")[f"{path}/height"].attrs
        by_hand = np.where(numbers == said["_FillValue"], np.nan, numbers * said["scale_factor"] + said["add_offset"])
        np.testing.assert_array_equal(by_hand.astype(np.float32), ours)
        assert said["scale_factor"] == (step if path == "heights/0" else step / 4)


def test_zarrita_reads_them(tmp_path):
    """zarrita.js, where NODE_PATH (or ./node_modules) has it: ``npm install zarrita``."""
    modules = Path(os.environ.get("NODE_PATH", "node_modules")).absolute()
    if shutil.which("node") is None or not (modules / "zarrita").is_dir():
        pytest.skip("there is no zarrita")
    (tmp_path / "node_modules").symlink_to(modules)
    terrain = store.build(source(HEIGHTS), tmp_path / "s", max_error=0.1, errors=(), **SIZES)
    (tmp_path / "read.mjs").write_text(
        "import * as zarr from 'zarrita'; import { FileSystemStore } from '@zarrita/storage';\n"
        "import { writeFileSync } from 'fs';\n"
        "const root = zarr.root(new FileSystemStore('s'));\n"
        "for (const [name, path] of [['heights', 'heights/0/height'], ['means', 'mean/1/height']]) {\n"
        "  const array = await zarr.open(root.resolve(path), { kind: 'array' });\n"
        "  const { data } = await zarr.get(array), { scale_factor, _FillValue } = array.attrs;\n"
        "  writeFileSync(name, Float32Array.from(data, (n) => n === _FillValue ? NaN : n * scale_factor));\n"
        "}\n"
    )
    subprocess.run(["node", "read.mjs"], cwd=tmp_path, check=True, timeout=60)
    for name, ours in (("heights", full(terrain)), ("means", terrain.read_mean(1, 0, 150, 0, 130))):
        found = np.frombuffer((tmp_path / name).read_bytes(), np.float32).reshape(ours.shape)
        np.testing.assert_array_equal(found, ours)


def test_command_line(tmp_path):
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=260, height=300, count=1, dtype="float32",
        crs="EPSG:32611", transform=grid_of((300, 260)).transform, nodata=np.nan,
    ) as file:  # fmt: skip
        file.write(HEIGHTS, 1)
    dem, area = str(tmp_path / "dem.tif"), str(tmp_path / "a.oro")
    line = ["build", dem, "-o", area, "--codec", "portable", "--max-error"]
    ran = CliRunner().invoke(cli, [*line, "0.5"], catch_exceptions=False)
    assert "codec: portable, steps of 1 m: heights at most 0.5 m off, 0.29 m rms" in ran.output
    told = info(area)
    assert "codec    portable, steps of 1 m" in repr(told)
    assert told["codec"] | {"rms": 0} == {
        "name": "portable", "step": 1.0, "max_error": 0.5, "largest": pytest.approx(0.5, abs=0.01), "rms": 0,
    }  # fmt: skip
    ran = CliRunner().invoke(cli, [*line, "much"], catch_exceptions=False)
    assert ran.exit_code == 2 and "neither lossless, auto nor a number of metres" in ran.output
    ran = CliRunner().invoke(cli, ["build", "-o", area, "--repair", "--max-error", "1"])
    assert "--repair cannot be combined with --max-error" in str(ran.exception or ran.output)
