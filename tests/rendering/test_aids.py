"""Orientation aids: where they stand against closed forms, shadows against brute force, tiles against the whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.transform import from_origin

import orograph
from orograph.errors import OrographError, UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.standing import Kind
from orograph.rendering.furniture.lettering import Style
from orograph.rendering.furniture.pieces import cube
from orograph.rendering.lines import ground_grid
from orograph.rendering.shadows import DARK, depth_in
from orograph.rendering.standing import stand
from orograph.scene.aids import Aids, interval_of
from orograph.scene.scene import Scene

UTM = "EPSG:32630"
WEST, NORTH = 500_000.0, 5_600_000.0


def ground(rows=61, cols=83, cell=(10.0, 10.0), slope=(0.0, 0.0), bumps=0.0):
    y, x = np.mgrid[:rows, :cols]
    heights = 100 + slope[0] * x * cell[0] + slope[1] * y * cell[1] + bumps * np.sin(x / 5) * np.cos(y / 4)
    return orograph.terrain(heights.astype(np.float32), transform=from_origin(WEST, NORTH, *cell), crs=UTM)


def balloons(*places, **keys):
    """Points (x, y, metres)."""
    x, y, z = np.array(places, float).T
    columns = {"x": WEST + x, "y": NORTH - y, "z": z, "value": np.arange(len(x)) + 1.0}
    return Dataset(columns, variable="value", **({"above": "z"} | keys))


def looking(terrain, size=(300, 200), azimuth=200, pitch=25):
    return orograph.camera.around(terrain, size, azimuth=azimuth, pitch=pitch, distance=None)


@pytest.mark.parametrize("exaggeration", [1.0, 2.5])
@pytest.mark.parametrize("key", ["height", "above"])
def test_points_float_where_they_are(key, exaggeration):
    terrain = ground(slope=(0.1, 0.0))
    true = 100 + 0.1 * 390 + 120  # (x is a sample's middle: half a cell from the corner)
    level = 120.0 if key == "above" else true
    data = balloons((395, 305, level), **{"above": None, key: "z"}, size=30.0, range=(0, 1))
    view = looking(terrain)
    shown = orograph.render(terrain, view, data=data, exaggeration=exaggeration, samples=1)
    bare = orograph.render(terrain, view, exaggeration=exaggeration, samples=1)
    rows, cols = np.nonzero(np.nan_to_num(bare.depth, nan=9e9) > np.nan_to_num(shown.depth, nan=9e9) + 1)
    (xy,), _ = view.project(np.array([[WEST + 395, NORTH - 305, true]]), exaggeration)
    assert np.hypot(cols.mean() + 0.5 - xy[0], rows.mean() + 0.5 - xy[1]) < 0.6
    assert "1 of them float" in shown.describe()


def test_drop_lines_reach_from_things_to_the_ground():
    terrain = ground(bumps=15.0)
    data = balloons((200, 300, 150), (400, 250, -40), (600, 400, 90))
    scene = Scene.of(terrain, looking(terrain), data=data, aids="drops")
    things = scene.theme.things
    lines = things.kind == Kind.TUBE
    assert lines.sum() == 2  # what is below the ground has none
    np.testing.assert_allclose(things.x[lines], WEST + np.array([200, 600]))
    assert np.isnan(things.ends[lines, 0]).all()
    from orograph.measuring.ground import heights

    col, row = terrain.grid.index(things.x[lines], things.y[lines])
    np.testing.assert_allclose(things.ends[lines, 3] - heights(terrain, col, row), [150, 90])


@settings(max_examples=40, deadline=None)
@given(st.floats(1.0, 5000.0), st.floats(0.5, 600.0))
def test_poles_have_a_band_for_each_step(high, step):
    from orograph.geovis.data import standing_aids as made

    terrain = ground(5, 7)
    if high / step > 1e4:
        return
    at = made.Floating(np.array([WEST]), np.array([NORTH]), np.array([100.0 + high]), np.zeros(1))
    rods = made.poles(at, np.array([100.0]), step, terrain.grid)
    bands = rods.kind == Kind.TUBE
    low, top = rods.ends[bands, 0], rods.ends[bands, 3]
    assert bands.sum() == max(np.ceil(high / step - 1e-6), 1) or bands.sum() == np.ceil(high / step)
    assert low[0] == 100 and top[-1] == 100 + high
    np.testing.assert_allclose(low[1:], top[:-1], rtol=1e-12)
    np.testing.assert_allclose(np.diff(low), step, rtol=1e-6)
    assert (rods.rgb[bands][::2] == rods.rgb[0]).all() and (rods.rgb[bands][1::2] != rods.rgb[0]).any(-1).all()
    assert (~bands).sum() == (bands.sum() - 1) // 5
    assert f"bands of {step:g} m" in rods.legend.note


def test_far_too_many_bands_are_refused():
    terrain = ground()
    with pytest.raises(UsageError, match="poles=METRES"):
        Scene.of(terrain, looking(terrain), data=balloons((100, 100, 9e6)), aids="poles=0.01")


def test_tracks_have_aids_at_equal_distances():
    terrain = ground()
    line = [[WEST + 100, NORTH - 300, 200.0], [WEST + 300, NORTH - 300, 250.0], [WEST + 700, NORTH - 300, 250.0]]
    track = {"type": "Feature", "properties": {"v": 3.0}, "geometry": {"type": "LineString", "coordinates": line},
             "crs": {"type": "name", "properties": {"name": UTM}}}  # fmt: skip
    data = Dataset(track, variable="v", style="tubes", size=10.0)
    scene = Scene.of(terrain, looking(terrain), data=data, aids="drops,shadows")
    things = scene.theme.things
    lines = (things.kind == Kind.TUBE) & np.isnan(things.ends[:, 0])
    x, level = things.x[lines], things.ends[lines, 3]
    np.testing.assert_allclose(np.diff(x), 830 / 32)
    np.testing.assert_allclose(level, np.interp(x - WEST, [100, 300, 700], [200, 250, 250]), atol=1e-6)
    assert (things.kind == Kind.SHADOW).sum() == 2


segments = st.lists(
    st.tuples(*[st.floats(-300, 300)] * 4, st.floats(0.5, 60)).map(
        lambda s: (s[0], s[1], s[0] + s[2] / 4, s[1] + s[3], s[4])
    ),
    min_size=1, max_size=8,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(segments, st.integers(0, 99))
def test_shadows_are_those_of_brute_force(given_segments, seed):
    all_ = np.array(given_segments)
    x, y = np.random.default_rng(seed).uniform(-400, 400, (2, 50))
    x[0] = np.nan
    a, b = all_[:, :2], all_[:, 2:4] - all_[:, :2]
    p = np.stack([x, y], 1)[:, None] - a
    part = np.clip((p * b).sum(-1) / np.maximum((b * b).sum(-1), 1e-300), 0, 1)
    away = np.linalg.norm(p - part[..., None] * b, axis=-1)
    true = ((all_[:, 4] - away) / all_[:, 4]).max(1)
    found = depth_in(x, y, all_)
    near = true > -0.25
    np.testing.assert_allclose(found[near], true[near], atol=1e-6)
    assert (found[~near] < -0.249).all()


def test_a_shadow_is_straight_below_whatever_the_light():
    terrain = ground()
    view = orograph.camera.plan(terrain, (249, 183))
    data = balloons((395, 305, 120), size=60.0, range=(0, 1))
    bare = orograph.render(terrain, view, sun="90,30", water="none").pixels.astype(float)
    scene = Scene.of(terrain, view, data=data, aids="shadows", water="none")
    from orograph.rendering.ground_places import ground_places
    from orograph.rendering.shadows import shade

    depth = orograph.render(terrain, view).depth
    shaded = bare.astype(np.uint8)
    shade(scene.theme.things, shaded, depth, scene)
    x, y = ground_places(scene, depth)
    away = np.hypot(x - WEST - 395, y - NORTH + 305)
    dark = shaded.astype(float).mean(-1) < bare.mean(-1) - 1
    assert dark[away < 35].all() and not dark[away > 38].any()
    from orograph.geovis.color import srgb_to_linear

    ratio = srgb_to_linear(shaded[away < 20] / 255).mean() / srgb_to_linear(bare[away < 20] / 255).mean()
    assert ratio == pytest.approx(1 - DARK, abs=0.02)


@pytest.mark.parametrize("name", ["plan", "perspective"])
@pytest.mark.parametrize("cell", [(10.0, 10.0), (12.0, 7.0)])
def test_grid_lines_are_where_eastings_and_northings_are_round(name, cell):
    terrain = ground(cell=cell, slope=(0.15, -0.1))
    view = orograph.camera.plan(terrain, (300, 200)) if name == "plan" else looking(terrain, pitch=40)
    scene = Scene.of(terrain, view, aids="grid=100")
    depth = orograph.render(terrain, view).depth
    part = ground_grid.coverage(scene, depth) / ground_grid.OPACITY
    inside = np.zeros(depth.shape, bool)
    inside[2:-2, 2:-2] = True
    for axis in (0, 1):
        on = np.stack(np.meshgrid(np.linspace(60, 540, 200), np.arange(100.0, 400.0, 100)), -1).reshape(-1, 2)
        on = on if axis else on[:, ::-1]
        x, y = np.rint(WEST / 100) * 100 + on[:, 0], np.rint(NORTH / 100) * 100 - on[:, 1]
        z = 100 + 0.15 * (x - WEST - cell[0] / 2) - 0.1 * (NORTH - cell[1] / 2 - y)
        known = (NORTH - y > cell[1]) & (NORTH - y < 60 * cell[1]) & (x - WEST > cell[0]) & (x - WEST < 82 * cell[0])
        xy, _ = view.project(np.stack([x, y, z], 1)[known], 1.0)
        col, row = np.floor(xy).astype(int).T
        there = (col > 1) & (row > 1) & (col < 298) & (row < 198)
        assert there.sum() > 100
        assert np.quantile(part[row[there], col[there]], 0.02) > 0.3
    picture = orograph.render(terrain, view)
    places = picture.places()
    apart = np.abs((places[..., :2] + 50) % 100 - 50).min(-1)
    metres = view.pixel_metres * (1 if name == "plan" else 6)
    assert not (part[np.isfinite(apart) & (apart > 2 * metres)] > 0).any()


def test_grid_lines_fade_where_they_would_run_together():
    terrain = ground()
    view = orograph.camera.plan(terrain, (300, 200))
    depth = orograph.render(terrain, view).depth
    assert ground_grid.coverage(Scene.of(terrain, view, aids="grid=10"), depth).max() == 0
    assert ground_grid.coverage(Scene.of(terrain, view, aids="grid=200"), depth).max() == ground_grid.OPACITY


def test_the_grids_own_interval_is_a_round_number():
    terrain = ground()
    for size in ((100, 80), (300, 200), (900, 700)):
        view = orograph.camera.plan(terrain, size)
        step = interval_of(Aids(grid="auto"), view)
        assert f"{step:e}"[0] in "125" and 60 < step / view.pixel_metres < 190


@pytest.mark.parametrize("name", ["plan", "perspective"])
def test_values_stand_at_the_ends_of_their_lines(name):
    terrain = ground()
    view = orograph.camera.plan(terrain, (600, 450)) if name == "plan" else looking(terrain, (600, 400), pitch=35)
    found = ground_grid.values(Scene.of(terrain, view, aids="grid=100"), 100.0)
    assert {one.words[-1] for one in found} == {"E", "N"}
    for one in found:
        value, axis = float(one.words.split()[0]), "EN".index(one.words[-1])
        along = np.linspace(5, 825 if axis else 605, 500)
        x, y = (WEST + along, np.full(500, value)) if axis else (np.full(500, value), NORTH - along)
        xy, _ = view.project(np.stack([x, y, np.full(500, 100.0)], 1), 1.0)
        assert np.hypot(*(xy - [one.x, one.y]).T).min() < 60
    boxes = [(one.x, one.y) for one in found]
    assert len(set(boxes)) == len(boxes) >= 6


def test_tiles_show_what_the_whole_shows():
    terrain = ground(bumps=12.0)
    view = looking(terrain, (240, 160))
    data = balloons((200, 300, 150), (400, 250, 80), (600, 400, 90), size=40.0)
    options = {"data": data, "aids": "drops,shadows,poles=20,grid=100", "samples": 4}
    whole = orograph.render(terrain, view, **options).pixels
    for left, top, width, height in ((0, 0, 120, 90), (64, 32, 120, 100), (120, 90, 120, 70)):
        tile = orograph.render(terrain, view.tile(left, top, width, height), **options).pixels
        np.testing.assert_array_equal(tile, whole[top : top + height, left : left + width])


def test_both_backends_draw_them(device):
    terrain = ground(bumps=12.0)
    data = balloons((200, 300, 150), (400, 250, 80), size=40.0)
    options = {"data": data, "aids": "drops,shadows,poles=20,grid=100", "tolerance": 0.1}
    view = looking(terrain)
    cpu, gpu = (orograph.render(terrain, view, backend=one, **options).pixels.astype(int) for one in ("cpu", "gpu"))
    bare = orograph.render(terrain, view, tolerance=0.1).pixels.astype(int)
    assert (np.abs(cpu - bare).max(-1) > 40).mean() > 0.02
    assert (np.abs(cpu - gpu).max(-1) > 40).mean() < 0.005
    tile = orograph.render(terrain, view.tile(64, 32, 120, 100), backend="gpu", **options).pixels.astype(int)
    assert (np.abs(tile - gpu[32:132, 64:184]).max(-1) > 8).mean() < 0.002


@pytest.mark.parametrize(("azimuth", "letters"), [(200, "SW"), (225, "SW"), (315, "NW"), (20, "NE"), (100, "ES")])
def test_the_cube_shows_the_sides_that_face_the_eye(azimuth, letters):
    view = looking(ground(), azimuth=azimuth, pitch=10)
    piece = cube(view.axes(), Style(12.0, None))
    words = [text[2] for text in piece.texts]
    assert set(words) - {"N"} <= set(letters) and words.count("N") <= 1 and len(words) >= 1
    if "N" in letters:
        return
    # The N on its top is to the north of the cube's middle on the screen.
    right, up, _ = view.axes()
    way = np.array([right[1], -up[1]])
    off = np.array(piece.texts[0][:2]) - np.array([piece.width / 2, piece.width / 2 + 0.34 * 12])
    top = -np.array([-right[2], up[2]]) * 1.1 * 12
    assert words[0] == "N" and (off - top) @ way / np.linalg.norm(off - top) / np.linalg.norm(way) > 0.99


def test_the_cube_takes_the_arrows_place_in_perspective_alone():
    terrain = ground()
    for view, same in ((orograph.camera.plan(terrain, (400, 300)), True), (looking(terrain, (400, 300)), False)):
        plain, aided = (orograph.render(terrain, view, furniture=True, aids=a).pixels for a in (None, "icon"))
        assert np.array_equal(plain, aided) == same


@pytest.mark.parametrize("text", ["", "drop", "drops=3", "poles=x", "grid=-5", "icon,", "poles=nan"])
def test_what_is_no_aid_is_refused(text):
    with pytest.raises(ValueError):
        Aids.parse(text)
    with pytest.raises(OrographError):
        Scene.of(ground(), orograph.camera.plan(ground(), (50, 40)), aids=text)


def test_aids_as_text_and_as_aids_are_the_same():
    assert Aids.parse("drops,poles=25,grid") == Aids(drops=True, poles=25.0, grid="auto")


def test_heights_of_what_cannot_float_are_refused():
    terrain, view = ground(), orograph.camera.plan(ground(), (50, 40))
    with pytest.raises(UsageError, match="spheres or discs"):
        Scene.of(terrain, view, data=balloons((100, 100, 5), style="bars"))
    with pytest.raises(UsageError, match="Give one"):
        Dataset({"x": [0]}, height="z", above="z")
    with pytest.raises(UsageError, match="height=NAME"):
        Scene.of(terrain, view, data=balloons((100, 100, 5), above=None, height="altitude"))
    with pytest.raises(UsageError, match="these are not points"):
        Scene.of(terrain, view, data=Dataset(np.zeros((61, 83), np.float32), height="z"))


def test_panels_are_hit_between_their_heights_from_their_left_alone():
    from orograph.geovis.data.standing import Things
    from orograph.geovis.keys import Legend

    terrain = ground(bumps=0.0)
    one = np.ones(1)
    for turned in (False, True):
        x0, x1 = (700.0, 100.0) if turned else (100.0, 700.0)
        panel = Things(
            np.array([Kind.PANEL], np.int8), WEST + x0 * one, NORTH + 50 * one, 0 * one, 0 * one, 0 * one,
            np.array([[1.0, 0.0, 0.0]], np.float32), one, Legend(),
            np.array([[150.0, WEST + x1, NORTH + 50, 230.0]]),
        )  # fmt: skip
        view = looking(terrain, azimuth=180, pitch=20)
        bare = orograph.render(terrain, view, exaggeration=2.0)
        stood = stand(panel, bare.pixels, bare.depth, Scene.of(terrain, view, exaggeration=2.0))
        if not turned:
            assert not (stood.which >= 0).any()
            continue
        rows, cols = np.nonzero(stood.which >= 0)
        corners = [[WEST + x, NORTH + 50, z] for x in (100, 700) for z in (150, 230)]
        xy, _ = view.project(np.array(corners), 2.0)
        assert abs(cols.min() - xy[:, 0].min()) < 1.5 and abs(cols.max() + 1 - xy[:, 0].max()) < 1.5
        assert abs(rows.min() - xy[:, 1].min()) < 1.5 and abs(rows.max() + 1 - xy[:, 1].max()) < 1.5
        inner = stood.pixels[(rows.min() + rows.max()) // 2, (cols.min() + cols.max()) // 2]
        np.testing.assert_array_equal(inner, [255, 0, 0])  # no light falls on it


@pytest.mark.cases(3)
@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
@pytest.mark.parametrize("azimuth", [150, 200, 310])
def test_walls_show_the_profile_in_the_datas_colours(exaggeration, azimuth):
    terrain = ground(bumps=40.0, cell=(12.0, 9.0))
    values = np.mgrid[:61, :83][1].astype(np.float32)
    data = Dataset(values, colormap="viridis", range=(0, 82))
    scene = Scene.of(terrain, looking(terrain, azimuth=azimuth), data=data, aids="walls", exaggeration=exaggeration)
    things = scene.theme.things
    panel = things.kind == Kind.PANEL
    low, high = terrain.height_range
    from orograph.geovis.data.standing_walls import COLUMNS, GAP
    from orograph.measuring.ground import heights

    fill = panel & (things.ends[:, 0] == low) & (things.ends[:, 3] < high + 1e-6)
    assert fill.sum() == 4 * COLUMNS  # (two walls of each of two sections)
    col, row = terrain.grid.index((things.x + things.ends[:, 1]) / 2, (things.y + things.ends[:, 2]) / 2)
    gap = GAP * 83 * 12
    north = fill & (np.abs(row + gap / 9) < 0.01)
    assert north.sum() == COLUMNS
    true = heights(terrain, col[north], np.full(COLUMNS, 30.0))
    assert np.abs(things.ends[north, 3] - true).max() < 0.02 * (high - low)
    from orograph.geovis.data.scales import ColorScale

    expected = ColorScale.of(values, "viridis", (0, 82)).color(col[north])
    assert np.abs(things.rgb[north] - expected).max() < 0.02
    picture = orograph.render(terrain, scene.view, data=data, aids="walls", exaggeration=exaggeration)
    bare = orograph.render(terrain, scene.view, data=data, exaggeration=exaggeration)
    beside = np.isfinite(picture.depth) & ~np.isfinite(bare.depth)
    assert beside.sum() > 200
    # A wall is seen from its inner side alone.
    places = picture.places()[beside]
    col, row = terrain.grid.index(places[:, 0], places[:, 1])
    eye_col, eye_row = terrain.grid.index(*np.array(scene.view.eye[:2])[:, None])
    for at, eye, last in ((col, eye_col, 82), (row, eye_row, 60)):
        assert (eye > at[at < -5]).all() and (eye < at[at > last + 5]).all()


def test_walls_are_the_same_in_tiles_and_on_the_gpu(device):
    terrain = ground(bumps=40.0)
    view = looking(terrain, (240, 160))
    options = {"aids": "walls", "exaggeration": 2.0}
    whole = orograph.render(terrain, view, **options).pixels
    tile = orograph.render(terrain, view.tile(64, 0, 120, 100), **options).pixels
    np.testing.assert_array_equal(tile, whole[0:100, 64:184])
    gpu = orograph.render(terrain, view, **options, backend="gpu", tolerance=0.1).pixels.astype(int)
    assert (np.abs(gpu - whole).max(-1) > 40).mean() < 0.006


@pytest.mark.stress
def test_the_cues_carry_the_information():
    import runpy
    from pathlib import Path

    task = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "which_is_higher.py"))
    terrain = ground(bumps=10.0)
    rng = np.random.default_rng(2)
    for _ in range(2):
        view, pair = task["stimulus"](terrain, rng)
        pictures = {cue: task["draw"](terrain, view, pair, cue, 20.0) for cue in task["CUES"]}
        for place in pair:
            for cue in ("drops", "poles", "shadows"):
                found = task["read"](cue, terrain, view, pictures, place, 20.0)
                assert abs(found - place[2]) < 4 * task["worth"](terrain, view, place)
