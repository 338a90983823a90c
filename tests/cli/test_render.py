"""``orograph render`` as people use it: files in, pictures out, and what it says when it cannot."""

from __future__ import annotations

import datetime
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from PIL import Image
from pyproj import CRS, Transformer

from orograph import store
from orograph.geo.grid import Grid
from orograph.lighting.sun import place as place_of
from orograph.lighting.sun import position
from orograph.store.prepare import prepare

PLACE = Affine(30, 0, 500_000, 0, -30, 4_000_000)
SMALL = ("--size", "160x90", "--quiet")


def hills(rows=80, cols=100):
    y, x = np.mgrid[:rows, :cols]
    return (500 + 200 * np.sin(x / 9) * np.cos(y / 7)).astype(np.float32)


def write(path, heights=None, transform=PLACE, crs="EPSG:32611", **profile):
    heights = hills() if heights is None else heights
    rows, cols = heights.shape
    with rasterio.open(path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype=heights.dtype, crs=crs,
                       transform=transform, **profile) as file:  # fmt: skip
        file.write(heights, 1)
    return path


@pytest.fixture
def dem(tmp_path):
    return write(tmp_path / "dem.tif")


def refused(said, code, *words):
    """One paragraph on stderr, nothing on stdout, the right exit code."""
    assert said[0] == code, said
    assert said[1] == ""
    assert "Traceback" not in said[2]
    assert len(said[2].strip().splitlines()) == 1, said[2]
    for word in words:
        assert word in said[2], said[2]


# ---- pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("ending", "kind"), [("png", "PNG"), ("jpg", "JPEG"), ("webp", "WEBP"), ("tif", "TIFF")])
def test_formats(run, dem, tmp_path, ending, kind):
    out = tmp_path / f"a.{ending}"
    code, said, _ = run("render", dem, "-o", out, *SMALL)
    assert code == 0 and str(out) in said and "160 × 90" in said
    with Image.open(out) as image:
        assert image.format == kind and image.size == (160, 90) and image.mode == "RGB"
        assert len(np.unique(np.asarray(image).reshape(-1, 3), axis=0)) > 200
    assert not list(tmp_path.glob(".*")) and not list(tmp_path.glob("*.part"))


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_json_depth_and_the_camera_again(run, dem, tmp_path):
    out, depth, view = tmp_path / "a.png", tmp_path / "d.tif", tmp_path / "v.json"
    code, said, err = run("render", dem, "-o", out, "--from", 120, "--pitch", 20, "--depth", depth, "--save-view", view,
                          "--json", *SMALL)  # fmt: skip
    assert code == 0 and err == ""
    told = json.loads(said)
    for key in ("picture", "depth", "width", "height", "seconds_in_all", "seconds", "crs", "view", "windows",
                "tolerance_px", "hit_fraction", "edge_fraction", "shader"):  # fmt: skip
        assert key in told
    assert told["picture"] == str(out) and told["crs"] == "EPSG:32611" and told["view"]["width"] == 160
    with rasterio.open(depth) as file:
        assert file.dtypes == ("float32",) and file.shape == (90, 160)
        z = file.read(1)
    assert np.isnan(z).any() and np.isfinite(z).mean() == pytest.approx(told["hit_fraction"])
    assert 100 < np.nanmin(z) < np.nanmax(z) < 20_000

    again = tmp_path / "b.png"
    assert run("render", dem, "-o", again, "--view", view, "--quiet")[0] == 0
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_a_view_in_degrees(run, dem, tmp_path):
    first, view = tmp_path / "a.png", tmp_path / "v.json"
    assert run("render", dem, "-o", first, "--depth", tmp_path / "a.tif", "--save-view", view, *SMALL)[0] == 0
    camera = json.loads(view.read_text())
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    for name in ("eye", "target"):
        camera[name] = [*move.transform(*camera[name][:2]), camera[name][2]]
    camera["crs"] = "EPSG:4326"
    view.write_text(json.dumps(camera))
    second = tmp_path / "b.png"
    assert run("render", dem, "-o", second, "--depth", tmp_path / "b.tif", "--view", view, "--quiet")[0] == 0
    a, b = (rasterio.open(tmp_path / f"{n}.tif").read(1) for n in "ab")
    np.testing.assert_allclose(a, b, rtol=1e-5)


