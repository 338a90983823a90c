"""Manifests: what they say of files is what the files say, and counts only as long as it is true."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.dem import deciding, folders, handles, openers
from orograph.dem.mosaic import Mosaic
from orograph.dem.source import Source
from orograph.errors import OrographError, ReadError, UsageError
from orograph.store.build import build
from orograph.store.inputs import inputs_of
from orograph.verbs.manifest import manifest


def tile(path: Path, col: int = 0, value: float = 5.0, **profile: Any) -> Path:
    given = {"crs": "EPSG:32632", "dtype": "int16", "nodata": -32768, **profile}
    place = Affine(30, 0, 500_000 + 30 * 8 * col, 0, -30, 5_000_000)
    with rasterio.open(path, "w", driver="GTiff", width=8, height=6, count=1, transform=place, **given) as file:
        data = np.full((6, 8), value, given["dtype"])
        data[0, 0] = given["nodata"] if given["nodata"] is not None else value
        file.write(data, 1)
    return path


@pytest.fixture
def tiles(tmp_path: Path) -> list[Path]:
    (tmp_path / "tiles").mkdir()
    return [tile(tmp_path / "tiles" / f"t{i}.tif", i, 10.0 * i) for i in range(4)]


@pytest.fixture
def opens(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What GDAL opens."""
    seen: list[str] = []
    plain = handles.open_dataset

    def noted(location: str) -> Any:
        seen.append(location)
        return plain(location)

    monkeypatch.setattr(handles, "open_dataset", noted)
    return seen


def fresh() -> None:
    """Forget what this process knows of files, as another would not know it."""
    handles.HANDLES.close()
    deciding._known.clear()
    folders._folders.clear()


def said(source: Source) -> dict[str, Any]:
    return {one.name: repr(getattr(source, one.name)) for one in fields(source) if one.name not in ("_opened", "path")}


def test_a_mosaic_of_a_manifest_is_that_of_its_files(tiles: list[Path], tmp_path: Path, opens: list[str]) -> None:
    files = [*tiles, tile(tmp_path / "feet.tif", 4, 3.5, dtype="float64", nodata=float("nan"), crs="EPSG:32632+5703")]
    listed = tmp_path / "all.manifest.geojsonl"
    assert manifest(files, listed, progress=False).files == 5
    plain = Mosaic.open(files)
    fresh()
    opens.clear()
    found = Mosaic.open(listed)
    mark = found.fingerprint()
    assert not opens  # no file was touched
    assert [said(one) for one in found.sources] == [said(one) for one in plain.sources]
    assert mark == plain.fingerprint() and found.grid == plain.grid and found.warnings == plain.warnings
    rows, cols = plain.grid.shape
    np.testing.assert_array_equal(found.read(0, rows, 0, cols), plain.read(0, rows, 0, cols))


def test_it_is_geojson_that_other_tools_read(tiles: list[Path], tmp_path: Path) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tiles, listed, progress=False)
    features = [json.loads(line) for line in listed.read_text().splitlines()]
    assert [one["properties"]["path"] for one in features] == [f"tiles/t{i}.tif" for i in range(4)]
    ring = np.array(features[1]["geometry"]["coordinates"][0])
    assert features[1]["type"] == "Feature" and (ring[0] == ring[-1]).all()
    # the central meridian of zone 32 is 9° E, and 500 km the easting of it
    assert 9.0 < ring[:, 0].min() < 9.01 and 45.1 < ring[:, 1].min() < 45.2
    assert features[0]["properties"]["shape"] == [6, 8] and features[0]["properties"]["nodata"] == -32768


