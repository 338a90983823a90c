"""Tours made by hand: what is edited, shown while it plays, saved, and filmed by ``orograph movie``."""

from __future__ import annotations

import datetime
import json
import math
from dataclasses import replace

import pytest

from orograph.lighting.sun import Moment, Placed
from orograph.store.prepare import prepare
from orograph.touring import Tour
from orograph.viewer.navigation import orbit
from orograph.viewer.session import Session
from orograph.viewer.touring import LEG, SHORTEST, Touring


@pytest.fixture
def session(dem, own_config):
    session = Session(prepare([str(dem)]), size=(640, 360))
    yield session
    session.close()


@pytest.fixture
def touring(session) -> Touring:
    return Touring(session)


def turned(session, degrees, pitch=0.0):
    session.nav.view = orbit(session.view, session.view.target, degrees, pitch)
    return session.view


def three(session, touring):
    views = []
    for degrees in (0.0, 40.0, 50.0):
        views.append(turned(session, degrees))
        touring.add()
    return views


def test_stops_are_passed_where_and_when_they_were_kept(session, touring):
    views = three(session, touring)
    assert touring.times == [0.0, LEG, 2 * LEG]
    assert touring.duration == 2 * LEG
    for view, time in zip(views, touring.times):
        assert touring.tour.at(time) == view
    assert touring.chosen == 2


def test_edits_keep_times_in_order(session, touring):
    views = three(session, touring)
    touring.retime(1, 7.5)
    assert touring.times == [0.0, 7.5, 7.5 + LEG]
    touring.retime(2, 1.0)  # not before the one before it
    assert touring.times[2] == pytest.approx(7.5 + SHORTEST)
    touring.change(1, hold=2.0)
    assert touring.times[2] == pytest.approx(7.5 + 2.0 + SHORTEST)
    assert touring.tour.at(8.5) == views[1]
    touring.move(2, -1)
    assert [s.key.view for s in touring.stops] == [views[0], views[2], views[1]]
    assert touring.chosen == 1
    touring.move(0, -1)  # nowhere to go
    touring.remove(1)
    assert [s.key.view for s in touring.stops] == [views[0], views[1]]
    assert touring.stops[1].key.hold == 2.0
    turned(session, 30.0)
    touring.put(1)
    assert touring.stops[1].key.view == session.view
    assert touring.stops[1].key.hold == 2.0
    touring.chosen = 0
    touring.add()  # after the chosen one
    assert len(touring.stops) == 3
    assert touring.chosen == 1
    touring.clear()
    assert touring.tour is None
    assert touring.duration == 0.0
    assert touring.way().shape == (0, 2, 3)


def test_what_makes_no_sense_is_told_and_not_done(session, touring):
    touring.play()
    assert "add some cameras" in session.messages.shown[-1].text
    three(session, touring)
    touring.change(0, turns=2)  # of a spline
    assert "turns" in session.messages.shown[-1].text
    assert touring.tour is not None
    touring.change(0, path="orbit")
    touring.change(0, turns=1)
    assert touring.tour is not None


def test_playing_goes_through_it_and_ends(session, touring):
    views = three(session, touring)
    touring.time = 0.0
    touring.play()
    touring.advance(1.0)  # the first shows the beginning
    assert touring.time == 0.0
    assert session.view == views[0]
    touring.advance(1.3)
    assert session.view == touring.tour.at(1.3)
    for _ in range(100):
        touring.advance(0.1)
    assert not touring.playing
    assert session.view == views[-1]
    touring.play()  # at its end: again from the beginning
    touring.advance(0.0)
    assert session.view == views[0]


def test_a_loop_goes_on(session, touring):
    three(session, touring)
    touring.loop = True
    assert touring.duration == 3 * LEG
    touring.time = 0.0
    touring.play()
    touring.advance(0.0)
    for _ in range(130):
        touring.advance(0.1)
    assert touring.playing
    assert touring.time == pytest.approx(1.0, abs=1e-6)


