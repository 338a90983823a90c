"""``orograph.contours`` and its files, read back by GDAL, pyarrow and by hand."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import OutputError, UsageError
from orograph.verbs.contours import ContourLines, traced


@pytest.fixture(scope="module")
def dem():
    y, x = np.mgrid[:60, :80] * 30.0
    heights = (500 + 90 * np.sin(x / 300) * np.cos(y / 250)).astype(np.float32)
    return orograph.Dem(heights, orograph.Grid((60, 80), Affine(30, 0, 500_000, 0, -30, 4_000_000), "EPSG:32611"))


def test_heights_and_index_contours(dem):
    lines = traced(dem, 20)
    assert isinstance(lines, ContourLines)
    assert set(lines.heights) == {420.0, 440.0, 460.0, 480.0, 500.0, 520.0, 540.0, 560.0, 580.0}
    assert np.array_equal(lines.is_index, lines.heights == 500.0)
    assert repr(lines).startswith("<ContourLines of 'terrain': every 20 m, 420 to 580 m, ")
    moved = traced(dem, 20, base=5, index=2)
    assert set(moved.heights[moved.is_index]) <= {5.0 + 40 * k for k in range(20)} and moved.is_index.any()
    assert set(traced(dem, levels="450.5,470").heights) == {450.5, 470.0}
    assert traced(dem).interval == 10  # 180 m of relief
    assert len(traced(dem, levels=9000)) == 0 and traced(dem, levels=9000).lines == []


def test_lines_lie_at_their_heights(dem):
    lines = traced(dem, 30)
    found = orograph.measure.heights(dem, lines.coordinates)
    # (between samples heights are measured bilinearly, and lines run on triangles)
    assert np.abs(found - np.repeat(lines.heights, np.diff(lines.offsets))).max() < 1.0


def test_without_geopandas_they_are_features(dem, monkeypatch):
    monkeypatch.setitem(sys.modules, "geopandas", None)
    lines = orograph.contours(dem, 30)
    assert isinstance(lines, ContourLines)
    with pytest.raises(UsageError, match="pip install geopandas"):
        lines.to_geodataframe()
    features = lines.__geo_interface__["features"]
    assert len(features) == len(lines)
    assert features[0]["properties"] == {"height": lines.heights[0], "is_index": bool(lines.is_index[0])}


def test_a_geodataframe(dem):
    pytest.importorskip("geopandas")
    frame, lines = orograph.contours(dem, 30), traced(dem, 30)
    assert list(frame.columns) == ["height", "is_index", "geometry"] and frame.crs.to_epsg() == 32611
    assert all(np.array_equal(g.coords, line) for g, line in zip(frame.geometry, lines.lines))
    assert np.array_equal(frame.geometry.is_ring, lines.closed)


@pytest.mark.parametrize("ending", [".gpkg", ".shp", ".fgb"])
def test_files_of_gdal(dem, tmp_path, ending):
    raw = pytest.importorskip("pyogrio.raw")
    path = tmp_path / f"lines{ending}"
    lines = traced(dem, 15)
    assert orograph.contours(dem, 15, output=path, max_memory="1MiB", jobs=2) == path
    meta, _, shapes, (heights, index) = raw.read(path)
    assert meta["crs"] in ("EPSG:32611",) or "32611" in meta["crs"]
    order = np.argsort(heights, kind="stable") if ending == ".fgb" else slice(None)  # (that one sorts by place)
    assert np.array_equal(heights[order], lines.heights)
    assert np.array_equal(index[order].astype(bool), lines.is_index)
    wkb = {bytes(s)[9:] for s in shapes}
    assert wkb == {line.tobytes() for line in lines.lines}
    assert not [p for p in tmp_path.iterdir() if p.stem != "lines"]
    lines.save(path)
    assert len(raw.read(path)[2]) == len(lines)


def test_a_geopackage_with_layers_of_others_is_not_replaced(dem, tmp_path):
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    out = tmp_path / "project.gpkg"
    for layer in ("roads", "parcels"):
        geopandas.GeoDataFrame(geometry=[shapely.Point(1, 2)], crs=4326).to_file(out, layer=layer)
    before = out.read_bytes()
    with pytest.raises(OutputError, match="holds the layers parcels, roads, which would be lost"):
        orograph.contours(dem, 20, output=out)
    with pytest.raises(OutputError, match="parcels, roads"):
        orograph.measure.viewshed(dem, dem.grid.xy(9, 9), radius=300).save(out)
    assert out.read_bytes() == before
    for _ in range(2):  # its own layer may be replaced
        orograph.contours(dem, 20, output=tmp_path / "lines.gpkg")


def test_geoparquet(dem, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path, lines = tmp_path / "lines.parquet", traced(dem, 15)
    orograph.contours(dem, 15, output=path, max_memory="1MiB")
    table = parquet.read_table(path)
    geo = json.loads(table.schema.metadata[b"geo"])
    assert geo["version"] == "1.1.0" and geo["columns"]["geometry"]["crs"]["id"] == {"authority": "EPSG", "code": 32611}
    assert {s[9:] for s in table["geometry"].to_pylist()} == {line.tobytes() for line in lines.lines}
    assert np.array_equal(table["height"], lines.heights)


def test_geojson_is_in_degrees(dem, tmp_path):
    from pyproj import Transformer

    path, lines = tmp_path / "lines.geojson", traced(dem, 40)
    orograph.contours(dem, 40, output=path, max_memory="1MiB")
    told = json.loads(path.read_text())
    assert [f["properties"]["height"] for f in told["features"]] == lines.heights.tolist()
    to = Transformer.from_crs(32611, 4326, always_xy=True)
    for feature, line in zip(told["features"], lines.lines):
        np.testing.assert_allclose(feature["geometry"]["coordinates"], np.stack(to.transform(*line.T), -1), atol=2e-9)


def test_empty_files(dem, tmp_path):
    raw = pytest.importorskip("pyogrio.raw")
    for ending in (".gpkg", ".shp", ".fgb", ".geojson"):
        path = orograph.contours(dem, levels=9000, output=tmp_path / f"none{ending}")
        assert len(raw.read(path)[2]) == 0


def test_the_command_line_says_what_it_did(dem, tmp_path):
    pytest.importorskip("pyogrio")
    source = orograph.export(dem, tmp_path / "dem.tif")
    out = tmp_path / "lines.gpkg"
    ran = CliRunner().invoke(cli, ["contours", str(source), "-o", str(out), "--interval", "20"], obj={"quiet": True})
    lines = traced(dem, 20)
    assert ran.exit_code == 0, ran.output
    said = f"{out}  {len(lines)} contour lines every 20 m from 420 to 580 m, {len(lines.coordinates):,} points\n"
    assert ran.stdout == said
    ran = CliRunner().invoke(
        cli, ["contours", str(source), "-o", str(out), "--levels", "450", "--json"], obj={"quiet": True}
    )
    assert json.loads(ran.stdout)["lines"] == len(traced(dem, levels=450))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"interval": 10, "levels": [5]}, "say the same twice"),
        ({"interval": 0.0001}, "Give a larger"),
        ({"interval": -1}, "more than 0 metres"),
        ({"simplify": -1}, "`simplify`"),
        ({"levels": "high"}, "`levels`"),
        ({"output": "lines.dxf"}, "cannot be written as .dxf"),
        ({"output": "lines"}, "a file without ending"),
    ],
)
def test_what_cannot_be_meant(dem, options, said):
    with pytest.raises(UsageError, match=said):
        orograph.contours(dem, **options)


def test_no_crs_no_geojson(tmp_path):
    heights = np.add.outer(np.arange(9.0), np.arange(9.0))
    with pytest.raises(UsageError, match="the terrain has no CRS"):
        orograph.contours(heights, 3, spacing=10, output=tmp_path / "lines.geojson")
    assert not list(tmp_path.iterdir())


def test_real_ground(shared_data):
    (fuji,) = (shared_data / "martini-fuji").glob("*.png")
    lines = traced(str(fuji), 100, encoding="mapbox", spacing=30)
    assert lines.closed.mean() > 0.5 and len(lines) > 50
