"""``orograph.render`` and what it gives: options by name, cameras, plans that know where they lie."""

from __future__ import annotations

import datetime
import inspect
import math
import re

import numpy as np
import pytest
import rasterio
from affine import Affine
from scenes import NORTH_UP, ROTATED, hills, terrain

import orograph
from orograph.errors import NothingInViewError, UsageError
from orograph.lighting.sun import Sun, sun_of
from orograph.progress import Progress
from orograph.rendering.cpu import draw as cpu
from orograph.rendering.memory import BYTES_PER_PIXEL, amount, available, check_memory
from orograph.scene.camera import whole
from orograph.scene.diagnostics import diagnose
from orograph.scene.parts import HOMES, PARTS
from orograph.scene.scene import Scene
from orograph.viewpoint import View

SIZE = (64, 48)
PLAIN = {"samples": 1, "shadows": False, "water": None}


class Heard(Progress):
    def __init__(self):
        self.warnings = []

    def warn(self, text):
        self.warnings.append(text)


@pytest.fixture(scope="module")
def ground():
    return terrain(hills())


def test_every_option_of_a_scene_is_a_keyword_that_is_documented():
    given = inspect.signature(orograph.render).parameters
    for name, part in HOMES.items():
        assert name in given
        if name != "sun":
            assert given[name].default == getattr(PARTS[part](), name), name
    documented = inspect.getdoc(orograph.render)
    for name in given:  # (how the terrain is read is told in one sentence)
        assert name == "unknown" or re.search(rf"\s{name}[,:]\s", documented), name


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exagerration": 2}, "Did you mean exaggeration"),
        ({"shadow": False}, "Did you mean shadows"),
        ({"azimuth": 90}, "orograph.camera"),
        ({"xyzzy": 1}, "The options are view, size"),
    ],
)
def test_unknown_options(ground, options, words):
    with pytest.raises(UsageError, match=f"no option '{next(iter(options))}'") as error:
        orograph.render(ground, size=SIZE, **options)
    assert words in str(error.value)


def test_cameras_are_at_hand(ground):
    view = orograph.camera.around(ground, SIZE, azimuth=225, pitch=30, distance=None)
    assert isinstance(view, orograph.View)
    picture = orograph.render(ground, view, sun=orograph.Sun(90, 30), **PLAIN)
    assert picture.grid is None
    assert repr(picture).startswith("<Picture 64 × 48") and len(repr(picture)) < 80


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.parametrize("place", [NORTH_UP, ROTATED])
@pytest.mark.parametrize("azimuth", [180.0, 90.0, 217.0])
def test_a_plan_knows_where_it_lies(tmp_path, place, azimuth):
    """A single summit, found in the picture by GDAL's georeference where its sample lies."""
    heights = np.full((41, 61), 100, np.float32)
    heights[11, 37] = 900
    ground = terrain(heights, place)
    x, y = (float(v) for v in ground.grid.xy(37, 11))
    view = orograph.camera.plan(ground, (300, 240), azimuth=azimuth)
    picture = orograph.render(ground, view, **PLAIN)
    picture.save_depth(tmp_path / "d.tif")
    picture.save(tmp_path / "p.tif")
    with rasterio.open(tmp_path / "d.tif") as file:
        assert file.crs.to_epsg() == 32611
        depth = file.read(1)
        row, col = file.index(x, y)
        top = np.unravel_index(np.nanargmin(depth), depth.shape)
        assert np.hypot(top[0] - row, top[1] - col) <= 1
        turned = file.transform.b != 0 or file.transform.d != 0
        assert turned == (azimuth == 217 or azimuth == 90)
        if azimuth == 180:
            assert file.transform.a > 0 > file.transform.e
        # the valid pixels span the samples' extent, along both axes, to a pixel or two
        r, c = np.nonzero(np.isfinite(depth))
        inside = np.array([file.xy(a, b) for a, b in ((r.min(), c.min()), (r.max(), c.max()))])
        assert np.isfinite(inside).all()
        place_of_all = [ground.grid.index(*file.xy(a, b)) for a, b in zip(r[::97], c[::97])]
        cols, rows = np.array(place_of_all).T
        assert cols.min() > -0.5 and cols.max() < 60.5 and rows.min() > -0.5 and rows.max() < 40.5
        # and pixel centres are where the camera sees them, which must not be half a pixel beside
        for a, b in ((0, 0), (17, 211), (239, 299)):
            at, _ = view.project([*file.xy(a, b), 100.0])
            np.testing.assert_allclose(at, [b + 0.5, a + 0.5], atol=1e-3)
    with rasterio.open(tmp_path / "p.tif") as file:
        assert file.count == 3 and file.crs.to_epsg() == 32611
        with rasterio.open(tmp_path / "d.tif") as other:
            assert file.transform == other.transform
        np.testing.assert_array_equal(file.read(), picture.pixels.transpose(2, 0, 1))


