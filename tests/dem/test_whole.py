"""What GDAL's drivers read past: sizes that differ, headers that are damaged, parts that are lost."""

from __future__ import annotations

import gzip
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.shutil import copy

from orograph.dem import read
from orograph.errors import ReadError

UTM = Affine(30, 0, 500_000, 0, -30, 4_000_000)
ROWS, COLS = 61, 83


def hill(dtype: str = "int16") -> np.ndarray:
    row, col = np.mgrid[:ROWS, :COLS]
    values = 900 + 300 * np.sin(col / 9) * np.cos(row / 7) + (row * 7 + col * 13) % 11
    return (values / 6 if dtype == "uint8" else values).astype(dtype)


def made(folder: Path, driver: str, name: str, dtype: str = "int16", **more: object) -> Path:
    """The hill in a format that GDAL writes."""
    folder.mkdir(exist_ok=True)
    plain = folder.parent / "hill.tif"
    with rasterio.open(plain, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype=dtype, crs="EPSG:32611",
                       transform=UTM) as file:  # fmt: skip
        file.write(hill(dtype), 1)
    copy(str(plain), str(folder / name), driver=driver, **more)
    return folder / name


def altered(path: Path, change: tuple[bytes, bytes] | bytes) -> None:
    """One text in a file for another, or bytes put in before its last hundred."""
    data = path.read_bytes()
    if isinstance(change, bytes):
        data = data[:-100] + change + data[-100:]
    else:
        if b"\r\n" in data:
            change = change[0].replace(b"\n", b"\r\n"), change[1].replace(b"\n", b"\r\n")
        assert change[0] in data
        data = data.replace(*change, 1)
    path.write_bytes(data)


RAW = [
    ("ENVI", "a.img", "a.img"), ("EHdr", "a.bil", "a.bil"), ("ERS", "a.ers", "a"), ("RST", "a.rst", "a.rst"),
    ("SAGA", "a.sdat", "a.sdat"), ("ILWIS", "a.mpr", "a.mp#"), ("PAux", "a.raw", "a.raw"),
    ("RRASTER", "a.grd", "a.gri"), ("ISCE", "a.isce", "a.isce"), ("SIGDEM", "a.sigdem", "a.sigdem"),
    ("BT", "a.bt", "a.bt"), ("GSBG", "a.grd", "a.grd"), ("GS7BG", "a.grd", "a.grd"), ("GTX", "a.gtx", "a.gtx"),
    ("KRO", "a.kro", "a.kro"), ("LAN", "a.lan", "a.lan"), ("PCRaster", "a.map", "a.map"), ("MFF", "a.hdr", "a.r00"),
    ("NITF", "a.ntf", "a.ntf"), ("netCDF", "a.nc", "a.nc"), ("ELAS", "a.elas", "a.elas"), ("VICAR", "a.vic", "a.vic"),
    ("ISIS3", "a.cub", "a.cub"), ("PDS4", "a.xml", "a.img"), ("BMP", "a.bmp", "a.bmp"),
]  # fmt: skip
KINDS = {"GTX": "float32", "KRO": "float32", "PCRaster": "float32", "MFF": "float32", "ELAS": "float32", "BMP": "uint8"}


@pytest.mark.parametrize(("driver", "name", "data"), RAW, ids=[raw[0] for raw in RAW])
def test_bytes_put_into_samples_are_noticed(tmp_path: Path, driver: str, name: str, data: str) -> None:
    dtype = KINDS.get(driver, "int16")
    path = made(tmp_path / "made", driver, name, dtype)
    np.testing.assert_array_equal(read(path).heights, hill(dtype))
    altered(tmp_path / "made" / data, b"\x07")
    with pytest.raises(ReadError, match=r"bytes|section|label") as told:
        read(path)
    assert told.value.remedy


