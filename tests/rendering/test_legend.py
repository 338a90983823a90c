"""What the furniture says is what was drawn: keys, scale, north, names."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from scenes import NORTH_UP, hills, terrain

from orograph.geovis.layers import Layer
from orograph.rendering.cpu import draw as cpu
from orograph.rendering.furniture import furnish as furniture
from orograph.rendering.furniture import legend
from orograph.scene import camera
from orograph.scene.scene import Scene

SIZE = (320, 180)


def told(monkeypatch, scene):
    """What ``furnish`` is given for a scene."""
    given = {}
    monkeypatch.setattr(furniture, "furnish", lambda pixels, **pieces: (given.update(pieces), pixels)[1])
    cpu.draw(scene)
    return given


def plan(ground, **options):
    return Scene.of(ground, camera.plan(ground, SIZE), samples=1, furniture=True, **options)


def test_keys_are_of_what_is_seen(monkeypatch):
    heights = hills(200, 400, tall=60)
    heights[:, :150] = 0
    heights[80:110, 60:90] = np.nan
    ground = terrain(heights)
    keys = told(monkeypatch, plan(ground))["legend"]
    assert len(keys.scales) == 1 and [words for words, _ in keys.swatches] == ["Water", "No data"]
    tile = dict(keys.swatches)["No data"]
    assert tile.shape == (7, 7, 3) and len(np.unique(tile.reshape(-1, 3), axis=0)) == 2
    assert all((tile == np.roll(tile, (k, -k), (0, 1))).all() for k in range(7))  # lines at 45°
    # The same terrain, its eastern part alone in the picture.
    x, y = (float(v) for v in ground.grid.xy(300, 100))
    east = camera.fit(np.array([[x - 2000, y - 1500, 800.0], [x + 2000, y + 1500, 800.0]]),
                      camera.direction(180, 90), 30, SIZE)  # fmt: skip
    keys = told(monkeypatch, Scene.of(ground, east, samples=1, furniture=True))["legend"]
    assert keys.swatches == ()
    assert [words for words, _ in told(monkeypatch, plan(ground, water=None))["legend"].swatches] == ["No data"]


@pytest.mark.parametrize(("covered", "explained"), [(0.5, True), (1.0, False)])
def test_heights_are_explained_unless_an_image_hides_them(monkeypatch, tmp_path, covered, explained):
    import rasterio

    ground = terrain(hills(200, 400))
    path = tmp_path / "image.tif"
    with rasterio.open(path, "w", driver="GTiff", width=10, height=10, count=3, dtype="uint8", crs="EPSG:32611",
                       transform=NORTH_UP @ Affine.scale(41 * covered, 21)) as file:  # fmt: skip
        file.write(np.full((3, 10, 10), 99, np.uint8))
    keys = told(monkeypatch, plan(ground, layers=(Layer(str(path)),)))["legend"]
    assert (keys is not None) == explained
    heights = hills(200, 400)
    heights[80:110, 60:90] = np.nan
    keys = told(monkeypatch, plan(terrain(heights), layers=(Layer(str(path)),)))["legend"]
    assert dict(keys.swatches).keys() == {"No data"} and bool(keys.scales) == explained


def test_layers_are_explained(monkeypatch, tmp_path):
    """Each scale has the values and the unit of its raster; classes have swatches; heights come last, if seen."""
    import rasterio

    ground, path = terrain(hills(200, 400)), tmp_path / "rain_of_may.tif"
    values = np.linspace(10, 90, 200 * 410, dtype=np.float32).reshape(200, 410)
    with rasterio.open(path, "w", driver="GTiff", width=410, height=200, count=1, dtype="float32", crs="EPSG:32611",
                       transform=NORTH_UP) as file:  # fmt: skip
        file.write(values, 1)
        file.units = ("Kelvin",)
    over = Layer(str(path), colormap="viridis", range=(20, 80), opacity=0.6)
    keys = told(monkeypatch, plan(ground, layers=(over,)))["legend"]
    (scale,) = keys.scales
    assert (scale.words, scale.low, scale.high) == ("rain of may (K)", 20, 80)
    np.testing.assert_array_equal(scale.colors[0], [68, 1, 84])
    with rasterio.open(path, "r+") as file:
        file.descriptions = ("rain",)
    assert told(monkeypatch, plan(ground, layers=(over,)))["legend"].scales[0].label == "rain"
    thin = Layer(str(path), colormap="magma", range=(0, 100), opacity=0.3, name="Heat")
    keys = told(monkeypatch, plan(ground, layers=(over, thin)))["legend"]
    assert [one.label for one in keys.scales] == ["Heat", "rain"]
    keys = told(monkeypatch, plan(ground, layers=(thin,)))["legend"]
    assert [one.label for one in keys.scales] == ["Heat", "Height"]
    classes = Layer((values > 50).astype(np.uint8) + 1, colormap={1: "#00ff00", 2: "#0000ff"}, name="Cover")
    keys = told(monkeypatch, plan(ground, layers=(classes,)))["legend"]
    assert keys.scales == () and [words for words, _ in keys.swatches] == ["Cover", "1", "2"]
    np.testing.assert_array_equal(dict(keys.swatches)["1"], [0, 255, 0])


@pytest.mark.parametrize(
    ("codes", "meanings", "words"),
    [((11, 42, 90), {}, ["cover", "11", "42", "90"]),
     ((11, 42, 90), {"flag_values": "11, 42", "flag_meanings": "open_water forest"},
      ["cover", "open water", "forest", "90"]),
     ((0, 1, 2), {}, None)],
)  # fmt: skip
def test_classes_of_a_colour_table_are_explained(monkeypatch, tmp_path, codes, meanings, words):
    """Land cover has a legend; an image of numbered colours has none."""
    import rasterio

    ground, path = terrain(hills(200, 400)), tmp_path / "cover.tif"
    with rasterio.open(path, "w", driver="GTiff", width=410, height=200, count=1, dtype="uint8", crs="EPSG:32611",
                       transform=NORTH_UP) as file:  # fmt: skip
        file.write(np.resize(np.repeat(codes, 20), (200, 410)).astype(np.uint8), 1)
        file.write_colormap(1, {code: (code, 100, 200, 255) for code in codes})
        file.update_tags(1, **meanings)
    keys = told(monkeypatch, plan(ground, layers=(Layer(str(path), opacity=0.6),)))["legend"]
    if words is None:
        assert keys is None
    else:
        assert [word for word, _ in keys.swatches] == words
        np.testing.assert_array_equal(keys.swatches[1][1], [codes[0], 100, 200])


def test_counts_do_not_depend_on_threads(monkeypatch):
    heights = hills(200, 400, tall=60)
    heights[:, :150] = 0
    seen = []
    shown = legend._legend
    monkeypatch.setattr(
        legend, "_legend", lambda drawn, scene: (seen.append(dict(drawn.shown)), shown(drawn, scene))[1]
    )
    for jobs in (1, 4):
        cpu.draw(plan(terrain(heights), jobs=jobs))
    assert seen[0] == seen[1] and seen[0]["ground"] > seen[0]["water"] > 0


def test_one_scale_where_there_is_one(monkeypatch):
    ground = terrain(hills(200, 400, tall=20))
    steep = told(monkeypatch, Scene.of(ground, camera.whole(ground, SIZE), samples=1, furniture=True))
    assert steep["metres_per_pixel"] > 0 and "scale at" in steep["note"]
    x, y = (float(v) for v in ground.grid.xy(200, 199))
    low = camera.View((x, y, 900.0), (x, y + 100, 895.0), width=320, height=180)
    level = told(monkeypatch, Scene.of(ground, low, samples=1, furniture=True))
    assert level["metres_per_pixel"] is None and "scale" not in level["note"]


def test_scale_is_that_of_the_ground(monkeypatch):
    """Web Mercator is stretched by 1 / cos φ: very nearly, for its sphere has the ellipsoid's larger radius."""
    from pyproj import Transformer

    x, y = Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True).transform(10.0, 60.0)
    ground = terrain(hills(), Affine(30, 0, x, 0, -30, y), "EPSG:3857")
    scene = plan(ground)
    assert told(monkeypatch, scene)["metres_per_pixel"] == pytest.approx(scene.view.pixel_metres / 2, rel=0.005)
    utm = plan(terrain(hills()))
    assert told(monkeypatch, utm)["metres_per_pixel"] == pytest.approx(utm.view.pixel_metres, rel=0.001)


