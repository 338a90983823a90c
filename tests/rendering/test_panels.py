"""Panels: each is what its picture alone would be, with one camera and one scale."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.data.derived import deviations, read_data
from orograph.rendering.furniture.furnish import EDGE
from orograph.rendering.panels import _boxes, _note, panels_of
from orograph.rendering.standing import extent_of
from orograph.scene.scene import Scene

PLACE = Affine(50, 0, 500_000, 0, -50, 5_600_000)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:60, :80]
    return orograph.terrain((100 + 20 * np.sin(x / 7 + y / 9)).astype(np.float32), transform=PLACE, crs="EPSG:32630")


@pytest.fixture(scope="module")
def data() -> orograph.Dataset:
    members = np.random.default_rng(3).normal(0, 1, (5, 12, 16)).cumsum(1) + np.arange(5)[:, None, None]
    return orograph.Dataset(members.astype(np.float32), name="Field", style="segmented")


@pytest.mark.stress
def test_each_panel_is_its_own_picture(ground, data):
    view = orograph.camera.whole(ground, (400, 300))
    sheet = orograph.render(ground, view, data=data, each="member=2-5", progress=False)
    boxes = _boxes(4, (400, 300), (0, 0, 0, 0), *_type())
    wide, tall = boxes[0][2], boxes[0][3] - _type()[0]
    first = panels_of((data,), "member=2-5", ground)[0].data[0]
    span = first.range
    values = data.source[1:]
    assert span == pytest.approx((values.min(), values.max()), abs=0.05 * float(np.ptp(values)))
    for k, (x, y, _, _) in enumerate(boxes):
        alone = orograph.render(
            ground, view.resized(wide, tall), progress=False,
            data=data.but(member=str(k + 2), range=span, breaks=first.breaks),
        )  # fmt: skip
        top = y + _type()[0]
        np.testing.assert_array_equal(sheet.pixels[top : top + tall, x : x + wide], alone.pixels)
    assert sheet.describe().startswith("4 panels: member 2, member 3")
    assert repr(sheet) == "<Picture 400 × 300 pixels, 4 panels>"


def test_members_that_the_data_choose_are_the_panels(ground, data):
    chosen = data.but(member="2-4")
    assert [p.title for p in panels_of((chosen,), "member", ground)] == ["member 2", "member 3", "member 4"]
    assert [p.title for p in panels_of((chosen,), "member=4-5", ground)] == ["member 4", "member 5"]


def _type():
    from orograph.rendering.furniture.lettering import Style

    style = Style.of((400, 300), "member")
    return int(np.ceil(1.9 * style.unit)), style.gap


def test_boxes_do_not_meet_and_keep_proportions():
    for count in (2, 3, 7, 24, 36):
        boxes = _boxes(count, (1200, 800), (0.0, 0.15, 0.08, 0.1), 20, 8)
        assert len(boxes) == count
        for x, y, wide, tall in boxes:
            assert x >= 0 and y >= 64 and x + wide <= 1020 and y + tall <= 720
            assert abs(wide / (tall - 20) - 1.5) < 0.03
        for i, a in enumerate(boxes):
            for b in boxes[:i]:
                assert a[0] >= b[0] + b[2] or b[0] >= a[0] + a[2] or a[1] >= b[1] + b[3] or b[1] >= a[1] + a[3]
    with pytest.raises(UsageError, match="do not fit"):
        _boxes(30, (200, 150), (0, 0, 0, 0), 20, 8)


def test_a_map_beside_the_relief(ground, data):
    sheet = orograph.render(ground, size=(600, 300), data=data, each="view", furniture=True, progress=False)
    assert sheet.pixels.shape == (300, 600, 3) and "Map, Relief" in sheet.describe()
    found = panels_of((data,), "view", ground)
    assert [panel.plan for panel in found] == [True, False]


def test_times_and_one_scale_of_uncertainties(ground):
    xarray = pytest.importorskip("xarray")
    times = np.array(["2019-03-01T00", "2019-03-01T12", "2019-03-02T12"], "M8[ns]")
    y, x = 5_600_000 - 100 - np.arange(15) * 200.0, 500_100 + np.arange(20) * 200.0
    values = np.random.default_rng(1).normal(0, 1, (3, 15, 20)).astype(np.float32)
    array = xarray.DataArray(values, dims=("time", "y", "x"), coords={"time": times, "y": y, "x": x})
    sigma = orograph.Uncertainty(np.full((15, 20), 0.5, np.float32))
    found = panels_of((orograph.Dataset(array, uncertainty=sigma),), "time=T12", ground)
    assert [panel.title for panel in found] == ["2019-03-01 12:00", "2019-03-02 12:00"]
    spans = {panel.data[0].range for panel in found}
    assert len(spans) == 1 and spans.pop() == pytest.approx((values[1:].min(), values[1:].max()), abs=0.3)
    assert len({panel.data[0].uncertainty.range for panel in found}) == 1


def test_times_of_one_day_are_told_by_their_hour(ground):
    xarray = pytest.importorskip("xarray")
    times = np.array(["2019-03-01T00", "2019-03-01T12", "2019-03-02T12"], "M8[ns]")
    y, x = 5_600_000 - 100 - np.arange(15) * 200.0, 500_100 + np.arange(20) * 200.0
    array = xarray.DataArray(np.ones((3, 15, 20)), dims=("time", "y", "x"), coords={"time": times, "y": y, "x": x})
    found = panels_of((orograph.Dataset(array),), "time=2019-03-01", ground)
    assert [panel.title for panel in found] == ["00:00", "12:00"]
    assert _note(found, "time=2019-03-01") == "one panel for each time on 2019-03-01 (UTC), one scale"


@pytest.mark.stress
@pytest.mark.parametrize("measure", ["spread", "ci90"])
def test_panels_of_members_carry_how_all_of_them_differ(ground, data, measure):
    found = panels_of((data.but(uncertainty=measure),), "member=2-3", ground)
    ensemble = np.asarray(data.source, np.float64)
    low, high = np.quantile(ensemble, [0.05, 0.95], axis=0)
    truth = ensemble.std(0, ddof=1) if measure == "spread" else (high - low) / 2
    assert len({panel.data[0].uncertainty.range for panel in found}) == 1
    for panel in found:
        doubt = panel.data[0].uncertainty.source
        np.testing.assert_allclose(doubt.mean, truth, rtol=1e-5)
        assert doubt.name.endswith("of all 5")
    view = orograph.camera.whole(ground, (400, 300))
    options = {"each": "member=2-3", "progress": False, "furniture": True}
    sheet = orograph.render(ground, view, data=data.but(uncertainty=measure), **options)
    assert "of all 5" in sheet.describe() and "Their uncertainty is shown" in sheet.describe()
    assert (sheet.pixels != orograph.render(ground, view, data=data, **options).pixels).any()


@pytest.mark.parametrize(
    ("each", "says"),
    [
        ("station", "view, data, member, band, time"),
        ("member=9", "no 9"),
        ("member=2", "there is 1"),
        ("time", "there are 0"),
    ],
)
def test_panels_that_cannot_be_are_refused(ground, data, each, says):
    with pytest.raises(UsageError) as told:
        panels_of((data,), each, ground)
    assert says in f"{told.value.what} {told.value.remedy}"
    with pytest.raises(UsageError, match="there are none"):
        panels_of((), "member", ground)
    with pytest.raises(UsageError, match="value= or exceeds= is taken over several"):
        panels_of((data.but(exceeds=1.0),), "member", ground)


def test_each_time_has_the_spread_of_its_own_members(ground):
    xarray = pytest.importorskip("xarray")
    times = np.array(["2019-03-01T00", "2019-03-01T12"], "M8[ns]")
    y, x = 5_600_000 - 100 - np.arange(15) * 200.0, 500_100 + np.arange(20) * 200.0
    values = np.random.default_rng(1).normal(0, 1, (2, 6, 15, 20)).astype(np.float32)
    values[1] *= 3
    array = xarray.DataArray(values, dims=("time", "member", "y", "x"), coords={"time": times, "y": y, "x": x})
    data = orograph.Dataset(array, uncertainty=orograph.Uncertainty("spread"))
    found = [panel.data[0] for panel in panels_of((data,), "time", ground)]
    spans = {one.uncertainty.range for one in found}
    assert len(spans) == 1 and spans.pop()[1] == pytest.approx(3 * 1.9, rel=0.3)
    fields = [read_data(one, ground.grid) for one in found]
    spreads = [deviations(one, field, ground.grid)[1] for one, field in zip(found, fields)]
    for spread, members in zip(spreads, values):
        np.testing.assert_allclose(np.sort(spread, None), np.sort(members.std(0, ddof=1), None), rtol=1e-4)


@pytest.mark.stress
def test_a_long_legend_leaves_panels_alone(ground, data):
    """The legend keeps off the panels whatever it says, and a scale keeps its unit."""
    named = data.but(name="A variable with quite a long name")
    view = orograph.camera.whole(ground, (900, 560))
    picture = orograph.render(ground, view, data=named, each="view", furniture=True)
    bare = orograph.render(ground, view, data=named, each="view")
    assert picture.pixels.shape == bare.pixels.shape
    # Right of the panels there is the legend alone, on paper without a frame of its own.
    assert not (picture.pixels == np.array(EDGE, np.uint8)).all(-1).any()


def test_each_of_several_data_has_a_panel_and_its_own_scale(ground, data):
    other = orograph.Dataset(np.linspace(0, 300, 48, dtype=np.float32).reshape(6, 8), variable="rain_sum")
    view = orograph.camera.whole(ground, (400, 300))
    found = panels_of((data, other), "data", ground)
    assert [panel.title for panel in found] == ["Field", "rain sum"]
    sheet = orograph.render(ground, view, data=[data, other], each="data", furniture=True, progress=False)
    assert sheet.facts["panels"] == 2
    with pytest.raises(UsageError, match="there are 1"):
        panels_of((data,), "data", ground)


@pytest.mark.parametrize("each", ["member", "data", "view"])
def test_what_stands_fits_into_each_panel(ground, each):
    """One camera, so far away that the highest bars of any panel are in the picture."""
    members = np.ones((3, 12, 16), np.float32)
    members[1, 0] = members[2, :, 0] = 5
    bars = orograph.Dataset(members, name="Field", style="bars", size=900.0, range=(0.0, 5.0))
    data = [bars.but(member="1", size=300.0), bars.but(member="2")] if each == "data" else [bars.but(member="1-3")]
    options = {"data": data, "each": each, "progress": False, "samples": 1}
    sheet = orograph.render(ground, size=(600, 240), **options)
    kept = orograph.camera.whole(ground, (600, 240))
    above = {sheet.view: [], kept: []}
    for panel in panels_of(tuple(data), each, ground):
        for view in above:
            points = extent_of(Scene.of(ground, view, data=panel.data))
            assert points is not None
            pixels = view.project(points)[0]
            above[view].append(float(pixels[:, 1].min()))
            assert view == kept or ((pixels >= 0) & (pixels <= (600, 240))).all()
    assert min(above[kept]) < 0 < min(above[sheet.view]) < 15  # no farther away than needed
    assert orograph.render(ground, kept, **options).view == kept
