"""What panels set, without a panel."""

from __future__ import annotations

import datetime
import threading
from dataclasses import replace

import numpy as np
import pytest
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.data.priority import Priority
from orograph.geovis.layers import Layer
from orograph.lighting.sun import Moment, Placed, position
from orograph.scene.parts import HOMES, OPTIONS
from orograph.store.prepare import prepare
from orograph.viewer.settings import Settings
from orograph.viewer.sun_setting import SunSetting


@pytest.fixture(scope="module")
def terrain(dem):
    return prepare([str(dem)])


def test_a_day_played_ends_where_it_began(terrain):
    light = SunSetting.over(terrain)
    assert light.place is not None
    light.mode, light.playing, light.speed = "moment", True, 3600.0
    begin = light.when
    for _ in range(240):
        assert light.advance(0.1)
    assert light.when == begin
    assert not SunSetting.over(terrain).advance(1.0)


def test_times_are_those_of_the_place(terrain):
    light = SunSetting.over(terrain)
    assert light.zone == 1  # 14° east
    light.when = datetime.datetime(2024, 2, 29, 12, 30, tzinfo=light.when.tzinfo)
    assert light.hour == 12.5
    assert light.day == 60
    light.hour = 6.25
    light.day = 366
    assert (light.when.month, light.when.day, light.when.hour, light.when.minute) == (12, 31, 6, 15)
    light.zone = -3
    assert (light.when.hour, light.when.minute) == (2, 15)
    light.hour = 24.0
    assert light.when.hour == 23


def test_the_sun_is_the_real_one(terrain):
    when = datetime.datetime(2026, 6, 21, 10, 0, tzinfo=datetime.UTC)
    light = SunSetting.over(terrain, Moment(when))
    azimuth, altitude = position(when, *light.place)
    sun = light.sun(terrain)
    assert sun.altitude == pytest.approx(altitude)
    assert sun.azimuth == pytest.approx(azimuth, abs=1.5)  # grid north differs by the convergence
    placed = SunSetting.over(terrain, Placed(-45.0, 30.0))
    assert (placed.sun(terrain).azimuth, placed.sun(terrain).altitude) == (315.0, 30.0)


def test_a_terrain_without_a_place_says_why():
    import numpy as np
    from affine import Affine

    from orograph.dem import Dem
    from orograph.geo import Grid
    from orograph.store import terrain as in_memory

    bare = in_memory(Dem(np.zeros((9, 9), np.float32), Grid((9, 9), Affine(1, 0, 0, 0, -1, 0))))
    light = SunSetting.over(bare)
    assert light.place is None
    assert "where on Earth" in light.trouble
    with pytest.raises(UsageError):
        SunSetting.over(bare, Moment(datetime.datetime.now(datetime.UTC)))


@pytest.mark.parametrize("power", [0.6, 1.0, 1.4])
def test_a_budget_is_reached(terrain, power):
    settings = Settings(terrain)
    settings.budget = 100_000

    def triangles() -> int:
        return int(60_000 / settings.tolerance**power)

    for _ in range(30):
        if not settings.balance(triangles()):
            break
    assert 0.9 <= triangles() / 100_000 <= 1.05


def test_scenes(terrain):
    from orograph.scene import camera

    settings = Settings(terrain, sun=(200.0, 30.0), exaggeration=2.0, layers=[Layer("x.tif", visible=False)])
    settings.water = None
    scene = settings.scene(terrain, camera.whole(terrain, (100, 100)))
    assert scene.surface.exaggeration == 2.0
    assert scene.data.layers == (Layer("x.tif", visible=False),)
    assert scene.data.water is None and scene.lighting.sky
    assert (scene.lighting.sun.azimuth, scene.lighting.sun.altitude) == (200.0, 30.0)


