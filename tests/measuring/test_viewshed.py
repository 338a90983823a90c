"""Viewsheds: closed forms, every sample by brute force, real ground, and the same however it is held."""

from __future__ import annotations

import math

import brute
import geopandas
import numpy as np
import pytest
import rasterio
import rasterio.features
from affine import Affine
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, rough, terrain_of
from pyproj import CRS

import orograph
from orograph import store
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.measuring import line_of_sight, viewshed
from orograph.measuring.ground import heights
from orograph.measuring.paint import HIDDEN, SEEN, save_paint
from orograph.measuring.places import Places

R = 6_371_008.8


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
@pytest.mark.parametrize("curvature", [True, False])
def test_every_sample_by_brute_force(transform, curvature):
    h = rough((40, 43), 2, True)
    terrain = terrain_of(h, transform)
    ox, oy = 17.3, 21.8
    point = terrain.grid.xy(ox, oy)
    eye, target = 12.0, 3.0
    values = viewshed(terrain, point, eye, target, flat=not curvature, refraction=0.0).values()
    bend = 1 / R if curvature else 0.0
    t = np.linspace(0, 1, 1501)
    start = float(brute._height(h, np.array(ox), np.array(oy))) + eye
    checked = np.zeros(2, int)
    for r in range(40):
        for c in range(43):
            if np.isnan(h[r, c]):
                assert np.isnan(values[r, c])
                continue
            s = t * math.dist(point, terrain.grid.xy(c, r))
            z = brute._height(h, ox + t * (c - ox), oy + t * (r - oy)) - bend / 2 * s**2
            end = float(h[r, c]) + target - bend / 2 * s[-1] ** 2
            clear = start + t * (end - start) - z
            least = np.nanmin(clear[1:-1]) if np.isfinite(clear[1:-1]).any() else 1.0
            if abs(least) > 0.05:
                assert values[r, c] == (least > 0), (r, c, least)
                checked[int(least > 0)] += 1
    assert checked.min() > 100


@pytest.mark.stress
@pytest.mark.parametrize("holes", [False, True])
def test_each_sample_is_its_own_line_of_sight(holes):
    h = rough((30, 28), 11, holes)
    terrain = terrain_of(h, SQUARE, "EPSG:32611")
    for x, y in ((9.0, 14.0), (9.4, 14.0), (12.7, 20.2), (0.0, 0.0)):
        point = terrain.grid.xy(x, y)
        if np.isnan(brute._height(h, np.array(x), np.array(y))):
            continue
        seen = viewshed(terrain, point, 6.0, 2.0).values()
        needed = viewshed(terrain, point, 6.0, heights=True).values()
        for r, c in np.argwhere(np.isfinite(h)):
            if (c, r) == (x, y):
                assert seen[r, c] == 1 and needed[r, c] == 0
                continue
            if np.isnan(heights(terrain, np.array([float(c)]), np.array([float(r)]))[0]):
                continue  # a sample with no triangle: the line has no end
            sight = line_of_sight(terrain, point, terrain.grid.xy(c, r), 6.0, 2.0)
            near = sight.tightest is not None and abs(sight.tightest.clearance) < 1e-3
            assert near or sight.visible == (seen[r, c] == 1), (x, y, r, c, sight.tightest)
            assert needed[r, c] == pytest.approx(sight.needed, abs=5e-3, rel=1e-3)


def test_behind_a_wall_the_ground_is_hidden_up_to_where_the_line_over_its_top_comes_down():
    h = np.zeros((21, 300), np.float32)
    h[:, 40] = 6.0
    terrain = terrain_of(h)
    values = viewshed(terrain, terrain.grid.xy(0.0, 10.0), 10.0, flat=True).values()
    # Over the wall's top, 4 m down in 40 samples, the line reaches the ground after 100.
    row = values[10]
    assert (row[:41] == 1).all() and (row[41:100] == 0).all() and (row[100:] == 1).all()
    needed = viewshed(terrain, terrain.grid.xy(0.0, 10.0), 10.0, flat=True, heights=True).values()[10]
    c = np.arange(300)
    expected = np.where((c > 40) & (c < 100), 10 - c / 10.0, 0.0)
    np.testing.assert_allclose(needed, expected, atol=1e-3)
    # The wall is straight: what it hides ends at the same column in every row from which it is crossed.
    assert (values[:, 42:99] == 0).all() and (values[:, 102:] == 1).all()


