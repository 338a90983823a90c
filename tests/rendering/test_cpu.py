"""The CPU backend against what pictures must show: depth by Embree and by interpolation, light by closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scenes import NORTH_UP, RECTANGULAR, ROTATED, embree_depth, hills, holes, surface, terrain

from orograph import store
from orograph.errors import NothingInViewError
from orograph.geovis.color import TINTS, elevation_table, linear_to_srgb, srgb_to_linear
from orograph.lighting.sun import Sun
from orograph.rendering.cpu import draw as cpu
from orograph.rendering.cpu.ground import LEAST_MEMORY
from orograph.rendering.cpu.kernels import _shoulder
from orograph.rendering.palette import MISSING
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.viewpoint import View

SIZE = (160, 90)
BARE = {"samples": 1, "water": None, "relief": 1.0}
"""Light and colour only, as nature has them."""


def agree(depth, reference, least=0.999):
    """Same hits on all but a few pixels (edges decide by rounding), depth to 1e-4 where both hit."""
    both = np.isfinite(depth) & np.isfinite(reference)
    assert both.sum() > 500
    same = np.isfinite(depth) == np.isfinite(reference)
    near = np.abs(depth - reference) <= 1e-4 * np.abs(reference)
    assert (same & (near | ~both)).mean() >= least


def linear(picture):
    return srgb_to_linear(picture.pixels / 255.0)


# ---- depth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transform", [NORTH_UP, RECTANGULAR, ROTATED], ids=["square", "rectangular", "rotated"])
@pytest.mark.parametrize("exaggeration", [1.0, 2.5])
@pytest.mark.parametrize("holed", [False, True], ids=["whole", "holed"])
def test_depth_is_that_of_the_triangles(transform, exaggeration, holed):
    heights = hills()
    ground = terrain(holes(heights) if holed else heights, transform)
    for azimuth, pitch in ((200, 25), (65, 8)):
        view = camera.whole(ground, SIZE, azimuth=azimuth, pitch=pitch, exaggeration=exaggeration)
        picture = cpu.draw(Scene.of(ground, view, exaggeration=exaggeration, shadows=False, **BARE))
        assert picture.depth.dtype == np.float32 and picture.depth.shape == (90, 160)
        agree(picture.depth, embree_depth(ground, view, exaggeration))


@pytest.mark.stress
def test_depth_of_a_real_dem(shared_data):
    path = shared_data / "bigtujunga-srtm30m-utm"
    from orograph.store.prepare import prepare

    ground = prepare([str(next(f for f in sorted(path.iterdir()) if f.suffix in (".tif", ".bil")))])
    view = camera.whole(ground, (320, 180), azimuth=220, pitch=20)
    picture = cpu.draw(Scene.of(ground, view, **BARE))
    agree(picture.depth, embree_depth(ground, view))


def test_depth_from_within_and_beneath():
    """An eye over a valley between the hills, and one under the ground."""
    ground = terrain(hills(tall=500))
    x, y = (float(v) for v in ground.grid.xy(41, 30))
    z = camera.ground(ground, x, y, 0)
    for height in (z + 50, z - 150):
        for toward in ((1, 0.3), (-0.2, 1)):
            view = View(
                (x, y, height), (x + 1000 * toward[0], y + 1000 * toward[1], height), fov_y=60, width=160, height=90
            )
            picture = cpu.draw(Scene.of(ground, view, shadows=False, **BARE))
            agree(picture.depth, embree_depth(ground, view))


def test_depth_is_cut_by_near_and_far():
    ground = terrain(hills())
    view = camera.whole(ground, SIZE)
    whole = cpu.draw(Scene.of(ground, view, **BARE)).depth
    near, far = (float(v) for v in np.nanpercentile(whole, [30, 60]))
    cut = cpu.draw(Scene.of(ground, dataclasses.replace(view, near=near, far=far), **BARE)).depth
    assert np.nanmin(cut) >= near * (1 - 1e-6) and np.nanmax(cut) <= far * (1 + 1e-6)
    inside = (whole > near * 1.0001) & (whole < far * 0.9999)
    np.testing.assert_allclose(cut[inside], whole[inside], rtol=1e-6)


@pytest.mark.parametrize("transform", [NORTH_UP, RECTANGULAR, ROTATED], ids=["square", "rectangular", "rotated"])
def test_depth_of_a_plan_is_height_under_the_eye(transform):
    ground = terrain(holes(hills()), transform)
    view = camera.plan(ground, SIZE)
    for exaggeration in (1.0, 3.0):
        depth = cpu.draw(Scene.of(ground, view, exaggeration=exaggeration, **BARE)).depth
        px, py = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
        x = view.target[0] + (px - 80) * view.pixel_metres
        y = view.target[1] - (py - 45) * view.pixel_metres
        expected = (view.eye[2] - surface(ground, *ground.grid.index(x, y))) * exaggeration
        agree(depth, expected)


# ---- nothing to draw -------------------------------------------------------------------------------------------------


def test_looking_away_is_an_error():
    ground = terrain(hills())
    view = camera.whole(ground, SIZE)
    away = View(view.eye, tuple(2 * e - t for e, t in zip(view.eye, view.target)), width=160, height=90)
    with pytest.raises(NothingInViewError, match="beyond the terrain's southern border, and looks towards"):
        cpu.draw(Scene.of(ground, away))
    x, y = (float(v) for v in ground.grid.xy(40, 30))
    with pytest.raises(NothingInViewError, match="above or under its area"):
        cpu.draw(Scene.of(ground, View((x, y, 5000), (x, y, 6000), width=160, height=90)))


def test_nothing_valid_is_an_error():
    ground = terrain(np.full((50, 40), np.nan, np.float32))
    x, y = (float(v) for v in ground.grid.xy(20, 25))
    for projection in ("perspective", "plan"):
        with pytest.raises(NothingInViewError):
            cpu.draw(Scene.of(ground, View((x, y, 500), (x, y, 0), width=160, height=90, projection=projection)))


def test_a_hole_in_view_is_no_picture():
    """Only missing ground in view: its hatching alone would be a picture of nothing."""
    heights = hills()
    heights[20:40, 30:60] = np.nan
    ground = terrain(heights)
    x, y = (float(v) for v in ground.grid.xy(45, 30))
    with pytest.raises(NothingInViewError):
        cpu.draw(Scene.of(ground, View((x, y, 1500), (x, y, 0), fov_y=5, width=160, height=90)))


# ---- the same picture whatever the way -------------------------------------------------------------------------------


def test_threads_do_not_change_a_bit():
    ground = terrain(holes(hills()))
    for projection in ("perspective", "plan"):
        view = camera.whole(ground, SIZE) if projection == "perspective" else camera.plan(ground, SIZE)
        for sky in (False, True):
            one, two = (cpu.draw(Scene.of(ground, view, sky=sky, jobs=jobs)) for jobs in (1, 2))
            np.testing.assert_array_equal(one.pixels, two.pixels)
            np.testing.assert_array_equal(one.depth, two.depth)


@pytest.mark.stress
def test_threads_do_not_change_a_bit_of_a_store_seen_through_windows(tmp_path):
    """Levels of detail, missing data, water cut by the view: each picture from a store opened anew."""
    heights = holes(hills(900, 1100, tall=300), part=0.0005)
    heights[500:700, 300:800] = 420.25
    memory = terrain(heights)
    store.build(store.ArraySource(memory.heights, memory.grid, memory.name), tmp_path / "a.oro").close()
    x, y = (float(v) for v in memory.grid.xy(550, 640))
    views = [camera.whole(memory, SIZE, pitch=20), View((x, y - 9000, 2500), (x, y, 420), width=160, height=90)]
    for view in views:
        pictures = []
        for jobs in (1, 2, 5):
            with store.open(tmp_path / "a.oro") as stored:
                pictures.append(cpu.draw(Scene.of(stored, view, sun=Sun(300, 20), sky=True, tolerance=1.0, jobs=jobs)))
        assert len({w["level"] for w in pictures[0].facts["windows"]}) > 1
        for other in pictures[1:]:
            np.testing.assert_array_equal(other.pixels, pictures[0].pixels)
            np.testing.assert_array_equal(other.depth, pictures[0].depth)


def test_more_samples_change_edges_only():
    ground = terrain(hills())
    view = camera.whole(ground, SIZE, pitch=15)
    scene = Scene.of(ground, view, sun=Sun(300, 20), samples=1)
    rough = cpu.draw(scene)
    smooth = cpu.draw(scene.but(samples=8))
    changed = (rough.pixels != smooth.pixels).any(-1)
    assert not changed[~cpu.find_edges(rough.pixels)].any()
    assert changed.sum() > 100
    np.testing.assert_array_equal(rough.depth, smooth.depth)
    # The truth is the mean over many rays in every pixel: a picture eight times as large, shrunk in linear light.
    large = cpu.draw(scene.but(view=view.resized(8 * 160, 8 * 90)))
    truth = linear(large).reshape(90, 8, 160, 8, 3).mean((1, 3))
    before, after = (np.abs(linear(p) - truth)[changed].mean() for p in (rough, smooth))
    assert after < 0.45 * before


def test_edges_by_hand():
    picture = np.zeros((5, 6, 3), np.uint8)
    picture[2, 3, 1] = cpu.EDGE + 1
    expected = np.zeros((5, 6), bool)
    expected[2, 2:5] = expected[1:4, 3] = True
    np.testing.assert_array_equal(cpu.find_edges(picture), expected)
    picture[2, 3, 1] = cpu.EDGE
    assert not cpu.find_edges(picture).any()


def test_sample_positions_are_spread_evenly():
    for n in (4, 16, 64):
        at = cpu.pattern(n)
        assert at.shape == (n, 2) and (at >= 0).all() and (at < 1).all()
        np.testing.assert_allclose(at.mean(0), 0.5, atol=0.6 / n)
        for axis in (0, 1):  # every strip of a pixel gets its share
            assert np.abs(np.histogram(at[:, axis], 4, (0, 1))[0] - n / 4).max() <= 1 + n / 16


def test_a_store_gives_the_same_picture(tmp_path):
    heights = holes(hills(300, 420, tall=300))
    memory = terrain(heights)
    source = store.ArraySource(memory.heights, memory.grid, memory.name)
    with store.build(source, tmp_path / "a.oro") as stored:
        view = camera.whole(memory, SIZE)
        np.testing.assert_array_equal(camera.whole(stored, SIZE).eye, view.eye)
        for tolerance in (None, 0.5):
            a = cpu.draw(Scene.of(memory, view, tolerance=tolerance))
            b = cpu.draw(Scene.of(stored, view, tolerance=tolerance))
            np.testing.assert_array_equal(a.pixels, b.pixels)
            np.testing.assert_array_equal(a.depth, b.depth)


@pytest.mark.cases(1)
@pytest.mark.parametrize("tolerance", [0.5, 2.0])
def test_level_of_detail_keeps_its_tolerance(tolerance):
    """The surface drawn may be displaced by ``tolerance`` pixels, no more: where it is hit, some exact depth is found
    within as many pixels of there."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:1300, :1100]
    heights = (900 + 500 * np.sin(x / 170) * np.cos(y / 130) + rng.normal(0, 4, x.shape)).astype(np.float32)
    ground = terrain(heights)
    assert ground.levels == 4
    view = camera.whole(ground, SIZE, pitch=25)
    exact = cpu.draw(Scene.of(ground, view, tolerance=0.0, **BARE))
    coarse = cpu.draw(Scene.of(ground, view, tolerance=tolerance, **BARE))
    assert len(exact.facts["windows"]) == 1 and exact.facts["windows"][0]["level"] == 0
    assert any(w["level"] > 0 for w in coarse.facts["windows"])
    assert coarse.facts["tolerance_px"] == tolerance
    drawn = sum(w["rows"] * w["cols"] for w in coarse.facts["windows"])
    assert drawn < 0.7 * heights.size
    # On the exact picture, the range of depths within the tolerance (rounded up to pixels) around every pixel.
    k = math.ceil(tolerance)
    padded = np.pad(np.where(np.isfinite(exact.depth), exact.depth, np.inf), k, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (2 * k + 1, 2 * k + 1)).reshape(90, 160, -1)
    low, high = around.min(-1), around.max(-1)
    hit = np.isfinite(coarse.depth)
    slack = 1e-3 * coarse.depth[hit]
    assert ((coarse.depth[hit] >= low[hit] - slack) & (coarse.depth[hit] <= high[hit] + slack)).mean() > 0.999
    assert np.isfinite(low[hit]).all()  # no ground where there is none within the tolerance
    assert (hit | ~np.isfinite(around).all(-1)).all()  # and none lost