def test_every_option_of_a_scene_is_a_setting(terrain):
    from orograph.scene import camera

    settings = Settings(terrain)
    for name in OPTIONS:
        assert hasattr(settings, name), name
    scene = settings.scene(terrain, camera.whole(terrain, (100, 100)))
    for name, value in settings.options.items():
        if name not in ("layers", "depths"):
            assert getattr(getattr(scene, HOMES[name]), name) == value, name
    with pytest.raises(UsageError, match="no option 'colour'"):
        Settings(terrain, colour="grey")
    with pytest.raises(AttributeError):
        settings.colour  # noqa: B018


def test_lamps_shine_where_the_light_knows_them(terrain):
    from orograph.scene import camera

    settings = Settings(terrain, light="aperture", lamps=[(13.93, 45.0, 900.0, 500.0)])
    view = camera.whole(terrain, (100, 100))
    assert len(settings.scene(terrain, view).lighting.lamps) == 1
    settings.light = "relief"
    assert settings.scene(terrain, view).lighting.lamps == ()


@pytest.mark.stress
def test_data_are_painted_once_and_stand():
    terrain = orograph.terrain(np.add.outer(np.arange(30.0), np.arange(40.0)).astype(np.float32), spacing=10.0)
    values = np.linspace(0, 1, 1200, dtype=np.float32).reshape(30, 40)
    settings = Settings(terrain, data=orograph.Dataset(values, style="continuous"), priority="T-D+U-")
    view = orograph.camera.whole(terrain, (160, 90))
    one, two = (settings.scene(terrain, view) for _ in range(2))
    assert [layer.title for layer in one.data.layers] == ["data"]
    assert one.data.layers[0] is two.data.layers[0]
    assert one.lighting.light == "none" and one.annotations.contours is not None
    standing = Settings(terrain, data=orograph.Dataset(values, style="bars"))
    assert len(standing.scene(terrain, view).theme.things) > 100
    assert standing.scene(terrain, view) == standing.scene(terrain, view)  # nothing is drawn anew


@pytest.mark.stress
def test_priorities_are_switched_and_leave_nothing_behind():
    terrain = orograph.terrain(np.add.outer(np.arange(30.0), np.arange(40.0)).astype(np.float32), spacing=10.0)
    values = np.linspace(0, 1, 1200, dtype=np.float32).reshape(30, 40)
    settings = Settings(terrain, data=orograph.Dataset(values), priority="T+D+U-")
    settings.layers = [Layer("x.tif", visible=False), replace(settings.layers[0], opacity=0.5)]
    before = dict(settings.options)
    settings.show(terrain, priority=Priority.parse("T-D-U-"))
    assert settings.light == "none" and settings.contours is not None and settings.silhouettes is not None
    assert [layer.opacity for layer in settings.layers] == [1.0, 0.5]
    assert settings.shown.painted[0].style == "segmented"
    settings.exaggeration = 2.0
    settings.show(terrain, priority=Priority.parse("T+D+U-"))
    after = dict(settings.options)
    assert after.pop("exaggeration") == 2.0
    assert settings.layers[0].path == "x.tif" and len(settings.layers) == 2
    for name in after:
        if name not in ("layers", "colormap"):
            assert after[name] == before[name], name
    settings.show(terrain, priority=Priority.parse("T-D+U-"))
    settings.light = "ao"  # chosen by hand: it stays
    settings.show(terrain, priority=Priority.parse("T+D+U-"))
    assert settings.light == "ao"