def test_an_eye_below_the_ground(ground):
    x, y = (float(v) for v in ground.grid.xy(40, 30))
    height = orograph.camera.ground(ground, x, y, default=math.nan)
    low, high = View((x, y, height - 250), (x, y + 900, height)), View((x, y, height + 2), (x, y + 900, height))
    (said,) = diagnose(Scene.of(ground, low))
    assert "250 m below the ground" in said and f"({height:.0f} m)" in said and "underside" in said
    assert diagnose(Scene.of(ground, high)) == []
    beside = View((x - 1e5, y, 0), (x, y, height))
    assert not any("below" in said for said in diagnose(Scene.of(ground, beside)))
    heard = Heard()
    orograph.render(ground, low.resized(*SIZE), progress=heard, **PLAIN)
    assert said in heard.warnings
    assert orograph.render(ground, low.resized(*SIZE), **PLAIN).facts["warnings"] == [said]
    plan = orograph.camera.plan(ground, SIZE)
    assert diagnose(Scene.of(ground, plan)) == []
    sunk = View((*plan.eye[:2], ground.height_range[1] - 50), (*plan.target[:2], -1e4), projection="plan")
    assert "left out" in diagnose(Scene.of(ground, sunk))[0]


@pytest.mark.parametrize(("altitude", "said"), [(45, False), (-5.9, False), (-6.5, True), (-90, True)])
def test_a_sun_below_the_horizon(ground, altitude, said):
    view = orograph.camera.whole(ground, SIZE)
    assert any("below the horizon" in text for text in diagnose(Scene.of(ground, view, sun=Sun(0, altitude)))) == said


def test_pictures_that_do_not_fit(ground):
    with pytest.raises(UsageError, match=r"100000 × 100000 .* takes 466 GiB .* \(`max_memory`\)|are free"):
        check_memory((100_000, 100_000), 1 << 30)
    side = 1000
    check_memory((side, side), BYTES_PER_PIXEL * side**2)
    with pytest.raises(UsageError, match="max_memory"):
        check_memory((side, side), BYTES_PER_PIXEL * side**2 - 1)
    with pytest.raises(UsageError, match="memory"):
        orograph.render(ground, size=(10_000_000, 1_000_000))
    free = available()
    assert free is None or free > 1 << 26
    assert amount(512) == "512 bytes" and amount(3 << 29) == "1.5 GiB" and amount(5 << 40) == "5 TiB"


def test_places_given_latitude_first(ground):
    from pyproj import Transformer

    move = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True)
    lon, lat = move.transform(*(float(v) for v in ground.grid.xy(40, 30)))
    orograph.camera.standing(ground, SIZE, (lon, lat, 3000), (lon, lat + 0.001))
    for eye, target in (((lat, lon, 3000), None), ((lon, lat, 3000), (lat, lon))):
        with pytest.raises(UsageError, match="swapped"):
            orograph.camera.standing(ground, SIZE, eye, target)
    with pytest.raises(UsageError) as error:  # nowhere near either way
        orograph.camera.standing(ground, SIZE, (lon, 95, 3000), None)
    assert "swapped" not in str(error.value)


def test_a_view_in_degrees_that_does_not_say_so(ground):
    with pytest.raises(NothingInViewError, match='"crs": "EPSG:4326"'):
        orograph.render(ground, View((-117, 36, 3000), (-117, 36.1, 0), width=64, height=48), **PLAIN)
    with pytest.raises(NothingInViewError) as error:
        orograph.render(ground, View((4e5, 3.9e6, 3000), (3e5, 3.9e6, 9000), width=64, height=48), **PLAIN)
    assert "EPSG:4326" not in str(error.value)


