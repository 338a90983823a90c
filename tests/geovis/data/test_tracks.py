"""Tracks with times: reading, speeds and heights that are times, against closed forms."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.standing import Kind
from orograph.geovis.data.times import seconds_of, ticks
from orograph.geovis.data.tracks import read_tracks, rows_of, until
from orograph.scene.theming import themed

UTM = "EPSG:32630"
WEST, NORTH = 500_000, 5_600_000
START = datetime.datetime(2019, 3, 1, 12, tzinfo=datetime.UTC).timestamp()


def ground(rows=60, cols=80):
    heights = np.broadcast_to(np.arange(cols, dtype=np.float32), (rows, cols))
    return orograph.terrain(np.ascontiguousarray(heights), transform=from_origin(WEST, NORTH, 10, 10), crs=UTM)


def things(data, **options):
    found = themed({"data": data, **options}, ground(), (300, 200)).things
    assert found is not None
    return found


def tracks(data):
    rows = rows_of(data, ground().grid)
    assert rows is not None
    return read_tracks(data, rows, ground().grid)


def table(**more):
    """Two tracks: one eastwards, 100 m in 50 s and 100 m in 100 s; one that stands still. Out of order."""
    made = {
        "x": [WEST + 300.0, WEST + 100, WEST + 200, WEST + 400, WEST + 400],
        "y": [NORTH - 300.0] * 3 + [NORTH - 500.0] * 2,
        "time": [f"2019-03-01T12:{s // 60:02}:{s % 60:02}Z" for s in (150, 0, 50, 100, 200)],
        "who": ["a", "a", "a", "b", "b"],
        "pulse": [3.0, 1, 2, 8, 9],
    }
    return made | more


@pytest.mark.parametrize(
    "told",
    ["2019-03-01T12:00:00Z", "2019-03-01 12:00", "2019-03-01T13:00+01:00", "2019-03-01T12:00:00.000000000",
     str(START), str(START * 1000)],
)  # fmt: skip
def test_moments_are_read(told):
    assert seconds_of([told, "", None], "f", "time")[0] == START
    assert np.isnan(seconds_of([told, "", None], "f", "time")[1:]).all()


def test_what_is_no_moment_is_refused():
    with pytest.raises(ReadError, match="'noon' in its when"):
        seconds_of(["noon"], "f", "when")


@settings(deadline=None, max_examples=80)
@given(st.integers(0, 2_000_000_000), st.integers(1, 1_000_000_000))
def test_ticks_are_round_and_few(first, long):
    at, words = ticks(first, first + long)
    assert len(at) == len(words) <= 8 and ((at >= first) & (at <= first + long)).all()
    assert len(at) >= 2 or long < 2
    if len(at) > 1:
        np.testing.assert_allclose(np.diff(at), at[1] - at[0])


def test_samples_are_put_in_order_and_have_speeds():
    found = tracks(Dataset(table(), group="who", variable="speed", style="tubes"))
    assert found.part.tolist() == [0, 0, 0, 1, 1] and found.tracks == 2
    np.testing.assert_allclose(found.at[:3, 0], [WEST + 100, WEST + 200, WEST + 300])
    np.testing.assert_allclose(found.values, [2.0, 200 / 150, 1.0, 0.0, 0.0])
    assert found.unit == "m/s"


def test_of_samples_at_one_moment_the_first_counts():
    same = table(time=["2019-03-01T12:00:00Z"] * 2 + ["2019-03-01T12:00:10Z"] * 3)
    found = tracks(Dataset(same, group="who", variable="pulse", style="tubes"))
    assert found.values.tolist() == [3, 2, 8]


@pytest.mark.parametrize("stretch", [1.0, 4.0])
def test_the_height_of_a_path_is_its_time(stretch):
    found = things(Dataset(table(), group="who", style="paths"), exaggeration=stretch)
    shown = np.isfinite(found.values)
    assert set(found.kind[shown]) == {Kind.TUBE} and [n for n, _ in found.legend.classes] == ["a", "b"]
    first, last = found.ends[shown, 0].min(), found.ends[shown, 3].max()
    # A third of the longer side as it is drawn, for 200 s; above the highest ground.
    assert (last - first) * stretch == pytest.approx(800 / 3)
    assert first > 79
    second = lambda level: 200 * (level - first) / (last - first)  # noqa: E731
    a = shown & (found.values == 0)
    where = np.interp(second(found.ends[a, 0]), [0, 50, 150], [100, 200, 300])
    np.testing.assert_allclose(found.x[a] - WEST, where, atol=1e-6)
    b = shown & (found.values == 1)
    np.testing.assert_allclose(found.x[b], found.ends[b, 1])  # upright: it stands still
    assert second(found.ends[b, 0].min()) == pytest.approx(100)
    # The axis says when.
    words = [mark.words for mark in found.marks]
    assert words[0] == "1 Mar 12:00:00" and words[1] == "12:00:30"
    np.testing.assert_allclose([second(mark.level) for mark in found.marks], 30 * np.arange(len(words)), atol=1e-6)
    assert "height is time" in found.legend.note


def test_paths_have_their_size_and_the_scale_of_all_times():
    data = Dataset(table(), group="who", variable="pulse", style="paths", size=500)
    whole, half = things(data), things(data.but(time="2019-03-01T12:01:40"))
    assert whole.legend.scales[0].low == half.legend.scales[0].low
    shown = [np.isfinite(one.values) for one in (whole, half)]
    tops = [one.ends[s, 3].max() - one.ends[s, 0].min() for one, s in zip((whole, half), shown)]
    np.testing.assert_allclose(tops, [500, 250], rtol=1e-6)
    assert [m.level for m in whole.marks] == [m.level for m in half.marks]


@settings(deadline=None, max_examples=40)
@given(st.floats(0, 200))
def test_places_between_samples_are_linear_in_time(second):
    found = until(tracks(Dataset(table(), group="who", variable="pulse", style="tubes")), START + second)
    a = found.at[found.part == 0]
    assert a[-1, 0] - WEST == pytest.approx(np.interp(second, [0, 50, 150], [100, 200, 300]))
    assert found.seconds.max() <= START + second + 1e-6
    assert ((found.part == 1).sum() > 0) == (second >= 100)


def test_a_tube_follows_the_ground_or_its_heights():
    low = things(Dataset(table(), group="who", variable="pulse", style="tubes"))
    assert np.isnan(low.ends[:, 0]).all() and (np.hypot(low.ends[:, 1] - low.x, low.ends[:, 2] - low.y) <= 10.01).all()
    np.testing.assert_allclose(sorted(set(low.values)), [1, 2, 3, 8, 9])
    high = things(Dataset(table(z=[0.2] * 5), group="who", variable="pulse", style="tubes", above="z:km"))
    np.testing.assert_allclose(high.ends[:, 0], 200 + (high.x - WEST - 5) / 10, atol=1e-3)


def gpx(tmp_path, body):
    path = tmp_path / "walk.gpx"
    path.write_text(f'<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">{body}</gpx>')
    return str(path)


def place(lon, lat, second, ele=""):
    return f'<trkpt lat="{lat}" lon="{lon}">{ele}<time>2019-03-01T12:00:{second:02}Z</time></trkpt>'


def test_gpx_has_tracks_segments_and_heights(tmp_path):
    one = place(-2.9985, 50.549, 0, "<ele>7</ele>") + place(-2.998, 50.549, 10)
    two = place(-2.993, 50.548, 40) + place(-2.992, 50.548, 50)
    path = gpx(tmp_path, f"<trk><name>Up</name><trkseg>{one}</trkseg><trkseg>{two}</trkseg></trk>")
    found = tracks(Dataset(path, style="tubes"))
    assert found.part.tolist() == [0, 0, 1, 1] and found.tracks == 1 and found.classes == ("Up",)
    drawn = things(Dataset(path, style="tubes"))
    # The gap between the segments is not bridged.
    x = np.sort(np.concatenate([drawn.x, drawn.ends[:, 1]]))
    assert np.diff(x).max() > 200
    assert tracks(Dataset(path, style="tubes", height="ele")).at[0, 2] == 7
    for body in ("<wpt lat='1' lon='2'/>", "<trk><trkseg><trkpt lon='2'/></trkseg></trk>"):
        with pytest.raises(ReadError):
            tracks(Dataset(gpx(tmp_path, body), style="tubes"))
    (tmp_path / "bad.gpx").write_text("<gpx><trk>")
    with pytest.raises(ReadError, match="not GPX"):
        tracks(Dataset(str(tmp_path / "bad.gpx"), style="tubes"))


def test_geojson_lines_have_times_in_their_properties():
    places = {"type": "LineString", "coordinates": [[-2.9985, 50.549, 90], [-2.998, 50.549, 95]]}
    about = {"name": "x", "coordTimes": [START, START + 10]}
    line = {"type": "Feature", "properties": about, "geometry": places}
    found = tracks(Dataset(line, style="paths"))
    assert found.at[:, 2].tolist() == [90, 95] and found.seconds.tolist() == [START, START + 10]
    about["coordTimes"] = [START]
    with pytest.raises(ReadError, match="2 places and 1 times"):
        tracks(Dataset(line, style="paths"))
    bare = {"type": "LineString", "coordinates": [[-2.9985, 50.549], [-2.998, 50.549]]}
    assert set(things(Dataset(bare, style="tubes")).kind) == {Kind.TUBE}
    with pytest.raises(UsageError, match="have no times"):
        things(Dataset(bare, style="paths"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"variable": "weight"}, "no attribute 'weight'"),
        ({"when": "then"}, "no attribute 'then'"),
        ({"group": "whose"}, "no attribute 'whose'"),
        ({"time": "2019-01"}, "not a time"),
        ({"height": "pulse+pulse"}, "not an interval"),
    ],
)
def test_what_makes_no_track_is_refused(change, words):
    with pytest.raises((ReadError, UsageError), match=words):
        things(Dataset(table(), group="who", style="paths").but(**change))
    untimed = {k: v for k, v in table().items() if k != "time"}
    with pytest.raises(UsageError, match="Nothing says when"):
        things(Dataset(untimed, group="who", style="paths"))
    with pytest.raises(ReadError, match="No two consecutive"):
        things(Dataset(table(x=[0.0] * 5), group="who", style="tubes"))


def test_moments_are_written_beside_the_axis():
    terrain = ground()
    view = orograph.camera.around(terrain, (400, 300), azimuth=200, pitch=25, distance=2500)
    data = Dataset(table(), group="who", style="paths")
    shown = orograph.render(terrain, view, data=data)
    from orograph.geovis.data.standing import Things
    from orograph.rendering.lines.ground_grid import label
    from orograph.scene.scene import Scene

    scene = Scene.of(terrain, view, data=data)
    assert isinstance(scene.theme.things, Things)
    bare = np.full((300, 400, 3), 128, np.uint8)
    written = label(scene, bare)
    mark = scene.theme.things.marks[0]
    (u, v), _ = view.project(np.array([mark.x, mark.y, mark.level]), 1.0)
    changed = np.argwhere((written != bare).any(-1))
    near = changed[np.abs(changed[:, 0] - v) < 10]
    assert len(near) and near[:, 1].max() < u < near[:, 1].max() + 25
    assert shown.pixels.shape == (300, 400, 3)


def test_before_a_track_begins_nothing_of_it_is_there():
    data = Dataset(table(), group="who", style="paths")
    found = things(data.but(time="2019-01-01"))
    assert not np.isfinite(found.values).any() and len(found.marks) > 2


def test_an_even_speed_has_a_scale_that_can_be_read():
    from orograph.geovis.data.scales import spanned

    speeds = 71.9 + np.random.default_rng(0).normal(0, 1e-12, 50)
    assert spanned(speeds, None) == pytest.approx((71.4, 72.4))
    assert spanned(np.array([1e-9, 2e-9]), None) == pytest.approx((1e-9, 2e-9), rel=0.1)
