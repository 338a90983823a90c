"""Parts of rasters (files of a VRT, masks) that are damaged: what is noticed of a file is noticed of a part as well."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.io import MemoryFile

from orograph.dem import Source
from orograph.dem.deciding import files_of, states
from orograph.errors import ReadError

UTM = Affine(30, 0, 500000, 0, -30, 4000000)
SIZE = 200
LAST = (SIZE - 1, SIZE, SIZE - 1, SIZE)


def heights() -> np.ndarray:
    row, col = np.mgrid[:SIZE, :SIZE]
    return (1000 + 300 * np.sin(row / 17) * np.cos(col / 23) + (row * 7 + col * 13) % 11).astype(np.uint16)


def write(path: Path, driver: str, **more: object) -> Path:
    profile = {"width": SIZE, "height": SIZE, "count": 1, "dtype": "uint16", "transform": UTM, "crs": "EPSG:32633"}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", **profile) as file:
            file.write(heights(), 1)
        with memory.open() as file:
            rasterio.shutil.copy(file, path, driver=driver, **more)
    return path


def virtual(path: Path, body: str, cols: int = SIZE, kind: str = "") -> Path:
    """A VRT of ``SIZE`` rows with this band."""
    path.write_text(
        f'<VRTDataset rasterXSize="{cols}" rasterYSize="{SIZE}"><SRS>EPSG:32633</SRS>'
        f"<GeoTransform>{', '.join(map(str, UTM.to_gdal()))}</GeoTransform>"
        f'<VRTRasterBand dataType="UInt16" band="1"{kind}>{body}</VRTRasterBand></VRTDataset>'
    )
    return path


def source(name: str, left: int | None = None) -> str:
    size = f'xSize="{SIZE}" ySize="{SIZE}"'
    place = "" if left is None else f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="{left}" yOff="0" {size}/>'
    return (
        f'<SimpleSource><SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>'
        f"{place}</SimpleSource>"
    )


def read(path: Path | str) -> np.ndarray:
    with Source.open(path) as file:
        return file.read(0, file.shape[0], 0, file.shape[1])


DRIVERS = [
    ("ENVI", "img", {}), ("AAIGrid", "asc", {}), ("PCIDSK", "pix", {}), ("GTiff", "tif", {"compress": "deflate"}),
]  # fmt: skip


@pytest.mark.parametrize(("driver", "ending", "more"), DRIVERS, ids=[d[0] for d in DRIVERS])
@pytest.mark.parametrize("nested", [False, True])
def test_damage_of_a_part_is_noticed(tmp_path: Path, driver: str, ending: str, more: dict, nested: bool) -> None:
    path = write(tmp_path / f"part.{ending}", driver, **more)
    area = virtual(tmp_path / "area.vrt", source(path.name))
    if nested:
        area = virtual(tmp_path / "outer.vrt", source("area.vrt"))
    assert np.array_equal(read(area), heights())
    data = path.read_bytes()
    if driver == "GTiff":
        with rasterio.open(path) as file:
            at = int(file.get_tag_item("BLOCK_OFFSET_0_3", "TIFF", bidx=1))
            size = int(file.get_tag_item("BLOCK_SIZE_0_3", "TIFF", bidx=1))
        longer = zlib.compress(bytes(4 * SIZE * SIZE))  # libtiff stops when the block is full
        data = data[:at] + (longer[:-1] + bytes([longer[-1] ^ 1])).ljust(size, b"\0") + data[at + size :]
    elif driver == "AAIGrid":
        at = data.rindex(b" 1") + 1
        data = data[:at] + b"x" + data[at + 1 :]
    else:
        data = data[: len(data) * 2 // 3]
    path.write_bytes(data)
    with pytest.raises(ReadError, match=f"part\\.{ending}"):
        read(area)


def test_raw_samples_of_a_vrt_that_are_cut_off(tmp_path: Path) -> None:
    raw = tmp_path / "samples.raw"
    raw.write_bytes(b"12345678" + heights().tobytes())
    body = (
        '<SourceFilename relativeToVRT="1">samples.raw</SourceFilename><ImageOffset>8</ImageOffset>'
        f"<PixelOffset>2</PixelOffset><LineOffset>{2 * SIZE}</LineOffset><ByteOrder>LSB</ByteOrder>"
    )
    area = virtual(tmp_path / "area.vrt", body, kind=' subClass="VRTRawRasterBand"')
    assert np.array_equal(read(area), heights())
    raw.write_bytes(raw.read_bytes()[:-1])
    with pytest.raises(ReadError, match=r"samples\.raw|cannot be read"):
        read(area)


def test_only_the_parts_that_are_read_are_looked_at(tmp_path: Path) -> None:
    write(tmp_path / "west.asc", "AAIGrid")
    east = write(tmp_path / "east.asc", "AAIGrid")
    area = virtual(tmp_path / "area.vrt", source("west.asc", 0) + source("east.asc", SIZE), 2 * SIZE)
    east.write_bytes(east.read_bytes() + b" x")
    with Source.open(area) as file:
        assert np.array_equal(file.read(0, SIZE, 0, SIZE), heights())
        with pytest.raises(ReadError, match=r"east\.asc"):
            file.read(0, 1, SIZE, SIZE + 1)


def test_the_name_that_gdal_has_for_what_is_in_a_zip_is_looked_at_as_well(tmp_path: Path) -> None:
    path = write(tmp_path / "part.img", "ENVI")
    path.write_bytes(path.read_bytes()[: SIZE * SIZE])
    packed = tmp_path / "parts.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for name in ("part.img", "part.hdr"):
            archive.write(tmp_path / name, name)
    with pytest.raises(ReadError, match="bytes that its header promises"):
        read(f"/vsizip/{packed}/part.img")


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("compress", ["deflate", "lzw"])
def test_a_damaged_mask_is_noticed(tmp_path: Path, beside: bool, compress: str) -> None:
    path = tmp_path / "masked.tif"
    profile = {"width": SIZE, "height": SIZE, "count": 1, "dtype": "uint16", "transform": UTM, "compress": compress}
    valid = np.random.default_rng(7).random((SIZE, SIZE)) < 0.5
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=not beside), rasterio.open(path, "w", driver="GTiff", **profile) as file:
        file.write(heights(), 1)
        file.write_mask(valid)
    assert np.array_equal(read(path), np.where(valid, heights(), np.nan), equal_nan=True)
    mask = tmp_path / "masked.tif.msk"
    assert mask.exists() == beside
    with rasterio.open(mask if beside else f"GTIFF_DIR:2:{path}") as file:
        at = int(file.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))
        size = int(file.get_tag_item("BLOCK_SIZE_0_0", "TIFF", bidx=1))
    damaged = mask if beside else path
    data = damaged.read_bytes()
    longer = zlib.compress(bytes(4 * SIZE * SIZE))
    broken = (longer[:-1] + bytes([longer[-1] ^ 1])).ljust(size, b"\0")
    damaged.write_bytes(data[:at] + broken + data[at + size :])
    with pytest.raises(ReadError, match="Deflate stream is damaged"):
        read(path)


@pytest.mark.parametrize("size", [0, 100, 300])
def test_a_mask_that_cannot_be_opened_is_noticed(tmp_path: Path, size: int) -> None:
    """GDAL goes on without it, and what is missing would be heights."""
    path = tmp_path / "masked.tif"
    profile = {"width": SIZE, "height": SIZE, "count": 1, "dtype": "uint16", "transform": UTM}
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "w", driver="GTiff", **profile) as file:
        file.write(heights(), 1)
        file.write_mask(np.arange(SIZE * SIZE).reshape(SIZE, SIZE) % 3 > 0)
    mask = tmp_path / "masked.tif.msk"
    mask.write_bytes(mask.read_bytes()[:size])
    with pytest.raises(ReadError, match=r"masked\.tif"):
        read(path)


def packed(folder: Path, *names: str) -> Path:
    """An archive of files of a folder, which go."""
    with zipfile.ZipFile(folder / "parts.zip", "w") as archive:
        for name in names:
            archive.write(folder / name, name)
            (folder / name).unlink()
    return folder / "parts.zip"


def contained(folder: Path, form: str, cut: bool) -> str:
    """What GDAL calls a raster in a container, relative to a folder; of the container a part is lost, if it is cut."""
    if form == "zip":
        path = write(folder / "part.img", "ENVI")
        path.write_bytes(path.read_bytes()[: SIZE * SIZE if cut else None])
        return f"/vsizip/{packed(folder, 'part.img', 'part.hdr')}/part.img"
    path = write(folder / "part.nc", "netCDF", FORMAT="NC")
    path.write_bytes(path.read_bytes()[: -SIZE * SIZE if cut else None])
    return f'NETCDF:"{path}":Band1' if form == "netcdf" else 'NETCDF:"part.nc":Band1'


@pytest.mark.parametrize("form", ["zip", "netcdf", "netcdf-relative"])
@pytest.mark.parametrize("cut", [False, True])
def test_parts_in_containers_are_looked_at(tmp_path: Path, form: str, cut: bool) -> None:
    part = contained(tmp_path, form, cut)
    body = source(part.replace('"', "&quot;"))
    if form != "netcdf-relative":
        body = body.replace('relativeToVRT="1"', 'relativeToVRT="0"')
    area = virtual(tmp_path / "area.vrt", body)
    if cut:
        with pytest.raises(ReadError, match=r"part\.(img|nc)|cannot be read"):
            read(area)
    else:
        assert np.array_equal(read(area), heights())


def test_parts_of_a_vrt_in_a_vrt_s_text_are_looked_at(tmp_path: Path) -> None:
    part = write(tmp_path / "part.img", "ENVI")
    inner = virtual(tmp_path / "inner.vrt", source(str(part)).replace('relativeToVRT="1"', 'relativeToVRT="0"'))
    text = inner.read_text().replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    area = virtual(tmp_path / "area.vrt", source(text).replace('relativeToVRT="1"', 'relativeToVRT="0"'))
    inner.unlink()
    assert np.array_equal(read(area), heights())
    assert str(part) in files_of(str(area))
    part.write_bytes(part.read_bytes()[: SIZE * SIZE])
    with pytest.raises(ReadError, match=r"part\.img"):
        read(area)


@pytest.mark.parametrize("how", ["mask-band", "complex", "nested"])
@pytest.mark.parametrize("inside", [False, True])
def test_a_damaged_mask_of_a_part_is_noticed(tmp_path: Path, how: str, inside: bool) -> None:
    path = tmp_path / "masked.tif"
    profile = {"width": SIZE, "height": SIZE, "count": 1, "dtype": "uint16", "transform": UTM, "crs": "EPSG:32633"}
    valid = np.random.default_rng(7).random((SIZE, SIZE)) < 0.5
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=inside), rasterio.open(path, "w", driver="GTiff", **profile) as file:
        file.write(heights(), 1)
        file.write_mask(valid)
    mask_band = f'<MaskBand><VRTRasterBand dataType="Byte">{source(path.name)}</VRTRasterBand></MaskBand></VRTDataset>'
    if how == "complex":
        area = virtual(tmp_path / "area.vrt", f"<NoDataValue>0</NoDataValue>{source(path.name)}")
        text = area.read_text().replace("SimpleSource", "ComplexSource")
        text = text.replace("</ComplexSource>", "<UseMaskBand>true</UseMaskBand></ComplexSource>")
        area.write_text(text)
    else:
        area = virtual(tmp_path / "area.vrt", source(path.name))
        mask_band = mask_band.replace("<SourceBand>1<", "<SourceBand>mask,1<")
        area.write_text(area.read_text().replace("</VRTDataset>", mask_band))
        if how == "nested":
            body = mask_band.replace("masked.tif", "area.vrt")
            area = virtual(tmp_path / "outer.vrt", source("area.vrt"))
            area.write_text(area.read_text().replace("</VRTDataset>", body))
    assert np.array_equal(read(area), np.where(valid, heights(), np.nan), equal_nan=True)
    damaged = path if inside else tmp_path / "masked.tif.msk"
    with rasterio.open(f"GTIFF_DIR:2:{path}" if inside else damaged) as file:
        at = int(file.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))
        size = int(file.get_tag_item("BLOCK_SIZE_0_0", "TIFF", bidx=1))
    data, longer = damaged.read_bytes(), zlib.compress(bytes(4 * SIZE * SIZE))
    broken = (longer[:-1] + bytes([longer[-1] ^ 1])).ljust(size, b"\0")
    damaged.write_bytes(data[:at] + broken + data[at + size :])
    with pytest.raises(ReadError, match="Deflate stream is damaged"):
        read(area)


@pytest.mark.parametrize("properties", [f'<SourceProperties RasterXSize="{SIZE}" RasterYSize="{SIZE}"/>', ""])
def test_a_part_of_another_size_than_the_vrt_says(tmp_path: Path, properties: str) -> None:
    """GDAL gives 0 for what a file that was replaced by a smaller one lacks."""
    write(tmp_path / "part.tif", "GTiff")
    rectangle = f'xOff="0" yOff="0" xSize="{SIZE}" ySize="{SIZE}"'
    body = (
        '<SimpleSource><SourceFilename relativeToVRT="1">part.tif</SourceFilename><SourceBand>1</SourceBand>'
        f"{properties}<SrcRect {rectangle}/><DstRect {rectangle}/></SimpleSource>"
    )
    area = virtual(tmp_path / "area.vrt", body)
    np.testing.assert_array_equal(read(area), heights())
    with rasterio.open(tmp_path / "part.tif") as file:
        some = file.read(1)[:150]
        profile = {**file.profile, "height": 150}
    with rasterio.open(tmp_path / "part.tif", "w", **profile) as file:
        file.write(some, 1)
    with pytest.raises(ReadError, match=r"150 × 200 samples, but the VRT .* 200 × 200"):
        read(area)


def test_a_part_that_is_an_overview(tmp_path: Path) -> None:
    """It has fewer samples than the file, as the VRT says."""
    with rasterio.open(write(tmp_path / "part.tif", "GTiff"), "r+") as file:
        file.build_overviews([2])
    half = f'xOff="0" yOff="0" xSize="{SIZE // 2}" ySize="{SIZE // 2}"'
    body = (
        '<SimpleSource><SourceFilename relativeToVRT="1">part.tif</SourceFilename><OpenOptions>'
        '<OOI key="OVERVIEW_LEVEL">0</OOI></OpenOptions><SourceBand>1</SourceBand>'
        f'<SourceProperties RasterXSize="{SIZE // 2}" RasterYSize="{SIZE // 2}" DataType="UInt16"/>'
        f"<SrcRect {half}/><DstRect {half}/></SimpleSource>"
    )
    found = read(virtual(tmp_path / "area.vrt", body))[: SIZE // 2, : SIZE // 2]
    with rasterio.open(tmp_path / "part.tif", overview_level=0) as file:
        np.testing.assert_array_equal(found, file.read(1))


@pytest.mark.parametrize("name", ["vrt://{}", "vrt://{}?bands=1", "/vsisubfile/0_,{}"])
def test_files_by_other_names(tmp_path: Path, name: str) -> None:
    """They are read, and a change of the file behind the name is one of the input."""
    path = write(tmp_path / "part.tif", "GTiff")
    location = name.format(path)
    np.testing.assert_array_equal(read(location), heights())
    before = states(files_of(location))
    path.write_bytes(path.read_bytes() + b"more")
    assert all(a != b for a, b in zip(before, states(files_of(location)), strict=True))


def test_an_index_of_tiles_is_refused(tmp_path: Path) -> None:
    """GDAL gives 0 for a tile that is lost, and does not say which there are."""
    tile = write(tmp_path / "tile.tif", "GTiff")
    west, north, south, east = 500000, 4000000, 4000000 - 30 * SIZE, 500000 + 30 * SIZE
    corners = [[west, north], [east, north], [east, south], [west, south], [west, north]]
    feature = {"type": "Feature", "properties": {"location": str(tile)},
               "geometry": {"type": "Polygon", "coordinates": [corners]}}  # fmt: skip
    crs = {"type": "name", "properties": {"name": "EPSG:32633"}}
    index = tmp_path / "index.geojson"
    index.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]}))
    try:
        rasterio.open(f"GTI:{index}").close()
    except rasterio.errors.RasterioIOError:
        pytest.skip("this GDAL has no GTI")
    with pytest.raises(ReadError, match="index of tiles"):
        read(f"GTI:{index}")


@pytest.mark.parametrize("how", ["gone", "cut", "replaced"])
def test_a_part_that_is_there_again_is_read_again(tmp_path: Path, how: str) -> None:
    """GDAL's pool of parts outlives a VRT in a VRT, and gives 0 for what it could not open once."""
    part = write(tmp_path / "part.tif", "GTiff", compress="lzw")
    area = virtual(tmp_path / "area.vrt", source("part.tif"))
    outer = virtual(tmp_path / "outer.vrt", source("area.vrt"))
    assert np.array_equal(read(outer), heights())
    data = part.read_bytes()
    if how == "replaced":
        with rasterio.open(part, "r+") as file:
            file.write(heights()[::-1], 1)
        assert np.array_equal(read(area), heights()[::-1])
        assert np.array_equal(read(outer), heights()[::-1])
        return
    if how == "gone":
        part.unlink()
    else:
        part.write_bytes(data[:-900])
    for path in (area, outer, area):
        with pytest.raises(ReadError):
            read(path)
    part.write_bytes(data)
    assert np.array_equal(read(area), heights())
    assert np.array_equal(read(outer), heights())


