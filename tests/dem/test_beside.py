"""Notes beside a GeoTIFF (.aux.xml) that contradict it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from orograph.dem import Source

UTM = Affine(30, 0, 5e5, 0, -30, 4e6)
BAND = '<PAMRasterBand band="1">{}</PAMRasterBand>'


def made(path: Path, *, plain: bool = False) -> Path:
    said = {} if plain else {"crs": "EPSG:32611", "transform": UTM, "nodata": -9999}
    with rasterio.open(path, "w", driver="GTiff", height=5, width=6, count=1, dtype="float32", **said) as file:
        file.write(np.arange(30, dtype=np.float32).reshape(5, 6), 1)
        if not plain:
            file.units, file.scales, file.offsets = ("ft",), (0.1,), (5.0,)
    return path


def warnings_of(path: Path, note: str) -> str:
    Path(f"{path}.aux.xml").write_text(f"<PAMDataset>{note}</PAMDataset>")
    with Source.open(path) as source:
        return " ".join(source.warnings)


def crs(code: int) -> str:
    return "<SRS>" + CRS(code).to_wkt().replace('"', "&quot;") + "</SRS>"


@pytest.mark.parametrize(
    ("note", "said"),
    [(crs(32612), "the CRS WGS 84 / UTM zone 12N, but the file itself says WGS 84 / UTM zone 11N"),
     ("<GeoTransform>600000,30,0,4000000,0,-30</GeoTransform>", "lies at 600000, 4000000, but the file itself says"),
     ("<GeoTransform>500000,60,0,4000000,0,-60</GeoTransform>", "that it lies at"),
     (BAND.format("<NoDataValue>7</NoDataValue>"), "that 7.0 is missing, but the file itself says -9999.0"),
     (BAND.format("<UnitType>m</UnitType>"), "in 'm', but the file itself says 'ft'"),
     (BAND.format("<Scale>20</Scale>"), "a scale and offset of 20,"),
     (BAND.format("<Offset>9</Offset>"), "a scale and offset of")],
)  # fmt: skip
def test_what_contradicts_is_told(tmp_path: Path, note: str, said: str) -> None:
    assert said in warnings_of(made(tmp_path / "a.tif"), note)


@pytest.mark.parametrize(
    "note",
    ["", crs(32611), "<GeoTransform>500000,30,0,4000000,0,-30</GeoTransform>",
     BAND.format("<NoDataValue>-9999</NoDataValue><UnitType>ft</UnitType>"),
     BAND.format('<Metadata><MDI key="STATISTICS_MAXIMUM">29</MDI></Metadata>')],
)  # fmt: skip
def test_what_agrees_is_not(tmp_path: Path, note: str) -> None:
    assert "aux.xml" not in warnings_of(made(tmp_path / "a.tif"), note)


def test_what_is_said_only_beside_counts(tmp_path: Path) -> None:
    path = made(tmp_path / "a.tif", plain=True)
    note = crs(32611) + "<GeoTransform>500000,30,0,4000000,0,-30</GeoTransform>"
    assert warnings_of(path, note + BAND.format("<NoDataValue>7</NoDataValue><UnitType>ft</UnitType>")) == ""
    with Source.open(path) as source:
        assert source.grid.transform == UTM
        assert source.nodata == 7


WORLD = "{a}\n0\n0\n{e}\n{x}\n{y}\n"
RIGHT = {"a": "30.0", "e": "-30.0", "x": "500015.0", "y": "3999985.0"}  # the middle of the first sample


@pytest.mark.parametrize("name", ["a.tfw", "a.wld", "a.tifw"])
@pytest.mark.parametrize(
    "wrong", [{"x": "500000.0"}, {"y": "4999985.0"}, {"a": "31"}, {"e": "-28,5"}, {"a": "-30", "e": "30"}]
)
def test_a_world_file_that_contradicts_the_file_is_told(tmp_path: Path, name: str, wrong: dict[str, str]) -> None:
    path = made(tmp_path / "a.tif")
    (tmp_path / name).write_text(WORLD.format(**{**RIGHT, **wrong}))
    with Source.open(path) as source:
        assert f"{name} beside it says that it lies at" in " ".join(source.warnings)
        assert source.grid.transform == UTM  # what the warning says is used


@pytest.mark.parametrize("text", [WORLD.format(**RIGHT), WORLD.format(**{**RIGHT, "x": "500015.4"}), "", "no numbers"])
def test_a_world_file_that_agrees_or_says_nothing_is_not(tmp_path: Path, text: str) -> None:
    path = made(tmp_path / "a.tif")
    (tmp_path / "a.tfw").write_text(text)
    with Source.open(path) as source:
        assert not [one for one in source.warnings if "tfw" in one]


def test_a_world_file_places_what_says_nothing_of_its_place(tmp_path: Path) -> None:
    path = made(tmp_path / "a.tif", plain=True)
    (tmp_path / "a.tfw").write_text(WORLD.format(**RIGHT))
    with Source.open(path, assume_crs="EPSG:32611") as source:
        assert not [one for one in source.warnings if "tfw" in one]
        assert source.grid.transform == UTM


def test_a_world_file_of_points(tmp_path: Path) -> None:
    """PixelIsPoint: GDAL's place has half a sample more; the world file names middles anyway."""
    path = tmp_path / "a.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=5, width=6, count=1, dtype="float32", crs="EPSG:32611", transform=UTM
    ) as file:
        file.update_tags(AREA_OR_POINT="Point")
        file.write(np.arange(30, dtype=np.float32).reshape(5, 6), 1)
    (tmp_path / "a.tfw").write_text(WORLD.format(**RIGHT))
    with Source.open(path) as source:
        assert not [one for one in source.warnings if "tfw" in one]