def test_a_cone_from_its_top_and_from_its_foot():
    slope, top = 0.5, 1000.0
    terrain = of_function((81, 81), lambda x, y: top - slope * np.hypot(x - 501_215, y - 3_998_785))
    from_top = viewshed(terrain, (501_215, 3_998_785), 2.0, flat=True).values()
    assert (from_top == 1).all()
    # From the foot, 900 m from the axis and e above the ground, the seen side lies before the line of contact of the
    # tangent planes: ground at azimuth φ from the eye's is seen where d cos φ > d − e/slope, the others are behind it.
    d, eye = 900.0, 20.0
    values = viewshed(terrain, (501_215 - d, 3_998_785), eye, flat=True).values()
    x, y = terrain.grid.xy(*np.meshgrid(np.arange(81), np.arange(81)))
    u, v = x - 501_215, y - 3_998_785
    cosine = -u / np.maximum(np.hypot(u, v), 1e-9)
    limit = (d - eye / slope) / d
    near = np.hypot(u, v) < 150  # the triangulated top is blunt
    assert (values[(cosine > limit + 0.02) & ~near] == 1).all()
    # Not before the contact: of a convex cone only ground at the eye's own level and beyond the contact is hidden.
    assert (values[(cosine < limit - 0.02) & ~near] == 0).all()


@pytest.mark.parametrize("target", [0.0, 3.0])
def test_at_sea_a_disc_is_seen(target):
    terrain = terrain_of(np.zeros((301, 301)), Affine(100, 0, 0, 0, -100, 0))
    eye = 4.0
    shed = viewshed(terrain, (15_050, -15_050), eye, target)
    y, x = np.mgrid[:301, :301]
    distance = 100 * np.hypot(x - 150, y - 150)
    horizon = math.sqrt(2 * R / 0.87 * eye) + math.sqrt(2 * R / 0.87 * target)
    values = shed.values()
    assert (values[distance < horizon - 150] == 1).all() and (values[distance > horizon + 150] == 0).all()
    flat = viewshed(terrain, (15_050, -15_050), eye, target, flat=True).values()
    assert (flat == 1).all()


def test_on_a_ball_with_true_curvature_it_is_the_horizon_too():
    # A ball of 20 km modelled in heights, without curvature of the body: seen as far as the tangent plane's contact.
    radius, eye = 20_000.0, 30.0
    terrain = of_function(
        (161, 161), lambda x, y: np.sqrt(radius**2 - (x - 501_200) ** 2 - (y - 3_998_800) ** 2) - radius,
        Affine(15, 0, 499_992.5, 0, -15, 4_000_007.5),
    )  # fmt: skip
    values = viewshed(terrain, (501_200, 3_998_800), eye, flat=True).values()
    y, x = np.mgrid[:161, :161]
    distance = 15 * np.hypot(x - 80, y - 80)
    contact = radius * math.sin(math.acos(radius / (radius + eye)))
    assert contact == pytest.approx(1094, abs=1)
    assert (values[distance < contact - 25] == 1).all() and (values[distance > contact + 25] == 0).all()


@pytest.mark.stress
def test_real_ground_against_lines_of_sight(shared_data):
    with rasterio.open(next((shared_data / "bigtujunga-srtm30m-utm").glob("*.tif"))) as file:
        h = file.read(1, window=((100, 400), (200, 600))).astype(np.float32)
        transform, crs = file.window_transform(((100, 400), (200, 600))), CRS.from_wkt(file.crs.to_wkt())
    terrain = store.MemoryTerrain(h, Grid(h.shape, transform, crs), "real")
    point = np.array(terrain.grid.xy(201.3, 148.9))
    values = viewshed(terrain, point, 1.7).values()
    assert 0.02 < np.nanmean(values) < 0.5
    rng = np.random.default_rng(0)
    for r, c in rng.integers(0, (300, 400), (700, 2)):
        sight = line_of_sight(terrain, point, terrain.grid.xy(c, r), 1.7)
        near = sight.tightest is not None and abs(sight.tightest.clearance) < 1e-3
        assert near or sight.visible == (values[r, c] == 1), (r, c)


