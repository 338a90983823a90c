"""Sizes, parts and headers of further formats that GDAL reads past; tags of TIFFs that contradict one another."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem import read
from orograph.errors import ReadError

from .test_tiff_layout import by_hand
from .test_whole import UTM, hill, made

COLS, ROWS = 83, 61
SIZED = [
    ("PNM", "a.pgm", "a.pgm", "uint8"), ("PNM", "a.pgm", "a.pgm", "uint16"), ("ROI_PAC", "a.dem", "a.dem", "int16"),
    ("WEBP", "a.webp", "a.webp", "uint8"), ("GIF", "a.gif", "a.gif", "uint8"), ("XPM", "a.xpm", "a.xpm", "uint8"),
    ("FIT", "a.fit", "a.fit", "uint8"), ("ZMap", "a.dat", "a.dat", "float32"), ("R", "a.rda", "a.rda", "float32"),
]  # fmt: skip


@pytest.mark.parametrize(("driver", "name", "data", "dtype"), SIZED, ids=[f"{s[0]} {s[3]}" for s in SIZED])
def test_bytes_put_in_or_cut_off(tmp_path: Path, driver: str, name: str, data: str, dtype: str) -> None:
    options = {"ASCII": "YES", "COMPRESS": "NO"} if driver == "R" else {}
    options |= {"LOSSLESS": "YES"} if driver == "WEBP" else {}
    if driver == "WEBP":
        (tmp_path / "made").mkdir()
        bands = np.stack([hill("uint8")] * 3)
        with rasterio.open(tmp_path / "made" / name, "w", driver=driver, height=ROWS, width=COLS, count=3,
                           dtype="uint8", transform=UTM, **options) as file:  # fmt: skip
            file.write(bands)
        path = tmp_path / "made" / name
    else:
        path = made(tmp_path / "made", driver, name, dtype, **options)
    whole = read(path).heights
    if driver != "XPM":  # whose numbers are those of its colours
        np.testing.assert_allclose(whole, hill(dtype), atol=1e-3)
    file_ = tmp_path / "made" / data
    there = file_.read_bytes()
    at = len(there) * 3 // 4
    line = there.rindex(b"\n", 0, at) + 1 if driver in ("ZMap", "R", "XPM") else at
    put = there[line : there.index(b"\n", line) + 1] if line != at else b"\x07\x08"
    for mutant in (there[:line] + put + there[line:], there[:at] + b"\x07\x07" + there[at:], there[: len(there) - 37]):
        file_.write_bytes(mutant)
        with pytest.raises(ReadError, match=path.name):
            read(path)


@pytest.mark.parametrize("kind", ["int16", "int32", "float64"])
def test_a_panorama_matrix_is_as_long_as_it_says(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.mtw"
    with rasterio.open(path, "w", driver="RMF", MTW="ON", height=ROWS, width=COLS, count=1, dtype=kind,
                       crs="EPSG:32611", transform=UTM) as file:  # fmt: skip
        file.write(hill(kind), 1)
    np.testing.assert_array_equal(read(path).heights, hill(kind).astype(np.float32))
    data = path.read_bytes()
    path.write_bytes(data[:-3000] + b"1" + data[-3000:])
    with pytest.raises(ReadError, match="header promises"):
        read(path)


def labelled(folder: Path, kind: str) -> tuple[Path, Path]:
    """The hill with a header of text: the file to open, and that of the samples."""
    raw = hill().astype("<i2" if kind == "GenBin" else ">i2").tobytes()
    header, data = folder / "a.hdr", folder / ("a.bil" if kind == "GenBin" else "a.raw")
    if kind == "GenBin":
        header.write_text(
            f"BANDS: 1\nROWS: {ROWS}\nCOLS: {COLS}\nINTERLEAVING: BIL\nDATATYPE: S16\nBYTE_ORDER: LSB\n"
            f"UL_X_COORDINATE: 500015\nUL_Y_COORDINATE: 4000015\nLR_X_COORDINATE: {500015 + 30 * (COLS - 1)}\n"
            f"LR_Y_COORDINATE: {4000015 - 30 * (ROWS - 1)}\n"
        )
        data.write_bytes(raw)
        return data, data
    if kind == "EIR":
        header.write_text(
            f"IMAGINE_RAW_FILE\nWIDTH {COLS}\nHEIGHT {ROWS}\nNUM_LAYERS 1\nPIXEL_FILES a.raw\nFORMAT BSQ\n"
            "DATATYPE S16\nBYTE_ORDER MSB\n"
        )
        data.write_bytes(raw)
        return header, data
    records = f"RECORD_TYPE = FIXED_LENGTH\nRECORD_BYTES = {2 * COLS}\nFILE_RECORDS = {ROWS}\n"
    header = folder / "a.lbl"
    header.write_text(
        f'PDS_VERSION_ID = PDS3\n{records}^IMAGE = "a.raw"\nOBJECT = IMAGE\n  LINES = {ROWS}\n'
        f"  LINE_SAMPLES = {COLS}\n  BANDS = 1\n  SAMPLE_TYPE = MSB_INTEGER\n  SAMPLE_BITS = 16\n"
        "END_OBJECT = IMAGE\nEND\n"
    )
    data.write_bytes(raw)
    return header, data


@pytest.mark.parametrize("kind", ["GenBin", "EIR", "PDS"])
def test_raw_samples_beside_a_label(tmp_path: Path, kind: str) -> None:
    path, data = labelled(tmp_path, kind)
    np.testing.assert_array_equal(read(path).heights, hill())
    there = data.read_bytes()
    for mutant in (there[:-2], there[:2000] + b"\r" + there[2000:]):
        data.write_bytes(mutant)
        with pytest.raises(ReadError):
            read(path)


@pytest.mark.parametrize(("kind", "change"), [("GenBin", ("S16", "S1")), ("EIR", ("DATATYPE S16\n", "")),
                                              ("PDS", ("MSB_INTEGER", "MSC_INTEGER"))])  # fmt: skip
def test_labels_that_are_damaged(tmp_path: Path, kind: str, change: tuple[str, str]) -> None:
    path, data = labelled(tmp_path, kind)
    header = data.with_suffix(".hdr") if kind == "GenBin" else path
    header.write_text(header.read_text().replace(*change))
    with pytest.raises(ReadError):
        read(path)


def test_a_place_beside_a_pnm_that_is_no_number(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "PNM", "a.pgm", "uint8")
    notes = Path(f"{path}.aux.xml")
    notes.write_text(notes.read_text().replace(", -", ", -\n", 1))
    with pytest.raises(ReadError, match=r"place|GeoTransform"):
        read(path)


def entry(path: Path, tag: int) -> int:
    """Where a tag stands in the first directory of a small TIFF."""
    data = path.read_bytes()
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    return next(at for i in range(count) if struct.unpack_from("<H", data, at := first + 2 + 12 * i) == (tag,))


CHANGED = {
    "twice": (262, 0, struct.pack("<H", 259), "twice"),
    "more strips than the size asks for": (257, 8, struct.pack("<H", 30), "requires"),
    "strips of fewer rows": (278, 8, struct.pack("<H", 14), r"requires|bytes"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_tags_that_contradict_one_another(tmp_path: Path, name: str) -> None:
    tag, at, put, said = CHANGED[name]
    path = by_hand(tmp_path / "a.tif")
    place = entry(path, tag) + at
    data = path.read_bytes()
    path.write_bytes(data[:place] + put + data[place + len(put) :])
    with pytest.raises(ReadError, match=said):
        read(path)


@pytest.mark.parametrize(("at", "put"), [(2, struct.pack("<H", 0x0C)), (4, struct.pack("<I", 2))])
def test_a_predictor_that_libtiff_passes_over(tmp_path: Path, at: int, put: bytes) -> None:
    """Heights would be the differences of neighbours."""
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", compress="lzw",
                       predictor=2, transform=UTM) as file:  # fmt: skip
        file.write(hill(), 1)
    np.testing.assert_array_equal(read(path).heights, hill())
    place = entry(path, 317) + at
    data = path.read_bytes()
    path.write_bytes(data[:place] + put + data[place + len(put) :])
    with pytest.raises(ReadError, match="invalid type"):
        read(path)


def test_a_strip_with_a_place_and_no_size_or_the_place_of_another(tmp_path: Path) -> None:
    path = by_hand(tmp_path / "a.tif")
    data = path.read_bytes()
    places, sizes = (struct.unpack_from("<I", data, entry(path, tag) + 8)[0] for tag in (273, 279))
    for at, put, said in ((sizes + 4, bytes(4), "no size"), (places + 4, data[places : places + 4], "twice")):
        path.write_bytes(data[:at] + put + data[at + 4 :])
        with pytest.raises(ReadError, match=said):
            read(path)


def test_a_mask_that_is_none_any_more(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(
        path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", crs="EPSG:32611",
        transform=Affine(30, 0, 500_000, 0, -30, 4_000_000),
    ) as file:  # fmt: skip
        file.write(hill(), 1)
        file.write_mask((hill() > 900).astype(np.uint8) * 255)
    assert np.isnan(read(path).heights).any()
    data = path.read_bytes()
    at = data.index(struct.pack("<HHII", 254, 4, 1, 4))
    path.write_bytes(data[: at + 8] + bytes(4) + data[at + 12 :])
    with pytest.raises(ReadError, match="mask"):
        read(path)