def test_standing_somewhere(run, dem, tmp_path):
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    lon, lat = move.transform(501_500, 3_996_000)
    code, said, _ = run("render", dem, "-o", tmp_path / "a.png", "--lonlat", f"{lon},{lat},1500", "--json", *SMALL)
    assert code == 0
    np.testing.assert_allclose(json.loads(said)["view"]["eye"], [501_500, 3_996_000, 1500], atol=0.01)


def test_several_tiles_are_one_terrain(run, tmp_path):
    heights = hills(80, 101)
    west = write(tmp_path / "w.tif", heights[:, :51])
    east = write(tmp_path / "e.tif", heights[:, 50:], Affine(30, 0, 500_000 + 50 * 30, 0, -30, 4_000_000))
    whole = write(tmp_path / "whole.tif", heights)
    options = ("--title", "same", *SMALL)
    assert run("render", west, east, "-o", tmp_path / "two.png", *options)[0] == 0
    assert run("render", whole, "-o", tmp_path / "one.png", *options)[0] == 0
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_degrees_and_plans_and_everything_on(run, tmp_path):
    dem = write(tmp_path / "deg.tif", hills(), Affine(0.001, 0, 8, 0, -0.001, 47), "EPSG:4326")
    code, _, _ = run("render", dem, "-o", tmp_path / "a.png", "--projection", "plan", "--from", 90, "--furniture",
                     "--title", "Ein Titel", "--sky", "--size", "400x300", "--quiet")  # fmt: skip
    assert code == 0


def test_a_picture_as_heights(run, tmp_path):
    Image.fromarray((hills() / 4).astype(np.uint8)).save(tmp_path / "h.png")
    code, said, _ = run("render", tmp_path / "h.png", "-o", tmp_path / "a.png", "--spacing", 30, "--json", *SMALL)
    assert code == 0 and json.loads(said)["crs"] is None


# ---- what it refuses -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--from", 10, "--lonlat", "8,47,1000"), ("one camera",)),
        (("--view", "v.json", "--pitch", 3), ("one camera",)),
        (("--look-at", "8,47"), ("--lonlat",)),
        (("--projection", "plan", "--pitch", 10), ("--pitch", "plan")),
        (("--projection", "plan", "--lonlat", "8,47,1000"), ("--lonlat", "plan")),
        (("--pitch", 100), ("--pitch",)),
        (("--distance", -1), ("--distance",)),
        (("--exaggeration", 0), ("exaggeration",)),
        (("--water", "nan"), ("water",)),
        (("--light-at", "-117,36.1,900,400"), ("--light aperture",)),
        (("--light-at", "-117,36.1,900,0", "--light", "aperture"), ("reach",)),
        (("--disc", "10,100,1", "--light", "aperture"), ("altitude",)),
        (("--colormap", "virids"), ("no colour map 'virids'", "viridis")),
    ],
)
def test_wrong_options(run, dem, tmp_path, options, words):
    refused(run("render", dem, "-o", tmp_path / "a.png", *options, *SMALL), 2, *words)
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--relief", -1), "-1.0 is not in the range"),
        (("--tolerance", -1), "-1.0 is not in the range"),
        (("--samples", 0), "0 is not in the range"),
        (("--light-at", "-117,36.1,900,400,1", "--light", "aperture"), "without the last 3"),
        (("--disc", "10,20", "--light", "aperture"), "is not AZ,ALT,DIAMETER"),
        (("--method", "saor"), "There is no method 'saor'"),
        (("--sun", "noon"), "'noon' is not a sun"),
    ],
)
def test_what_an_option_cannot_be_is_said_of_the_option(run, dem, tmp_path, options, said):
    code, out, err = run("render", dem, "-o", tmp_path / "a.png", *options, *SMALL)
    assert code == 2 and out == "" and said in err and f"Invalid value for '{options[0]}'" in err
    assert not (tmp_path / "a.png").exists()


@pytest.mark.stress
def test_lights(run, dem, tmp_path):
    """Each light draws another picture; what is baked into a store is used."""
    path, seen = tmp_path / "s.oro", []
    assert run("build", dem, "-o", path, "--bake", "aperture,sky-view-factor", "--quiet")[0] == 0
    for light, told in (("ao", "baked sky-view-factor"), ("aperture", "baked aperture"), ("raytraced", "16 rays"),
                        ("none", "none"), ("relief", None)):  # fmt: skip
        given = ("--light", light, "--rays", 16, "--json", *SMALL)
        code, said, err = run("render", path, "-o", tmp_path / "a.png", *given)
        assert code == 0, err
        assert json.loads(said)["shader"].get("light") == told
        seen.append(np.asarray(Image.open(tmp_path / "a.png")).tobytes())
    assert len(set(seen)) == 5
    more = ("--light-at", "-117,36.137,900,400", "--disc", "120,30,20,1,0.5,0", "--light", "aperture")
    code, _, err = run("render", path, "-o", tmp_path / "b.png", *more, *SMALL)
    assert code == 0, err
    assert np.asarray(Image.open(tmp_path / "b.png")).tobytes() not in seen