def test_little_memory_loosens_the_tolerance_and_says_so():
    from orograph.progress import Progress

    class Heard(Progress):
        def __init__(self):
            self.warnings = []

        def warn(self, text):
            self.warnings.append(text)

    ground = terrain(np.random.default_rng(0).normal(500, 60, (1800, 1800)).astype(np.float32))
    view = camera.whole(ground, SIZE)
    heard = Heard()
    picture = cpu.draw(Scene.of(ground, view, max_memory=8 << 20, **BARE), heard)
    assert picture.facts["tolerance_px"] > 0
    assert any("instead of 0: more would not fit" in text for text in heard.warnings)
    # Heights, their pyramids, and what holds them while they are put together.
    assert sum(w["rows"] * w["cols"] for w in picture.facts["windows"]) * (4 * 17 / 12 + 4) <= LEAST_MEMORY


# ---- light -----------------------------------------------------------------------------------------------------------


def sunlit(heights, sun, transform=NORTH_UP, **options):
    """Linear colours in the middle of a plan of ``heights`` and the picture's depth."""
    ground = terrain(heights, transform)
    scene = Scene.of(ground, camera.plan(ground, SIZE), sun=sun, colormap="grey", **{**BARE, **options})
    picture = cpu.draw(scene)
    return linear(picture), picture


