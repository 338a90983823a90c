"""Focus and context: inside, a picture is what another priority draws; outside, its own; between, a smooth blend."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import orograph
from orograph.errors import UsageError
from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.focus import Focus, smooth_step
from orograph.rendering.backends import session
from orograph.scene.scene import Scene

SIZE = (160, 120)
IN, OUT = "T+D+U-", "T-D-U-"


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:90, :120]
    heights = (300 + 120 * np.sin(x / 12) * np.cos(y / 15)).astype(np.float32)
    place = orograph.Grid(heights.shape, _place()).transform
    return orograph.terrain(heights, transform=place, crs="EPSG:32630", name="hills")


def _place():
    from affine import Affine

    return Affine(100, 0, 500_000, 0, -100, 5_600_000)


@pytest.fixture(scope="module")
def data() -> orograph.Dataset:
    y, x = np.mgrid[:30, :40] / 9
    members = np.random.default_rng(2).normal(0, 0.2, (7, 30, 40)) + np.sin(x) + np.cos(y)
    return orograph.Dataset(members.astype(np.float32), band="all", uncertainty="spread", name="Field")


@pytest.fixture(scope="module")
def plain(ground, data):
    """The pictures of both priorities."""
    return {p: orograph.render(ground, size=SIZE, data=data, priority=p, progress=False) for p in (IN, OUT)}


def drawn(ground, data, focus, **more):
    return orograph.render(ground, size=SIZE, data=data, priority=OUT, focus=focus, progress=False, **more)


def check(picture, plain, weight):
    """Every pixel is the blend of two pictures by weights, in linear light."""
    part = np.asarray(weight)[..., None]
    one, other = (srgb_to_linear(plain[p].pixels / 255) for p in (OUT, IN))
    expected = linear_to_srgb(one * (1 - part) + other * part) * 255
    assert (part > 0.99).sum() > 200 and (part < 0.01).sum() > 200
    assert np.abs(picture.pixels - expected).max() < 1.0
    np.testing.assert_array_equal(picture.depth, plain[OUT].depth)


def test_a_lens(ground, data, plain):
    focus = orograph.Focus("lens", IN, at=(0.4, 0.55), radius=0.3, blend=0.1)
    y, x = np.mgrid[:120, :160] + 0.5
    far = np.hypot(x - 0.4 * 160, y - 0.55 * 120) / 120
    check(drawn(ground, data, focus), plain, smooth_step(0.3 - far, 0.1))


def test_what_is_near(ground, data, plain):
    eye = np.array(plain[OUT].view.eye)
    far = np.linalg.norm(plain[OUT].places() - eye, axis=-1)
    middle = float(np.nanmedian(far))
    focus = f"near,distance={middle},blend=2000,priority={IN}"
    check(drawn(ground, data, focus), plain, np.nan_to_num(smooth_step(middle - far, 2000.0)))


def shape(ground, kind, corners):
    from pyproj import Transformer

    x, y = ground.grid.xy(*np.array(corners, float).T)
    places = np.stack(Transformer.from_crs(32630, 4326, always_xy=True).transform(x, y), 1).tolist()
    return {"type": kind, "coordinates": [places] if kind == "Polygon" else places}


def test_a_region(ground, data, plain):
    """A rectangle, whose distance from a place is plain."""
    box = shape(ground, "Polygon", [(30, 20), (90, 20), (90, 70), (30, 70), (30, 20)])
    col, row = ground.grid.index(*np.moveaxis(plain[OUT].places()[..., :2], -1, 0))
    dx, dy = np.abs(col - 60) - 30, np.abs(row - 45) - 25
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) + np.minimum(np.maximum(dx, dy), 0)
    weight = np.nan_to_num(smooth_step(-outside * 100, 1500.0))
    picture = drawn(ground, data, orograph.Focus(box, IN, blend=1500.0))
    part = np.asarray(weight)[..., None]
    one, other = (srgb_to_linear(plain[p].pixels / 255) for p in (OUT, IN))
    expected = linear_to_srgb(one * (1 - part) + other * part) * 255
    off = np.abs(picture.pixels - expected)
    assert off.max() < 6 and off.mean() < 0.5  # (edges in degrees are not quite straight in UTM; texels)
    inside, beyond = weight == 1, weight == 0
    np.testing.assert_array_equal(picture.pixels[inside], plain[IN].pixels[inside])
    np.testing.assert_array_equal(picture.pixels[beyond], plain[OUT].pixels[beyond])


def test_a_corridor(ground, data, plain, tmp_path):
    line = shape(ground, "LineString", [(10, 45), (110, 45)])
    path = tmp_path / "route.geojson"
    path.write_text(json.dumps(line))
    picture = drawn(ground, data, f"{path},width=3000,blend=400,priority={IN}")
    col, row = ground.grid.index(*np.moveaxis(plain[OUT].places()[..., :2], -1, 0))
    far = np.abs(row - 45) * 100
    there, away = (far < 1200) & (col > 15) & (col < 105), far > 1800
    assert there.sum() > 300 and away.sum() > 300
    np.testing.assert_array_equal(picture.pixels[there], plain[IN].pixels[there])
    np.testing.assert_array_equal(picture.pixels[away], plain[OUT].pixels[away])


def test_tiles_films_and_furniture_have_it_too(ground, data):
    scene = Scene.of(ground, orograph.camera.whole(ground, SIZE), data=orograph.Dataset(data.source, band="all"),
                     priority=OUT, focus=f"lens,priority={IN}", light="none")  # fmt: skip
    draw = session()
    whole = draw(scene)
    tile = draw(scene.but(view=scene.view.tile(30, 20, 64, 48)))
    np.testing.assert_array_equal(tile.pixels, whole.pixels[20:68, 30:94])
    moved = draw(scene.but(exaggeration=2.0))
    assert moved.exaggeration == 2.0 and (moved.pixels != whole.pixels).any()
    legend = [scale.label for key in scene.keys for scale in key.scales]
    assert legend == ["data", "data, focus"]
    furnished = draw(scene.but(furniture=True))
    assert (furnished.pixels != whole.pixels).any()


@pytest.mark.stress
def test_the_gpu_blends_the_same(ground, data, plain, device):
    focus = orograph.Focus("lens", IN, radius=0.3, blend=0.05)
    both = [drawn(ground, data, focus, backend=backend) for backend in ("cpu", "gpu")]
    assert both[1].facts["backend"] == "gpu"
    assert np.abs(both[0].pixels.astype(int) - both[1].pixels).mean() < 3


def test_a_focus_that_shows_nowhere_is_told(ground, data, plain):
    with pytest.warns(UserWarning, match="The focus is not visible .* nearest ground is [0-9,]+ m"):
        made = orograph.render(ground, size=SIZE, data=data, priority=OUT, focus="near,distance=1")
    np.testing.assert_array_equal(made.pixels, plain[OUT].pixels)


def test_steps_are_smooth():
    t = np.linspace(-2, 2, 401)
    found = smooth_step(t, 2.0)
    assert found[0] == 0 and found[-1] == 1 and found[200] == 0.5 and (np.diff(found) >= 0).all()
    np.testing.assert_array_equal(smooth_step(t, 0.0), t >= 0)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Focus.parse("lens,radius=0"), "more than 0"),
        (lambda: Focus.parse("lens,at=2:0"), "from 0 to 1"),
        (lambda: Focus.parse("lens,at=0.5"), "X:Y"),
        (lambda: Focus.parse("lens,raduis=3"), "radius"),
        (lambda: Focus.parse("near"), "needs a distance"),
        (lambda: Focus("lens", distance=5.0), "the focus near"),
        (lambda: Focus("lens", "X+"), "priority"),
        (lambda: Focus("lens", at=0.5), "two parts of the picture"),
        (lambda: Focus("lens", blend=math.nan), "blend of a focus"),
    ],
)
def test_what_makes_no_sense_is_refused(make, says):
    with pytest.raises(UsageError) as told:
        make()
    assert says in f"{told.value.what} {told.value.remedy}"


@pytest.mark.stress
def test_shapes_that_are_no_region_are_refused(ground, data, tmp_path):
    line = shape(ground, "LineString", [(10, 45), (110, 45)])
    with pytest.raises(UsageError, match="needs a width"):
        drawn(ground, data, Focus(line))
    with pytest.raises(UsageError, match="no area"):
        drawn(ground, data, Focus({"type": "Point", "coordinates": [-2.9, 50.5]}))
    with pytest.raises(UsageError, match="lens, near, or a file"):
        drawn(ground, data, Focus("heights.tif"))
