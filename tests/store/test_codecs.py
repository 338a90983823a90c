"""The codecs *compact* and *smallest*: any whole numbers come back, their bytes are as documented, and damaged ones are
told."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import compact_reference
import numpy as np
import pytest
import rasterio
import smallest_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import rough, source

from orograph import store
from orograph.store import compact, smallest

MISSING = -(2**31)
BOTH = pytest.mark.parametrize("codec", [compact, smallest], ids=["compact", "smallest"])
REFERENCE = {compact: compact_reference, smallest: smallest_reference}
ROOT = Path(__file__).parents[2]


def is_kept(codec, whole, **how):
    """A chunk comes back, from the kernels and from the page's decoder; its bytes."""
    data = codec.compressed(whole, **how)
    np.testing.assert_array_equal(codec.decompressed(data, whole.shape), whole)
    np.testing.assert_array_equal(REFERENCE[codec].decoded(data, whole.shape), whole)
    return data


def numbers(shape, seed, step=0.1, missing=0.0):
    heights = rough(shape, seed, missing)
    found = np.round(heights / np.float64(step))
    return np.where(np.isnan(found), MISSING, found).astype(np.int32)


def city(side, seed):
    """Level ground, roofs, and trees between them: numbers, of which the codec *smallest* tests the surroundings."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:side, :side]
    whole = 30.0 * (rows + 2 * cols) / side + rng.normal(0, 2, (side, side))
    for row, col in rng.integers(0, side, (side // 3, 2)):
        whole[row : row + 20, col : col + 14] = rng.integers(200, 3000)
    trees = (rows // 13 + cols // 9) % 3 == 0
    whole[trees] += rng.normal(300, 200, (side, side))[trees]
    return np.rint(whole).astype(np.int32)


def test_tests_choose_among_eight_sets_of_weights():
    whole = city(128, 1)
    assert is_kept(smallest, whole)[2] == 8
    whole[40:60, 30:90] = MISSING
    assert is_kept(smallest, whole)[2] == 8
    assert is_kept(smallest, numbers((128, 128), 3))[2] == 1


@BOTH
@settings(deadline=None, max_examples=30)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 2**20), st.integers(-(2**31) + 1, 2**31 - 1))
def test_a_common_factor_is_stored_once(codec, rows, cols, factor, origin):
    """Whole metres in steps of a tenth take the space of whole metres, and differences wrap around as int32 does."""
    whole = numbers((rows, cols), rows * 41 + cols, 5.0, 0.1)
    apart = (origin + factor * whole.astype(np.int64) + 2**31) % 2**32 - 2**31
    apart = np.where(whole == MISSING, MISSING, apart).astype(np.int32)
    data = is_kept(codec, apart)
    if abs(origin) + factor * np.abs(np.where(whole == MISSING, 0, whole).astype(np.int64)).max() < 2**31:
        assert len(data) == len(codec.compressed(whole))


@BOTH
@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 70), st.integers(1, 60), st.sampled_from([1e-6, 1e-3, 0.1, 5.0, 1e4]),
    st.sampled_from([0.0, 0.02, 0.6, 1.0]),
)  # fmt: skip
def test_any_numbers_come_back(codec, rows, cols, step, missing):
    is_kept(codec, numbers((rows, cols), rows * 41 + cols, step, missing))


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 70), st.integers(1, 60), st.sampled_from([1e-6, 0.1, 5.0]), st.sampled_from([0.0, 0.2, 1.0]))
def test_numbers_of_which_a_quarter_is_known_come_back(rows, cols, step, missing):
    whole = numbers((rows, cols), rows * 41 + cols, step, missing)
    whole[::2, ::2] = np.where(whole[::2, ::2] == MISSING, MISSING, 0)
    is_kept(smallest, whole, nested=True)


@BOTH
@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.sampled_from([1, 3, 8, 20, 30, 31]), st.integers(1, 70))
def test_noise_of_any_size_comes_back(codec, seed, bits, side):
    whole = np.random.default_rng(seed).integers(-(2**bits), 2**bits, (side, side)).astype(np.int32)
    whole[:: side // 3 + 1] = 2**31 - 1
    is_kept(codec, whole)


@BOTH
def test_a_flat_chunk_and_a_plane_take_next_to_nothing(codec):
    rows, cols = np.mgrid[:256, :256]
    for whole in (np.full((256, 256), 7), 3 * rows - 2 * cols, np.where(rows > 100, MISSING, 5)):
        data = codec.compressed(whole.astype(np.int32))
        np.testing.assert_array_equal(codec.decompressed(data, (256, 256)), whole)
        assert len(data) < 1500


def test_compact_is_smaller_than_lorenzo_with_zstd():
    from orograph._blosc import blosc

    whole = numbers((256, 256), 4, 0.1)
    around = np.pad(whole, ((1, 0), (1, 0)), mode="edge")
    left = (whole - around[1:, :-1] - around[:-1, 1:] + around[:-1, :-1]).astype(np.int32)
    lorenzo = min(len(blosc.compress(left, b"zstd", level, blosc.SHUFFLE, 1 << 18)) for level in (1, 5))
    assert len(compact.compressed(whole)) <= 0.95 * lorenzo


def test_codes_of_frequencies_take_the_fewest_bits():
    """Against all codes that three symbols can have."""
    from orograph.store.codec_write import LN2, WEIGHT, decided_codes

    codes = np.indices((48, 48, 48)).reshape(3, -1)
    steps = np.diff(codes, axis=0)
    table = np.abs(codes[0] - 36) + np.where(steps >= 0, steps + 2, 1 - steps).sum(0)
    rng = np.random.default_rng(1)
    for counts in [*rng.integers(0, [9, 90, 900], (5, 3)), np.array([500, 0, 3])]:
        with np.errstate(divide="ignore", invalid="ignore"):
            told = np.where(counts > 0, counts * (12 - np.log2(WEIGHT[codes.T])), 0).sum(1)
        bits = table + told + WEIGHT[codes].sum(0) * counts.sum() / (4096 * LN2)
        found = np.zeros(256, np.int64)
        decided_codes(counts, found)
        assert bits[np.flatnonzero((found[:3] == codes.T).all(1))[0]] <= bits.min() + 0.001 * counts.sum()


@BOTH
@pytest.mark.parametrize("whole", [numbers((64, 64), 5), numbers((64, 64), 5, missing=0.3), city(128, 3)])
def test_damaged_bytes_are_told_or_give_other_numbers(codec, whole):
    """Whatever bytes: an error or numbers, never a crash; what is cut off, or has more behind it, is always told."""
    data, rng = codec.compressed(whole), np.random.default_rng(1)
    for length in [*range(200), *rng.integers(0, len(data), 100)]:
        with pytest.raises(ValueError, match="cannot be decoded"):
            codec.decompressed(data[:length], whole.shape)
    with pytest.raises(ValueError, match="stream ends in the wrong place"):
        codec.decompressed(data + b"ab", whole.shape)
    told = 0
    for k in [*range(min(len(data), 600)), *rng.integers(0, len(data), 1000)]:
        changed = bytearray(data)
        changed[k] ^= 1 << rng.integers(8)
        try:
            codec.decompressed(bytes(changed), whole.shape)
        except ValueError:
            told += 1
    assert told > 1000
    for size in rng.integers(0, 3000, 300):
        noise = bytes([3 + (codec is smallest), rng.integers(3), rng.choice([1, 4, 8]), 0]) + rng.bytes(size)
        with pytest.raises(ValueError, match="cannot be decoded"):
            codec.decompressed(noise, (64, 64))


@pytest.mark.parametrize("codec", ["compact", "smallest"])
def test_zarr_finds_it_by_its_entry_point(codec, tmp_path):
    """In a process that imports no Orograph by itself, with the entry points that are declared."""
    pytest.importorskip("zarr")
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["zarr.codecs"]
    info = tmp_path / "path" / "told-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: told\nVersion: 1\n")
    lines = "".join(f"{name} = {place}\n" for name, place in points.items())
    (info / "entry_points.txt").write_text(f"[zarr.codecs]\n{lines}")
    heights = rough((90, 70), 2, missing=0.05)
    terrain = store.build(source(heights), tmp_path / "s", codec=codec, max_error=0.5, shard=64, chunk=16)
    code = (
        "import sys, zarr, numpy; "
        "numpy.save(sys.argv[2], zarr.open_group(sys.argv[1], mode='r')['heights/0/height'][:]); "
        "a = zarr.open_group(sys.argv[1], mode='r')['heights/0/height']; "
        "b = zarr.create_array(sys.argv[3], shape=(50, 30), chunks=(16, 16), dtype='int32', fill_value=0, "
        "serializer=a.metadata.codecs[0].codecs[0], compressors=None); b[:] = a[:50, :30]; "
        "assert (zarr.open_array(sys.argv[3])[:] == a[:50, :30]).all()"
    )
    path = f"{tmp_path / 'path'}:{ROOT / 'src'}"
    subprocess.run(
        [sys.executable, "-c", code, tmp_path / "s", tmp_path / "n.npy", tmp_path / "again"],
        check=True, env={"PYTHONPATH": path, "PATH": ""}, timeout=120,
    )  # fmt: skip
    kept = terrain.read(0, 0, 90, 0, 70)
    np.testing.assert_array_equal(np.load(tmp_path / "n.npy"), np.where(np.isnan(kept), MISSING, kept))


@BOTH
@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node")
def test_the_decoder_for_browsers(codec, tmp_path):
    rng = np.random.default_rng(3)
    wholes = [numbers((61, 50), 1, 0.1, 0.3), numbers((32, 64), 2, 1e-5), numbers((9, 3), 3), numbers((1, 1), 4)]
    wholes += [rng.integers(-(2**31), 2**31, (20, 21)).astype(np.int32), np.full((8, 8), MISSING, np.int32)]
    wholes += [np.where(np.mgrid[:40, :40][0] > 20, MISSING, numbers((40, 40), 6)).astype(np.int32)]
    all_data = [codec.compressed(whole) for whole in wholes]
    if codec is smallest:
        nested = numbers((33, 34), 7)
        nested[::2, ::2] = 0
        wholes += [city(128, 2), nested]
        all_data.append(smallest.compressed(city(128, 2)))
        all_data.append(smallest.compressed(nested, nested=True))
    for k, data in enumerate(all_data):
        (tmp_path / f"{k}.chunk").write_bytes(data)
    for script in (ROOT / "src/orograph/store/browser").glob("*.js"):
        shutil.copy(script, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    name = codec.NAME.partition(".")[2]
    (tmp_path / "all.js").write_text(
        f"import {{ decode }} from './{name}.js'; import {{ readFileSync, writeFileSync }} from 'fs';\n"
        f"for (const [k, [rows, cols]] of {[list(whole.shape) for whole in wholes]}.entries()) {{\n"
        "  const data = new Uint8Array(readFileSync(`${k}.chunk`));\n"
        "  writeFileSync(`${k}.out`, decode(data, rows, cols));\n"
        "  let told = 0;\n"
        "  for (const wrong of [data.subarray(0, data.length - 1), data.subarray(0, 9), new Uint8Array(0),\n"
        "    new Uint8Array([...data, 1, 2])])\n"
        "    try { decode(wrong, rows, cols) } catch (e) { if (e instanceof RangeError) told++ }\n"
        "  if (told != 4) throw new Error(`${k}: ${told}`);\n"
        "}\n"
    )
    subprocess.run(["node", "all.js"], cwd=tmp_path, check=True, timeout=120)
    for k, whole in enumerate(wholes):
        found = np.frombuffer((tmp_path / f"{k}.out").read_bytes(), "<i4").reshape(whole.shape)
        np.testing.assert_array_equal(found, whole)


@pytest.mark.parametrize(
    ("path", "step"),
    [("n44w072-hgt/N44W072.hgt", 1.0), ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", 1.0),
     ("nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif", 0.01),
     ("nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif", 204 / 1024),
     ("lsd-topo/gabilan.tif", 204 / 1024)],
)  # fmt: skip
def test_smallest_is_not_larger_than_jpeg_xl(path, step, shared_data):
    imagecodecs = pytest.importorskip("imagecodecs")
    with rasterio.open(shared_data / path) as file:
        heights = file.read(1, masked=True).astype(np.float64).filled(np.nan)
    ours = theirs = count = 0
    for row in range(0, heights.shape[0] - 255, 256):
        for col in range(0, heights.shape[1] - 255, 256):
            part = heights[row : row + 256, col : col + 256]
            if np.isnan(part).any() or count == 9:
                continue
            whole = np.rint(part / step).astype(np.int32)
            count, ours = count + 1, ours + len(smallest.compressed(whole))
            theirs += len(imagecodecs.jpegxl_encode((whole - whole.min()).astype(np.uint16), lossless=True, effort=7))
    assert 0 < ours <= theirs
