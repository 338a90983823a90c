"""Files cut short or altered are read alike every time, or refused; what was cut off is never made up."""

from __future__ import annotations

import random
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from orograph.dem import read
from orograph.errors import ReadError

from .mutants import made, mutants, outcomes, write

ENCODED = {"mapbox_st_helens.png": "mapbox", "terrarium.png": "terrarium", "14-2625-6369.png": "mapbox",
           "fuji.png": "mapbox"}  # fmt: skip
RASTERS = {".tif", ".tiff", ".png", ".nc", ".cub", ".dem", ".hgt", ".gtx", ".bag", ".dt0", ".ter", ".grib"}
WITHOUT_AN_END = {"XYZ", "VRT"}  # columns of points end anywhere
glibc = pytest.mark.skipif(sys.platform != "linux", reason="MALLOC_PERTURB_ is glibc's")


def judged(files: list[tuple[str, Path, Path, str | None]], folder: Path, seed: int, cuts: int, changes: int) -> int:
    """Read mutants of (format, to open, of samples, encoding) twice; how many there were."""
    rng = random.Random(seed)
    whole = outcomes([(opened, encoding) for _, opened, _, encoding in files], 0)
    said: list[tuple[str, str, list[str | int]]] = []
    paths: list[tuple[Path, str | None]] = []
    for (name, opened, data, encoding), before in zip(files, whole, strict=True):
        for change, mutant in mutants(data.read_bytes(), rng, cuts, changes) if before[0] == "read" else ():
            said.append((f"{name} {opened.name}: {change} of {data.stat().st_size}", change, before))
            paths.append((write(folder / str(len(paths)), opened, data, mutant), encoding))
    first, again = outcomes(paths, 85), outcomes(paths, 170)
    for (what, change, before), one, two in zip(said, first, again, strict=True):
        assert one == two, (what, one, two)
        assert one[0] in ("read", "refused"), (what, one)
        if change.startswith("cut") and one[0] == "read" and not what.startswith(tuple(WITHOUT_AN_END)):
            assert one == before, (what, one)
    return len(paths)


@pytest.mark.stress
@glibc
def test_a_few_of_the_formats_that_need_watching(tmp_path: Path) -> None:
    only = {"PNG", "HFA runs", "HFA spilled", "PCIDSK", "PCRaster", "ENVI", "ILWIS", "netCDF", "MRF Deflate", "AAIGrid",
            "GTiff DEFLATE", "GTiff Deflate strips", "GTiff LZW"}  # fmt: skip
    files = [(name, opened, data, None) for name, opened, data in made(tmp_path / "made", only)]
    assert {name for name, *_ in files} >= only - {"MRF Deflate"}
    assert judged(files, tmp_path, 1, 2, 9) > 150


@glibc
@pytest.mark.stress
@pytest.mark.parametrize("seed", range(4))
def test_every_format_that_can_be_written(tmp_path: Path, seed: int) -> None:
    files = [(name, opened, data, None) for name, opened, data in made(tmp_path / "made")]
    assert judged(files, tmp_path, seed, 8, 12) > 1500


@glibc
@pytest.mark.stress
@pytest.mark.parametrize("seed", range(4))
def test_real_files(tmp_path: Path, shared_data: Path, seed: int) -> None:
    paths = sorted(p for p in shared_data.rglob("*") if p.suffix.lower() in RASTERS and p.stat().st_size < 700_000)
    assert len(paths) >= 50
    assert judged([(p.parent.name, p, p, ENCODED.get(p.name)) for p in paths], tmp_path, seed, 8, 12) > 2000


@pytest.mark.parametrize("seed", range(12))
def test_a_deflate_stream_that_yields_too_much_is_damage(tmp_path: Path, seed: int) -> None:
    """What libtiff takes for whole: of 64 altered bytes per file some make a stream longer."""
    [(_, opened, data), *_] = made(tmp_path / "made", {"GTiff DEFLATE"})
    whole = read(opened).heights
    rng = random.Random(seed)
    altered = bytearray(data.read_bytes())
    for _ in range(3):
        altered[rng.randrange(200, len(altered))] ^= 1 << rng.randrange(8)
    (tmp_path / "altered.tif").write_bytes(altered)
    try:
        found = read(tmp_path / "altered.tif").heights
    except ReadError as error:
        assert "altered.tif" in str(error)
    else:
        np.testing.assert_array_equal(found, whole)


@pytest.mark.parametrize("kind", ["zip", "gz"])
def test_damage_within_an_archive_is_noticed(tmp_path: Path, kind: str) -> None:
    import gzip
    import zipfile

    for name in ("GTiff DEFLATE", "PNG"):
        [(_, opened, data), *_] = made(tmp_path / name, {name})
        altered = bytearray(data.read_bytes()[: -200 if name == "PNG" else None])
        if name != "PNG":
            altered[-40] ^= 255
        path = tmp_path / f"{opened.name}.{kind}"
        if kind == "zip":
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr(opened.name, bytes(altered))
        else:
            path.write_bytes(gzip.compress(bytes(altered)))
        with pytest.raises(ReadError, match=r"a\.(tif|png)"):
            read(path)