@pytest.mark.parametrize("change", ["rewritten", "mask", "edited", "options"])
def test_what_is_no_longer_true_is_opened_anew(
    change: str, tiles: list[Path], tmp_path: Path, opens: list[str]
) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tiles, listed, progress=False)
    how: dict[str, Any] = {}
    if change == "rewritten":
        tile(tiles[2], 2, 7.0, nodata=0)
        os.utime(tiles[2], ns=(1, 1))
    elif change == "mask":
        mask = {"driver": "GTiff", "width": 8, "height": 6, "count": 1, "dtype": "uint8", "transform": Affine.scale(30)}
        with rasterio.open(f"{tiles[2]}.msk", "w", **mask) as file:
            file.write(np.zeros((1, 6, 8), np.uint8))
            file.update_tags(INTERNAL_MASK_FLAGS_1="2")
    elif change == "edited":
        text = listed.read_text().replace('"nodata": -32768', '"nodata": 20', 7)
        listed.write_text(text)
    else:
        how = {"nodata": 20}
    fresh()
    opens.clear()
    found = Mosaic.open(listed, **how)
    again = Mosaic.open(tiles, **how)
    assert [said(one) for one in found.sources] == [said(one) for one in again.sources]
    anew = {Path(name).name for name in opens[: len(opens) - 4] if name.endswith(".tif")}
    assert "t2.tif" in anew
    rows, cols = again.grid.shape
    np.testing.assert_array_equal(found.read(0, rows, 0, cols), again.read(0, rows, 0, cols))


def test_made_again_it_opens_only_what_is_new(tiles: list[Path], tmp_path: Path, opens: list[str]) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tmp_path / "tiles", listed, progress=False)
    before = listed.read_text()
    tile(tmp_path / "tiles" / "t9.tif", 9)
    fresh()
    opens.clear()
    assert manifest(tmp_path / "tiles", listed, progress=False).files == 5
    assert {Path(name).name for name in opens} == {"t9.tif"}
    assert listed.read_text().startswith(before)


def test_it_goes_on_where_it_was_broken_off(
    tiles: list[Path], tmp_path: Path, opens: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tiles, listed, progress=False)
    whole = listed.read_text()
    listed.unlink()
    rows = whole.splitlines()  # two files were found, and the third was being written
    (tmp_path / ".all.manifest.geojsonl.begun").write_text("\n".join([*rows[:2], rows[2][:100]]))
    fresh()
    opens.clear()
    manifest(tiles, listed, progress=False)
    assert {Path(name).name for name in opens} == {"t2.tif", "t3.tif"} and listed.read_text() == whole
    assert not (tmp_path / ".all.manifest.geojsonl.begun").exists()


def test_damaged_and_missing_files_are_listed(tiles: list[Path], tmp_path: Path) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    tiles[1].write_bytes(b"II*\0 and nothing else")
    tiles[2].unlink()
    with pytest.raises(ReadError, match=r"2 of 4 files are damaged or missing"):
        manifest(tiles, listed, progress=False)
    assert len(manifest(tiles, listed, skip_damaged=True, progress=False).damaged) == 2
    with pytest.raises(ReadError, match=r"t1\.tif(.|\n)*t2\.tif: There is no such file"):
        Mosaic.open(listed)
    assert len(Mosaic.open(listed, skip_damaged=True).sources) == 2
    tiles[1].unlink()
    tile(tiles[1], 1)
    tile(tiles[2], 2)
    assert len(Mosaic.open(listed).sources) == 4  # they are whole now


def test_lines_of_paths_are_enough_and_their_order_is_that_of_precedence(tmp_path: Path) -> None:
    tile(tmp_path / "low.tif", 0, 1.0)
    tile(tmp_path / "high.tif", 0, 9.0)
    listed = tmp_path / "hand.manifest.geojsonl"
    listed.write_text('{"path": "high.tif"}\n\n{"path": "low.tif"}\n')
    assert Mosaic.open(listed).read(1, 2, 1, 2)[0, 0] == 9.0
    listed.write_text('{"path": "low.tif"}\n{"path": "high.tif"}\n')
    assert Mosaic.open(listed).read(1, 2, 1, 2)[0, 0] == 1.0


