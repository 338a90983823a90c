"""Every file of nasty-gdal (GDAL's own odd and broken test files) is read right or refused clearly, in bounded memory.

The table says which, and why; its numbers are GDAL's (rasterio's masked array, scaled), not this reader's. A file that
is not in it, or is not there, fails the test.
"""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import rasterio

from orograph.dem import read
from orograph.errors import ReadError


class Reads(NamedTuple):
    shape: tuple[int, int]
    valid: int
    low: float | None
    high: float | None
    why: str


class Fails(NamedTuple):
    says: str
    why: str


TABLE: dict[str, Reads | Fails] = {
    "1bit_2bands.tif": Reads((32, 32), 1024, 0.0, 1.0, "1-bit samples, band 1 of 2"),
    "GTModelTypeGeoKey_only.tif": Reads((20, 20), 400, 74.0, 255.0, "a nameless local CRS and no place"),
    "bigtiff_header_extract.tif": Fails("37.3 GiB of memory", "declares 100000 × 100000, has 252 bytes"),
    "byte_JXL.tif": Fails("codec JXL", "JPEG XL is not in every GDAL"),
    "byte_LERC_ZSTD_tiled.tif": Reads((20, 20), 400, 74.0, 255.0, "LERC inside ZSTD"),
    "byte_bigtiff_invalid_slong8_for_stripoffsets.tif": Reads((20, 20), 400, 74.0, 255.0, "a tag of a wrong type"),
    "byte_bigtiff_strip5lines.tif": Reads((20, 20), 400, 74.0, 255.0, "BigTIFF"),
    "byte_gcp.tif": Reads((20, 20), 400, 74.0, 255.0, "control points only"),
    "byte_gcp_pixelispoint.tif": Reads((20, 20), 400, 74.0, 255.0, "control points, point"),
    "byte_lerc.tif": Reads((20, 20), 400, 74.0, 255.0, "LERC"),
    "byte_nogeoref.tif": Reads((20, 20), 400, 74.0, 255.0, "no place"),
    "byte_rpc.tif": Reads((20, 20), 400, 74.0, 255.0, "RPC only"),
    "cfloat32.tif": Fails("complex", "complex"),
    "cint16.tif": Fails("complex", "complex integers"),
    "cog_sparse_strile_arrays_zeroified_when_possible.tif": Reads(
        (512, 512), 262144, 0.0, 255.0, "sparse: blocks left out are 0, as there is no nodata value"
    ),
    "compound_with_VerticalCitationGeoKey_only.tif": Reads((20, 20), 400, 74.0, 255.0, "compound CRS"),
    "corrupted_deflate_singlestrip.tif": Fails("block of rows 0–0, columns 0–19", "damaged deflate stream"),
    "dbl_min.tif": Reads((1, 4), 3, 0.0, 1.0, "nodata DBL_MIN is not 0"),
    "empty_nodata.tif": Reads((1, 1), 1, 115.0, 115.0, "an empty nodata tag is none"),
    "excessive-memory-TIFFFillStrip2.tif": Fails("506 MiB each", "65535 interleaved bands, truncated"),
    "float16.tif": Reads((20, 20), 400, 74.0, 255.0, "half floats"),
    "float24.tif": Reads((20, 20), 400, 74.0, 255.0, "24-bit floats"),
    "float32.tif": Reads((20, 20), 400, 74.0, 255.0, "plain"),
    "float32_LZW_predictor_3.tif": Reads((20, 20), 400, 74.0, 255.0, "float predictor"),
    "float32_almost_nodata_max_float32.tif": Reads((2, 2), 3, 0.0, 0.0, "a value a few ulps from its nodata tag"),
    "float32_lzw_predictor_3_big_endian.tif": Reads((20, 20), 400, 74.0, 255.0, "big-endian, float predictor"),
    "float32_minwhite.tif": Reads(
        (1, 1), 1, 0.5763584971427917, 0.5763584971427917, "one sample; min-is-white is a matter of pictures"
    ),
    "float32_with_nodata_slightly_above_float_max.tif": Reads(
        (1, 100), 85, -1.0989999771118164, 0.703338623046875, "nodata tag above FLT_MAX"
    ),
    "float64.tif": Reads((20, 20), 400, 74.0, 255.0, "doubles"),
    "float64_LZW_predictor_3.tif": Reads((20, 20), 400, 74.0, 255.0, "doubles, predictor"),
    "flt_min.tif": Reads((1, 4), 3, 0.0, 1.0, "nodata FLT_MIN is not 0"),
    "geoloc_triangles.tif": Reads((15, 15), 225, -111388.265625, -103832.40625, "geolocation arrays only"),
    "geolocation_arrays_lon180_lon360.tif": Reads((10, 5), 50, 1.0, 50.0, "a band of geolocation arrays"),
    "geomatrix.tif": Reads((20, 20), 400, 74.0, 255.0, "rotated, point"),
    "huge-number-strips.tif": Fails("cannot open", "directory larger than the file"),
    "huge4GB.tif": Fails("16.0 GiB of memory", "declares 65535 × 65535, has 401 bytes"),
    "hugeblocksize.tif": Fails("cannot open", "blocks of 2^31 columns"),
    "image_width_above_32bit.tif": Fails("cannot open", "more than 2^31 columns"),
    "int10.tif": Reads((20, 20), 400, 74.0, 255.0, "10-bit"),
    "int12.tif": Reads((20, 20), 400, 74.0, 255.0, "12-bit"),
    "int16.tif": Reads((20, 20), 400, 74.0, 255.0, "plain"),
    "int16_big_endian.tif": Reads((20, 20), 400, 74.0, 255.0, "big-endian"),
    "int24.tif": Reads((20, 20), 400, 74.0, 255.0, "24-bit"),
    "int32.tif": Reads((20, 20), 400, 74.0, 255.0, "plain"),
    "int64_full_range.tif": Reads((1, 2), 2, -10000000000.0, 10000000000.0, "int64, kept to 24 bits"),
    "lzw_corrupted.tif": Fails("block of rows 0–0, columns 0–1", "damaged LZW stream"),
    "many_blocks_truncated.tif": Fails("block of rows 0–0, columns 0–0", "16 777 215 blocks declared, none there"),
    "minfloat.tif": Reads((1, 4), 2, -3.0, 5.0, "nodata -FLT_MAX"),
    "missing_tilebytecounts_and_offsets.tif": Fails("block of rows 0–15, columns 0–15", "no table of tiles"),
    "n43.dt0": Reads((121, 121), 14641, 75.0, 460.0, "DTED"),
    "n43_bad_crc.dt0": Fails("columns 0–0", "DTED of a wrong checksum, which GDAL tolerates"),
    "nan32.tif": Reads((10, 10), 90, 50.0, 58.0, "NaN, not declared"),
    "nan32_nodata.tif": Reads((10, 10), 90, 50.0, 58.0, "NaN, declared"),
    "nan64.tif": Reads((50, 10), 450, 50.0, 58.0, "NaN of doubles"),
    "non_standard_tiled_blockysize_one.tif": Reads((1, 3), 3, 1.0, 1.0, "tiles of one row"),
    "oddsize1bit.tif": Reads((99, 99), 9801, 0.0, 1.0, "1-bit with a colour table"),
    "orog_CRCM1.nc": Reads((115, 140), 16100, 0.0, 3233.0, "netCDF orography"),
    "record_1025_ending_with_linefeed.dem": Reads((3, 1024), 2048, 90.0, 206.0, "USGS DEM with odd records"),
    "rotated_pole.nc": Reads((108, 137), 5507, -37.779998779296875, 14.75999927520752, "rotated pole, scaled, Celsius"),
    "scanline_more_than_2GB.tif": Fails("4,096 MiB each", "one line of 2^31 samples"),
    "separate_tiled.tif": Reads((37, 35), 1295, 0.0, 70.0, "three planar bands of 8 bits"),
    "sparse_nodata_one.tif": Reads((1, 1), 0, None, None, "sparse: nothing but nodata"),
    "sparse_tiled_separate.tif": Reads((21, 40), 0, None, None, "sparse, planar: nothing but nodata"),
    "sstgeo.tif": Reads((39, 60), 2340, -89.9793701171875, -79.74603271484375, "longitudes as a band"),
    "stats_nodata_neginf.tif": Reads((1, 3), 2, -2.0, 1.0, "nodata -inf"),
    "stats_nodata_posinf.tif": Reads((1, 3), 2, -2.0, 1.0, "nodata +inf"),
    "ter6test.ter": Reads(
        (96, 64), 6144, 11.384688377380371, 96.72213745117188, "Leveller: scaled, south-up, CRS in feet"
    ),
    "test3_with_mask_8bit.tif": Reads((20, 20), 100, 127.0, 127.0, "mask per band"),
    "test_with_mask_1bit.tif": Reads((20, 20), 100, 127.0, 127.0, "mask band"),
    "test_with_mask_8bit.tif": Reads((20, 20), 100, 127.0, 127.0, "mask band"),
    "tiff_dos_strip_chop.tif": Fails("512 MiB each", "declares 2048 × 2^30, has 122 bytes"),
    "uint16_nodata_65535_bigtiff.tif": Reads((1, 1), 0, None, None, "nothing but nodata"),
    "uint64_full_range.tif": Reads((1, 2), 2, 0.0, 10000000000.0, "uint64, kept to 24 bits"),
    "unsupported_codec_unknown.tif": Fails("codec", "codec 44510 does not exist"),
    "utm.tif": Reads((512, 512), 262144, 0.0, 255.0, "plain"),
}
READABLE = {n: o for n, o in TABLE.items() if isinstance(o, Reads)}
BROKEN = {n: o for n, o in TABLE.items() if isinstance(o, Fails)}
SOUTH_UP = {"ter6test.ter"}  # flipped to north-west first; of files without a place the rows run south already


