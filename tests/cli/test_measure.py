"""``orograph measure`` as people call it."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
import rasterio
from PIL import Image

A, B, C = "500300,3999700", "501500,3998200", "500400,3998000"


@pytest.fixture
def measured(run, hilly):
    """A measure's JSON."""

    def call(verb, *args):
        code, said, err = run("measure", verb, hilly, *args, "--json", "--quiet")
        assert code == 0, err
        return json.loads(said)

    return call


def test_a_place(run, hilly, measured):
    told = measured("pick", A)
    assert told["crs"] == "EPSG:32611"
    (hit,) = told["places"]
    with rasterio.open(hilly) as file:
        h = file.read(1)
    assert (hit["column"], hit["row"]) == pytest.approx((9.5, 9.5))
    assert h[9:11, 9:11].min() <= hit["height"] <= h[9:11, 9:11].max() and hit["depth"] is None
    code, said, err = run("measure", "pick", hilly, A, B, "--quiet")
    assert code == 0, err
    assert said.count("height") == 2 and "lon -116." in said and "true" in said and "slope" in said


def test_degrees_that_begin_with_a_minus(measured):
    (hit,) = measured("pick", A)["places"]
    (same,) = measured("pick", "--lonlat", f"{hit['longitude']:.12f},{hit['latitude']:.12f}")["places"]
    assert same["height"] == pytest.approx(hit["height"], abs=1e-4)


def test_under_a_pixel_is_what_render_shows_there(run, hilly, measured, tmp_path):
    camera = ("--from", 135, "--pitch", 40, "--size", "320x200", "--exaggeration", 2)
    code, _, err = run("render", hilly, "-o", tmp_path / "a.png", "--depth", tmp_path / "d.tif", *camera, "--quiet")
    assert code == 0, err
    with rasterio.open(tmp_path / "d.tif") as file:
        depth = file.read(1)
    pixels = [(160.5, 100.5), (120.5, 110.5)]
    more = [a for p in pixels for a in ("--pixel", f"{p[0]},{p[1]}")]
    hits = measured("pick", *more, *camera)["places"]
    for (x, y), hit in zip(pixels, hits):
        assert hit["depth"] == pytest.approx(float(depth[int(y), int(x)]), rel=1e-5)
    code, _, err = run("measure", "pick", hilly, "--pixel", "0,0", *camera, "--quiet")
    assert code == 2 and "no ground at pixel" in err


def test_a_profile(measured, tmp_path):
    table, plot = tmp_path / "p.csv", tmp_path / "p.png"
    told = measured("profile", A, B, C, "-o", table, "-o", plot, "--every", 50)
    assert told["ground_m"] > told["horizontal_m"] > told["straight_m"] and told["missing_m"] == 0
    assert told["geodesic_m"] == pytest.approx(told["horizontal_m"], rel=1e-7)
    assert told["outputs"] == [str(table), str(plot)]
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == math.ceil(told["horizontal_m"] / 50) + 1
    assert float(rows[-1]["ground_m"]) == pytest.approx(told["ground_m"], abs=1e-3)
    with Image.open(plot) as image:
        assert image.size == (1350, 540)