def test_patterns_and_folders(tiles: list[Path], tmp_path: Path) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    (tmp_path / "tiles" / "notes.txt").write_text("side file")
    (tmp_path / "tiles" / "preview.PNG").write_bytes(b"a picture")
    assert manifest(tmp_path / "tiles", listed, progress=False).files == 4
    inside = tmp_path / "tiles" / "all.manifest.geojsonl"
    for _ in range(2):
        assert manifest(tmp_path / "tiles", inside, progress=False).files == 4
    assert manifest([f"{tmp_path}/tiles/t*2.tif", tiles[1]], listed, progress=False).files == 2
    with pytest.raises(ReadError, match="There is no such file"):
        manifest(f"{tmp_path}/tiles/*.hgt", listed, progress=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [("", "lists no file"), ("{}\n", "Line 1 .* not a JSON object with a path"), ('{"path": "a"}\n[1]\n', "Line 2"),
     ('{"path": 3}', "Line 1"), ("not json", "Line 1")],
)  # fmt: skip
def test_what_is_no_manifest_is_refused(text: str, words: str, tmp_path: Path) -> None:
    listed = tmp_path / "bad.manifest.geojsonl"
    listed.write_text(text)
    with pytest.raises(ReadError, match=words):
        Mosaic.open(listed)


def test_names_and_options_are_checked(tiles: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"must end in \.manifest\.geojsonl"):
        manifest(tiles, tmp_path / "all.json", progress=False)
    with pytest.raises(UsageError, match="`resolution` cannot be given for single files"):
        manifest(tiles, tmp_path / "all.manifest.geojsonl", resolution=3, progress=False)
    with pytest.raises(OrographError, match="one raster is needed"):
        Source.open(tmp_path / "all.manifest.geojsonl")


def test_a_mask_that_comes_while_a_terrain_is_built_is_noticed(tiles: list[Path]) -> None:
    mosaic = Mosaic.open(tiles)
    before = mosaic.fingerprint()
    Path(f"{tiles[1]}.aux.xml").write_text("<PAMDataset></PAMDataset>")
    assert mosaic.fingerprint() != before


def test_builds_of_a_manifest_have_the_bytes_of_builds_of_its_files(
    tiles: list[Path], tmp_path: Path, opens: list[str]
) -> None:
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tiles, listed, progress=False)
    build(tiles, tmp_path / "a.oro", progress=False)
    fresh()
    opens.clear()
    with build(listed, tmp_path / "b.oro", progress=False) as made:
        assert [Path(file["path"]).name for file in made.record.inputs["files"]] == [tile.name for tile in tiles]
    assert sorted(Path(name).name for name in opens) == [tile.name for tile in tiles]  # for their samples
    for number in (1, 2):
        build(listed, tmp_path / "c.oro", part=(number, 2), progress=False)
    build(listed, tmp_path / "c.oro", finish=True, progress=False)
    first = contents(tmp_path / "a.oro")
    assert first == contents(tmp_path / "b.oro") == contents(tmp_path / "c.oro")
    facts = orograph.info(listed, progress=False)
    assert facts["shape"] == [6, 32] and facts["height_range"][1] == 30


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_files_are_opened_once(tiles: list[Path], tmp_path: Path, opens: list[str], monkeypatch: Any) -> None:
    monkeypatch.setattr(handles.HANDLES, "limit", 0)  # as of many, none stays open
    fresh()
    mosaic = Mosaic.open(tiles)
    mosaic.fingerprint()
    assert inputs_of(mosaic) is not None
    assert len(opens) == len(tiles)


def test_the_command_line_tells_all(tiles: list[Path], tmp_path: Path) -> None:
    listed = str(tmp_path / "all.manifest.geojsonl")
    done = CliRunner().invoke(cli, ["manifest", str(tmp_path / "tiles"), "-o", listed])
    assert done.exit_code == 0 and "all.manifest.geojsonl: 4 files" in done.output
    tiles[3].write_bytes(b"")
    done = CliRunner().invoke(cli, ["manifest", str(tmp_path / "tiles"), "-o", listed, "--skip-damaged", "--json"])
    assert json.loads(done.stdout)["damaged"] == [f"{tiles[3]}: The file is empty."]
    done = CliRunner().invoke(cli, ["manifest", str(tmp_path / "tiles"), "-o", listed], standalone_mode=False)
    assert isinstance(done.exception, ReadError) and "t3.tif" in str(done.exception)