@pytest.mark.stress
def test_times_of_a_series_share_a_scale_and_say_their_values():
    xr = pytest.importorskip("xarray")
    terrain = orograph.terrain(
        np.zeros((30, 40), np.float32), transform=Affine(100, 0, 500_000, 0, -100, 5_600_000), crs="EPSG:32630"
    )
    x, y = 500_050 + 100 * np.arange(40), 5_599_950 - 100 * np.arange(30)
    days = np.arange("2020-01-01", "2020-01-05", dtype="M8[D]").astype("M8[ns]")
    cube = np.arange(4.0)[:, None, None] + np.linspace(0, 1, 40)[None, None] + np.zeros((1, 30, 1))
    array = xr.DataArray(cube, dims=("time", "y", "x"), coords={"time": days, "x": x, "y": y}, name="warmth",
                         attrs={"units": "degC", "crs": "EPSG:32630"})  # fmt: skip
    settings = Settings(terrain, data=orograph.Dataset(array, style="continuous", band="all", uncertainty="spread"))
    shown = settings.shown
    assert len(shown.times) == 4 and shown.time == ""
    (given,) = shown.at(502_000, 5_598_500)
    assert given.value == pytest.approx(2.0, abs=0.02) and given.sigma == pytest.approx(
        np.arange(4).std(ddof=1), rel=0.01
    )
    scales = []
    for k, time in enumerate(shown.times):
        settings.show(terrain, time=time)
        (found,) = shown.at(502_000, 5_598_500)
        assert found.value == pytest.approx(k + 0.5, abs=0.02) and found.unit == "°C" and found.sigma is None
        scales.append((shown.painted[0].scale.low, shown.painted[0].scale.high))
    assert len(set(scales)) == 1 and scales[0][0] < 0.3 and scales[0][1] > 3.7
    with pytest.raises(UsageError, match="no time"):
        settings.show(terrain, time="1999")
    assert shown.time == shown.times[-1]
    assert shown.at(0, 0) == ()
    # Between two times values are linear in time, on the same scale, and it is said so.
    settings.show(terrain, time="2020-01-02T06:00")
    (found,) = shown.at(502_000, 5_598_500)
    assert found.value == pytest.approx(1.75, abs=0.02)
    assert (shown.painted[0].scale.low, shown.painted[0].scale.high) == scales[0]
    assert shown.time_text == "2020-01-02 06:00, linear between 2020-01-02 and 2020-01-03"
    assert "linear between" in shown.painted[0].note
    assert shown.part == pytest.approx(1.25 / 3) and shown.at_part(1.25 / 3) == "2020-01-02T06:00"
    assert shown.at_part(0.0) == "2020-01-01T00:00" and shown.at_part(1.0) == "2020-01-04T00:00"


@pytest.fixture
def stepwise(monkeypatch):
    """Settings over data, and what its thread waits for before it paints."""
    from orograph.viewer import settings as module

    monkeypatch.setattr(module, "PAINTED", (800, 450))
    terrain = orograph.terrain(np.add.outer(np.arange(30.0), np.arange(40.0)).astype(np.float32), spacing=10.0)
    values = np.linspace(0, 1, 1200, dtype=np.float32).reshape(30, 40)
    settings = Settings(terrain, data=orograph.Dataset(values, name="load"), priority="T+D+U-")
    gate, carried_out = threading.Semaphore(0), module._carried_out

    def held_up(options, terrain, size):
        if threading.current_thread() is not threading.main_thread():
            assert gate.acquire(timeout=300)
        return carried_out(options, terrain, size)

    monkeypatch.setattr(module, "_carried_out", held_up)
    return terrain, settings, gate


def texels(settings):
    return max(settings.shown.painted[0].over.shape)


def asked(terrain, settings, marks):
    """A priority that a thread paints; the event that tells of each painting."""
    ready = threading.Event()
    settings.show(terrain, priority=Priority.parse(marks), finer=ready.set)
    return ready


def taken(settings, gate, ready):
    """Let the thread paint once, and take it; returns whether it counted."""
    gate.release()
    assert ready.wait(300)
    ready.clear()
    return settings.finish()