def plane(east, north, rows=90, cols=160, transform=NORTH_UP):
    """A plane that rises by so much per metre to the east and to the north."""
    r, c = np.mgrid[:rows, :cols].astype(np.float64)
    a, b, _, d, e, _ = transform[:6]
    return (1000 + east * (a * c + b * r) + north * (d * c + e * r)).astype(np.float32)


@pytest.mark.parametrize("transform", [NORTH_UP, RECTANGULAR, ROTATED], ids=["square", "rectangular", "rotated"])
def test_direct_light_is_lamberts(transform, monkeypatch):
    """With the sky switched off, brightness is albedo · cos(angle between sun and normal), up to one factor."""
    monkeypatch.setattr("orograph.rendering.palette.AMBIENT", 0.0)
    monkeypatch.setattr("orograph.rendering.cpu.shading.BOUNCE", 0.0)
    monkeypatch.setitem(TINTS, "grey", [(0.0, "#808080"), (1.0, "#808080")])
    for azimuth, altitude in ((315, 45), (100, 30)):
        a, h = math.radians(azimuth), math.radians(altitude)
        sun = np.array([math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)])
        level, _ = sunlit(plane(0, 0), Sun(azimuth, altitude), transform, shadows=False)
        for east, north, exaggeration in ((0.4, 0, 1), (0, 0.4, 1), (-0.3, 0.2, 1), (0.1, -0.15, 3), (1.2, 1.2, 1)):
            tilted, _ = sunlit(
                plane(east, north, transform=transform), Sun(azimuth, altitude), transform, shadows=False,
                exaggeration=exaggeration,
            )  # fmt: skip
            normal = np.array([-east * exaggeration, -north * exaggeration, 1.0])
            expected = max(normal @ sun / np.linalg.norm(normal), 0) / sun[2]
            got = tilted[45, 80] / level[45, 80]
            np.testing.assert_allclose(got, expected, rtol=0.02, atol=0.005)