def test_a_png_whose_image_data_are_short(tmp_path: Path) -> None:
    """All chunks have their checksums, and yet the picture is not all there."""
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 20, 20, 8, 0, 0, 0, 0)
    for rows, said in ((20, None), (13, "after 273 of 420 bytes")):
        data = zlib.compress(bytes(21 * rows))
        path = tmp_path / f"{rows}.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b""))
        if said is None:
            assert read(path).heights.shape == (20, 20)
        else:
            with pytest.raises(ReadError, match=said):
                read(path)


def test_terrain_pictures_cut_short(tmp_path: Path, shared_data: Path) -> None:
    for name, encoding in (("mapbox_st_helens.png", "mapbox"), ("terrarium.png", "terrarium")):
        whole = (shared_data / "pymartini-tiles" / name).read_bytes()
        for part in (0.1, 0.5, 0.9, 0.999):
            path = tmp_path / f"{part}{name}"
            path.write_bytes(whole[: int(len(whole) * part)])
            with pytest.raises(ReadError, match="ends"):
                read(path, encoding=encoding)


def test_a_classic_netcdf_of_records_cut_short(tmp_path: Path, shared_data: Path) -> None:
    whole = (shared_data / "nasty-gdal" / "rotated_pole.nc").read_bytes()
    path = tmp_path / "cut.nc"
    path.write_bytes(whole[:-100])
    with pytest.raises(ReadError, match="of the 31,540 bytes"):
        read(path)
    shutil.copy(shared_data / "nasty-gdal" / "rotated_pole.nc", path)
    assert read(path).heights.shape == (108, 137)


def test_the_checksums_of_dted_count(tmp_path: Path, shared_data: Path) -> None:
    data = (shared_data / "nasty-gdal" / "n43.dt0").read_bytes()
    path, rng = tmp_path / "n43.dt0", random.Random(6)
    for _ in range(20):
        altered = bytearray(data)
        altered[rng.randrange(3428, len(data))] ^= 1 << rng.randrange(8)  # behind the three headers
        path.write_bytes(altered)
        try:
            found = read(path).heights
        except ReadError:
            continue
        np.testing.assert_array_equal(found, read(shared_data / "nasty-gdal" / "n43.dt0").heights)


ARCHIVES = ["zip", "gz", "tar.gz"]


def packed(folder: Path, opened: Path, kind: str, data: bytes | None = None) -> tuple[Path, str]:
    """An archive of a file and of what lies beside it, and GDAL's name of the file in it."""
    import gzip
    import tarfile
    import zipfile

    folder.mkdir(exist_ok=True)
    path = folder / f"{opened.name}.{kind}"
    if kind == "zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in opened.parent.iterdir():
                archive.write(file, file.name)
        return path, f"/vsizip/{path}/{opened.name}"
    if kind == "gz":
        path.write_bytes(gzip.compress(opened.read_bytes()))
        return path, f"/vsigzip/{path}"
    with tarfile.open(path, "w:gz" if kind == "tar.gz" else "w") as archive:
        for file in opened.parent.iterdir():
            archive.add(file, file.name)
    return path, f"/vsitar/{path}/{opened.name}"


@pytest.mark.parametrize("kind", ARCHIVES)
@pytest.mark.parametrize("name", ["GTiff NONE", "GTiff LZW"])
def test_the_checksums_of_an_archive_count(tmp_path: Path, kind: str, name: str) -> None:
    """GDAL goes on after a checksum that differs, and these formats have none of their own."""
    opened = next(file for _, file, _ in made(tmp_path / "made", {name}))
    path, location = packed(tmp_path / "packed", opened, kind)
    whole = read(location).heights
    np.testing.assert_array_equal(whole, read(opened).heights)
    data, rng = path.read_bytes(), random.Random(5)
    for _ in range(12):
        altered = bytearray(data)
        altered[rng.randrange(60, len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(altered)
        try:
            found = read(location).heights
        except ReadError:
            continue
        np.testing.assert_array_equal(found, whole)


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
@pytest.mark.parametrize("name", ["ENVI", "PCIDSK", "HFA runs", "HFA spilled", "ILWIS"])
def test_files_cut_short_within_an_archive(tmp_path: Path, kind: str, name: str) -> None:
    """What is noticed of a file is noticed in an archive, too, of all files that it is made of."""
    _, opened, data = next(each for each in made(tmp_path / "made", {name}))
    _, location = packed(tmp_path / "packed", opened, kind)
    np.testing.assert_array_equal(read(location).heights, read(opened).heights)
    whole = data.read_bytes()
    data.write_bytes(whole[: len(whole) * 2 // 3])
    _, location = packed(tmp_path / "cut", opened, kind)
    with pytest.raises(ReadError):
        read(location)