@pytest.fixture(scope="module")
def nasty(shared_data: Path) -> Path:
    return shared_data / "nasty-gdal"


def test_every_file_is_accounted_for(nasty: Path) -> None:
    assert {p.name for p in nasty.iterdir() if not p.name.startswith("SOURCE")} == set(TABLE)


@pytest.mark.parametrize("name", sorted(READABLE))
def test_it_reads(nasty: Path, name: str) -> None:
    expected = READABLE[name]
    dem = read(nasty / name)
    assert dem.heights.shape == dem.grid.shape == expected.shape
    assert int(dem.valid.sum()) == expected.valid
    if expected.valid:
        assert float(np.nanmin(dem.heights)) == expected.low and float(np.nanmax(dem.heights)) == expected.high
    with warnings.catch_warnings(), rasterio.open(nasty / name) as dataset:
        warnings.simplefilter("ignore")
        raw = dataset.read(1, masked=True)
        truth = np.asarray(raw.data, np.float64)
        missing = np.ma.getmaskarray(raw) | ~(np.abs(truth) < 1e30)
        truth = np.where(missing, np.nan, truth * dataset.scales[0] + dataset.offsets[0]).astype(np.float32)
    np.testing.assert_array_equal(dem.heights, truth[::-1] if name in SOUTH_UP else truth)