def test_level_ground_in_the_sun_has_the_color_of_the_legend():
    heights = np.full((90, 160), 300, np.float32)
    heights[:, 80:] = 900  # two levels, so that the tint has a span; the cliff is in the middle
    ground = terrain(heights)
    for name in ("alpine", "grey", "viridis"):
        scene = Scene.of(ground, camera.plan(ground, SIZE), sun=Sun(90, 45), colormap=name, shadows=False, **BARE)
        picture = cpu.draw(scene)
        table = np.round(linear_to_srgb(elevation_table(name, 300.0, 900.0)) * 255)
        for place, color in (((45, 25), table[0]), ((45, 135), table[-1])):
            if srgb_to_linear(color / 255).max() < 0.8:  # brighter colours are bent by the shoulder, as documented
                np.testing.assert_allclose(picture.pixels[place], color, atol=1.5)


def test_relief_is_strengthened_for_shading_only(monkeypatch):
    monkeypatch.setitem(TINTS, "grey", [(0.0, "#808080"), (1.0, "#808080")])
    ground = terrain(hills(tall=10))
    view = camera.plan(ground, SIZE)
    plain = cpu.draw(Scene.of(ground, view, colormap="grey", water=None, samples=1, relief=1.0))
    drawn = cpu.draw(Scene.of(ground, view, colormap="grey", water=None, samples=1))
    assert drawn.facts["shader"]["relief"] > 1.5 and plain.facts["shader"]["relief"] == 1
    np.testing.assert_array_equal(plain.depth, drawn.depth)
    assert linear(drawn)[10:-10, 30:-30].std() > 1.3 * linear(plain)[10:-10, 30:-30].std()


