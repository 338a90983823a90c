"""Files that change: what a terrain was made of is known by all its files, and none is read as if it were another."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine

from orograph import store
from orograph.dem import Source
from orograph.dem.mosaic import Mosaic
from orograph.dem.whole.files import absolute, on_disk
from orograph.errors import ReadError, StoreError
from orograph.store.inputs import changes

UTM = Affine(30, 0, 500000, 0, -30, 4000000)
SHAPE = (300, 280)


def write(path: Path, value: int, driver: str = "GTiff", **more: object) -> Path:
    heights = np.full(SHAPE, value, np.int16)
    profile = {"width": SHAPE[1], "height": SHAPE[0], "count": 1, "dtype": "int16", "transform": UTM}
    with rasterio.open(path, "w", driver=driver, crs="EPSG:32633", **profile, **more) as file:
        file.write(heights, 1)
    return path


def virtual(path: Path, *sources: str) -> Path:
    """A VRT of the rasters, each all over it."""
    each = "".join(
        f'<SimpleSource><SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource>"
        for name in sources
    )
    path.write_text(
        f'<VRTDataset rasterXSize="{SHAPE[1]}" rasterYSize="{SHAPE[0]}"><SRS>EPSG:32633</SRS>'
        f"<GeoTransform>{', '.join(map(str, UTM.to_gdal()))}</GeoTransform>"
        f'<VRTRasterBand dataType="Int16" band="1">{each}</VRTRasterBand></VRTDataset>'
    )
    return path


def replace(path: Path, value: int) -> None:
    """Another file takes its place, in one moment."""
    write(path.with_name("other.tif"), value)
    path.with_name("other.tif").replace(path)


def print_of(path: Path) -> str:
    return Mosaic.open(path).fingerprint()


def test_tiles_of_a_vrt_count(tmp_path: Path) -> None:
    tile = write(tmp_path / "tile.tif", 100)
    area, outer = virtual(tmp_path / "area.vrt", "tile.tif"), virtual(tmp_path / "outer.vrt", "area.vrt")
    before = print_of(area), print_of(outer)
    assert before == (print_of(area), print_of(outer))
    replace(tile, 900)
    assert print_of(area) != before[0] and print_of(outer) != before[1]
    assert Mosaic.open(outer).read(0, 2, 0, 2).tolist() == [[900, 900], [900, 900]]


@pytest.mark.parametrize("form", ["zip", "netcdf", "mask"])
def test_what_lies_in_containers_and_masks_of_parts_count(tmp_path: Path, form: str) -> None:
    """Parts whose names are no files' names, and what lies beside parts."""
    if form == "zip":
        write(tmp_path / "tile.tif", 100)
        archive = tmp_path / "tiles.zip"
        with zipfile.ZipFile(archive, "w") as file:
            file.write(tmp_path / "tile.tif", "tile.tif")
        changed, name = archive, f"/vsizip/{archive}/tile.tif"
    elif form == "netcdf":
        changed = tmp_path / "tile.nc"
        rasterio.shutil.copy(write(tmp_path / "tile.tif", 100), changed, driver="netCDF")
        name = f"NETCDF:&quot;{changed}&quot;:Band1"
    else:
        name = str(write(tmp_path / "tile.tif", 100))
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK="NO"), rasterio.open(name, "r+") as file:
            file.write_mask(np.ones(SHAPE, bool))
        changed = tmp_path / "tile.tif.msk"
    area = virtual(tmp_path / "area.vrt", name)
    area.write_text(area.read_text().replace('relativeToVRT="1"', 'relativeToVRT="0"'))
    assert Mosaic.open(area).read(0, 1, 0, 1).tolist() == [[100]]
    before = print_of(area)
    kept = store.build(area, tmp_path / "area.oro", shard=256, chunk=64)
    assert changes(kept.record.inputs) == [] and print_of(area) == before
    os.utime(changed, ns=(1, 1))
    assert print_of(area) != before
    assert changes(kept.record.inputs) and all(
        str(changed) in told and "was changed" in told for told in changes(kept.record.inputs)
    )


def test_names_of_gdal_are_made_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "tile.tif", 100)
    with zipfile.ZipFile("tiles.zip", "w") as file:
        file.write("tile.tif")
    here = tmp_path.as_posix()
    (tmp_path / "TILE:1:tile.tif").write_text("x")
    for name, expected in {
        "tile.tif": f"{here}/tile.tif",
        "GTIFF_DIR:1:tile.tif": f"GTIFF_DIR:1:{here}/tile.tif",
        'NETCDF:"tile.tif":z': f'NETCDF:"{here}/tile.tif":z',
        'HDF5:"tile.tif"://a/b': f'HDF5:"{here}/tile.tif"://a/b',
        "NETCDF:tile.tif:z": f"NETCDF:{here}/tile.tif:z",
        'HDF4_SDS:UNKNOWN:"tile.tif":0': f'HDF4_SDS:UNKNOWN:"{here}/tile.tif":0',
        "/vsizip/tiles.zip/tile.tif": f"/vsizip/{here}/tiles.zip/tile.tif",
        "/vsizip/{tiles.zip}/tile.tif": f"/vsizip/{{{here}/tiles.zip}}/tile.tif",
        "/vsicurl/https://a.org/tile.tif": "/vsicurl/https://a.org/tile.tif",
        "absent.tif": "absent.tif",
        "TILE:1:tile.tif": f"{here}/TILE:1:tile.tif",  # a file's name
    }.items():
        assert absolute(name) == expected
        assert on_disk(expected).is_file() == expected.startswith(("/vsizip", here, "GTIFF", "NETCDF", "HDF"))