@pytest.mark.parametrize("name", sorted(BROKEN))
def test_it_is_refused(nasty: Path, name: str) -> None:
    try:
        dem = read(nasty / name)
    except ReadError as error:
        assert BROKEN[name].says in str(error)
        assert name in str(error) and error.remedy
    else:  # a GDAL with JPEG XL
        assert name == "byte_JXL.tif" and (dem.heights.min(), dem.heights.max()) == (74, 255)


WATCHED = """
import json, resource, sys, time
from orograph.verbs.info import info
from orograph.dem import Source, read
from orograph.errors import OrographError
from orograph.progress import SILENT
import rasterio.enums, scipy, pyproj
LIMIT = 3 << 30
resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT))
def corner(path):
    with Source.open(path) as source:
        rows, cols = source.shape
        source.read(rows - 1, rows, cols - 1, cols)
        source.read(0, min(rows, 4096), 0, min(cols, 64), step=64)
for path in sys.argv[1:]:
    for what in (lambda p: read(p, progress=SILENT), corner, lambda p: info(p, progress=SILENT, exact=None, jobs=2)):
        before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
        try:
            what(path)
            ended = "read"
        except OrographError as error:
            ended = type(error).__name__
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(json.dumps([path, ended, time.perf_counter() - start, (after - before) / 1024]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in KiB on Linux only")
def test_memory_and_time_are_bounded(nasty: Path) -> None:
    """All of it in one process that may not have more than 3 GiB of address space: read, a far corner, info."""
    paths = [str(nasty / name) for name in sorted(TABLE)]
    run = subprocess.run([sys.executable, "-c", WATCHED, *paths], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-2000:]
    assert run.stderr == ""  # GDAL does not talk past us
    rows = [json.loads(line) for line in run.stdout.splitlines()]
    assert len(rows) == 3 * len(TABLE)
    for path, ended, seconds, grown in rows:
        expected = TABLE[Path(path).name]
        assert seconds < 10, (path, seconds)
        assert grown < 200, (path, grown)  # MiB
        if isinstance(expected, Reads):
            assert ended == "read", path
        elif Path(path).name != "byte_JXL.tif":
            assert ended == "ReadError", path