def wall(height=300.0, rows=80, cols=400):
    """A plain with a plateau in the east, that drops between two columns."""
    heights = np.zeros((rows, cols), np.float32)
    heights[:, 300:] = height
    return heights


@pytest.mark.parametrize("exaggeration", [1.0, 2.0])
def test_a_shadow_ends_where_the_sun_comes_over_the_wall(exaggeration):
    """Sun in the east at altitude h: the shadow of a wall of height H reaches H / tan h to its west."""
    spacing, height = 30.0, 300.0
    ground = terrain(wall(height))
    for altitude in (10.0, 25.0):
        view = camera.plan(ground, (800, 100))
        sun = Sun(90, altitude, 0.0)
        picture = cpu.draw(Scene.of(ground, view, sun=sun, exaggeration=exaggeration, colormap="grey", **BARE))
        bright = linear(picture)[50].mean(-1)
        x = view.target[0] + (np.arange(800) + 0.5 - 400) * view.pixel_metres
        foot = ground.grid.xy(299, 0)[0]
        edge = ground.grid.xy(300, 0)[0]
        plain = np.isfinite(picture.depth[50]) & (x < foot - 2 * spacing)
        level = (bright[plain].min() + bright[plain].max()) / 2
        dark = x[plain][bright[plain] < level]
        length = height * exaggeration / math.tan(math.radians(altitude))
        assert dark.min() == pytest.approx(edge - length, abs=view.pixel_metres)
        assert (np.diff(dark) < 1.5 * view.pixel_metres).all()  # one shadow, without holes
        lit = Scene.of(ground, view, sun=sun, exaggeration=exaggeration, colormap="grey", shadows=False, **BARE)
        assert linear(cpu.draw(lit))[50][plain].min() > level


def test_a_penumbra_is_as_wide_as_the_suns_disc_makes_it():
    """The sun's disc, diameter d, sinks behind the wall between H / tan(h + d/2) and H / tan(h − d/2); in between the
    brightness falls as the area of the disc's segment does."""
    height, altitude, diameter = 300.0, 20.0, 12.0
    ground = terrain(wall(height))
    view = camera.plan(ground, (800, 100))
    picture = cpu.draw(Scene.of(ground, view, sun=Sun(90, altitude, diameter), colormap="grey", **BARE))
    bright = linear(picture)[50].mean(-1)
    x = view.target[0] + (np.arange(800) + 0.5 - 400) * view.pixel_metres
    distance = ground.grid.xy(300, 0)[0] - x
    use = np.isfinite(picture.depth[50]) & (distance > 100)
    angle = np.degrees(np.arctan(height / distance[use]))
    s = np.clip((angle - altitude) / (diameter / 2), -1, 1)
    seen = (np.arccos(s) - s * np.sqrt(1 - s * s)) / np.pi
    low, high = bright[use][seen == 0].max(), np.median(bright[use][seen == 1])
    assert ((seen > 0.02) & (seen < 0.98)).sum() > 15
    np.testing.assert_allclose((bright[use] - low) / (high - low), seen, atol=0.06)