def test_the_sun_may_be_a_time(run, dem, tmp_path):
    code, said, err = run("render", dem, "-o", tmp_path / "a.png", "--sun", "2026-06-21T19:00Z", "--json", *SMALL)
    assert code == 0, err
    azimuth, altitude = json.loads(said)["sun"]
    there = position(datetime.datetime(2026, 6, 21, 19, tzinfo=datetime.UTC), *place_of(prepare([str(dem)]).grid))
    assert altitude == pytest.approx(there[1], abs=1e-9) and abs((azimuth - there[0] + 180) % 360 - 180) < 4


@pytest.mark.parametrize(
    "options",
    [("--size", "12x"), ("--size", "0"), ("--size", "0x5"), ("--sun", "1"), ("--sun", "10,100"), ("--sun", "nan,10"),
     ("--sun", "2026-06-21T12:00"), ("--lonlat", "1,2"), ("--fov", "0"), ("--water", "wet"), ("--samples", "0"),
     ("--projection", "map"), ("--nope",)],
)  # fmt: skip
def test_wrong_words(run, dem, tmp_path, options):
    code, out, err = run("render", dem, "-o", tmp_path / "a.png", *options)
    assert code == 2 and out == "" and "Usage:" in err and options[0] in err and "Traceback" not in err


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("{", 3, ("not JSON",)),
        ("[1]", 3, ("JSON object",)),
        ('{"eye": [1, 2, 3]}', 2, ("target",)),
        ('{"eye": [1, 2], "target": [1, 2, 3], "crs": "EPSG:4326"}', 2, ("eye",)),
        ('{"eye": [1, 2, 3], "target": [1, 2, 3]}', 2, ("same point",)),
        ('{"eye": [1, 2, 3], "target": [1, 2, 4], "eyes": 2}', 2, ("eyes",)),
        ('{"eye": [1, 2, 3], "target": [1, 2, 4], "width": 1e999}', 2, ("width",)),
        ('{"eye": [1, 2, 3], "target": [1, 2, 4], "up": [0, 0, 0]}', 2, ("up",)),
        ('{"eye": [1, 2, 3], "target": [1, 2, 4], "crs": "EPSG:nope"}', 2, ("nope",)),
        ('{"eye": [500, 95, 3], "target": [1, 2, 4], "crs": "EPSG:4326"}', 2, ("eye",)),
    ],
)
def test_wrong_views(run, dem, tmp_path, text, code, words):
    (tmp_path / "v.json").write_text(text)
    refused(run("render", dem, "-o", tmp_path / "a.png", "--view", tmp_path / "v.json", *SMALL), code, "v.json", *words)
    refused(run("render", dem, "-o", tmp_path / "a.png", "--view", tmp_path / "none.json", *SMALL), 3, "none.json")


def test_outputs_that_cannot_be_written_are_said_first(run, tmp_path):
    """Even where the input is wrong as well: nothing is drawn for nothing."""
    none = tmp_path / "none.tif"
    refused(run("render", none, "-o", tmp_path / "no" / "a.png", *SMALL), 4, "There is no folder", "a.png")
    refused(run("render", none, "-o", tmp_path / "a.xyz", *SMALL), 2, ".xyz", ".png")
    refused(run("render", none, "-o", tmp_path / "a", *SMALL), 2, "without ending")
    refused(run("render", none, "-o", tmp_path / "a.png", "--depth", "d.png", *SMALL), 2, "--depth", ".png", ".tif")
    for option in ("--depth", "--save-view"):
        there = tmp_path / "no" / "b.tif"
        refused(run("render", none, "-o", tmp_path / "a.png", option, there, *SMALL), 4, "no folder")