HEADERS = [
    ("EHdr", "a.bil", "a.hdr", (b"BYTEORDER", b"BYTEORDFR"), "BYTEORDER"),
    ("EHdr", "a.bil", "a.hdr", (b"XDIM           30\n", b""), "XDIM"),
    ("EHdr", "a.bil", "a.hdr", (b"NBITS          16\n", b""), "BANDROWBYTES"),
    ("EHdr", "a.bil", "a.hdr", (b"ULXMAP         500015", b"ULXMAP         x"), "ULXMAP"),
    ("ENVI", "a.img", "a.hdr", (b"data type = 2\n", b""), "data type"),
    ("ENVI", "a.img", "a.hdr", (b"byte order = 0", b"byte order = 5"), "byte order"),
    ("ENVI", "a.img", "a.hdr", (b"band names = {\nBand 1}", b"band names = {\nBand 1"), "brace"),
    ("ERS", "a.ers", "a.ers", (b"Xdimension", b"Xdimensjon"), "Xdimension"),
    ("ERS", "a.ers", "a.ers", (b"CellInfo Begin", b"CellInfo Bexin"), "CellInfo"),
    ("ERS", "a.ers", "a.ers", (b"LSBFirst", b"LSBFisst"), "ByteOrder"),
    ("RST", "a.rst", "a.rdc", (b"min. X      : 500000", b"min. X      : 800000"), "min. X"),
    ("RST", "a.rst", "a.rdc", (b"flag value  : none\n", b""), "flag value"),
    ("SAGA", "a.sdat", "a.sgrd", (b"CELLSIZE\t= 30", b"CELLSIZE\t= -30"), "CELLSIZE"),
    ("SAGA", "a.sdat", "a.sgrd", (b"POSITION_XMIN", b"POSITION_XNIN"), "POSITION_XMIN"),
    ("RRASTER", "a.grd", "a.grd", (b"ymax=4000000", b"ymax=0"), "ymin"),
    ("PAux", "a.raw", "a.aux", (b"Swapped", b"Swa ped"), "ChanDefinition-1"),
    ("PAux", "a.raw", "a.aux", (b"UpLeftX: 500000", b"UpLeftX: 900000"), "UpLeftX"),
    ("MFF", "a.hdr", "a.hdr", (b"TOP_RIGHT_CORNER_LATITUDE", b"TOP_RIGHT_CORNER_LATLTUDE"), "TOP_RIGHT"),
    ("ILWIS", "a.mpr", "a.grf", (b"MinX=500000", b"MinX=x"), "minx"),
    ("ILWIS", "a.mpr", "a.grf", (b"lines=61", b"lines=60"), "60 × 83"),
    ("ILWIS", "a.mpr", "a.csy", (b"Projection=UTM\n", b""), "projection"),
    ("ILWIS", "a.mpr", "a.mpr", (b"Range=", b"Rang="), "range|Range"),
    ("ILWIS", "a.mpr", "a.mpr", (b"Type=Map\n", b"\x05\nType=Map\n"), ""),
    ("AAIGrid", "a.asc", "a.asc", (b"xllcorner    500000.000000000000\n", b""), "xll"),
    ("ISIS3", "a.cub", "a.cub", (b"Type       = SignedWord", b"Tyqe       = SignedWord"), "label"),
    ("MRF", "a.mrf", "a.mrf", (b'minx="500000"', b'minx="900000"'), "contradicts"),
]  # fmt: skip


@pytest.mark.parametrize(("driver", "name", "file", "change", "said"), HEADERS)
def test_a_damaged_header_is_noticed(
    tmp_path: Path, driver: str, name: str, file: str, change: tuple[bytes, bytes], said: str
) -> None:
    path = made(tmp_path / "made", driver, name, KINDS.get(driver, "int16"))
    if driver == "AAIGrid":
        header = (tmp_path / "made" / file).read_bytes()
        change = (re.findall(rb"xllcorner.*\n", header)[0], b"")
    if (driver, said) == ("ILWIS", ""):
        altered(tmp_path / "made" / file, change)
        np.testing.assert_array_equal(read(path).heights, hill())  # a line of no meaning does no harm
        return
    altered(tmp_path / "made" / file, change)
    with pytest.raises(ReadError, match=said) as told:
        read(path)
    assert name in str(told.value) and told.value.remedy


@pytest.mark.parametrize(("driver", "name"), [("ENVI", "a.img"), ("BT", "a.bt"), ("PCIDSK", "a.pix")])
def test_notes_beside_a_raster_that_are_cut_short(tmp_path: Path, driver: str, name: str) -> None:
    """They may hold its nodata value and its CRS; GDAL goes on without them."""
    path = made(tmp_path / "made", driver, name)
    notes = Path(f"{path}.aux.xml")
    notes.write_text('<PAMDataset><PAMRasterBand band="1"><NoDataValue>900</NoDataValue></PAMRasterBand></PAMDataset>')
    assert np.isnan(read(path).heights).any()
    notes.write_text(notes.read_text()[:-20])
    with pytest.raises(ReadError, match=r"aux\.xml"):
        read(path)