def test_headers_and_masks_beside_a_raster_count(tmp_path: Path) -> None:
    raw = write(tmp_path / "raw.img", 1, "ENVI")
    header = raw.with_suffix(".hdr")
    before = print_of(raw)
    header.write_text(header.read_text().replace("byte order = 0", "byte order = 1"))
    assert print_of(raw) != before
    assert Source.open(raw).read(0, 1, 0, 1)[0, 0] == 256

    masked = write(tmp_path / "masked.tif", 5)
    time = masked.stat().st_mtime_ns
    before = print_of(masked)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK="NO"), rasterio.open(masked, "r+") as file:
        file.write_mask(np.zeros(SHAPE, bool))
    os.utime(masked, ns=(time, time))
    assert print_of(masked) != before
    assert np.isnan(Source.open(masked).read(0, 1, 0, 1)).all()


def test_a_file_that_was_changed_since_it_was_opened_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "dem.tif", 100)
    source = Source.open(path)
    assert source.read(0, 1, 0, 1)[0, 0] == 100
    replace(path, 900)
    with pytest.raises(ReadError, match=r"dem\.tif.*changed"):
        source.read(0, 1, 0, 1)
    assert Source.open(path).read(0, 1, 0, 1)[0, 0] == 900


@pytest.mark.parametrize("name", ["tile.tif", "masked.tif.msk", "raw.hdr"])
def test_nor_is_one_whose_parts_were_changed(tmp_path: Path, name: str) -> None:
    """A part of a VRT, a mask, a header: GDAL goes on with what it knew of them, or not."""
    paths = {
        "tile.tif": virtual(tmp_path / "area.vrt", write(tmp_path / "tile.tif", 100).name),
        "masked.tif.msk": write(tmp_path / "masked.tif", 100),
        "raw.hdr": write(tmp_path / "raw.img", 100, "ENVI"),
    }
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK="NO"), rasterio.open(tmp_path / "masked.tif", "r+") as file:
        file.write_mask(np.ones(SHAPE, bool))
    source = Source.open(paths[name])
    assert source.read(0, 1, 0, 1)[0, 0] == 100
    changed = tmp_path / name
    changed.write_bytes(changed.read_bytes() + b"\n")
    with pytest.raises(ReadError, match=rf"{name}.*changed"):
        source.read(0, 1, 0, 1)


@pytest.mark.parametrize(
    ("driver", "name", "more"), [("ILWIS", "a.mpr", {}), ("MRF", "a.mrf", {"COMPRESS": "NONE"}), ("Zarr", "a.zarr", {})]
)
def test_files_of_samples_that_drivers_do_not_list_count(tmp_path: Path, driver: str, name: str, more: dict) -> None:
    write(tmp_path / "dem.tif", 100)
    (tmp_path / "made").mkdir()
    path = tmp_path / "made" / name
    rasterio.shutil.copy(str(tmp_path / "dem.tif"), str(path), driver=driver, **more)
    before, source = print_of(path), Source.open(path)
    found = [file for file in path.parent.rglob("*") if file.suffix in (".mp#", ".til") or file.name == "0.0"]
    [samples] = found
    assert source.read(0, 1, 0, 1)[0, 0] == 100
    time = path.stat().st_mtime_ns
    samples.write_bytes(bytes(reversed(samples.read_bytes())))
    os.utime(samples, ns=(time + 10**9, time + 10**9))
    assert print_of(path) != before
    with pytest.raises(ReadError, match="changed"):
        source.read(0, 1, 0, 1)


class Meanwhile:
    """A mosaic of which something happens to its files when so many windows were read."""

    def __init__(self, mosaic: Mosaic, after: int, change: object) -> None:
        self.mosaic, self.left, self.change = mosaic, after, change

    def __getattr__(self, name: str) -> object:
        return getattr(self.mosaic, name)

    def read(self, *window: int) -> np.ndarray:
        self.left -= 1
        if self.left == 0:
            self.change()
        return self.mosaic.read(*window)


@pytest.mark.parametrize("name", ["tile.tif", "area.vrt"])
@pytest.mark.parametrize("after", [1, 2, 4])
def test_a_store_is_never_made_of_two_states_of_its_files(tmp_path: Path, name: str, after: int) -> None:
    tile = write(tmp_path / "tile.tif", 100)
    virtual(tmp_path / "area.vrt", "tile.tif")
    source = Meanwhile(Mosaic.open(tmp_path / name), after, lambda: replace(tile, 900))
    area = tmp_path / "area.oro"
    with pytest.raises((ReadError, StoreError), match="changed"):
        store.build(source, area, shard=256, chunk=64, jobs=1)
    assert not area.exists()
    try:
        terrain = store.build(tmp_path / name, area, shard=256, chunk=64, resume=True)
    except StoreError:
        terrain = store.build(tmp_path / name, area, shard=256, chunk=64, overwrite=True)
    assert (terrain.read(0, 0, SHAPE[0], 0, SHAPE[1]) == 900).all()
