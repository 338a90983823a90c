"""VRTs whose band says other things of numbers than their parts do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.vrt import WarpedVRT

from orograph.dem import Source
from orograph.errors import ReadError

from .test_geotiff_odd import tiff

UTM = Affine(30, 0, 5e5, 0, -30, 4e6)
COLS, ROWS = 9, 7
HEIGHTS = np.arange(COLS * ROWS, dtype=np.float32).reshape(ROWS, COLS) + 100


def part(
    path: Path, unit: str = "", scale: float = 1, nodata: float | None = None, crs: str = "EPSG:32611",
    kind: str = "float32", mask: bool = False,
) -> Path:  # fmt: skip
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"),
        rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=ROWS,
            width=COLS,
            count=1,
            dtype=kind,
            crs=crs,
            transform=UTM,
            nodata=nodata,
        ) as file,
    ):
        file.write(HEIGHTS.astype(kind), 1)
        if unit:
            file.units = (unit,)
        if scale != 1:
            file.scales = (scale,)
        if mask:
            file.write_mask(HEIGHTS > 120)
    return path


def source(
    name: str, tag: str = "SimpleSource", more: str = "", left: int = 0, width: int = COLS, take: int = 0
) -> str:
    return (
        f'<{tag}><SourceFilename relativeToVRT="1">{name}</SourceFilename><SourceBand>1</SourceBand>'
        f'<SrcRect xOff="{take}" yOff="0" xSize="{width}" ySize="{ROWS}"/>'
        f'<DstRect xOff="{left}" yOff="0" xSize="{width}" ySize="{ROWS}"/>{more}</{tag}>'
    )


def virtual(folder: Path, body: str, kind: str = "Float32") -> Path:
    path = folder / "a.vrt"
    path.write_text(
        f'<VRTDataset rasterXSize="{COLS}" rasterYSize="{ROWS}"><SRS>EPSG:32611</SRS>'
        f"<GeoTransform>{', '.join(map(str, UTM.to_gdal()))}</GeoTransform>"
        f'<VRTRasterBand dataType="{kind}" band="1">{body}</VRTRasterBand></VRTDataset>'
    )
    return path


def warnings_of(path: Path, **options: str) -> str:
    with Source.open(path, **options) as opened:  # type: ignore[arg-type]
        return " ".join(opened.warnings)


def test_units_that_it_does_not_repeat(tmp_path: Path) -> None:
    part(tmp_path / "m.tif")
    part(tmp_path / "ft.tif", unit="ft")
    part(tmp_path / "crs.tif", crs="EPSG:32611+6360")
    mixed = source("m.tif", width=4) + source("ft.tif", take=4, left=4, width=5)
    for body in (source("ft.tif"), mixed):
        path = virtual(tmp_path, body)
        assert "a unit of 0.3048 m, but it declares 1 m" in warnings_of(path)
        assert warnings_of(path, vertical_unit="ft") == ""
    assert "a unit of 0.304800" in warnings_of(virtual(tmp_path, source("crs.tif")))
    assert warnings_of(virtual(tmp_path, "<UnitType>ft</UnitType>" + source("ft.tif"))) == ""
    in_metres = source("ft.tif", "ComplexSource", "<ScaleOffset>0</ScaleOffset><ScaleRatio>0.3048</ScaleRatio>")
    assert warnings_of(virtual(tmp_path, in_metres)) == ""


def test_scales_that_it_does_not_repeat(tmp_path: Path) -> None:
    part(tmp_path / "a.tif", scale=0.1, kind="int32")
    assert "a scale of 0.1 and an offset of 0" in warnings_of(virtual(tmp_path, source("a.tif"), "Int32"))
    assert warnings_of(virtual(tmp_path, "<Scale>0.1</Scale>" + source("a.tif"), "Int32")) == ""


NODATA = "<NoDataValue>{}</NoDataValue>"


def test_missing_samples_that_it_does_not_repeat(tmp_path: Path) -> None:
    part(tmp_path / "a.tif", nodata=110)
    part(tmp_path / "b.tif", mask=True)
    left_out = source("a.tif", "ComplexSource", "<NODATA>110</NODATA>")
    heights = "they are read as heights"
    assert heights in warnings_of(virtual(tmp_path, source("a.tif")))
    assert heights in warnings_of(virtual(tmp_path, NODATA.format(-1) + source("a.tif")))
    assert "they become heights of 0" in warnings_of(virtual(tmp_path, left_out))
    assert "Parts have a mask" in warnings_of(virtual(tmp_path, source("b.tif")))
    assert warnings_of(virtual(tmp_path, source("a.tif")), nodata="110") == ""
    for body in (NODATA.format(110) + source("a.tif"), NODATA.format(-1) + left_out):
        path = virtual(tmp_path, body)
        assert warnings_of(path) == ""
        with Source.open(path) as opened:
            assert np.isnan(opened.read(0, ROWS, 0, COLS)).sum() == 1


def test_gaps(tmp_path: Path) -> None:
    part(tmp_path / "a.tif")
    halves = source("a.tif", width=4) + source("a.tif", take=4, left=4, width=5)
    gap = source("a.tif", width=4) + source("a.tif", take=5, left=5, width=4)
    twice = source("a.tif", width=5) + source("a.tif", width=5)
    assert warnings_of(virtual(tmp_path, halves)) == ""
    for body in (gap, twice, ""):
        assert "do not cover all of it" in warnings_of(virtual(tmp_path, body))
        assert warnings_of(virtual(tmp_path, NODATA.format(-1) + body)) == ""


def test_samples_from_beyond_an_edge(tmp_path: Path) -> None:
    part(tmp_path / "a.tif")
    with pytest.raises(ReadError, match="from beyond its edge"):
        Source.open(virtual(tmp_path, source("a.tif", take=-3)))


@pytest.mark.parametrize(("kind", "told"), [("Byte", True), ("Int16", True), ("Float32", False), ("Float64", False)])
def test_a_narrower_type(tmp_path: Path, kind: str, told: bool) -> None:
    part(tmp_path / "a.tif")
    assert ("clipped" in warnings_of(virtual(tmp_path, source("a.tif"), kind))) == told


@pytest.mark.parametrize("nodata", [None, -1])
def test_warped(tmp_path: Path, nodata: float | None) -> None:
    path = part(tmp_path / "a.tif", nodata=nodata)
    with rasterio.open(path) as file, WarpedVRT(file, crs="EPSG:32612") as warped:
        rasterio.shutil.copy(warped, str(tmp_path / "w.vrt"), driver="VRT")
    assert ("It is warped and declares no nodata" in warnings_of(tmp_path / "w.vrt")) == (nodata is None)


def test_a_nodata_value_that_its_type_cannot_hold(tmp_path: Path) -> None:
    part(tmp_path / "a.tif", kind="uint16")
    path = virtual(tmp_path, NODATA.format(-9999) + source("a.tif"), "UInt16")
    assert "stored as 55537" in warnings_of(path)
    assert "stored as" not in warnings_of(virtual(tmp_path, NODATA.format(7) + source("a.tif"), "UInt16"))


def test_each_of_many_parts_is_asked(tmp_path: Path) -> None:
    """One of 120 is in feet, one has another nodata value, and one is written with a scale."""
    body = ""
    for number in range(120):
        what = {"unit": "ft"} if number == 41 else {"nodata": 110.0} if number == 77 else {}
        part(tmp_path / f"p{number}.tif", **what, scale=0.5 if number == 101 else 1)  # type: ignore[arg-type]
        body += source(f"p{number}.tif", left=number % COLS, take=number % COLS, width=1)
    said = warnings_of(virtual(tmp_path, body))
    for text, number in (("a unit of 0.3048 m", 41), ("are 110,", 77), ("a scale of 0.5", 101)):
        assert text in said
        assert f"p{number}.tif" in said
    assert said.count(".tif") == 3


def test_parts_are_judged_as_they_would_be_alone(tmp_path: Path) -> None:
    """What a GeoTIFF says that cannot be, and what contradicts it beside it, is told of a VRT's parts, too."""
    part(tmp_path / "a.tif", kind="uint16")
    tiff(tmp_path / "b.tif", b"-9999\0", kind="uint16")
    tiff(tmp_path / "c.tif", b"none at all\0")
    part(tmp_path / "d.tif")
    (tmp_path / "d.tfw").write_text("30\n0\n0\n-30\n500315\n3999985\n")
    alone = warnings_of(tmp_path / "b.tif")
    assert "cannot occur in uint16" in alone
    assert alone in warnings_of(virtual(tmp_path, source("b.tif"), "UInt16"))
    assert "'none at all') is not a number" in warnings_of(virtual(tmp_path, source("c.tif")))
    said = warnings_of(virtual(tmp_path, source("a.tif", width=4) + source("d.tif", take=4, left=4, width=5)))
    assert f"Of its part {tmp_path / 'd.tif'}: d.tfw beside it says" in said
    assert warnings_of(virtual(tmp_path, source("a.tif"))) == ""