def test_names_that_are_none():
    assert legend._crs_name(CRS("EPSG:32611")) == "WGS 84 / UTM zone 11N"
    assert (
        legend._crs_name(CRS("+proj=laea +lat_0=45 +lon_0=7 +type=crs")) == "Lambert Azimuthal Equal Area, 45° N 7° E"
    )
    assert legend._crs_name(None) is None
    assert legend._crs_name(CRS('LOCAL_CS["Unnamed",UNIT["metre",1]]')) is None


def test_grid_north_is_named_where_it_differs():
    """On a transverse Mercator grid the convergence is near Δλ·sin φ (Snyder 1987, eq. 8-15 to first order)."""
    for lon, named in ((-117.0, False), (-114.2, False), (-105.0, True)):
        ground = terrain(hills())
        from pyproj import Proj

        x, y = Proj("EPSG:32611")(lon, 40.0)
        view = camera.View((x, y, 9000.0), (x, y, 0.0))
        angle = legend.convergence(Scene.of(ground, view))
        assert angle == pytest.approx((lon + 117) * np.sin(np.radians(40)), abs=0.2)
        assert (abs(angle) > legend.CONVERGENCE) == named
    nowhere = terrain(hills(), crs=None)
    assert legend.convergence(Scene.of(nowhere, camera.plan(nowhere, SIZE))) == 0


@pytest.mark.parametrize("projection", ["perspective", "plan"])
def test_automatic_framing_leaves_room(projection, tmp_path):
    """From the command line and from Python: no piece needs a slip, since none lies over ground."""
    import rasterio
    from click.testing import CliRunner
    from PIL import Image

    import orograph
    from orograph.cli.render import command
    from orograph.rendering.furniture.furnish import EDGE

    heights = hills(120, 200)
    dem, out = tmp_path / "dem.tif", tmp_path / "out.png"
    with rasterio.open(dem, "w", driver="GTiff", width=200, height=120, count=1, dtype="float32", crs="EPSG:32611",
                       transform=NORTH_UP) as file:  # fmt: skip
        file.write(heights, 1)
    arguments = [str(dem), "-o", str(out), "--furniture", "--samples", "1", "--size", "640x400"]
    done = CliRunner().invoke(command, [*arguments, "--projection", projection], obj={})
    assert done.exit_code == 0, done.output
    pictures = [np.asarray(Image.open(out))]
    ground = terrain(heights)
    if projection == "perspective":
        pictures.append(orograph.render(ground, size=(640, 400), furniture=True, samples=1).pixels)
    for pixels in pictures:
        assert not (pixels == EDGE).all(2).any()
    close = camera.whole(ground, (640, 400))
    covered = orograph.render(ground, close, furniture=True, samples=1).pixels
    assert (covered == EDGE).all(2).any()
