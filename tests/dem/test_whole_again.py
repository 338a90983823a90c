"""What a further attack with mutants found GDAL to read past: tables and directories of TIFFs, lengths, texts."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.shutil import copy

import orograph
from orograph.dem import read
from orograph.errors import ReadError, StoreError

from .test_tiff_layout import by_hand
from .test_whole import UTM, hill
from .test_whole import made as copied
from .test_whole_more import entry

COLS, ROWS = 83, 61


def put(path: Path, at: int, data: bytes) -> None:
    """Overwrite bytes of a file."""
    there = path.read_bytes()
    path.write_bytes(there[:at] + data + there[at + len(data) :])


def refused(path: Path, said: str) -> None:
    with pytest.raises(ReadError, match=said) as told:
        read(path)
    assert path.name in str(told.value) and told.value.remedy


@pytest.mark.parametrize("tag", [273, 279])
def test_tables_of_unequal_length(tmp_path: Path, tag: int) -> None:
    path = by_hand(tmp_path / "a.tif")
    put(path, entry(path, tag) + 4, struct.pack("<I", 3))
    refused(path, "places of|sizes of")


def test_a_table_of_blocks_that_was_cut_off(tmp_path: Path, shared_data: Path) -> None:
    """GDAL says so on its log, and reads what it finds at the beginning of the file."""
    data = (shared_data / "nasty-gdal" / "non_standard_tiled_blockysize_one.tif").read_bytes()
    path = tmp_path / "a.tif"
    path.write_bytes(data)
    np.testing.assert_array_equal(read(path).heights, [[1, 1, 1]])
    path.write_bytes(data[:-8])
    refused(path, "beyond its end")


def test_bytes_that_lack_before_a_strip_that_is_filled_up(tmp_path: Path) -> None:
    """They shift all samples behind them, and the end of the file lies in what fills the last strip."""
    path = by_hand(tmp_path / "a.tif", pad=True)
    np.testing.assert_array_equal(read(path).heights, hill_of_tiff())
    data = path.read_bytes()
    path.write_bytes(data[:3000] + data[3003:])
    refused(path, "3 bytes before the end of its last part")
    unfilled = len(data) - (64 - ROWS) * COLS * 2
    path.write_bytes(data[:unfilled])  # as writers do that leave the filling out
    np.testing.assert_array_equal(read(path).heights, hill_of_tiff())


def hill_of_tiff() -> np.ndarray:
    from .test_tiff_layout import hill as other

    return other().astype(np.float32)


@pytest.mark.parametrize("compress", [None, "deflate", "lzw"])
@pytest.mark.parametrize("bigtiff", ["NO", "YES"])
def test_a_mask_that_no_directory_leads_to(tmp_path: Path, compress: str | None, bigtiff: str) -> None:
    path = tmp_path / "a.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(
        path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", crs="EPSG:32611", transform=UTM,
        BIGTIFF=bigtiff, **({"compress": compress} if compress else {}),
    ) as file:  # fmt: skip
        file.write(hill(), 1)
        file.write_mask((hill() > 900).astype(np.uint8) * 255)
    assert np.isnan(read(path).heights).any()
    data = path.read_bytes()
    if bigtiff == "YES":
        (first,) = struct.unpack_from("<Q", data, 8)
        following = first + 8 + 20 * struct.unpack_from("<Q", data, first)[0]
    else:
        (first,) = struct.unpack_from("<I", data, 4)
        following = first + 2 + 12 * struct.unpack_from("<H", data, first)[0]
    assert any(data[following : following + 4])
    put(path, following, bytes(8 if bigtiff == "YES" else 4))
    refused(path, "mask")


def test_the_place_of_a_compressed_block_copied_from_another_of_its_size(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    rows = np.arange(ROWS * COLS, dtype=np.int16).reshape(ROWS, COLS)
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", blockysize=4,
                       compress="packbits", transform=UTM) as file:  # fmt: skip
        file.write(rows, 1)
    np.testing.assert_array_equal(read(path).heights, rows)
    data = path.read_bytes()
    count = struct.unpack_from("<I", data, entry(path, 279) + 4)[0]
    kind = struct.unpack_from("<H", data, entry(path, 279) + 2)[0]
    (places,), (sizes,) = (struct.unpack_from("<I", data, entry(path, tag) + 8) for tag in (273, 279))
    size = struct.unpack_from(f"<{count}{'H' if kind == 3 else 'I'}", data, sizes)
    twins = [(i, j) for i in range(count) for j in range(i) if size[i] == size[j]]
    i, j = twins[0]
    put(path, places + 4 * i, data[places + 4 * j : places + 4 * j + 4])
    refused(path, "twice")


@pytest.mark.parametrize("kind", ["one band", "colours in tiles", "four bands", "bands apart"])
def test_a_block_of_jpeg_that_libjpeg_only_warns_of(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.tif"
    bands = {"one band": 1, "colours in tiles": 3, "four bands": 4, "bands apart": 2}[kind]
    more: dict[str, object] = {"tiled": True, "blockxsize": 32, "blockysize": 32} if "tiles" in kind else {}
    more |= {"photometric": "ycbcr"} if bands == 3 else {}
    more |= {"interleave": "band" if "apart" in kind else "pixel"}
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=bands, dtype="uint8",
                       compress="jpeg", transform=UTM, **more) as file:  # fmt: skip
        file.write(np.stack([hill("uint8")] * bands))
    assert read(path).heights.shape == (ROWS, COLS)
    data = bytearray(path.read_bytes())
    with rasterio.open(path) as file:
        place, size = (int(file.get_tag_item(f"BLOCK_{what}_0_0", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    data[place + size // 2 : place + size // 2 + 2] = b"\xff\xd9"  # the mark of its end
    path.write_bytes(data)
    refused(path, "JPEG")


def test_a_jpeg_2000_whose_inner_box_has_no_length(tmp_path: Path) -> None:
    """GDAL goes round in it for ever."""
    path = copied(tmp_path / "made", "JP2OpenJPEG", "a.jp2", "uint8")
    data = path.read_bytes()
    put(path, data.index(b"colr") - 4, bytes(4))
    refused(path, "colr")


def tiled_vrt(folder: Path) -> Path:
    """A VRT of four tiles of the hill."""
    sources = []
    for i, (top, left) in enumerate([(0, 0), (0, 40), (30, 0), (30, 40)]):
        part = hill()[top : top + 30, left : left + 40]
        rows, cols = part.shape
        place = Affine(30, 0, 500_000 + 30 * left, 0, -30, 4_000_000 - 30 * top)
        with rasterio.open(folder / f"t{i}.tif", "w", driver="GTiff", height=rows, width=cols, count=1, dtype="int16",
                           crs="EPSG:32611", transform=place) as file:  # fmt: skip
            file.write(part, 1)
        sources.append(
            f'<SimpleSource><SourceFilename relativeToVRT="1">t{i}.tif</SourceFilename><SourceBand>1</SourceBand>'
            f'<SrcRect xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"/>'
            f'<DstRect xOff="{left}" yOff="{top}" xSize="{cols}" ySize="{rows}"/></SimpleSource>\n'
        )
    path = folder / "a.vrt"
    path.write_text(
        '<VRTDataset rasterXSize="80" rasterYSize="60">\n<SRS>EPSG:32611</SRS>\n'
        "<GeoTransform>500000, 30, 0, 4000000, 0, -30</GeoTransform>\n"
        f'<VRTRasterBand dataType="Int16" band="1">\n{"".join(sources)}</VRTRasterBand>\n</VRTDataset>\n'
    )
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<SrcRect xOff="0" yOff="0" xSize="40"', '<SrcRect xOff="0" yOff="0" xSizf="40"'),
        ('<DstRect xOff="40" yOff="0"', '<DstRect yOff="0"'),
        ('<DstRect xOff="40" yOff="0"', '<DstRect xOff="90" yOff="0"'),
        ('<DstRect xOff="40" yOff="0"', '<DstRect xOff="46" yOff="0"'),
        ('<DstRect xOff="40" yOff="0" xSize="40"', '<DstRect xOff="40" yOff="0" xSize="30"'),
        ('<SrcRect xOff="0"', '<SrcRect xOff="nan"'),
    ],
)
def test_parts_of_a_vrt_that_lie_nowhere_or_elsewhere(tmp_path: Path, old: str, new: str) -> None:
    path = tiled_vrt(tmp_path)
    np.testing.assert_array_equal(read(path).heights, hill()[:60, :80])
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    refused(path, "parts|elsewhere|cannot be")


def test_tiles_of_a_vrt_exchanged(tmp_path: Path) -> None:
    path = tiled_vrt(tmp_path)
    (tmp_path / "t0.tif").rename(tmp_path / "t")
    (tmp_path / "t1.tif").rename(tmp_path / "t0.tif")
    (tmp_path / "t").rename(tmp_path / "t1.tif")
    refused(path, "elsewhere")


def test_a_vrt_across_the_antimeridian(tmp_path: Path) -> None:
    """Half of its tiles say that they lie 360 degrees west of where it lays them."""
    sources = []
    for i, west in enumerate((179.5, -180.0)):
        with rasterio.open(tmp_path / f"t{i}.tif", "w", driver="GTiff", height=50, width=50, count=1, dtype="int16",
                           crs="EPSG:4326", transform=Affine(0.01, 0, west, 0, -0.01, 50)) as file:  # fmt: skip
            file.write(hill()[:50, :50], 1)
        sources.append(
            f'<SimpleSource><SourceFilename relativeToVRT="1">t{i}.tif</SourceFilename>'
            '<SrcRect xOff="0" yOff="0" xSize="50" ySize="50"/>'
            f'<DstRect xOff="{50 * i}" yOff="0" xSize="50" ySize="50"/></SimpleSource>'
        )
    path = tmp_path / "a.vrt"
    path.write_text(
        '<VRTDataset rasterXSize="100" rasterYSize="50"><SRS>EPSG:4326</SRS>'
        "<GeoTransform>179.5, 0.01, 0, 50, 0, -0.01</GeoTransform>"
        f'<VRTRasterBand dataType="Int16" band="1">{"".join(sources)}</VRTRasterBand></VRTDataset>'
    )
    np.testing.assert_array_equal(read(path).heights, np.hstack([hill()[:50, :50]] * 2))


def test_a_vrt_that_places_all_its_parts_anew(tmp_path: Path) -> None:
    path = tiled_vrt(tmp_path)
    path.write_text(path.read_text().replace("500000, 30", "700010, 30"))
    np.testing.assert_array_equal(read(path).heights, hill()[:60, :80])


@pytest.mark.parametrize(("behind", "sound"), [(0, True), (3, False), (COLS * 2, True)])
def test_raw_bands_of_a_vrt_that_are_too_long(tmp_path: Path, behind: int, sound: bool) -> None:
    (tmp_path / "a.raw").write_bytes(hill().astype("<i2").tobytes() + b"\7" * behind)
    path = tmp_path / "a.vrt"
    path.write_text(
        f'<VRTDataset rasterXSize="{COLS}" rasterYSize="{ROWS}"><VRTRasterBand dataType="Int16" band="1" '
        'subClass="VRTRawRasterBand"><SourceFilename relativeToVRT="1">a.raw</SourceFilename>'
        f"<LineOffset>{2 * COLS}</LineOffset><ByteOrder>LSB</ByteOrder></VRTRasterBand></VRTDataset>"
    )
    if sound:
        np.testing.assert_array_equal(read(path).heights, hill())
    else:
        with pytest.raises(ReadError, match="3 bytes more"):
            read(path)


@pytest.mark.parametrize("driver", ["LCP", "PCIDSK", "netCDF"])
def test_a_file_that_is_longer_or_shorter(tmp_path: Path, driver: str) -> None:
    folder = tmp_path / "made"
    if driver == "LCP":
        folder.mkdir()
        with rasterio.open(tmp_path / "hill.tif", "w", driver="GTiff", height=ROWS, width=COLS, count=8, dtype="int16",
                           crs="EPSG:32611", transform=UTM) as file:  # fmt: skip
            file.write(np.stack([hill()] * 8))
        path = folder / "a.lcp"
        copy(str(tmp_path / "hill.tif"), str(path), driver="LCP", LATITUDE="40", LINEAR_UNIT="METER")
    elif driver == "PCIDSK":
        path = copied(folder, "PCIDSK", "a.pix", INTERLEAVING="TILED")
    else:
        path = copied(folder, "netCDF", "a.nc", FORMAT="NC")
    np.testing.assert_array_equal(read(path).heights, hill())
    data = path.read_bytes()
    for mutant in (data[:-2000] + b"\7" * 3 + data[-2000:], data[:-2000] + data[-1999:]):
        path.write_bytes(mutant)
        refused(path, "bytes|ends")


@pytest.mark.parametrize("tile", ["64", "100", "127"])
@pytest.mark.parametrize("compression", ["NONE", "RLE"])
def test_pcidsk_in_tiles_of_any_size(tmp_path: Path, tile: str, compression: str) -> None:
    path = copied(tmp_path / "made", "PCIDSK", "a.pix", INTERLEAVING="TILED", TILESIZE=tile, COMPRESSION=compression)
    np.testing.assert_array_equal(read(path).heights, hill())


def test_a_geoid_of_the_ngs_that_is_longer_or_shorter(tmp_path: Path) -> None:
    path = tmp_path / "g2012.bin"
    samples = (hill().astype("<f4") / 100 - 60)[::-1]
    data = struct.pack("<4d3i", 34.0, 241.0, 1 / 60, 1 / 60, ROWS, COLS, 1) + samples.tobytes()
    path.write_bytes(data)
    np.testing.assert_array_equal(read(path).heights, samples[::-1])
    for mutant in (data[:5000] + b"\7" + data[5000:], data[:-1]):
        path.write_bytes(mutant)
        refused(path, "bytes")


def floating(folder: Path, header: str, kind: str = "<f4") -> Path:
    """The hill as raw numbers of 32 bits with a header."""
    (folder / "a.hdr").write_text(header)
    (folder / "a.bil").write_bytes(hill().astype(kind).tobytes())
    return folder / "a.bil"


def test_a_header_that_does_not_call_its_numbers_floating(tmp_path: Path) -> None:
    said = f"NROWS {ROWS}\nNCOLS {COLS}\nNBITS 32\nBYTEORDER I\nULXMAP 15\nULYMAP 15\nXDIM 30\nYDIM 30\n"
    np.testing.assert_array_equal(read(floating(tmp_path, said + "PIXELTYPE FLOAT\n")).heights, hill())
    refused(floating(tmp_path, said), "floats")
    np.testing.assert_array_equal(read(floating(tmp_path, said, "<i4")).heights, hill())
    turned = said.replace("BYTEORDER I", "BYTEORDER M") + "PIXELTYPE FLOAT\n"
    np.testing.assert_array_equal(read(floating(tmp_path, turned, ">f4")).heights, hill())
    refused(floating(tmp_path, turned), "byte order")


@pytest.mark.parametrize("name", ["int16.tif", "byte_bigtiff_invalid_slong8_for_stripoffsets.tif"])
def test_a_byte_put_into_a_tiff_whose_last_part_is_odd(tmp_path: Path, shared_data: Path, name: str) -> None:
    """It is no byte that fills up to an even number."""
    data = (shared_data / "nasty-gdal" / name).read_bytes()
    path = tmp_path / "a.tif"
    path.write_bytes(data)
    assert read(path).heights.shape == (20, 20)
    path.write_bytes(data[:-60] + b"\7" + data[-60:])
    refused(path, "after its last part")


def test_a_store_whose_root_is_nested_too_deep(tmp_path: Path) -> None:
    orograph.build(hill().astype(np.float32), tmp_path / "a.oro")
    root = tmp_path / "a.oro" / "zarr.json"
    root.write_bytes(b"[" * 100_000 + root.read_bytes())
    with pytest.raises(StoreError, match=r"zarr\.json is damaged"):
        orograph.terrain(str(tmp_path / "a.oro"))


def test_a_header_of_a_corner_and_no_step(tmp_path: Path) -> None:
    said = f"ncols {COLS}\nnrows {ROWS}\nxllcorner 500000\nyllcorner 4000000\ncellsize 30\nbyteorder LSBFIRST\n"
    for text, sound in ((said, True), (said.replace("cellsize 30\n", ""), False)):
        path = floating(tmp_path, text).rename(tmp_path / "a.flt")
        if sound:
            np.testing.assert_array_equal(read(path).heights, hill())
        else:
            refused(path, "CELLSIZE")


def columns(decimals: int) -> str:
    lines = (f"{500015 + 30 * j} {4000000 - 30 * i} {hill()[i, j]:.{decimals}f}" for i in range(5) for j in range(9))
    return "\n".join(lines)


@pytest.mark.parametrize("end", ["", "\n"])
def test_columns_of_points(tmp_path: Path, end: str) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(columns(2) + end)
    np.testing.assert_array_equal(read(path).heights, hill()[:5, :9])


@pytest.mark.parametrize("joined", ["", " "])
def test_lines_of_points_that_are_joined(tmp_path: Path, joined: str) -> None:
    path = tmp_path / "a.xyz"
    lines = columns(0).split("\n")
    path.write_text("\n".join([*lines[:9], lines[9] + joined + lines[10], *lines[11:], ""]))
    refused(path, "joined")


@pytest.mark.parametrize("name", ["a.xyz", "a.asc"])
def test_a_last_number_that_was_cut_short(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    grid = "\n".join(" ".join(f"{v:.2f}" for v in row) for row in hill()[:5, :9])
    head = "ncols 9\nnrows 5\nxllcorner 0\nyllcorner 0\ncellsize 30\n"
    text = columns(2) if name == "a.xyz" else head + grid
    path.write_text(text)
    np.testing.assert_array_equal(read(path).heights, hill()[:5, :9])
    for cut in (1, 2, 3):
        path.write_text(text[:-cut])
        refused(path, "cut short")


def usgs(folder: Path) -> Path:
    return copied(folder / "made", "USGSDEM", "a.dem")


def test_a_digit_of_a_usgs_dem(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    np.testing.assert_array_equal(read(path).heights[:ROWS], hill())
    profile = 1024 + 20 * 1024
    data = path.read_bytes()
    values = [int(data[profile + 144 + 6 * i : profile + 150 + 6 * i]) for i in range(ROWS)]
    at = profile + 144 + 6 * values.index(max(values))
    put(path, at, f"{max(values) + 100:6d}".encode())
    refused(path, "profile 21 of 83")


def test_profiles_of_a_usgs_dem_exchanged(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    data = path.read_bytes()
    for i, j in ((30, 40), (2, 70)):
        path.write_bytes(data)
        put(path, 1024 * i, data[1024 * j : 1024 * j + 1024])
        put(path, 1024 * j, data[1024 * i : 1024 * i + 1024])
        refused(path, f"profile {i} of 83")


def test_a_profile_of_a_usgs_dem_that_stands_twice(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: 1024 * 20] + data[1024 * 19 : 1024 * 20] + data[1024 * 20 :])
    refused(path, "profile 20 of 83")
    path.write_bytes(data[: 1024 * 20 + 50] + b" " + data[1024 * 20 + 50 :])
    refused(path, "profile 20 of 83")


def test_a_byte_put_into_a_leveller_document(tmp_path: Path, shared_data: Path) -> None:
    whole = shared_data / "nasty-gdal" / "ter6test.ter"
    data, path = whole.read_bytes(), tmp_path / "a.ter"
    path.write_bytes(data)
    assert np.isfinite(read(path).heights).any()
    path.write_bytes(data[:-95] + b"\7" + data[-95:])
    refused(path, "parts end|no part")


def test_a_usgs_dem_that_keeps_no_least_and_greatest(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    data = bytearray(path.read_bytes())
    for profile in range(1, 84):
        data[1024 * profile + 96 : 1024 * profile + 144] = (b"%24s" % b"0.000000000000000D+00") * 2
    path.write_bytes(data)
    np.testing.assert_array_equal(read(path).heights[:ROWS], hill())


def test_the_steps_of_a_usgs_dem(tmp_path: Path) -> None:
    path = usgs(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[:688] + b"07" + data[688:])
    refused(path, "spacing")


@pytest.mark.parametrize(("driver", "name"), [("EHdr", "a.bil"), ("BT", "a.bt"), ("SAGA", "a.sdat")])
def test_a_crs_beside_a_raster_that_is_cut_short(tmp_path: Path, driver: str, name: str) -> None:
    path = copied(tmp_path / "made", driver, name)
    beside = path.with_suffix(".prj")
    np.testing.assert_array_equal(read(path).heights, hill())
    beside.write_text(beside.read_text().rstrip()[:-2])
    with pytest.raises(ReadError, match="CRS"):
        read(path)
