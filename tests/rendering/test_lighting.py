"""Ways of lighting a picture against closed forms, each other, and rays: planes, walls, penumbras, baked or swept."""

from __future__ import annotations

import math
import threading

import numpy as np
import pytest
from scenes import NORTH_UP, ROTATED, hills, terrain

import orograph
from orograph import store
from orograph.errors import UsageError
from orograph.geovis.color import srgb_to_linear
from orograph.lighting.aperture import Lamp
from orograph.lighting.bake import bake
from orograph.lighting.context import Options
from orograph.lighting.field import LightField
from orograph.lighting.sun import Sun
from orograph.progress import Progress
from orograph.rendering.cpu import draw as cpu
from orograph.rendering.cpu.lighting import Shine
from orograph.scene import camera
from orograph.scene.scene import Scene

SIZE = (96, 64)
BARE = {"water": None, "samples": 1, "relief": 1.0, "colormap": "grey"}


class Heard(Progress):
    def __init__(self):
        self.warnings = []

    def warn(self, text):
        self.warnings.append(text)


def light_on(ground, **options):
    """Irradiance (height, width, 3) by each light in a plan, without colours, water and antialiasing."""
    from orograph.rendering.cpu import lighting, shading

    caught = []
    view = options.pop("view", None) or camera.plan(ground, SIZE)
    made = lighting.lighting_of

    def spy(scene, there, shine, *rest):
        one = Shine(shine.to_sun, np.ones(3, np.float32), np.full(3, 0.5, np.float32), np.zeros(3, np.float32))
        found = made(scene, there, one, *rest)
        on = found.on
        found.on = lambda hits, px, py, part=1: caught.append((px, py, on(hits, px, py, part))) or caught[-1][2]
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shading, "lighting_of", spy)
        picture = cpu.draw(Scene.of(ground, view, **{**BARE, **options}))
    left, top = view.frame[:2]
    out = np.full((view.height, view.width, 3), np.nan)
    for px, py, values in caught:
        out[py.astype(int) - top, px.astype(int) - left] = values
    out[np.isnan(picture.depth)] = np.nan
    return out


def plane(east=0.0, north=0.0, size=64):
    row, col = np.mgrid[:size, :size]
    return terrain((1000 + 30 * (east * col - north * row)).astype(np.float32))


@pytest.mark.parametrize("light", ["ao", "aperture", "raytraced"])
def test_level_ground_gets_all_the_light_there_is(light):
    got = light_on(plane(), sun=Sun(200, 30), light=light)
    inner = got[8:-8, 24:-24]
    np.testing.assert_allclose(inner, math.sin(math.radians(30)) + 0.5, atol=0.004)


@pytest.mark.parametrize("light", ["ao", "aperture", "raytraced"])
def test_inclined_ground(light):
    """Lambert's cosine; ambient occlusion knows no horizon below: all of it, an aperture (1 + cos) / 2 nearly."""
    slope = math.atan(0.5)
    got = light_on(plane(east=0.5), sun=Sun(270, 40), light=light)[24:-24, 40:-40]
    direct = math.sin(math.radians(40) + slope)
    ambient = np.nanmedian(got) - direct
    if light == "aperture":
        cap = math.sin(math.acos(slope / math.pi)) ** 2 * math.cos(slope / 2)
        assert ambient == pytest.approx(0.5 * cap, abs=0.006)
    else:
        assert ambient == pytest.approx(0.5, abs=0.006)


def test_no_light_shows_the_maps_own_colors():
    ground = terrain(hills())
    view = camera.plan(ground, SIZE)
    picture = cpu.draw(Scene.of(ground, view, light="none", **BARE))
    seen = np.isfinite(picture.depth)
    heights = view.eye[2] - picture.depth[seen]
    from orograph.geovis.color import tint_of

    tint = tint_of(ground, "grey", sea=False)
    at = np.clip((heights - tint.low) / (tint.high - tint.low), 0, 1) * (len(tint.land) - 1)
    expected = tint.land[np.rint(at).astype(int)]
    got = srgb_to_linear(picture.pixels[seen].astype(np.float32) / 255)
    dark = expected < 0.8
    assert np.abs(got - expected)[dark].max() < 0.02


def wall(height=300.0):
    h = np.full((80, 120), 100, np.float32)
    h[:, 40] += height
    return terrain(h)