def test_nothing_overwrites_what_it_is_made_of(run, dem, tmp_path):
    before = dem.read_bytes()
    view, image, link = tmp_path / "v.json", tmp_path / "i.png", tmp_path / "link.tif"
    view.write_text('{"eye": [1, 2, 3], "target": [1, 2, 4]}')
    image.write_bytes(b"an image")
    link.symlink_to(dem)
    other = write(tmp_path / "other.tif")
    refused(run("render", dem, "-o", dem, *SMALL), 2, "--output would overwrite the input")
    refused(run("render", other, dem, "-o", link, *SMALL), 2, "--output would overwrite the input")
    refused(run("render", link, "-o", tmp_path / ".." / tmp_path.name / "dem.tif", *SMALL), 2, "would overwrite")
    refused(run("render", dem, "-o", tmp_path / "a.png", "--depth", dem, *SMALL), 2, "--depth would overwrite")
    refused(run("render", dem, "-o", tmp_path / "a.png", "--save-view", dem, *SMALL), 2, "--save-view would overwrite")
    refused(run("render", dem, "-o", tmp_path / "a.png", "--view", view, "--save-view", view, *SMALL), 2, "--view")
    refused(run("render", dem, "-o", image, "--drape", image, *SMALL), 2, "--drape")
    refused(
        run("render", dem, "-o", tmp_path / "a.tif", "--depth", tmp_path / "a.tif", *SMALL), 2, "--output and --depth"
    )
    geoid = write(tmp_path / "geoid.tif")
    refused(run("render", dem, "-o", geoid, "--to-vertical", "ellipsoidal", "--geoid", geoid, *SMALL), 2, "--geoid")
    area = built(tmp_path / "a.oro", hills())
    refused(run("render", area, "-o", area / "heights" / "a.png", *SMALL), 2, "lies within the input")
    assert (
        dem.read_bytes() == before and image.read_bytes() == b"an image" and view.read_text().startswith('{"eye": [1')
    )


def test_what_is_said_about_a_camera(run, dem, tmp_path):
    """The eye 1000 m under the ground: drawn, and said."""
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    lon, lat = move.transform(501_500, 3_999_000)
    options = ("-o", tmp_path / "a.png", "--size", "160x90")
    code, _, err = run("render", dem, "--lonlat", f"{lon},{lat},-500", *options)
    assert code in (0, 5) and "m below the ground there" in err
    refused(run("render", dem, "--lonlat", f"{lat},{lon},2000", *options, "--quiet"), 2, "swapped")
    refused(
        run("render", dem, "--lonlat", f"{lon},{lat},2000", "--look-at", f"{lat},{lon}", *options, "--quiet"), 2,
        "swapped",
    )  # fmt: skip
    (tmp_path / "v.json").write_text(json.dumps({"eye": [lon, lat, 2000], "target": [lon, lat + 0.01, 500]}))
    said = run("render", dem, "--view", tmp_path / "v.json", *options, "--quiet")
    refused(said, 5, '"crs": "EPSG:4326"')
    code, _, err = run("render", dem, "--sun", "100,-20", *options)
    assert code == 0 and "below the horizon" in err and "the ground there" not in err
    code, _, err = run("render", dem, "--title", "x", *options)
    assert code == 0 and "--furniture" in err


def test_pictures_that_do_not_fit_into_memory(run, dem, tmp_path):
    for size, words in (("100000x100000", "466 GiB of memory"), ("3000000x30000", "4.093 TiB of memory")):
        refused(run("render", dem, "-o", tmp_path / "a.png", "--size", size, "--quiet"), 2, words)
    allowed = ("--size", "2000x2000", "--max-memory", "150MiB", "--quiet")
    wires = ("--method", "soar", "--wireframe")
    refused(run("render", dem, "-o", tmp_path / "a.png", *allowed, *wires), 2, "191 MiB", "--max-memory")
    code, said, _ = run("render", dem, "-o", tmp_path / "large.png", "--size", "1300x1200", *allowed[2:])
    assert code == 0 and "1300 × 1200" in said  # by bands
    run("render", dem, "-o", tmp_path / "once.png", "--size", "1300x1200", "--quiet")
    with Image.open(tmp_path / "large.png") as a, Image.open(tmp_path / "once.png") as b:
        assert np.array_equal(np.asarray(a), np.asarray(b))
    code, _, err = run("render", dem, "-o", tmp_path / "a.png", "--max-memory", "10")
    assert code == 2 and "64MiB" in err and not (tmp_path / "a.png").exists()