def test_it_does_not_depend_on_how_it_is_held(tmp_path):
    h = rough((600, 560), 3, True)
    memory = terrain_of(h, SQUARE, "EPSG:32611")
    stored = store.build(store.ArraySource(h, memory.grid, "ground"), tmp_path / "g.oro")
    point = memory.grid.xy(301.0, 222.5)
    first = viewshed(memory, point, 300.0, jobs=1)
    values = first.values()
    assert not first.on_disk and np.nanmean(values) > 0.02
    disk = viewshed(stored, point, 300.0, jobs=2, max_memory=1 << 20)
    assert disk.on_disk
    np.testing.assert_array_equal(disk.values(), values)
    near = viewshed(stored, point, 300.0, radius=4000.0)
    rows, cols = near.grid.shape
    assert rows < 300 and cols < 300
    part = values[near.row : near.row + rows, near.col : near.col + cols]
    y, x = np.mgrid[near.row : near.row + rows, near.col : near.col + cols]
    points = np.stack(memory.grid.xy(x.ravel(), y.ravel()), axis=-1)
    places = Places(memory)
    there, here = places.geodetic(points), places.geodetic(np.array([point]))[0]
    metres = places.geod.inv(*(np.full(len(points), v) for v in here), *there.T)[2].reshape(rows, cols)
    found = near.values()
    assert np.isnan(found[metres > 4000.01]).all()
    inside = metres < 3999.99
    np.testing.assert_array_equal(found[inside], part[inside])
    assert inside[0].any() or metres[0].min() - 4000 < 61  # the window is no larger than it needs to be


def test_in_a_stretched_projection_distances_are_true():
    # Web Mercator at 60°: what looks 240 km away is 120 km away, and more so to the south than to the north.
    transform = Affine(1500, 0, 700_000, 0, -1500, 8_700_000)
    terrain = terrain_of(np.zeros((401, 401)), transform, "EPSG:3857")
    shed = viewshed(terrain, (1_000_000, 8_400_000), 1000.0)
    values = shed.values()
    y, x = np.mgrid[:401, :401]
    places = Places(terrain)
    points = np.stack(terrain.grid.xy(x.ravel(), y.ravel()), axis=-1)
    there, here = places.geodetic(points), places.geodetic(np.array([shed.point]))[0]
    metres = places.geod.inv(*(np.full(len(points), v) for v in here), *there.T)[2].reshape(401, 401)
    horizon = math.sqrt(2 * 1000.0 / shed.bend)
    assert 115e3 < horizon < 125e3 and metres[[0, -1]].min() > 135e3
    assert (values[metres < horizon - 800] == 1).all() and (values[metres > horizon + 800] == 0).all()


def test_files(tmp_path):
    h = rough((300, 290), 3, True)
    terrain = terrain_of(h, SQUARE, "EPSG:32611")
    shed = viewshed(terrain, terrain.grid.xy(150.0, 140.0), 25.0, radius=3000.0)
    told = shed.save(tmp_path / "seen.tif")
    values = shed.values()
    with rasterio.open(tmp_path / "seen.tif") as file:
        np.testing.assert_array_equal(file.read(1), values)
        assert file.descriptions == ("visible",) and np.isnan(file.nodata) and file.crs.to_epsg() == 32611
        assert file.tags()["eye_height"] == "25 m" and file.tags()["refraction"] == "0.130"
        assert tuple(file.transform)[:6] == tuple(shed.grid.transform)[:6]
    assert told["seen"] == (values == 1).sum() and told["samples"] == np.isfinite(values).sum()
    save_paint(shed, shed.blocks(), tmp_path / "paint.tif")
    with rasterio.open(tmp_path / "paint.tif") as file:
        paint = file.read().transpose(1, 2, 0)
        assert [c.name for c in file.colorinterp] == ["red", "green", "blue", "alpha"]
    assert (paint[values == 1] == SEEN).all() and (paint[values == 0] == HIDDEN).all()
    assert (paint[np.isnan(values)][:, 3] == 0).all()