def test_names_of_bands_in_another_encoding(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "ENVI", "a.img")
    altered(path.with_suffix(".hdr"), (b"Band 1}", "Höhe}".encode("latin-1")))
    np.testing.assert_array_equal(read(path).heights, hill())


def test_a_unit_that_is_no_text(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "RST", "a.rst")
    altered(path.with_suffix(".rdc"), (b"value units : unspecified", b"value units : f\xe4\xe4t"))
    with pytest.raises(ReadError, match="unit"):
        read(path)


@pytest.mark.parametrize("step", ["1", "0.5"])
def test_an_ilwis_map_of_two_kinds_of_numbers_does_not_end_the_process(tmp_path: Path, step: str) -> None:
    path = made(tmp_path / "made", "ILWIS", "a.mpr", "float32")
    text = path.read_text()
    path.write_text(re.sub(r"(Range=[^:]*:[^:]*:)[^:]*", rf"\g<1>{step}", text))
    if step == "1":
        with pytest.raises(ReadError, match="contradict"):
            read(path)
    else:
        read(path)


def test_padded_rows_are_never_read_as_if_they_were_not(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "EHdr", "a.bil")
    path.write_bytes(np.pad(hill(), ((0, 0), (0, 1))).tobytes())
    altered(
        path.with_suffix(".hdr"), (b"BANDROWBYTES   166\nTOTALROWBYTES  166", b"BANDROWBYTES   168\nTOTALROWBYTES  168")
    )
    with pytest.raises(ReadError, match="padded"):
        read(path)


@pytest.mark.parametrize("place", ["1e99", "99999999999999999999", "nan"])
def test_a_place_that_cannot_be(tmp_path: Path, place: str) -> None:
    path = tmp_path / "a.vrt"
    made(tmp_path / "made", "ENVI", "a.img")
    copy(str(tmp_path / "made" / "a.img"), str(path), driver="VRT")
    altered(path, (b"5.0000000000000000e+05", place.encode()))
    with pytest.raises(ReadError, match=r"places samples|degenerate"):
        read(path)


def test_a_vrt_that_is_no_xml_any_more(tmp_path: Path) -> None:
    made(tmp_path / "made", "ENVI", "a.img")
    path = tmp_path / "a.vrt"
    copy(str(tmp_path / "made" / "a.img"), str(path), driver="VRT")
    altered(path, (b'"Unit"', b'"Unit" <') if b'"Unit"' in path.read_bytes() else (b"<SRS ", b"<SRS & "))
    with pytest.raises(ReadError, match=r"header|cannot open"):
        read(path)


def test_a_pnm_has_its_place_or_none(tmp_path: Path) -> None:
    """GDAL gives what happened to be in memory."""
    path = made(tmp_path / "made", "PNM", "a.pgm", "uint8")
    assert read(path).grid.transform == UTM
    Path(f"{path}.aux.xml").unlink()
    assert read(path).grid.transform == Affine(1, 0, 0, 0, -1, ROWS)


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_a_jpeg_2000_of_tiles_cut_short(tmp_path: Path, part: float) -> None:
    path = made(tmp_path / "made", "JP2OpenJPEG", "a.jp2", REVERSIBLE="YES", QUALITY="100", BLOCKXSIZE="32",
                BLOCKYSIZE="32")  # fmt: skip
    np.testing.assert_array_equal(read(path).heights, hill())
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(ReadError):
        read(path)


@pytest.mark.parametrize("codec", ["DEFLATE", "ZSTD", "NONE", "PNG", "TIF"])
def test_tiles_of_an_mrf(tmp_path: Path, codec: str) -> None:
    dtype = "uint8" if codec == "PNG" else "int16"
    path = made(tmp_path / "made", "MRF", "a.mrf", dtype, COMPRESS=codec, BLOCKSIZE="64")
    np.testing.assert_array_equal(read(path).heights, hill(dtype))
    data = next(p for p in path.parent.iterdir() if p.suffix in (".pzp", ".pzs", ".til", ".ppg", ".ptf"))
    whole = data.read_bytes()
    data.write_bytes(whole[:700] + b"abcd" + whole[700:])
    with pytest.raises(ReadError, match="tile"):
        read(path)
    data.write_bytes(whole)
    path.with_suffix(".idx").unlink()
    with pytest.raises(ReadError):
        read(path)