def test_a_sun_below_the_horizon_leaves_light_of_the_sky():
    ground = terrain(hills())
    day = cpu.draw(Scene.of(ground, camera.plan(ground, SIZE), sun=Sun(200, 40)))
    night = cpu.draw(Scene.of(ground, camera.plan(ground, SIZE), sun=Sun(200, -10)))
    hit = np.isfinite(day.depth)
    assert 5 < night.pixels[hit].mean() < 0.7 * day.pixels[hit].mean()


# ---- colour ----------------------------------------------------------------------------------------------------------


def test_flat_sea_is_water_and_hills_are_not():
    heights = hills(90, 160, tall=60)
    heights[:, :60] = 0
    ground = terrain(heights)
    view = camera.plan(ground, SIZE)
    picture = cpu.draw(Scene.of(ground, view, samples=1))
    wet = picture.pixels[45, 30].astype(int)
    assert wet[2] > wet[0] + 15  # blue
    assert picture.facts["shader"]["water_fraction"] == pytest.approx(60 / 160, abs=0.01)
    x = view.target[0] + (np.arange(160) + 0.5 - 80) * view.pixel_metres
    col = ground.grid.index(x, np.full(160, view.target[1]))[0]
    row = picture.pixels[45].astype(int)
    blue = row[:, 2] > row[:, 0] + 15
    assert blue[(col >= 0) & (col < 58)].all() and not blue[(col > 61) & (col < 159)].any()
    dry = cpu.draw(Scene.of(ground, view, samples=1, water=None)).pixels[45].astype(int)
    assert not (dry[:, 2] > dry[:, 0] + 15)[(col >= 0) & (col < 159)].any()


def test_a_given_water_level():
    heights = plane(0.1, 0)  # rises to the east, 1000 to 1477 m
    ground = terrain(heights)
    view = camera.plan(ground, SIZE)
    picture = cpu.draw(Scene.of(ground, view, samples=1, water=1200.0))
    hit = np.isfinite(picture.depth)
    z = view.eye[2] - picture.depth
    p = picture.pixels.astype(int)
    blue = p[..., 2] > p[..., 0] + 15
    assert blue[hit & (z < 1195)].all() and not blue[hit & (z > 1205)].any()


def test_a_shore_seen_from_near_is_crisp_and_follows_the_ground():
    """Samples of 30 m drawn 60 pixels wide: the shore of a given level is the contour, a pixel or two wide."""
    heights = plane(0.1, 0.03)
    ground = terrain(heights)
    x, y = (float(v) for v in ground.grid.xy(62, 45))
    half = math.degrees(math.atan(0.25 * 90 / 5000))  # half a metre a pixel
    view = View((x, y, 5000), (x, y, 0), (0, 1, 0), 2 * half, 160, 90, projection="plan")
    level = float(heights[45, 62])
    wet, dry = (linear(cpu.draw(Scene.of(ground, view, samples=1, relief=1.0, water=w))) for w in (level, None))
    px, py = np.meshgrid(np.arange(160) + 0.5 - 80, 45 - np.arange(90) - 0.5)
    above = 0.5 * (0.1 * px + 0.03 * py)
    changed = np.abs(wet - dry).max(-1) > 1e-3
    assert changed[above < -0.1].all() and not changed[above > 0.1].any()


def hatched(pixels):
    """Pixels of the two greys over missing data."""
    greys = np.round(linear_to_srgb(MISSING) * 255)
    return (np.abs(pixels[..., None, :] - greys) <= 1).all(-1).any(-1)