def test_who_moves_the_camera_has_it(session, touring):
    three(session, touring)
    touring.time = 0.0
    touring.play()
    touring.advance(0.0)
    touring.advance(0.5)
    mine = turned(session, 5.0)
    touring.advance(0.5)
    assert not touring.playing
    assert session.view == mine


def test_a_window_of_another_size_goes_on_playing(session, touring):
    three(session, touring)
    touring.time = 0.0
    touring.play()
    touring.advance(0.0)
    session.resize(300, 500)
    touring.advance(0.5)
    assert touring.playing
    assert (session.view.width, session.view.height) == (300, 500)
    assert session.view.eye == touring.tour.at(0.5).eye


def test_light_and_exaggeration_go_along(session, touring):
    light = session.settings.sun
    light.mode = "moment"
    zone = light.when.tzinfo
    light.when = datetime.datetime(2026, 6, 21, 6, tzinfo=zone)
    touring.add()
    light.when = datetime.datetime(2026, 6, 21, 18, tzinfo=zone)
    turned(session, 60.0)
    session.stretch(2.0)
    touring.add()
    assert isinstance(touring.stops[0].key.sun, Moment)
    touring.show(LEG / 2)
    assert light.when.hour == 12
    assert light.when.tzinfo == zone
    assert 1.2 < session.settings.exaggeration < 1.8
    assert session.nav.exaggeration == session.settings.exaggeration
    light.mode, light.azimuth, light.altitude = "placed", 200.0, 30.0
    touring.add()  # the others go by time
    assert touring.stops[-1].key.sun is None
    assert "follows the others" in session.messages.shown[-1].text
    assert touring.tour is not None
    touring.clear()
    touring.add()
    assert touring.stops[0].key.sun == Placed(200.0, 30.0)


def test_it_is_kept_above_the_ground_as_a_film_is(session, touring):
    from orograph.touring.course import Course

    low = replace(session.view, eye=(412_500.0, 4_983_000.0, 520.0), target=(413_500.0, 4_983_000.0, 510.0))
    for east in (0.0, 3000.0):
        session.nav.view = replace(
            low, eye=(low.eye[0] + east, *low.eye[1:]), target=(low.target[0] + east, *low.target[1:])
        )
        touring.add()
    touring.above_ground = 150.0
    session.probe.changed = lambda: None
    touring.at(1.0)
    truth = Course(touring.tour, session.terrain)
    for _ in range(400):
        if touring._course[1] is not None:
            break
        import time

        time.sleep(0.02)
    assert touring.at(2.0) == truth.at(2.0)
    assert touring.at(2.0).eye[2] >= 649.0


def test_files_are_those_of_movie(session, touring, tmp_path):
    three(session, touring)
    touring.change(1, hold=1.5)
    touring.above_ground = 20.0
    path = tmp_path / "tour.json"
    assert touring.save(path)
    tour = Tour.load(path, crs=session.terrain.grid.crs)
    assert tour == touring.tour
    other = Touring(session)
    assert other.load(path)
    for k in range(40):
        assert other.tour.at(k / 4) == tour.at(k / 4)
    assert other.tour.duration == tour.duration
    assert not other.load(tmp_path / "none.json")
    assert "not read" in session.messages.shown[-1].text
    assert not other.save(tmp_path / "no" / "folder.json")
    assert "not saved" in session.messages.shown[-1].text
    assert len(other.stops) == 3  # what cannot be read takes nothing away