def test_an_mrf_that_leaves_tiles_out(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "MRF", "a.mrf", COMPRESS="ZSTD", BLOCKSIZE="32")
    corner = np.zeros((ROWS, COLS), np.int16)
    corner[40:, 40:] = 5
    with rasterio.open(tmp_path / "corner.tif", "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16",
                       transform=UTM) as file:  # fmt: skip
        file.write(corner, 1)
    (tmp_path / "sparse").mkdir()
    copy(
        str(tmp_path / "corner.tif"), str(tmp_path / "sparse" / "a.mrf"), driver="MRF", COMPRESS="ZSTD", BLOCKSIZE="32"
    )
    np.testing.assert_array_equal(read(tmp_path / "sparse" / "a.mrf").heights, corner)
    index = path.with_suffix(".idx")
    index.write_bytes(bytes(16) + index.read_bytes()[16:])
    with pytest.raises(ReadError, match="lacks tiles"):
        read(path)


@pytest.mark.parametrize("form", ["PNG", "TIFF"])
def test_tiles_of_a_geopackage_are_never_made_up(tmp_path: Path, form: str) -> None:
    path = made(tmp_path / "made", "GPKG", "a.gpkg", "uint8" if form == "PNG" else "float32", TILE_FORMAT=form)
    whole = read(path).heights
    data = path.read_bytes()
    at = data.rindex(b"IDAT") + 40 if form == "PNG" else data.rindex(b"II*\0")
    path.write_bytes(data[:at] + bytes([data[at] ^ 85]) + data[at + 1 :])
    with pytest.raises(ReadError, match="tile"):
        read(path)
    path.write_bytes(data[:-512])
    with pytest.raises(ReadError):
        read(path)
    path.write_bytes(data)
    np.testing.assert_array_equal(read(path).heights, whole)


@pytest.mark.parametrize("codec", ["PNG", "JPEG2000", "SIMPLE_PACKING"])
def test_a_grib_message_is_whole(tmp_path: Path, codec: str) -> None:
    path = made(tmp_path / "made", "GRIB", "a.grb2", DATA_ENCODING=codec)
    read(path)
    data = path.read_bytes()
    at = data.rindex(b"IDAT") + 40 if codec == "PNG" else len(data) - 100
    for mutant in (data[:at] + data[at + 1 :], data[:at] + b"1" + data[at:], data[:-3]):
        path.write_bytes(mutant)
        with pytest.raises(ReadError):
            read(path)
    if codec == "PNG":
        path.write_bytes(data[:at] + bytes([data[at] ^ 85]) + data[at + 1 :])
        with pytest.raises(ReadError, match="checksum"):
            read(path)


@pytest.mark.parametrize("form", ["NC", "NC2", "NC4", "NC5"])
def test_netcdf_with_bytes_put_in_or_left_out(tmp_path: Path, form: str) -> None:
    path = made(tmp_path / "made", "netCDF", "a.nc", FORMAT=form)
    data = path.read_bytes()
    for mutant in (data[:-300] + b"\7\7\7\7" + data[-300:], data[:-300] + data[-297:]):
        path.write_bytes(mutant)
        with pytest.raises(ReadError):
            read(path)


def test_the_numbers_of_a_netcdf_header_are_looked_at_before_memory_is_asked_for(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "netCDF", "a.nc", FORMAT="NC2")
    data = path.read_bytes()
    at = data.index(b"standard_name")
    path.write_bytes(data[: at - 4] + struct.pack(">I", 1 << 30) + data[at:])
    with pytest.raises(ReadError, match="header"):
        read(path)


@pytest.mark.parametrize("mode", ["FILE", "PIXEL", "TILED"])
def test_channels_of_a_pcidsk_file(tmp_path: Path, mode: str) -> None:
    path = made(tmp_path / "made", "PCIDSK", "a.pix", INTERLEAVING=mode)
    np.testing.assert_array_equal(read(path).heights, hill())
    if mode != "FILE":
        return
    channel = path.with_suffix(".001")
    data = channel.read_bytes()
    for mutant in (data[:-50], data + b"1"):
        channel.write_bytes(mutant)
        with pytest.raises(ReadError, match="bytes"):
            read(path)


def test_the_spilled_samples_of_an_imagine_file(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "HFA", "a.img", USE_SPILL="YES")
    spilled = path.with_suffix(".ige")
    data = spilled.read_bytes()
    spilled.write_bytes(data[:2000] + b"12" + data[2000:])
    with pytest.raises(ReadError, match="ige"):
        read(path)
    spilled.unlink()
    with pytest.raises(ReadError):
        read(path)