def test_rays_find_a_walls_shadow_and_its_penumbra():
    """Behind a wall of height H the disc's middle sets at H / tan(altitude); the penumbra is the disc's segment."""
    altitude, diameter = 20.0, 6.0
    ground = wall()
    view = camera.plan(ground, (300, 200))
    sun = Sun(270, altitude, diameter)
    got = light_on(ground, view=view.tile(0, 100, 300, 1), sun=sun, light="raytraced", rays=256)[0, :, 0]
    x = (np.arange(300) + 0.5 - 150) * view.pixel_metres + view.target[0]
    distance = x - (500_000 + 40.5 * 30)

    def at(horizon):
        return np.interp(300 / math.tan(math.radians(horizon)), distance, got)

    for above in (-2.0, -1.0, 1.0, 2.0):
        d = above / (diameter / 2)
        part = (math.acos(d) - d * math.sqrt(1 - d * d)) / math.pi
        ambient = at(altitude + 3.4)
        assert at(altitude + above) - ambient == pytest.approx(part * math.sin(math.radians(altitude)), abs=0.04)


def test_rays_and_skylines_agree():
    """Sun by rays to the disc, and by the skyline; the sky by rays, and by swept ambient occlusion.

    Rays begin beyond the hit's own facet, sweeps see their own cell: swept skies are darker by what stands there.
    """
    ground = terrain(hills(tall=250.0))
    sun = Sun(300, 25)
    options = {"sun": sun, "view": camera.plan(ground, (120, 80))}
    rays, ao = (light_on(ground, light=light, **options)[6:-6, 23:-23, 0] for light in ("raytraced", "ao"))
    assert 0 < np.nanmean(rays - ao) < 0.015 and np.nanmean(np.abs(rays - ao)) < 0.03
    shaded = light_on(ground, light="ao", shadows=False, **options)[6:-6, 23:-23, 0]
    assert np.nanmean(shaded - ao) > 0.01  # there are shadows to speak of


@pytest.mark.parametrize("light", ["ao", "aperture"])
@pytest.mark.parametrize("place", [NORTH_UP, ROTATED])
def test_baked_light_is_the_same_as_swept_light(tmp_path, light, place):
    ground = terrain(hills(tall=250.0), place)
    rows, cols = ground.grid.shape
    from orograph.store.source import ArraySource

    made = store.build(ArraySource(ground.read(0, 0, rows, 0, cols), ground.grid, "hills"), tmp_path / "s", errors=())
    made.close()
    name = "ambient-occlusion" if light == "ao" else "aperture"
    with bake(tmp_path / "s", [name], Options(azimuths=32)) as baked:
        view = camera.around(baked, SIZE, azimuth=200, pitch=40, distance=None)
        loads = []
        load = LightField.load
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(LightField, "load", lambda *how: loads.append(threading.current_thread()) or load(*how))
            alone = orograph.render(baked, view, light=light, jobs=1).pixels
            draw = cpu.session()
            assert all(np.array_equal(draw(Scene.of(baked, view, light=light, jobs=2)).pixels, alone) for _ in range(3))
        # With more than one thread, a layer is read in a thread aside; and for many frames, once.
        assert len(loads) == 2 and loads[0] is threading.main_thread() is not loads[1]
        a, b = (light_on(t, light=light, sun=Sun(300, 30), view=view) for t in (ground, baked))
        assert np.nanmax(np.abs(a - b)) < 0.02 and np.nanmean(np.abs(a - b)) < 0.002
        picture = orograph.render(baked, view, light=light)
        assert picture.facts["shader"]["light"] == f"baked {name}"
        heard = Heard()
        picture = orograph.render(baked, view, light=light, exaggeration=2.0, progress=heard)
        assert picture.facts["shader"]["light"] == f"swept {name}" and "true heights" in heard.warnings[0]


def test_coarse_windows_are_used_far_away(tmp_path):
    """Of a large store only windows about as fine as pixels are read, and light is the same as by the finest."""
    from orograph.store.source import ArraySource

    y, x = np.mgrid[:700, :700]
    big = terrain((500 + 150 * np.sin(x / 30) * np.cos(y / 40)).astype(np.float32))
    store.build(ArraySource(big.read(0, 0, 700, 0, 700), big.grid, "big"), tmp_path / "s", errors=()).close()
    with bake(tmp_path / "s", ["aperture"], Options(azimuths=8)) as baked:
        layer = baked.layer("aperture")
        read = []
        real = type(layer).planes
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(layer), "planes", lambda *a: read.append(a[1]) or real(*a))
            far = light_on(baked, light="aperture", view=camera.plan(baked, (90, 90)), sun=Sun(300, 40))
        assert min(read) == 2
        near = light_on(baked, light="aperture", view=camera.plan(baked, (360, 360)), sun=Sun(300, 40))
        mean = near.reshape(90, 4, 90, 4, 3).mean((1, 3))
        assert np.nanmean(np.abs(far - mean)) < 0.03