@pytest.mark.parametrize(
    "more", [{"speed": 300.0}, {"loop": True, "seconds": 30.0}, {"ease": False}, {"aim": "direction"}]
)
def test_tours_made_elsewhere_are_gone_through_as_they_are(session, touring, tmp_path, more):
    views = three(session, touring)
    keys = [
        {**({} if "speed" in more else {"time": 2.0 + 6.0 * k}), "hold": float(k == 1), **view.to_dict()}
        for k, view in enumerate(views)
    ]
    path = tmp_path / "tour.json"
    path.write_text(json.dumps({"keys": keys, **more}))
    tour = Tour.load(path, crs=session.terrain.grid.crs)
    assert touring.load(path)
    assert touring.duration == pytest.approx(tour.duration)
    if "speed" in more:  # times say when a key is reached, not how fast it is gone past
        assert touring.times == pytest.approx(list(tour.times))
        return
    for k in range(60):
        a, b = touring.tour.at(k / 2), tour.at(k / 2)
        assert math.dist(a.eye, b.eye) < 1e-6
        assert math.dist(a.target, b.target) < 1e-6


def test_movie_films_the_cameras_that_the_window_shows(session, touring, dem, tmp_path, monkeypatch):
    from click.testing import CliRunner

    from orograph.cli import cli
    from orograph.touring.film import Film

    three(session, touring)
    touring.change(1, hold=0.5)
    path = tmp_path / "tour.json"
    assert touring.save(path)
    filmed = []
    real = Film.picture

    def picture(self, number):
        filmed.append((number / self.tour.fps, self.scene(number)))
        return real(self, number)

    monkeypatch.setattr(Film, "picture", picture)
    monkeypatch.setattr("orograph.cli.spare_imports", lambda s3: None)
    done = CliRunner().invoke(
        cli,
        ["-q", "movie", str(dem), "--tour", str(path), "-o", str(tmp_path / "f%03d.png"), "--size", "32x18", "--fps=1"],
        catch_exceptions=False,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert len(filmed) == round(touring.duration) == len(list(tmp_path.glob("f*.png")))
    for time, scene in filmed:
        touring.show(time)
        assert session.view.resized(32, 18) == scene.view
        sun = session.settings.sun.sun(session.terrain)
        assert (scene.lighting.sun.azimuth, scene.lighting.sun.altitude) == pytest.approx((sun.azimuth, sun.altitude))
        assert scene.surface.exaggeration == session.settings.exaggeration


def test_layers_fade_as_in_a_film(session, touring, dem, tmp_path, monkeypatch):
    from orograph.geovis.layers import Layer
    from orograph.scene.scene import Scene
    from orograph.touring.film import Film

    settings = session.settings
    monkeypatch.chdir(dem.parent)
    settings.layers = [Layer(dem.name, colormap="viridis"), Layer(dem.name, colormap="magma", opacity=0.8)]
    touring.add()
    turned(session, 30.0)
    settings.layers = [settings.layers[0], replace(settings.layers[1], visible=False)]
    touring.add()
    monkeypatch.chdir(tmp_path)
    assert touring.save(tmp_path / "tour.json")
    tour = Tour.load(tmp_path / "tour.json", crs=session.terrain.grid.crs)
    base = Scene.of(session.terrain, session.view, relief=1.0, depths=(1.0, 2.0))
    film = Film(tour, base, fps=2.0, draw=lambda scene: None)
    seen = []
    for number in film.numbers:
        touring.show(number / 2.0)
        drawn = tuple(layer for layer in settings.stack if layer.visible)
        assert drawn == film.scene(number).data.layers
        seen.append([layer.opacity for layer in drawn])
    assert seen[0] == [1.0, 0.8]
    assert 0.3 < seen[4][1] < 0.5
    assert len(settings.layers) == 2  # what is not seen is not lost


def test_the_command_line_is_one_that_movie_takes(session, touring, tmp_path):
    import shlex

    from orograph.cli.movie import command

    three(session, touring)
    session.settings.light, session.settings.water, session.settings.colormap = "none", None, "mars"
    session.settings.shadows = False
    words = shlex.split(touring.command(tmp_path / "a tour.json", ["my dem.tif"]))
    assert words[:3] == ["orograph", "movie", "my dem.tif"]
    context = command.make_context("movie", words[2:])
    assert context.params["tour_path"].endswith("a tour.json")
    assert context.params["sky"]
    assert context.params["colormap"] == "mars"
    assert not context.params["shadows"]