def test_lines_and_polygons_from_geojson(measured, tmp_path):
    points = [measured("pick", p)["places"][0] for p in (A, B, C)]
    lonlat = [[p["longitude"], p["latitude"], 3.0] for p in points]
    grid = [[p["easting"], p["northing"]] for p in points]
    line, polygon, old = tmp_path / "l.geojson", tmp_path / "p.geojson", tmp_path / "o.geojson"
    line.write_text(json.dumps({"type": "Feature", "geometry": {"type": "LineString", "coordinates": lonlat}}))
    ring = [*lonlat, lonlat[0]]
    features = [{"type": "Feature", "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}}]
    polygon.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32611"}}
    old.write_text(json.dumps({"type": "Polygon", "coordinates": [[*grid, grid[0]]], "crs": crs}))
    assert measured("profile", "--geojson", line)["ground_m"] == pytest.approx(
        measured("profile", A, B, C)["ground_m"], abs=1e-3
    )
    expected = measured("area", A, B, C, "--level", 500)
    for file in (polygon, old):
        found = measured("area", "--geojson", file, "--level", 500)
        assert found["surface_m2"] == pytest.approx(expected["surface_m2"], rel=1e-6)
        assert found["above_m3"] == pytest.approx(expected["above_m3"], rel=1e-5)


def test_an_area(run, hilly, measured):
    told = measured("area", A, B, C)
    assert told["plan_grid_m2"] == pytest.approx(0.5 * abs(1200 * -1700 - 100 * -1500))
    assert told["surface_m2"] > told["plan_m2"] > told["plan_grid_m2"] and told["above_m3"] is None
    assert told["missing_grid_m2"] > 0
    code, said, err = run("measure", "area", hilly, A, B, C, "--level", 400, "--quiet")
    assert code == 0 and "km²" in said and "above 400 m" in said and "without data" in said, err


def test_a_line_of_sight(run, hilly, measured, tmp_path):
    told = measured("los", A, B, "--eye", 2, "-o", tmp_path / "s.svg", "-o", tmp_path / "s.csv")
    assert told["visible"] is False and 0 < told["obstruction"]["distance"] < told["horizontal_m"]
    assert told["target_needed_m"] > 0 and (tmp_path / "s.svg").is_file() and (tmp_path / "s.csv").is_file()
    assert measured("los", A, B, "--target", told["target_needed_m"] + 0.01, "--eye", 2)["visible"] is True
    assert measured("los", A, B, "--flat")["bend_per_m"] == 0
    code, said, err = run("measure", "los", hilly, A, B, "--quiet")
    assert code == 0 and "obstructed at" in said and "target needs" in said, err


def test_picked_places_as_files(run, hilly, measured, tmp_path):
    table, points = tmp_path / "places.csv", tmp_path / "places.geojson"
    told = measured("pick", A, B, "-o", table, "-o", points)
    with table.open() as file:
        rows = list(csv.DictReader(file))
    for hit, row, feature in zip(told["places"], rows, json.loads(points.read_text())["features"], strict=True):
        assert float(row["height"]) == pytest.approx(hit["height"], abs=1e-4) and row["depth"] == ""
        assert feature["geometry"]["coordinates"] == [round(hit[k], 9) for k in ("longitude", "latitude")]
        assert feature["properties"]["slope"] == float(row["slope"])
    code, _, err = run("measure", "pick", hilly, A, "-o", tmp_path / "a.png")
    assert code == 2 and "a .csv or .geojson" in err


def test_a_viewshed(run, hilly, measured, tmp_path):
    seen, picture, needed = tmp_path / "seen.tif", tmp_path / "seen.png", tmp_path / "n.tif"
    told = measured("viewshed", A, "--radius", 1200, "-o", seen, "--picture", picture, "--size", "320x200")
    with rasterio.open(seen) as file:
        values = file.read(1)
    assert told["seen"] == (values == 1).sum() and told["samples"] == np.isfinite(values).sum()
    assert told["outputs"] == [str(seen), str(picture)]
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    painted = (pixels[..., 0] > 200) & (pixels[..., 2] < 110)  # ground as if lit
    assert painted.sum() > 50
    assert measured("viewshed", A, "--heights", "-o", needed)["seen"] > 0
    with rasterio.open(needed) as file:
        assert np.nanmin(file.read(1)) == 0 and file.units == ("m",)
    code, said, err = run("measure", "viewshed", hilly, A, "-o", seen, "--quiet")
    assert code == 0 and "samples (" in said, err


@pytest.mark.stress
def test_what_is_probable(run, measured, tmp_path):
    out, picture = tmp_path / "p.tif", tmp_path / "p.png"
    how = ("--sigma", 3, "--range", 90, "--draws", 6, "--seed", 2)
    for verb in (("viewshed", A, "--radius", 1200), ("slope", "--exceeds", 10), ("contours", "--interval", 50)):
        told = measured(*verb, *how, "-o", out, "--picture", picture, "--size", "320x200")
        with rasterio.open(out) as file:
            values = file.read()
        assert told["samples"] == np.isfinite(values[0]).sum() and told["draws"] == 6
        np.testing.assert_allclose(list(told["means"].values()), np.nanmean(values, (1, 2), dtype=float), rtol=1e-6)
        assert np.nanmin(values[-1]) >= 0 and np.nanmax(values[-1]) <= 1 and values[-1].mean(where=values[-1] >= 0) > 0
        assert picture.stat().st_size > 1000
        again = measured(*verb, *how, "-o", tmp_path / "again.tif")
        assert again["means"] == told["means"]
    flooded = measured("flood", A, "--level", 600, "--picture", picture, "--size", "320x200")
    assert flooded["draws"] == 0 and set(flooded["outputs"]) == {str(picture)}


def test_a_store_measures_the_same(run, hilly, measured, tmp_path):
    assert run("build", hilly, "-o", tmp_path / "hilly.oro", "--quiet")[0] == 0
    code, said, err = run("measure", "profile", tmp_path / "hilly.oro", A, B, "--json", "--quiet")
    assert code == 0, err
    assert json.loads(said) == measured("profile", A, B)


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        (("pick",), 2, "Give a point"),
        (("pick", "1,2"), 2, "km south of hilly"),
        (("pick", "--lonlat", "36.1,-117"), 2, "Longitude comes first"),
        (("pick", "1;2"), 2, "X,Y"),
        (("pick", A, "--heigth"), 2, "No such option '--heigth'"),
        (("slope", "-o", "a.tif", "--sigm", "1"), 2, "Did you mean one of: '--sigma'"),
        (("slope", "--level=1", "-o", "a.tif", "--sigma", "1"), 2, "No such option '--level'"),
        (("los", A, B, "-x"), 2, "No such option '-x'"),
        (("profile", "--from", A, "--to", B), 2, "Points follow the file"),
        (("profile", A), 2, "at least 2 points, not 1"),
        (("profile", A, B, "-o", "a.txt"), 2, ".csv"),
        (("profile", A, B, "-o", "no/a.png"), 4, "folder"),
        (("profile", A, B, "--every", "0"), 2, "--every"),
        (("profile", "--geojson", "no.geojson"), 3, "cannot be read"),
        (("area", A, B), 2, "at least 3"),
        (("los", A, B, C), 2, "2 points, not 3"),
        (("los", A, B, "--eye", "-1"), 2, "eye's height"),
        (("viewshed", A), 2, "Give an output"),
        (("viewshed", A, "-o", "a.png"), 2, ".tif"),
        (("viewshed", A, "-o", "a.tif", "--radius", "-5"), 2, "radius"),
        (("viewshed", A, "-o", "a.tif", "--sigma", "1", "--heights"), 2, "contradict"),
        (("viewshed", A, "-o", "a.tif", "--range", "10"), 2, "--sigma gives"),
        (("viewshed", A, "-o", "a.tif", "--sigma", "-1"), 2, "standard deviation"),
        (("viewshed", A, "-o", "a.tif", "--sigma", "1", "--draws", "0"), 2, "1 to 65,535"),
        (("viewshed", A, "-o", "a.tif", "--draws", "50"), 2, "--draws applies to uncertain heights only"),
        (("viewshed", A, "-o", "a.tif", "--seed", "2"), 2, "--seed applies to uncertain heights only"),
        (("slope", "-o", "a.tif"), 2, "the uncertainty of heights"),
        (("slope", "-o", "a.tif", "--sigma", "no.tif"), 3, "no.tif"),
        (("contours", "-o", "a.tif", "--sigma", "1"), 2, "give one of the two"),
        (("flood", A, "--level", "5"), 2, "Give an output"),
        (("flood", "1,2", "--level", "5", "-o", "a.tif"), 2, "km south of hilly"),
        (("length", A, B), 2, "no measure 'length'"),
    ],
)
def test_what_is_wrong_is_said(run, hilly, tmp_path, monkeypatch, args, code, says):
    monkeypatch.chdir(tmp_path)
    found, _, err = run("measure", args[0], hilly, *args[1:], "--quiet")
    assert (found, says in err) == (code, True), err
    assert not list(tmp_path.iterdir())


def test_the_order_is_told(run, hilly):
    code, _, err = run("measure", hilly, "profile", A, B)
    assert code == 2 and f"What to measure comes first: orograph measure profile {hilly}" in err
    code, _, err = run("measure", "--max-memory", "1GiB", "pick", hilly, A)
    assert code == 2 and "then the options" in err


def test_options_of_the_terrain_stand_anywhere_after_what_is_measured(run, hilly):
    for args in (("--max-memory", "1GiB", hilly, A), (hilly, A, "--max-memory", "1GiB", "--jobs", "1")):
        code, said, err = run("measure", "pick", *args, "--quiet")
        assert code == 0 and said, err


def test_the_input_is_not_overwritten(run, hilly):
    code, _, err = run("measure", "viewshed", hilly, A, "-o", hilly)
    assert code == 2 and "overwrite" in err


def test_every_measure_has_its_help(run):
    for verb in ("pick", "profile", "area", "los", "viewshed", "flood", "slope", "contours"):
        code, said, _ = run("measure", verb, "--help")
        assert code == 0 and all(option in said for option in ("Usage", "--json", "--nodata", "--max-memory"))
    assert "viewshed" in run("measure", "--help")[1]
