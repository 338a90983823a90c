"""Films of data that change: what a frame shows is what NumPy finds for its moment, and a picture of it alone."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import xarray as xr
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.painting import image_grid
from orograph.geovis.data.sampling import Positions
from orograph.geovis.data.scales import class_breaks
from orograph.geovis.data.times import matches, seconds_of, span_within, written
from orograph.rendering.backends import session
from orograph.touring import make
from orograph.touring.film import Film
from orograph.touring.frames import recipe_of
from orograph.touring.playing import Played, Playing

PLACE = Affine(50, 0, 500_000, 0, -50, 5_600_000)
TIMES = np.array(["2020-01-01T00", "2020-01-01T06", "2020-01-02T00"], "M8[ns]")
MEMBERS = 5


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:41, :60]
    return orograph.terrain((100 + 20 * np.sin(x / 7 + y / 9)).astype(np.float32), transform=PLACE, crs="EPSG:32630")


def series(members: int = MEMBERS, **attributes: object) -> xr.DataArray:
    values = np.random.default_rng(7).normal(10, 4, (3, members, 12, 16)).astype(np.float32)
    x, y = 500_000 + (np.arange(16) + 0.5) * 190, 5_600_000 - (np.arange(12) + 0.5) * 175
    found = xr.DataArray(
        values, dims=("time", "member", "y", "x"), coords={"time": TIMES, "x": x, "y": y}, name="t", attrs=attributes
    )
    return found.rio.write_crs("EPSG:32630") if hasattr(found, "rio") else found


def film_of(ground: orograph.Terrain, data: Dataset, fps: float = 10.0, **options: object) -> Film:
    tour = make.still(ground, (60, 40), seconds=2.0, plan=True)
    return Film.of(
        tour, ground, (60, 40), {"data": data, **options}, draw=session(), fps=fps, first=None, last=None,
        progress=orograph.progress.SILENT,
    )  # fmt: skip


def test_frames_show_moments_evenly_from_the_first_to_the_last_with_values_linear_between_times(ground):
    source = series()
    film = film_of(ground, Dataset(source, time="..", member="all"))
    hours = np.array([0.0, 6.0, 24.0])
    spans = set()
    for number in (0, 1, 7, 19):
        (shown,) = film.scene(number).theme.data
        hour = 24 * number / 19
        k = min(int(np.searchsorted(hours, hour, "right")) - 1, 1)
        part = (hour - hours[k]) / (hours[k + 1] - hours[k])
        expected = source.values[k] * (1 - part) + source.values[k + 1] * part
        np.testing.assert_allclose(shown.source.values, expected, atol=2e-3)
        spans.add(shown.range)
        assert "linear between its times" in shown.source.chosen
    assert len(spans) == 1
    low, high = next(iter(spans))
    assert low < source.values.mean(1).min() + 1 and high > source.values.mean(1).max() - 1
    (fact,) = film.playing.facts
    assert fact["from"] == "2020-01-01T00:00" and fact["to"] == "2020-01-02T00:00"
    assert (fact["times"], fact["between"]) == (3, "linear")


@pytest.mark.stress
def test_a_frame_is_the_picture_of_its_moment(ground):
    film = film_of(ground, Dataset(series(1), time="2020-01-01..2020-01-02", name="T", style="segmented"))
    scene = film.scene(5)
    (shown,) = scene.theme.data
    second = 24 * 3600 * 5 / 19
    moment = written(seconds_of(["2020-01-01T00:00"], "", "")[0] + second)
    alone = orograph.render(
        ground, scene.view, progress=False, relief=scene.lighting.relief,
        data=Dataset(series(1), time=moment, name="T", style="segmented", range=shown.range, breaks=shown.breaks),
    )  # fmt: skip
    np.testing.assert_array_equal(film.picture(5).pixels, alone.pixels)
    assert (film.picture(5).pixels != film.picture(12).pixels).any()


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    ("breaks", "given"), [("quantiles", None), ("quantiles", (0.0, 30.0)), ("jenks", None), ("equal", None)]
)
def test_a_film_has_one_set_of_breaks(ground, breaks, given):
    """Found among the values of all its moments, as if they were one picture."""
    source = series(1)
    source = source.copy(data=source.values + 10 * np.arange(len(source))[:, None, None, None] ** 2)  # it grows warmer
    data = Dataset(source, time="..", name="T", style="segmented", classes=4, breaks=breaks, range=given)
    film = film_of(ground, data)
    scales = {(shown.range, shown.breaks) for k in (0, 19) for shown in film.scene(k).theme.data}
    ((span, found),) = scales
    over = image_grid(ground.grid, 512)
    every = []
    for second in np.linspace(0, 1, 20):  # (fewer frames than are looked at: all)
        moment = written(seconds_of(["2020-01-01T00:00"], "", "")[0] + 24 * 3600 * second)
        field = read_data(Dataset(source, time=moment), ground.grid)
        every.append(Positions.of(over, field).values(field.shown).ravel())
    pooled = np.concatenate(every)
    pooled = pooled[np.isfinite(pooled)]
    assert span == given or span == pytest.approx((pooled.min(), pooled.max()), abs=1e-3)
    if breaks == "equal":
        assert found == "equal"
        return
    inside = pooled[(pooled >= span[0]) & (pooled <= span[1])]
    assert found == pytest.approx((span[0], *class_breaks(inside, 4, breaks, *span), span[1]), abs=0.02)
    first = every[0][np.isfinite(every[0])]
    assert found[1:-1] != pytest.approx(class_breaks(first, 4, breaks, *span), abs=2)  # (alone, it has others)


def test_classes_are_those_of_the_nearer_time(ground):
    source = series(1, flag_values=np.arange(3), flag_meanings="wood field lake")
    source = source.copy(data=np.random.default_rng(1).integers(0, 3, source.shape).astype(np.float32))
    film = film_of(ground, Dataset(source, time="..2020-01-01T06"))
    for number, k in ((0, 0), (9, 0), (10, 1), (19, 1)):
        np.testing.assert_array_equal(film.scene(number).theme.data[0].source.values, source.values[k])
    assert film.playing.facts[0]["between"] == "nearest"


@pytest.mark.stress
@pytest.mark.parametrize("style", ["arrows", "curtains"])
def test_flows_and_sections_change_too(ground, style):
    if style == "arrows":
        found = xr.Dataset({"u": series(1)[:, 0], "v": series(1)[:, 0] + 3})
        data = Dataset(found, variable="u+v", style="arrows", time="..")
    else:
        levels = series().rename(member="height").assign_coords(height=[50.0, 150, 300, 400, 600])
        levels.coords["height"].attrs |= {"units": "m", "axis": "Z", "standard_name": "height"}
        data = Dataset(levels, style="curtains", time="..")
    film = film_of(ground, data)
    assert len({film.scene(number).theme.data[0].range for number in (0, 10, 19)}) == 1
    if style == "arrows":
        assert (film.picture(0).pixels != film.picture(10).pixels).any()
    else:  # (seen from above, a curtain is a line)
        first, later = (film.scene(number).theme.things.rgb for number in (0, 10))
        assert (first != later).any()


@pytest.mark.stress
@settings(deadline=None, max_examples=30)
@given(st.floats(0.5, 120), st.floats(0.01, 3.0), st.integers(2, 50))
def test_members_change_at_most_as_often_as_asked(fps, rate, count):
    hold = film_hold(fps, rate)
    one = Played(Dataset(np.zeros((count, 2, 2))), members=tuple(range(1, count + 1)), hold=hold)
    shown = [one.key(number, 999)[1] for number in range(1000)]
    each = shown[::hold]
    assert each == [k % count + 1 for k in range(len(each))]
    changes = np.flatnonzero(np.diff(shown)) / fps
    for begin in changes:
        assert ((changes >= begin) & (changes < begin + 1 - 1e-6)).sum() <= max(1, np.ceil(rate))
    assert fps / hold <= rate + 1e-6 or hold == 1


def film_hold(fps: float, rate: float) -> int:
    flat = orograph.terrain(np.zeros((3, 3), np.float32), transform=PLACE, crs="EPSG:32630")
    doubt = Uncertainty("spread", style="members", rate=rate)
    playing = Playing.of({"data": Dataset(np.zeros((2, 3, 3)), uncertainty=doubt)}, flat, 4, fps)
    assert playing is not None
    return playing.data[0].hold


@pytest.mark.stress
def test_members_are_shown_in_turn_at_each_moment(ground):
    source = series()
    doubt = Uncertainty("spread", style="members", rate=2.5)
    film = film_of(ground, Dataset(source, time="..2020-01-01T06", member="2-4", uncertainty=doubt))
    assert film.playing.facts[0]["members"] == 3
    assert film.playing.facts[0]["changes_per_second"] == pytest.approx(2.5)
    for number, member in ((0, 1), (3, 1), (4, 2), (8, 3), (12, 1)):
        (shown,) = film.scene(number).theme.data
        part = number / 19
        expected = source.values[0, member] * (1 - part) + source.values[1, member] * part
        np.testing.assert_allclose(shown.source.values, expected[None], atol=2e-3)
        assert shown.uncertainty is None
        assert shown.source.chosen.startswith(f"member {member + 1} 2020-01-01 0")


def test_another_process_has_the_same_film(ground):
    film = film_of(ground, Dataset(series(1), time=".."), fps=2.0)
    recipe = pickle.loads(pickle.dumps(recipe_of(film, "frames/%d.png", "cpu", None, 1 << 28)))
    state = recipe.open()  # (refuses where its film is another)
    own = state.stage("frames", 0).film
    np.testing.assert_array_equal(own.picture(2).pixels, film.picture(2).pixels)


def test_what_cannot_be_played_is_refused(ground):
    for rate in (0.0, -1.0, 3.5, 30.0, float("nan")):
        with pytest.raises(UsageError, match="at most 3 times a second"):
            Uncertainty("spread", style="members", rate=rate)
    with pytest.raises(UsageError, match="members in turn"):
        Uncertainty("spread", style="noise", rate=2.0)
    with pytest.raises(UsageError, match="those of the data"):
        Uncertainty("sigma.tif", style="members")
    turning = Dataset(series(1), time="2020-01-01T06", uncertainty=Uncertainty("spread", style="members"))
    with pytest.raises(UsageError, match="one member"):
        film_of(ground, turning)
    with pytest.raises(UsageError, match="taken over several"):
        film_of(ground, turning.but(source=series(), value="p90"))
    with pytest.raises(UsageError, match="seen in films"):
        orograph.render(ground, data=turning.but(source=series()), progress=False)
    for time in ("2020-01-02..2020-01-01", "2019..2020-01-02", "2020-01-01..2021", "2020-01-01T06..2020-01-01T06"):
        with pytest.raises(UsageError, match="is no span within its times"):
            film_of(ground, Dataset(series(1), time=time))
    with pytest.raises(UsageError, match="no series"):
        film_of(ground, Dataset(np.zeros((4, 4)), time=".."))


def test_a_span_ends_with_the_last_time_that_begins_as_it_says():
    times = ["2019-03-01T00:00", "2019-03-01T23:00", "2019-03-02T12:00"]
    first, last = span_within(times, "2019-03-01..2019-03-01")
    assert (written(first), written(last)) == ("2019-03-01T00:00", "2019-03-01T23:00")
    assert written(span_within(times, "2019-03-01T05:30..")[0]) == "2019-03-01T05:30"
    assert [matches(time, "2019-03-01..2019-03-01") for time in times] == [True, True, False]
    assert [matches(time, "2019-03-01T05..") for time in times] == [False, True, True]
    assert not matches("", "..")
    with pytest.raises(ReadError):
        span_within(times, "tomorrow..")


def test_pictures_show_the_mean_of_a_span(ground):
    from orograph.geovis.data.reading import read

    source = series(1)
    found = read(Dataset(source, time="2020-01-01..2020-01-01"), ground.grid)
    np.testing.assert_allclose(found.mean, source.values[:2, 0].mean(0), rtol=1e-6)
    assert found.chosen == "mean of 2 from 2020-01-01 00:00 to 2020-01-01 06:00"