def test_the_checksum_of_r_data(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "R", "a.rda")
    np.testing.assert_array_equal(read(path).heights, hill())
    unpacked = bytearray(gzip.decompress(path.read_bytes()))
    packed = bytearray(gzip.compress(bytes(unpacked)))
    packed[-8] ^= 1
    path.write_bytes(packed)
    with pytest.raises(ReadError, match="unpacked"):
        read(path)


def test_chunks_of_a_zarr(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "Zarr", "a.zarr", COMPRESS="NONE", BLOCKSIZE="32,32")
    np.testing.assert_array_equal(read(path).heights, hill())
    chunk = next(path.rglob("1.1"))
    data = chunk.read_bytes()
    chunk.write_bytes(data + b"1")
    with pytest.raises(ReadError, match=r"1\.1"):
        read(path)
    chunk.unlink()
    header = next(p for p in path.rglob(".zarray") if b"32" in p.read_bytes())
    if b'"fill_value":null' in header.read_bytes():
        with pytest.raises(ReadError, match=r"1\.1"):
            read(path)
    header.write_bytes(header.read_bytes().replace(b'"<i2"', b'"<i:"'))
    with pytest.raises(ReadError):
        read(path)


def test_a_grid_exchange_file_holds_all_its_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.gxf"
    rows = "\n".join(" ".join(map(str, row)) for row in hill()[::-1])
    head = (
        f"#POINTS\n{COLS}\n#ROWS\n{ROWS}\n#PTSEPARATION\n30\n#RWSEPARATION\n30\n#XORIGIN\n500000\n#YORIGIN\n0\n#GRID\n"
    )
    path.write_text(head + rows + "\n")
    np.testing.assert_array_equal(read(path).heights, hill())
    path.write_text(head + rows.replace("\n", "\nx1 ", 1) + "\n")
    with pytest.raises(ReadError, match="not a number"):
        read(path)
    path.write_text(head + rows.rpartition(" ")[0] + "\n")
    with pytest.raises(ReadError, match="promises"):
        read(path)


def test_deflate_of_an_mrf_of_other_writers(tmp_path: Path) -> None:
    """A tile may be zlib's, gzip's or without a header."""
    from orograph.dem.whole.mrf import _length

    data = bytes(1000)
    bare = zlib.compressobj(wbits=-15)
    for packed in (zlib.compress(data), gzip.compress(data), bare.compress(data) + bare.flush()):
        assert _length(packed, "DEFLATE") == 1000
        assert _length(packed[:-5], "DEFLATE") != 1000


def test_a_geotiff_with_a_label_of_pds4(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "PDS4", "a.xml", IMAGE_FORMAT="GEOTIFF")
    np.testing.assert_array_equal(read(path).heights, hill())
    altered(path.with_suffix(".tif"), b"\x07")
    with pytest.raises(ReadError, match="bytes"):
        read(path)


def test_columns_that_a_dted_file_lacks(tmp_path: Path) -> None:
    """GDAL takes them for missing heights."""
    heights = np.resize(hill(), (121, 121))
    place = Affine(1 / 120, 0, -72 - 1 / 240, 0, -1 / 120, 45 + 1 / 240)
    profile = {"driver": "GTiff", "height": 121, "width": 121, "count": 1, "dtype": "int16", "crs": "EPSG:4326"}
    with rasterio.open(tmp_path / "plain.tif", "w", transform=place, **profile) as file:
        file.write(heights, 1)
    path = tmp_path / "a.dt0"
    copy(str(tmp_path / "plain.tif"), str(path), driver="DTED")
    np.testing.assert_array_equal(read(path).heights, heights)
    data = path.read_bytes()
    for mutant in (data[:-254], data[:20000] + data[20001:], data[:20000] + b"1" + data[20000:]):
        path.write_bytes(mutant)
        with pytest.raises(ReadError):
            read(path)


def test_a_tar_is_made_of_whole_blocks(tmp_path: Path) -> None:
    import tarfile

    made(tmp_path / "made", "GTiff", "a.tif")
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as archive:
        archive.add(tmp_path / "made" / "a.tif", "a.tif")
    data = path.read_bytes()
    path.write_bytes(data[:5000] + b"12" + data[5000:])
    with pytest.raises(ReadError, match="blocks"):
        read(path)


def test_the_samples_of_a_terragen_file(tmp_path: Path) -> None:
    path = made(tmp_path / "made", "Terragen", "a.ter", "float32", MINUSERPIXELVALUE="100", MAXUSERPIXELVALUE="2000")
    assert read(path).heights.shape == (ROWS, COLS)
    altered(path, b"12")
    with pytest.raises(ReadError, match="bytes"):
        read(path)