@pytest.mark.stress
def test_data_are_painted_by_a_thread_coarsely_and_then_finely(stepwise):
    terrain, settings, gate = stepwise
    whole = texels(settings)
    settings.show(terrain, priority=Priority.parse("T-D-U-"))
    truth = settings.shown.painted[0]
    settings.show(terrain, priority=Priority.parse("T+D+U-"))
    settings.layers = [replace(settings.layers[0], opacity=0.5)]
    before, light = settings.shown.painted, settings.light
    ready = asked(terrain, settings, "T-D-U-")
    assert settings.shown.painted is before and settings.light == light  # the old picture stays
    assert settings.finer.coming and not settings.finish()
    assert taken(settings, gate, ready) and settings.finer.coming and settings.light == "none"
    assert texels(settings) < whole and settings.shown.painted[0].style == "segmented"
    # What is set before the thread is ready stays.
    (coarse,) = settings.layers
    other = Layer("x.tif", visible=False)
    settings.layers = [replace(coarse, visible=False), other]
    settings.light = "ao"
    assert taken(settings, gate, ready)
    fine, last = settings.layers
    assert (fine.opacity, fine.visible, fine.name) == (0.5, False, coarse.name) and fine.path != coarse.path
    assert last is other and settings.light == "ao"
    np.testing.assert_array_equal(settings.shown.painted[0].values, truth.values)
    assert not settings.finer.coming and not settings.finish()
    # The next change finds the fine layer as its own.
    settings.show(terrain, priority=Priority.parse("T+D+U-"))
    assert [layer.opacity for layer in settings.layers] == [0.5, 1.0] and len(settings.layers) == 2


def test_what_is_set_while_data_are_painted_stays(stepwise):
    terrain, settings, gate = stepwise
    ready = asked(terrain, settings, "T-D-U-")
    settings.light, settings.exaggeration = "ao", 3.0
    settings.layers = [Layer("x.tif", visible=False), replace(settings.layers[0], opacity=0.25)]
    assert taken(settings, gate, ready)
    assert (settings.light, settings.exaggeration) == ("ao", 3.0) and settings.contours is not None
    assert [layer.opacity for layer in settings.layers] == [1.0, 0.25]
    settings.show(terrain, priority=Priority.parse("T+D+U-"))
    assert settings.light == "ao" and settings.contours is None
    gate.release()


@pytest.mark.stress
def test_what_is_superseded_is_not_shown(stepwise):
    terrain, settings, gate = stepwise
    before = settings.shown.painted
    first, second = asked(terrain, settings, "T-D-U-"), asked(terrain, settings, "T+D-U+")
    assert not taken(settings, gate, first) and settings.finer.coming and settings.shown.painted is before
    assert taken(settings, gate, second) and settings.shown.painted[0].style == "segmented"
    assert taken(settings, gate, second)
    # Nor is a fine painting as time begins to pass, or as all is painted at once.
    for supersede in (lambda: setattr(settings.shown, "playing", True), lambda: settings.show(terrain)):
        settings.shown.playing = False
        ready = asked(terrain, settings, "T-D-U-")
        assert taken(settings, gate, ready)
        supersede()
        before = settings.shown.painted
        gate.release()
        assert ready.wait(300) and not settings.finish()
        assert settings.shown.painted is before and not settings.finer.coming


def test_what_a_thread_cannot_paint_is_said(stepwise, monkeypatch):
    from orograph.viewer import settings as module

    terrain, settings, _ = stepwise
    carried_out = module._carried_out

    def failing(options, terrain, size):
        if threading.current_thread() is not threading.main_thread():
            raise UsageError("It is gone.")
        return carried_out(options, terrain, size)

    monkeypatch.setattr(module, "_carried_out", failing)
    ready = threading.Event()
    before, priority = settings.shown.painted, settings.shown.priority
    settings.show(terrain, priority=Priority.parse("T-D-U-"), finer=ready.set)
    with pytest.raises(UsageError, match="It is gone"):
        assert ready.wait(300) and settings.finish()
    assert settings.shown.painted is before and settings.shown.priority == priority
    assert not settings.finer.coming and not settings.finish()
