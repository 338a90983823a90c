"""Points that happen at a time: those that are seen at a moment are those that NumPy finds, on the scales of all."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.errors import OrographError, UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.events import events_span
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.standing import Kind
from orograph.geovis.data.times import lasting, seconds_of, seconds_of_trail, written
from orograph.progress import SILENT
from orograph.rendering.backends import session
from orograph.rendering.standing import extent_of
from orograph.scene.scene import Scene
from orograph.touring import make
from orograph.touring.film import Film
from orograph.touring.playing import Playing
from orograph.viewer.data import ShownData

START = float(seconds_of(["2020-01-01T00:00"], "", "")[0])
HOUR = 3600.0


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.zeros((40, 60), np.float32), crs="EPSG:32632", transform=from_origin(5e5, 5.6e6, 10, 20))


def table(ground: orograph.Terrain, seconds: Any, **more: Any) -> dict[str, Any]:
    """Points along a row, with values 1, 2, 3…"""
    count = len(seconds)
    x, y = ground.grid.xy(np.linspace(3, 55, count), np.full(count, 20.0))
    return {"x": x, "y": y, "value": np.arange(1.0, count + 1), "time": seconds, **more}


def shown(ground: orograph.Terrain, data: Dataset) -> tuple[set[float], Any]:
    """The values of the points that a picture shows, and its things."""
    things = Scene.of(ground, orograph.camera.whole(ground, (60, 40)), data=data).theme.things
    assert things is not None
    return set(things.values[np.isfinite(things.values)].tolist()), things


def iso(hours: float) -> str:
    return written(START + hours * HOUR)


@settings(max_examples=40, deadline=None)
@given(
    hours=st.lists(st.integers(0, 200), min_size=2, max_size=12).filter(lambda h: min(h) < max(h)),
    moment=st.integers(-5, 220), trail=st.none() | st.integers(1, 90),
)  # fmt: skip
def test_at_a_moment_those_are_seen_that_just_happened(
    ground: orograph.Terrain, hours: list[int], moment: int, trail: int | None
) -> None:
    data = Dataset(table(ground, [iso(h) for h in hours]), variable="value", style="bars", time=iso(moment),
                   trail=None if trail is None else f"{trail}h")  # fmt: skip
    lasts = (max(hours) - min(hours)) / 12 if trail is None else trail
    truth = {k + 1.0 for k, h in enumerate(hours) if h <= moment < h + lasts}
    assert shown(ground, data)[0] == truth


def test_colors_are_those_of_all_and_pale_with_age(ground: orograph.Terrain) -> None:
    hours = [0.0, 10, 11, 12, 30]
    data = Dataset(table(ground, [START + h * HOUR for h in hours]), variable="value", trail="4h")
    _, whole = shown(ground, data)
    own = dict(zip(whole.values.tolist(), whole.rgb))
    _, now = shown(ground, data.but(time=iso(12)))
    assert now.values.tolist() == [2, 3, 4]
    pale = [float(np.linalg.norm(rgb - own[value]) / np.linalg.norm(1 - own[value]))
            for value, rgb in zip(now.values.tolist(), now.rgb)]  # fmt: skip
    np.testing.assert_allclose(pale, [0.75 * 2 / 4, 0.75 * 1 / 4, 0], atol=1e-5)
    np.testing.assert_allclose(now.radius, whole.radius[1:4])
    assert "2020-01-01 12:00, each seen for 4 h after its time" in now.legend.note


def test_paleness_that_tells_uncertainty_tells_no_age(ground: orograph.Terrain) -> None:
    doubtful = table(ground, [iso(h) for h in range(6)], sigma=[0.1, 0.5, 0.2, 0.4, 0.3, 0.6])
    data = Dataset(doubtful, variable="value", uncertainty=Uncertainty("sigma", style="whiteness"), trail="3h")
    _, whole = shown(ground, data)
    _, now = shown(ground, data.but(time=iso(4)))
    assert now.values.tolist() == [3, 4, 5]
    np.testing.assert_allclose(now.rgb, whole.rgb[2:5], atol=1e-6)


def test_of_a_span_all_are_seen_as_they_are(ground: orograph.Terrain) -> None:
    data = Dataset(table(ground, [iso(h) for h in (0, 20, 30, 47, 48, 90)]), variable="value")
    _, whole = shown(ground, data)
    found, things = shown(ground, data.but(time="2020-01-01T20..2020-01-02"))
    assert found == {2, 3, 4}
    np.testing.assert_array_equal(things.rgb, whole.rgb[1:4])
    assert shown(ground, data.but(time=".."))[0] == {1, 2, 3, 4, 5, 6}


def test_points_of_unknown_time_are_told_and_moments_without_any_show_none(ground: orograph.Terrain) -> None:
    data = Dataset(table(ground, [iso(0), "", iso(5)]), variable="value", time=iso(5))
    found, things = shown(ground, data)
    assert found == {3} and "1 without a time left out" in things.legend.note
    picture = orograph.render(ground, size=(90, 60), data=data.but(time=iso(2), trail="1h"), samples=1, furniture=True)
    assert not np.isfinite(shown(ground, data.but(time=iso(2), trail="1h"))[1].values).any()
    assert "each seen for 60 min" in str(picture.facts["description"])


def test_what_cannot_be_meant_is_refused(ground: orograph.Terrain) -> None:
    bare = {k: v for k, v in table(ground, [0, 1]).items() if k != "time"}
    for data, words in (
        (Dataset(bare, variable="value", time="2020"), "Nothing says when"),
        (Dataset(table(ground, [iso(0), iso(1)]), variable="value", time="T12"), "not a time"),
        (Dataset(table(ground, [iso(0), iso(1)]), variable="value", time="2021..2022"), "no span"),
        (Dataset(table(ground, [iso(1), iso(1)]), variable="value", time=".."), f"all of it is at one time, {iso(1)}"),
        (Dataset(table(ground, ["soon", iso(1)]), variable="value", time=iso(1)), "not a time"),
    ):
        with pytest.raises(OrographError, match=words):
            shown(ground, data)
    for wrong in ("6", "h", "-3h", "0h", "3 weeks"):
        with pytest.raises(UsageError, match="trail"):
            Dataset(bare, trail=wrong)
    assert seconds_of_trail("1.5 d") == 129_600 and lasting(129_600) == "36 h" and lasting(90) == "90 s"


def test_films_show_what_happens(ground: orograph.Terrain) -> None:
    hours = np.array([0, 6, 7, 20, 23, 40, 47.0])
    data = Dataset(table(ground, [iso(h) for h in hours]), variable="value", style="bars", size=300.0, time="..")
    playing = Playing.of({"data": data}, ground, 48, 24.0)
    assert playing is not None
    (fact,) = playing.facts
    assert (fact["from"], fact["to"], fact["between"]) == (iso(0), iso(47), "events")
    assert fact["trail_s"] == pytest.approx(47 * HOUR / 12)
    for number in range(48):
        (one,) = playing.at(playing.key(number), ground.grid)["data"]
        truth = {k + 1.0 for k, h in enumerate(hours) if h <= number < h + 47 / 12}
        assert shown(ground, one)[0] == truth
    # The camera leaves room for what does not stand yet in the first frame.
    view = orograph.camera.whole(ground, (60, 40))
    film = Film.of(
        make.still(ground, (60, 40), seconds=2), ground, (60, 40), {"data": data}, draw=session(), fps=24, first=None,
        last=None, progress=SILENT,
        again=lambda also: make.still(ground, (60, 40), seconds=2, also=also),
    )  # fmt: skip
    points = extent_of(Scene.of(ground, view, data=data.but(time=None)))
    pixels, _ = film.scene(0).view.project(points)
    assert (pixels > 0).all() and (pixels < [60, 40]).all()
    assert (film.scene(0).theme.things.kind == Kind.BAR).sum() == 1


def test_a_window_plays_them_within_a_span(ground: orograph.Terrain) -> None:
    data = Dataset(table(ground, [iso(h) for h in range(0, 49, 6)]), variable="value")
    assert events_span(data, ground.grid) == (START, START + 48 * HOUR)
    window = ShownData((data,), Priority(), ground.grid)
    assert window.span == window.limits == (START, START + 48 * HOUR)
    window.choose(iso(12))
    assert shown(ground, window.current(ground)[0])[0] == {3}
    window.limit(first=iso(12))
    window.limit(last=iso(24))
    window.choose(window.play(0.5))
    assert window.time == iso(18)
    window.choose(window.play(0.75))  # over the end: it begins again
    assert window.time == iso(15)
    with pytest.raises(UsageError, match="end later"):
        window.limit(last=iso(6))
    window.limit()
    assert window.limits == window.span
    chosen = ShownData((data.but(time=f"{iso(6)}..{iso(30)}"),), Priority(), ground.grid)
    assert chosen.limits == (START + 6 * HOUR, START + 30 * HOUR) and chosen.play(0.0) == iso(6)
    assert ShownData((Dataset(table(ground, [iso(1)]), variable="value"),), Priority(), ground.grid).span is None


def test_a_thing_tells_its_value_and_its_uncertainty(ground: orograph.Terrain) -> None:
    doubtful = table(ground, [iso(h) for h in range(4)], sigma=[0.1, 0.5, 0.2, 0.4])
    bars = Dataset(doubtful, variable="value", style="bars", uncertainty="sigma", unit="t", name="load")
    window = ShownData((bars, bars.but(uncertainty=None, source=table(ground, [0, 1, 2]))), Priority(True, True, True))
    scene = Scene.of(ground, orograph.camera.whole(ground, (60, 40)), data=window.data, priority="T+D+U+")
    window.things = scene.theme.things
    assert window.things is not None
    told = [found.words for number in range(len(window.things)) for found in window.of_thing(number)]
    assert told == ["load 1.00 ± 0.10 t", "load 2.00 ± 0.50 t", "load 3.00 ± 0.20 t", "load 4.00 ± 0.40 t",
                    "load 1 t", "load 2 t", "load 3 t"]  # fmt: skip


def test_exports_have_those_of_the_time(ground: orograph.Terrain, tmp_path: Path) -> None:
    data = Dataset(table(ground, [iso(h) for h in (0, 20, 30, 90)]), variable="value", time="2020-01-01T20..2020-01-02")
    orograph.export(ground, tmp_path / "some.csv", data=data)
    with (tmp_path / "some.csv").open() as file:
        assert [float(row["value"]) for row in csv.DictReader(file)] == [2, 3]