def test_layers_over_the_ground(run, dem, tmp_path):
    options = ("--size", "80x45", "--light", "none", "--quiet")
    shape = hills().shape
    image, rain = tmp_path / "image.tif", tmp_path / "rain.tif"
    with rasterio.open(dem) as file:
        profile = {**file.profile, "count": 3, "dtype": "uint8", "nodata": None}
    with rasterio.open(image, "w", **profile) as file:
        file.write(np.full((3, *shape), np.array([200, 30, 30])[:, None, None], np.uint8))
    with rasterio.open(rain, "w", **{**profile, "count": 1, "dtype": "float32"}) as file:
        file.write(np.full((1, *shape), 40, np.float32))
    pixels = {}
    for name, layers in {
        "bare": (), "image": (image,), "half": (f"{image},opacity=0.5",),
        "both": (image, f"{rain},colormap=viridis,range=0:80,opacity=0.25"), "hidden": (f"{image},visible=no",),
    }.items():  # fmt: skip
        given = [word for layer in layers for word in ("--drape", layer)]
        assert run("render", dem, "-o", tmp_path / "a.png", *given, *options)[0] == 0
        pixels[name] = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    there = pixels["image"][..., 0] > pixels["image"][..., 1] + 100
    assert there.sum() > 300 and np.array_equal(pixels["bare"], pixels["hidden"])
    red = {name: pixels[name][there][:, 0].mean() for name in pixels}
    green = {name: pixels[name][there][:, 1].mean() for name in pixels}
    assert green["image"] < green["half"] < green["bare"]
    assert green["both"] > green["image"] + 20 and red["both"] < red["image"] + 1
    refused(run("render", dem, "-o", tmp_path / "a.png", "--drape", tmp_path / "none.tif", *options), 3, "none.tif")
    refused(run("render", dem, "-o", tmp_path / "a.png", "--drape", f"{image},opacity=3", *options), 2, "0 to 1")
    refused(run("render", dem, "-o", tmp_path / "a.png", "--drape", f"{image},opactiy=1", *options), 2, "opacity")


MOON = "+proj=eqc +a=1737400 +b=1737400 +units=m +no_defs"


def test_rasters_of_different_bodies(run, dem, tmp_path):
    moon = write(
        tmp_path / "moon.tif", None, Affine(30, 0, 500_000, 0, -30, 1_000_000), CRS.from_user_input(MOON).to_wkt()
    )
    options = ("-o", tmp_path / "a.png", *SMALL)
    refused(run("render", dem, moon, *options), 3, "moon.tif", "a different planet or moon")
    refused(run("render", moon, "--crs", "EPSG:32633", *options), 2, "moon.tif", "a different planet or moon", "--crs")
    refused(run("render", dem, "--drape", moon, *options), 2, "moon.tif", "different celestial bodies", "same body")
    assert run("render", moon, *options)[0] == 0


def test_what_info_doubts_is_said_by_render_as_well(run, tmp_path):
    options = ("-o", tmp_path / "a.png", "--size", "80x45")
    radii = write(tmp_path / "radii.tif", hills() + 6_371_000)
    shades = write(tmp_path / "shades.tif", (hills() / 4).astype(np.uint8))
    world = Affine(400_000, 0, -20_000_000, 0, -400_000, 20_000_000)
    mercator = write(tmp_path / "mercator.tif", hills(100, 100), world, "EPSG:3857")
    for dem, words in ((radii, "look like radii"), (shades, "8 bits"), (mercator, "Pseudo-Mercator")):
        code, _, err = run("render", dem, *options)
        assert code == 0 and words in err, err
        lines = [line for line in err.splitlines() if line.startswith("warning:")]
        assert len(set(lines)) == len(lines)
        assert words in run("info", dem)[1] or dem == mercator
    assert "Web Mercator" in run("info", mercator)[1]
    code, _, err = run("render", shades, shades, *options)
    assert err.count("8 bits") == 1


def test_an_unfinished_store(run, tmp_path):
    heights = hills(300, 300)
    source = store.ArraySource(heights, Grid(heights.shape, PLACE, CRS.from_epsg(32611)), "built")

    class Stopped(store.ArraySource):
        def read(self, *window):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.build(Stopped(heights, source.grid, "built"), tmp_path / "a.oro")
    assert (tmp_path / "a.oro.partial").is_dir()
    for name in ("a.oro.partial", "a.oro"):
        refused(run("render", tmp_path / name, "-o", tmp_path / "a.png", *SMALL), 4, name, "incomplete", "--resume")
        refused(run("info", tmp_path / name), 4, name, "incomplete", "--resume")