def test_hatching_only_over_enclosed_holes():
    heights = hills(90, 160)
    heights[30:50, 40:70] = np.nan  # enclosed
    heights[60:, 120:] = np.nan  # open to the border: there the terrain ends
    ground = terrain(heights)
    view = camera.plan(ground, SIZE)
    picture = cpu.draw(Scene.of(ground, view, samples=1, colormap="viridis", relief=1))
    px, py = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
    col, row = ground.grid.index(
        view.target[0] + (px - 80) * view.pixel_metres, view.target[1] - (py - 45) * view.pixel_metres
    )
    grey = hatched(picture.pixels)
    hole = (col > 39) & (col < 70) & (row > 29) & (row < 50)
    sure = hole & (np.minimum(abs(col - 39), abs(col - 70)) > 0.01) & (np.minimum(abs(row - 29), abs(row - 50)) > 0.01)
    assert grey[sure].all() and not grey[~hole].any()
    assert len(np.unique(picture.pixels[sure][:, 0])) == 2  # two greys: stripes
    assert np.isnan(picture.depth[sure]).all()  # what is measured sees the hole
    paper = picture.pixels[0, 0]
    beyond = (col > 120) & (col < 159) & (row > 60) & (row < 89)
    assert (picture.pixels[beyond] == paper).all()


def test_hatching_keeps_to_its_hole_in_perspective():
    """On the rim patch and ground coincide, and rounding must not let the patch shine through."""
    heights = hills(90, 160, tall=300)
    heights[30:50, 40:70] = np.nan
    ground, whole = terrain(heights), terrain(hills(90, 160, tall=300))
    view = camera.whole(ground, (320, 180), pitch=35)
    picture = cpu.draw(Scene.of(ground, view, samples=1, colormap="viridis", relief=1))
    grey = hatched(picture.pixels)
    full = embree_depth(whole, view)
    holed = embree_depth(ground, view)
    same = np.isfinite(holed) & (np.abs(full - holed) <= 1e-4 * full)
    assert (grey & same).sum() <= 0.002 * same.sum()  # ground in front or beside stays ground
    behind = np.isfinite(full) & ~same
    assert behind.sum() > 300 and grey[behind].mean() > 0.8  # the hole shows as such, not as what lies behind


def test_the_floor_of_a_sea_and_a_basin_on_land():
    """A tenth of the ground below the sea is a sea; less of it a basin, like Death Valley."""

    def blue(part, **options):
        heights = plane(0.05, 0, 90, 160) - 1000  # 0 to 238 m
        heights[:, : int(160 * part)] = np.linspace(-85, -20, int(160 * part))
        ground = terrain(heights)
        p = cpu.draw(Scene.of(ground, camera.plan(ground, SIZE), samples=1, **options)).pixels[45].astype(int)
        deep = p[5 + 3 : 5 + int(140 * part) - 3]
        return (deep[:, 2] > deep[:, 0] + 15).mean()

    assert blue(0.08) == 0
    assert blue(0.4) == 1
    assert blue(0.4, water=None) == 0  # no water at all was asked for
    assert blue(0.4, colormap="alpine") == 0


def test_a_sky_is_drawn_where_no_ground_is():
    ground = terrain(hills())
    view = camera.whole(ground, SIZE, pitch=5)
    paper, sky = (cpu.draw(Scene.of(ground, view, sky=sky)) for sky in (False, True))
    empty = np.isnan(paper.depth)
    assert len(np.unique(paper.pixels[:5][empty[:5]], axis=0)) == 1
    above = sky.pixels[:5][empty[:5]].astype(int)
    assert (above[:, 2] > above[:, 0]).mean() > 0.9


def test_the_shoulder_is_smooth_and_stays_below_one():
    x = np.linspace(0, 5, 5001).astype(np.float64)
    y = np.array([_shoulder(v) for v in x])
    np.testing.assert_allclose(y[x < 0.82], x[x < 0.82], atol=1e-7)
    assert (np.diff(y) >= 0).all() and y.max() <= 1
    slope = np.diff(y.astype(np.float64)) / np.diff(x)
    assert np.abs(np.diff(slope)).max() < 0.01  # no kink where it begins