def test_a_large_image_is_made_of_means(tmp_path, monkeypatch):
    monkeypatch.setattr("orograph.measuring.paint.MOST", 10_000)
    terrain = terrain_of(rough((300, 290), 3), SQUARE, "EPSG:32611")
    shed = viewshed(terrain, terrain.grid.xy(150.0, 140.0), 25.0)
    save_paint(shed, shed.blocks(), tmp_path / "paint.tif")
    seen = shed.values()
    with rasterio.open(tmp_path / "paint.tif") as file:
        assert file.shape == (75, 73) and file.transform.a == 120
        alpha = file.read(4)
    mean = seen[:300, :288].reshape(75, 4, 72, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(alpha[:, :72], HIDDEN[3] + mean * (SEEN[3] - HIDDEN[3]), atol=0.51)


def test_nonsense_is_refused():
    h = np.zeros((20, 20), np.float32)
    h[5:9, 5:9] = np.nan
    terrain = terrain_of(h)
    at = terrain.grid.xy(12.0, 12.0)
    for point, options, says in (
        (terrain.grid.xy(6.5, 6.5), {}, "in a hole"),
        ((0, 0), {}, "of ground, whose surface"),
        (at, {"eye": -1.0}, "eye's height"),
        (at, {"radius": 0.0}, "radius"),
        (at, {"refraction": 2.0}, "refraction"),
        (at, {"heights": True, "target": 1.0}, "no meaning"),
        ([at, at], {}, "one point"),
    ):
        with pytest.raises(UsageError, match=says):
            viewshed(terrain, point, **options)


def test_measures_are_silenced_as_all_functions_are(recwarn):
    ground = orograph.terrain(np.add.outer(np.arange(30.0), np.arange(40.0)), spacing=10.0, progress=False)
    seen = orograph.measure.viewshed(ground, ground.grid.xy(20.0, 15.0), progress=False)
    assert seen.values(progress=False).shape == (30, 40)
    assert orograph.measure.area(ground, [(50, 50), (250, 50), (250, 200)], progress=False).surface > 0


@pytest.mark.parametrize("ending", [".gpkg", ".geojson"])
@pytest.mark.parametrize("transform", [SQUARE, ROTATED])
def test_polygons_are_the_cells_that_are_seen(tmp_path, transform, ending):
    terrain = terrain_of(rough((60, 64), 5, True), transform, "EPSG:32611")
    shed = viewshed(terrain, terrain.grid.xy(30.0, 31.0), 8.0)
    seen = shed.values() > 0
    told = shed.save(tmp_path / f"seen{ending}")
    assert told == shed.summary() and told["seen"] == seen.sum() > 0
    found = geopandas.read_file(tmp_path / f"seen{ending}")
    assert found.geom_type.eq("Polygon").all() and found.is_valid.all() and len(found) > 5
    assert found.grid_m2.sum() == pytest.approx(told["seen_grid_m2"], rel=1e-9)
    back = found.to_crs("EPSG:32611").geometry
    a = shed.grid.transform
    again = rasterio.features.rasterize(back, seen.shape, transform=a)
    np.testing.assert_array_equal(again, seen)
    if ending == ".geojson":  # as RFC 7946 wants it
        turns = [part.exterior.is_ccw and not any(ring.is_ccw for ring in part.interiors) for part in found.geometry]
        assert all(turns)


def test_what_a_viewshed_cannot_be_written_as(tmp_path):
    terrain = terrain_of(np.full((30, 30), 5.0, np.float32), SQUARE)
    for needed, name, problem in (
        (False, "a.png", "polygons"),
        (True, "a.gpkg", "raster"),
        (False, "a.geojson", "CRS"),
    ):
        shed = viewshed(terrain, terrain.grid.xy(3, 3), heights=needed)
        with pytest.raises(UsageError, match=problem):
            shed.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