def test_the_place_of_a_plan(run, dem, tmp_path):
    depth = tmp_path / "d.tif"
    options = ("-o", tmp_path / "a.tif", "--depth", depth, "--projection", "plan", "--size", "200x160", "--quiet")
    assert run("render", dem, *options)[0] == 0
    with rasterio.open(dem) as ground, rasterio.open(depth) as plan, rasterio.open(tmp_path / "a.tif") as picture:
        assert plan.crs == ground.crs == picture.crs and plan.transform == picture.transform
        heights, z = ground.read(1), plan.read(1)
        rows, cols = np.mgrid[5:75:7, 5:95:9]
        x, y = ground.xy(rows.ravel(), cols.ravel())
        found = np.array([z[plan.index(a, b)] for a, b in zip(x, y)])
        known = heights[rows.ravel(), cols.ravel()]
        total = found + known  # depth is the eye's height less the ground's: the same sum everywhere
        assert np.ptp(known) > 200 and np.ptp(total) < 25


@pytest.mark.parametrize("azimuth", [None, 45])
def test_nothing_in_view_advises_what_applies(run, tmp_path, monkeypatch, azimuth):
    from orograph.errors import NothingInViewError

    def fail(scene, progress):
        raise NothingInViewError("Nothing.", path="x", remedy="Leave out the camera options to see all of it.")

    monkeypatch.setattr("orograph.rendering.cpu.draw.draw", fail)
    options = () if azimuth is None else ("--from", azimuth)
    code, _, err = run("render", write(tmp_path / "dem.tif"), "-o", tmp_path / "a.png", *options, *SMALL)
    assert code == 5 and ("camera options" in err) == (azimuth is not None)


def test_inputs_that_are_none(run, tmp_path):
    refused(run("render", tmp_path / "none.tif", "-o", tmp_path / "a.png", *SMALL), 3, "none.tif")
    (tmp_path / "text.tif").write_text("no raster at all")
    refused(run("render", tmp_path / "text.tif", "-o", tmp_path / "a.png", *SMALL), 3, "text.tif")
    for shape in ((1, 50), (50, 1)):
        row = write(tmp_path / "row.tif", np.ones(shape, np.float32))
        refused(run("render", row, "-o", tmp_path / "a.png", *SMALL), 3, "row", "at least two")


def test_nothing_in_view(run, dem, tmp_path):
    empty = write(tmp_path / "empty.tif", np.full((50, 60), -9999, np.float32), nodata=-9999)
    refused(run("render", empty, "-o", tmp_path / "a.png", *SMALL), 5, "None of the samples is valid")
    (tmp_path / "v.json").write_text('{"eye": [501500, 3998000, 3000], "target": [501500, 3998000, 9000]}')
    refused(
        run("render", dem, "-o", tmp_path / "a.png", "--view", tmp_path / "v.json", *SMALL), 5, "Nothing of the terrain"
    )
    assert not (tmp_path / "a.png").exists()


def test_debug_shows_where(run, tmp_path):
    code, out, err = run("render", tmp_path / "none.tif", "-o", tmp_path / "a.png", "--debug")
    assert code == 3 and out == "" and "Traceback" in err and "none.tif" in err


# ---- stores and the cache --------------------------------------------------------------------------------------------


def built(path, heights):
    source = store.ArraySource(heights, Grid(heights.shape, PLACE, CRS.from_epsg(32611)), "built")
    store.build(source, path).close()
    return path


def test_a_store(run, tmp_path):
    area = built(tmp_path / "a.oro", hills(300, 300))
    assert run("render", area, "-o", tmp_path / "a.png", *SMALL)[0] == 0
    refused(run("render", area, "-o", tmp_path / "b.png", "--assume-crs", "EPSG:4326", "--nodata", 0, *SMALL), 2,
            "--assume-crs, --nodata", "a.oro")  # fmt: skip