def test_options_as_users_give_them(ground, tmp_path):
    """Paths, numbers and words stand for the parts' own values."""
    from PIL import Image

    from orograph.geovis.layers import Layer
    from orograph.scene.contours import Contours
    from orograph.scene.silhouettes import Silhouettes

    view = orograph.camera.whole(ground, SIZE)
    image = tmp_path / "a.png"
    Image.new("RGB", (8, 8), (200, 30, 30)).save(image)
    (tmp_path / "a.pgw").write_text("300\n0\n0\n-300\n500000\n4000000\n")
    layer = Layer(str(image))
    for given, made in (
        ({"layers": image}, {"layers": (layer,)}), ({"layers": [str(image), layer]}, {"layers": (layer, layer)}),
        ({"contours": 25}, {"contours": Contours(25.0)}), ({"silhouettes": True}, {"silhouettes": Silhouettes()}),
        ({"silhouettes": False}, {}), ({"water": "none"}, {"water": None}),
        ({"sun": "90,30"}, {"sun": Sun(90.0, 30.0)}),
        ({"discs": [(90, 30, 1)], "light": "aperture"},
         {"discs": ((Sun(90, 30, 1), (1.0, 1.0, 1.0)),), "light": "aperture"}),
    ):  # fmt: skip
        assert Scene.of(ground, view, **given) == Scene.of(ground, view, **made), given
    orograph.render(ground, size=SIZE, layers=image, contours=25, **PLAIN)
    with pytest.raises(UsageError, match="at most"):
        orograph.render(ground, size=SIZE, layers=[image] * 99)


def test_an_array_gives_its_name_to_the_title():
    xr = pytest.importorskip("xarray")
    import orograph.accessor  # noqa: F401

    heights = hills(40, 50)
    for crs, step, origin in (("EPSG:32611", 30.0, (5e5, 4e6)), ("EPSG:4326", 0.001, (8.0, 47.0))):
        array = xr.DataArray(
            heights, dims=("y", "x"), name="mont_blanc", attrs={"crs": crs},
            coords={"y": origin[1] - step * np.arange(40), "x": origin[0] + step * np.arange(50)},
        )  # fmt: skip
        assert array.orograph.to_terrain().name == "mont_blanc"
    nameless = array.rename(None)
    assert nameless.orograph.to_dem().name == "terrain"
    nameless.encoding["source"] = "dems/n44w072.tif"
    assert nameless.orograph.to_dem().name == "n44w072"


def test_the_sun_may_be_a_moment(ground):
    """The same picture as of the sun that stands there then."""
    when = datetime.datetime(2026, 6, 21, 16, tzinfo=datetime.UTC)
    there = sun_of(when, ground.grid)
    pictures = [orograph.render(ground, size=SIZE, sun=sun, **PLAIN) for sun in (when, there, when.isoformat())]
    for other in pictures[1:]:
        np.testing.assert_array_equal(pictures[0].pixels, other.pixels)
    assert (pictures[0].pixels != orograph.render(ground, size=SIZE, **PLAIN).pixels).any()


def test_ground_as_tall_as_planets_are_large_is_drawn_and_needles_are_explained():
    """Rays go as far as the eye is away; what is thinner than a pixel is not drawn, and says so."""
    y, x = np.mgrid[:200, :240]
    tall = (5e8 * np.sin(x / 20) * np.cos(y / 17)).astype(np.float32)
    broad = terrain(tall, Affine(3e6, 0, 500_000, 0, -3e6, 5_000_000))
    picture = cpu.draw(Scene.of(broad, whole(broad, (80, 50)), samples=1))
    assert np.isfinite(picture.depth).mean() > 0.2 and np.nanmax(picture.depth) > 1e9
    needle = terrain(tall, Affine(30, 0, 500_000, 0, -30, 5_000_000))
    with pytest.raises(NothingInViewError, match=r"thinner than a pixel") as said:
        cpu.draw(Scene.of(needle, whole(needle, (80, 50)), samples=1))
    assert said.value.remedy is not None and "`vertical_unit`" in said.value.remedy