@pytest.mark.cases(1)
@pytest.mark.parametrize("named", ["absolute", "relative"])
def test_many_files_are_opened_by_other_processes(
    named: str, tiles: list[Path], tmp_path: Path, opens: list[str], monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path / "tiles")
    monkeypatch.setattr(openers, "CHUNK", 3)
    files: list[str] = [str(one) if named == "absolute" else f"../tiles/{one.name}" for one in tiles]
    vrt = Path("all.vrt")
    vrt.write_text(
        '<VRTDataset rasterXSize="8" rasterYSize="6"><SRS>EPSG:32632</SRS><GeoTransform>500000,30,0,5000180,0,-30'
        '</GeoTransform><VRTRasterBand dataType="Int16" band="1"><NoDataValue>-32768</NoDataValue><SimpleSource>'
        '<SourceFilename relativeToVRT="1">t0.tif</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    files += [str(vrt.absolute()) if named == "absolute" else str(vrt)]
    plain = Mosaic.open(files)
    manifest(files, tmp_path / "a.manifest.geojsonl", progress=False)
    monkeypatch.setattr(openers, "MANY", 4)
    fresh()
    opens.clear()
    found = Mosaic.open(files)
    assert {Path(name).name for name in opens} == {"all.vrt", "t0.tif"}  # a VRT and its part, whenever it is used
    assert [said(one) for one in found.sources] == [said(one) for one in plain.sources]
    assert [one.path for one in found.sources] == files and found.fingerprint() == plain.fingerprint()
    manifest(files, tmp_path / "b.manifest.geojsonl", progress=False)
    assert (tmp_path / "a.manifest.geojsonl").read_text() == (tmp_path / "b.manifest.geojsonl").read_text()


@pytest.mark.stress
def test_errors_of_other_processes_are_those_of_this_one(tiles: list[Path], monkeypatch: Any) -> None:
    tiles[1].write_bytes(b"II*\0 and nothing else")
    tiles[2].unlink()
    told = []
    for many in (1000, 4):
        monkeypatch.setattr(openers, "MANY", many)
        with pytest.raises(ReadError) as damaged:
            Mosaic.open(tiles)
        with pytest.raises(UsageError) as wrong:
            Mosaic.open(tiles, band=2)
        told.append([str(damaged.value), str(wrong.value)])
    assert told[0] == told[1] and "There is no band 2" in told[0][1]


def test_what_processes_leave_undone_is_done_here(tiles: list[Path], opens: list[str], monkeypatch: Any) -> None:
    monkeypatch.setattr(openers, "MANY", 4)
    monkeypatch.setattr(openers, "piped", lambda _: subprocess.Popen(
        [sys.executable, "-c", ""], stdin=subprocess.PIPE, stdout=subprocess.PIPE))  # fmt: skip
    assert len(Mosaic.open(tiles).sources) == len(opens) == 4


@pytest.mark.stress
def test_workers_read_the_manifest(tiles: list[Path], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    listed = tmp_path / "all.manifest.geojsonl"
    manifest(tiles, listed, progress=False)
    build(tiles, tmp_path / "a.oro", progress=False)
    build(listed, tmp_path / "b.oro", workers=2, max_memory=4 << 30, progress=False)
    assert contents(tmp_path / "a.oro") == contents(tmp_path / "b.oro")


def test_of_many_files_those_that_were_cut_off_are_all_named(tiles: list[Path], tmp_path: Path) -> None:
    """A download that ended early opens: its header is there, and its last samples are not."""
    for i in (1, 3):
        os.truncate(tiles[i], tiles[i].stat().st_size - 5)
    with pytest.raises(ReadError, match=r"2 of 4 files are damaged") as caught:
        Mosaic.open(tiles)
    assert "t1.tif: It ends 5 bytes before" in str(caught.value) and "t3.tif" in str(caught.value)
    found = Mosaic.open(tiles, skip_damaged=True)
    assert len(found.skipped) == 2
    with pytest.raises(ReadError, match=r"2 of 4 files"):
        manifest(tiles, tmp_path / "a.manifest.geojsonl", progress=False)
    lines = [json.loads(line) for line in (tmp_path / "a.manifest.geojsonl").read_text().splitlines()]
    assert ["error" in line.get("properties", line) for line in lines] == [False, True, False, True]