def damage(area):
    """Flip bytes in the middle of the finest heights."""
    files = [f for f in (area / "heights" / "0").rglob("*") if f.is_file() and f.name != "zarr.json"]
    largest = max(files, key=lambda f: f.stat().st_size)
    data = bytearray(largest.read_bytes())
    for k in range(len(data) // 4, len(data) // 2):
        data[k] ^= 0xFF
    largest.write_bytes(bytes(data))


def test_a_damaged_store_is_never_drawn(run, tmp_path):
    area = built(tmp_path / "a.oro", hills(600, 600))
    damage(area)
    refused(run("render", area, "-o", tmp_path / "a.png", *SMALL), 4, "a.oro", "heights/0", "damaged", "--repair")
    assert not (tmp_path / "a.png").exists()


def test_large_dems_are_kept(run, tmp_path, monkeypatch):
    for place in ("orograph.store.prepare.EXACT_SAMPLES", "orograph.scene.scene.EXACT_SAMPLES"):
        monkeypatch.setattr(place, 10_000)
    cache = tmp_path / "cache"
    monkeypatch.setenv("OROGRAPH_CACHE", str(cache))
    dem = write(tmp_path / "dem.tif", hills(300, 400))
    options = ("--size", "160x90", "--title", "x", "--tolerance", 0.25)
    code, out, err = run("render", dem, "-o", tmp_path / "a.png", *options)
    assert code == 0 and str(cache) not in out and "is kept at" in err and str(cache) in err
    (kept,) = cache.glob("*.oro")
    stamp = (kept / "zarr.json").stat().st_mtime_ns
    code, _, err = run("render", dem, "-o", tmp_path / "b.png", *options)
    assert code == 0 and "drawn from the store kept at" in err and str(kept) in err
    assert (kept / "zarr.json").stat().st_mtime_ns == stamp
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()

    damage(kept)
    said = run("render", dem, "-o", tmp_path / "c.png", "--tolerance", 0, *SMALL)
    assert said[0] == 4 and "delete it" in said[2] and str(kept) in said[2] and not (tmp_path / "c.png").exists()

    (kept / "zarr.json").write_text("{")  # what cannot be opened is made again
    code, _, err = run("render", dem, "-o", tmp_path / "d.png", *options)
    assert code == 0 and "built again" in err
    assert (tmp_path / "d.png").read_bytes() == (tmp_path / "a.png").read_bytes()

    os.utime(dem, (1, 1))  # another file now, as far as one can tell
    assert "is kept at" in run("render", dem, "-o", tmp_path / "e.png", *options)[2]
    assert len(list(cache.glob("*.oro"))) == 2


def test_the_cache_keeps_within_its_size(run, tmp_path, monkeypatch):
    monkeypatch.setattr("orograph.store.prepare.EXACT_SAMPLES", 10_000)
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    first, second = (write(tmp_path / f"{name}.tif", hills(300, 400)) for name in "ab")
    assert run("render", first, "-o", tmp_path / "a.png", *SMALL)[0] == 0
    (kept,) = (tmp_path / "cache").glob("*.oro")
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", "1KB")
    assert run("render", second, "-o", tmp_path / "b.png", *SMALL)[0] == 0
    (left,) = (tmp_path / "cache").glob("*.oro")  # the one that was drawn
    assert left != kept
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", "much")
    refused(run("render", first, "-o", tmp_path / "a.png", *SMALL), 2, "OROGRAPH_CACHE_SIZE")


@pytest.mark.parametrize(("mib", "fits"), [(512, False), (600, True), (1024, True)])
def test_a_raster_is_read_into_memory_where_its_picture_keeps_within_the_limit(mib, fits):
    from orograph.store.prepare import _fits

    assert _fits(4097 * 4097, mib << 20) is fits  # in memory the picture takes 544 MiB
    assert _fits(344 * 403, 64 << 20)


def test_a_cache_that_cannot_be(run, tmp_path, monkeypatch):
    monkeypatch.setattr("orograph.store.prepare.EXACT_SAMPLES", 10_000)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "file" / "cache"))
    dem = write(tmp_path / "dem.tif", hills(300, 400))
    refused(run("render", dem, "-o", tmp_path / "a.png", *SMALL), 4, "OROGRAPH_CACHE")


# ---- as a process ----------------------------------------------------------------------------------------------------


def process(*args, **kwargs):
    return [sys.executable, "-m", "orograph", *map(str, args)], {"text": True, "cwd": kwargs.pop("cwd", None), **kwargs}


@pytest.mark.stress
def test_results_and_progress_keep_apart(dem, tmp_path):
    line, options = process("render", dem, "-o", "a.png", "--size", "160x90", "--json", cwd=tmp_path)
    ran = subprocess.run(line, capture_output=True, timeout=120, **options)
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)["picture"] == "a.png" and (tmp_path / "a.png").stat().st_size > 1000
    ran = subprocess.run(process("render", dem, "-o", "no/a.png")[0], capture_output=True, timeout=120, **options)
    assert ran.returncode == 4 and ran.stdout == "" and "Traceback" not in ran.stderr


