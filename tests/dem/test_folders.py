"""A folder as terrain: which of its files are taken, what is told, and mosaics that are nearly all void."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.dem.folders import inside, is_folder
from orograph.dem.mosaic import Mosaic
from orograph.errors import ReadError, UsageError
from orograph.progress import Progress


def tile(path: Path, east: float, north: float = 4_000_000, side: int = 40, height: float = 100) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(
        path, "w", driver="GTiff", width=side, height=side, count=1, dtype="float32", crs="EPSG:32611",
        transform=Affine(30, 0, east, 0, -30, north),
    ) as file:  # fmt: skip
        file.write(np.full((side, side), height, np.float32), 1)
    return path


class Told(Progress):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "tiles"
    tile(place / "b.tif", 501_200)
    tile(place / "a.TIF", 500_000)
    tile(place / "more" / "c.tiff", 502_400)
    for beside in ("Copernicus_DSM_10_N36_00_WBM.tif", "ASTGTMV003_N36_num.tif", "b.tif.ovr"):
        shutil.copy(place / "b.tif", place / beside)
    for other in ("notes.txt", "b.tif.aux.xml", ".hidden.tif", "preview.png"):
        (place / other).write_text("<PAMDataset/>")
    return place


def test_what_is_taken(folder):
    found = inside(folder)
    assert [Path(one).relative_to(folder).as_posix() for one in found.rasters] == ["a.TIF", "b.tif", "more/c.tiff"]
    assert found.others == 7
    heard = Told()
    assert Mosaic.open(folder, progress=heard).grid.shape == (40, 120)
    assert heard.notes == [f"{folder}: 3 rasters taken; 7 other files left out"]


def test_virtual_rasters_stores_and_grids(folder, tmp_path):
    (folder / "all.vrt").write_text("<VRTDataset/>")
    assert len(inside(folder).rasters) == 3
    orograph.build(folder, folder / "area.oro", progress=False)
    assert len(inside(folder).rasters) == 3 and not is_folder(folder / "area.oro")
    only = tmp_path / "only"
    only.mkdir()
    (only / "all.vrt").write_text("<VRTDataset/>")
    assert [Path(one).name for one in inside(only).rasters] == ["all.vrt"]
    grid = tmp_path / "grids" / "dem"
    grid.mkdir(parents=True)
    (grid / "hdr.adf").write_bytes(b"")
    (grid / "w001001.adf").write_bytes(b"")
    (tmp_path / "grids" / "info").mkdir()
    assert inside(tmp_path / "grids").rasters == [str(grid)] and not is_folder(grid)


@pytest.mark.stress
def test_every_way_in(folder, tmp_path):
    files = [folder / "a.TIF", folder / "b.tif", folder / "more" / "c.tiff"]
    wanted = orograph.terrain(files).grid
    assert orograph.terrain(folder).grid == wanted == orograph.terrain([str(folder)]).grid
    assert orograph.info(folder)["shape"] == [40, 120]
    store = orograph.build(folder, tmp_path / "a.oro", progress=False)
    assert store.grid == wanted
    assert orograph.render(folder, "plan", size=(160, 90), progress=False).pixels.shape == (90, 160, 3)
    run = CliRunner()
    ran = run.invoke(cli, ["info", str(folder)], obj={}, catch_exceptions=False)
    assert ran.exit_code == 0 and "40 rows × 120 columns" in ran.stdout
    ran = run.invoke(cli, ["build", str(folder), "-o", str(tmp_path / "b.oro")], obj={}, catch_exceptions=False)
    assert ran.exit_code == 0 and "3 rasters taken" in ran.stderr
    with pytest.raises(ReadError, match="This is a directory"):
        orograph.read(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ReadError, match="This is a directory"):
        orograph.terrain(tmp_path / "empty")


def test_outputs_in_a_folder_that_is_read(folder):
    run = CliRunner()
    with pytest.raises(UsageError, match="take it for one of its rasters the next time"):
        run.invoke(
            cli, ["light", str(folder), "--product", "slope", "-o", str(folder / "slope.tif")], obj={"quiet": True},
            catch_exceptions=False,
        )  # fmt: skip
    out = folder / "map.png"
    ran = run.invoke(
        cli, ["render", str(folder), "-o", str(out), "--size", "160x90"], obj={"quiet": True}, catch_exceptions=False
    )
    assert ran.exit_code == 0 and out.exists()


@pytest.mark.stress
def test_far_apart(tmp_path, monkeypatch):
    files = [tile(tmp_path / f"{east}.tif", east) for east in (200_000, 450_000, 800_000)]
    assert Mosaic.open(files).void == pytest.approx(1 - 3 * 40 / 20_040)
    assert not Mosaic.open(files).warnings  # (it is small)
    monkeypatch.setattr("orograph.dem.void.LARGE", 1000)
    (said,) = Mosaic.open(files).warnings
    assert said.startswith("The files lie far apart: 99.4 % of the terrain of 40 × 20,040 samples that holds them")
    assert Mosaic.open(files[0]).void == 0 and Mosaic.open(files[0]).warnings == []
    monkeypatch.setattr("orograph.dem.void.HUGE", 100_000)
    for way in (orograph.build, lambda source, url, **how: orograph.build(Mosaic.open(source), url, **how)):
        with pytest.raises(UsageError, match=r"If this is intended, .* `resolution=30`"):
            way(files, tmp_path / "a.oro", progress=False)
    assert orograph.build(files, tmp_path / "a.oro", resolution=30, progress=False).valid_fraction < 0.01


def test_void_in_degrees(tmp_path):
    names = []
    for k, lon in enumerate((10.0, 30.0)):
        names.append(tmp_path / f"{k}.tif")
        with rasterio.open(
            names[-1], "w", driver="GTiff", width=120, height=100, count=1, dtype="int16", crs="EPSG:4326",
            transform=Affine(1 / 120, 0, lon, 0, -1 / 120, 60),
        ) as file:  # fmt: skip
            file.write(np.ones((100, 120), np.int16), 1)
    assert Mosaic.open(names[0]).void < 0.1
    assert Mosaic.open(names).void == pytest.approx(1 - 2 / 21, abs=0.03)