@pytest.mark.parametrize("change", [('xSize="200"', 'xSize="20 0x"'), ("<SimpleSource>", "<SimpleSource> &")])
def test_parts_that_cannot_be_understood(tmp_path: Path, change: tuple[str, str]) -> None:
    write(tmp_path / "part.tif", "GTiff")
    area = virtual(tmp_path / "area.vrt", source("part.tif", 0))
    area.write_text(area.read_text().replace(*change, 1))
    with pytest.raises(ReadError, match=r"area\.vrt"):
        read(area)


def test_what_a_filter_takes_of_a_part_that_is_too_small(tmp_path: Path) -> None:
    kernel = '<Kernel normalized="1"><Size>1</Size><Coefs>1</Coefs></Kernel></KernelFilteredSource>'
    body = source("part.tif", 0).replace("<Simple", "<KernelFiltered").replace("</SimpleSource>", kernel)
    write(tmp_path / "part.tif", "GTiff")
    area = virtual(tmp_path / "area.vrt", body)
    assert np.array_equal(read(area), heights())
    with rasterio.open(
        tmp_path / "part.tif", "w", driver="GTiff", width=99, height=99, count=1, dtype="uint16"
    ) as file:
        file.write(heights()[:99, :99], 1)
    with pytest.raises(ReadError, match="99 × 99"):
        read(area)