@pytest.mark.stress
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c(tmp_path):
    heights = np.random.default_rng(0).normal(500, 100, (1500, 1500)).astype(np.float32)
    dem = write(tmp_path / "dem.tif", heights)
    line, options = process("render", dem, "-o", tmp_path / "a.png", "--size", "4000x4000", "--samples", "200")
    child = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)
    time.sleep(2.5)  # at work: the picture would take a minute
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=60)
    assert child.returncode == 130 and "interrupted" in err and out == "" and "Traceback" not in err
    assert [f.name for f in tmp_path.iterdir()] == ["dem.tif"]


def test_the_shared_california_tiles(run, shared_data, tmp_path, monkeypatch):
    """Two real tiles in degrees, one of them mostly ocean."""
    tiles = sorted(Path(shared_data / "california-3s-tiles").glob("*.tif"))[:2]
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    code, said, _ = run("render", *tiles, "-o", tmp_path / "a.png", "--json", *SMALL)
    assert code == 0 and json.loads(said)["hit_fraction"] > 0.2
    shutil.rmtree(tmp_path / "cache", ignore_errors=True)


def test_a_wrong_view_is_said_before_anything_is_read(run, tmp_path):
    path = tmp_path / "v.json"
    path.write_text('{"eye": [1, 2, 3], "target": [1, 2, 3]}')
    code, _, err = run("render", tmp_path / "not_there.tif", "-o", tmp_path / "a.png", "--view", path)
    assert code == 2 and "v.json" in err and "same point" in err


@pytest.mark.stress
def test_sizes_on_paper(run, dem, tmp_path):
    out = tmp_path / "a.png"
    for size, pixels, dpi in (
        ("4x3cm", (472, 354), 300), ("40x30mm@150", (236, 177), 150), ("1.5x1in@200", (300, 200), 200),
        ("160x90@96", (160, 90), 96), (" 4 X 3 CM @ 100 ", (157, 118), 100), ("160x90", (160, 90), None),
    ):  # fmt: skip
        code, _, err = run("render", dem, "-o", out, "--size", size, "--quiet")
        assert code == 0, err
        with Image.open(out) as image:
            assert image.size == pixels
            said = image.info.get("dpi", (None, None))
            assert said == (None, None) if dpi is None else said == pytest.approx((dpi, dpi), abs=0.02)
    options = ("--size", "16x12cm@300", "--max-memory", "150MiB", "--quiet")
    code, _, _ = run("render", dem, "-o", tmp_path / "b.jpg", *options)
    with Image.open(tmp_path / "b.jpg") as image:  # (drawn by bands)
        assert code == 0 and image.size == (1890, 1417) and image.info["dpi"] == (300, 300)


@pytest.mark.parametrize("size", ["20x15km", "20x15cm@", "20x15cm@0", "20.5x15", "0x15cm", "20x15@cm", "0.01x1mm@10"])
def test_what_is_no_size(run, dem, tmp_path, size):
    code, out, err = run("render", dem, "-o", tmp_path / "a.png", "--size", size, "--quiet")
    assert code == 2 and out == "" and ("size" in err or "dots per inch" in err or "pixel" in err)
    assert not (tmp_path / "a.png").exists()


def test_places_far_outside_are_told_with_distance_and_border(run, dem, tmp_path):
    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    options = ("-o", tmp_path / "a.png", "--size", "160x90")
    lon, lat = move.transform(501_500, 3_999_000)
    eye = ("--lonlat", f"{lon},{lat},3000")
    refused(
        run("render", dem, *eye, "--look-at", f"{lon},{lat + 3}", *options, "--quiet"), 2,
        "no ground to look at", "332 km beyond the terrain's northern border",
    )  # fmt: skip
    code, _, err = run("render", dem, *eye, "--look-at", f"{lon},{lat + 0.015}", *options)
    assert code == 0 and "beyond" not in err  # (a little outside: the horizon there)
    code, _, err = run("render", dem, "--lonlat", f"{lon - 0.6},{lat},20000", *options)
    assert code == 0 and "the eye stands 53 km beyond the terrain's western border, which is 3.84 km across" in err
    code, _, err = run("render", dem, "--lonlat", f"{lon - 0.6},{lat},20000", "--fov", "3", *options)
    assert code == 0 and "the eye stands" not in err
    (tmp_path / "v.json").write_text(
        json.dumps({"eye": [410_000, 3_999_000, 900], "target": [300_000, 3_999_000, 900]})
    )
    refused(run("render", dem, "--view", tmp_path / "v.json", *options, "--quiet"), 5,
            "90 km beyond the terrain's western border, and looks")  # fmt: skip