@pytest.mark.parametrize("light", ["aperture", "raytraced"])
def test_a_lamp_over_level_ground(light):
    """reach² / d² · cos of incidence, and nothing behind a wall."""
    ground = plane(size=100)
    x, y = ground.grid.xy(50, 50)
    lamp = Lamp.at(ground.grid, float(x), float(y), 1400.0, 500.0, (1.0, 0.5, 0.0))
    assert (lamp.col, lamp.row) == pytest.approx((50, 50))
    view = camera.plan(ground, SIZE)
    dark = {"sun": Sun(0, -20), "view": view, "light": light}
    got = light_on(ground, lamps=(lamp,), **dark) - light_on(ground, **dark)
    px, py = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    e = (px - SIZE[0] / 2) * view.pixel_metres + view.target[0] - x
    n = -(py - SIZE[1] / 2) * view.pixel_metres + view.target[1] - y
    d = np.sqrt(e * e + n * n + 400.0**2)
    expected = 500.0**2 / d**2 * 400.0 / d
    ok = np.isfinite(got[..., 0])
    assert ok.sum() > 2000
    np.testing.assert_allclose(got[..., 0][ok], expected[ok], rtol=0.02)
    np.testing.assert_allclose(got[..., 1][ok], 0.5 * expected[ok], rtol=0.02)
    assert (got[..., 2][ok] == 0).all()


def test_a_wall_hides_a_lamp_from_rays():
    ground = wall()
    x, y = ground.grid.xy(20, 40)
    lamp = Lamp.at(ground.grid, float(x), float(y), 200.0, 300.0)
    dark = {"sun": Sun(0, -20), "light": "raytraced"}
    got = (light_on(ground, lamps=(lamp,), **dark) - light_on(ground, **dark))[32, :, 0]
    assert got[30] > 0.05 and (got[55:80] == 0).all()


@pytest.mark.parametrize("light", ["aperture", "raytraced"])
def test_several_discs_add_up(light):
    ground = terrain(hills(tall=250.0))
    one, two = Sun(300, 25), Sun(120, 40, 20.0)
    night = light_on(ground, light=light, sun=Sun(0, -20))
    first = light_on(ground, light=light, sun=one) - night
    both = light_on(ground, light=light, sun=one, discs=((two, (0.5, 0.25, 0.0)),)) - night
    added = both - first
    ok = np.isfinite(added[..., 0])
    # Through an aperture a disc takes the place of the sky it covers, which is grey: a little less than it adds.
    np.testing.assert_allclose(added[..., 0][ok], 2 * added[..., 1][ok], atol=0.03)
    assert added[..., 0][ok].max() > 0.3


def test_tiles_are_what_the_whole_shows():
    ground = terrain(hills(tall=250.0))
    for light in ("aperture", "raytraced", "ao"):
        view = camera.around(ground, (96, 64), azimuth=200, pitch=40, distance=None)
        scene = {"light": light, "water": None, "rays": 8}
        whole = cpu.draw(Scene.of(ground, view, **scene)).pixels
        tile = cpu.draw(Scene.of(ground, view.tile(32, 16, 40, 32), **scene)).pixels
        np.testing.assert_array_equal(tile, whole[16:48, 32:72])


def test_what_makes_no_sense_is_refused():
    ground = plane()
    lamp = Lamp(0, 0, 0)
    for options, word in (
        ({"light": "sunshine"}, "`light` must be relief"),
        ({"lamps": (lamp,)}, "light='aperture'"),
        ({"discs": ((Sun(), (1.0, 1.0, 1.0)),), "light": "ao"}, "light='aperture'"),
        ({"rays": 0, "light": "raytraced"}, "ray"),
    ):
        with pytest.raises(UsageError, match=word):
            orograph.render(ground, size=SIZE, **options)
    with pytest.raises(UsageError, match="reach"):
        Lamp.at(ground.grid, 0, 0, 0, -1)
