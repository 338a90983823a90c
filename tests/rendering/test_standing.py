"""Things that stand on the ground: the kernels against Embree and closed forms, and what is seen of them."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.points import read_points
from orograph.geovis.data.standing import Kind, Things
from orograph.geovis.keys import Legend
from orograph.rendering import standing_kernels as kernels
from orograph.rendering.standing import stand
from orograph.scene.scene import Scene

UTM = "EPSG:32630"


def ground(rows=60, cols=80, ridge=False):
    heights = np.zeros((rows, cols), np.float32)
    if ridge:
        heights[rows // 2] = 400
    return orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, 10, 10), crs=UTM)


def thing(kind, x, y, radius=20.0, height=60.0):
    one = np.ones(1)
    return Things(
        np.array([kind], np.int8), x * one, y * one, 0 * one, radius * one, height * one,
        np.array([[1.0, 0.0, 0.0]], np.float32), one, Legend(),
    )  # fmt: skip


def rays(count, around, seed=0):
    """Origins on a sphere around a place, towards points near it."""
    rng = np.random.default_rng(seed)
    out = rng.normal(size=(count, 3))
    out *= 200 / np.linalg.norm(out, axis=1)[:, None]
    return out + around, rng.uniform(-60, 60, (count, 3)) - out


def test_tubes_meet_what_embree_meets():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    radius, long, place = 18.0, 60.0, np.array([3.0, -5.0, 11.0])
    solid = trimesh.creation.capsule(height=long, radius=radius, count=[96, 96])
    solid.apply_translation([0, 0, -solid.bounds[0][2] - radius])  # from the origin along z
    turn = trimesh.transformations.rotation_matrix(1.1, [1, 2, 0.5])
    solid.apply_transform(turn)
    solid.apply_translation(place)
    end = turn[:3, :3] @ [0, 0, long]
    o, d = rays(4000, place + end / 2)
    met, which, _ = RayMeshIntersector(solid).intersects_location(o, d, multiple_hits=False)
    true = np.full(len(o), np.inf)
    true[which] = np.linalg.norm(met - o[which], axis=1) / np.linalg.norm(d[which], axis=1)
    found = np.array([kernels._tube(tuple(a), tuple(b), tuple(place), tuple(end), radius) for a, b in zip(o, d)])
    same = np.isfinite(found[:, 0]) == np.isfinite(true)
    assert same.mean() > 0.995
    both = np.isfinite(found[:, 0]) & np.isfinite(true)
    assert both.sum() > 500
    off = np.abs(found[both, 0] - true[both]) * np.linalg.norm(d[both], axis=1)
    assert np.quantile(off, 0.98) < 0.2
    np.testing.assert_allclose(np.linalg.norm(found[both, 1:], axis=1), 1, atol=1e-9)
    assert (np.einsum("ij,ij->i", found[both, 1:], d[both]) < 1e-6).all()


def test_walls_are_hit_between_their_ends_and_their_heights():
    rng = np.random.default_rng(4)
    place, end, height = np.array([5.0, -3.0, 2.0]), np.array([40.0, 25.0, 12.0]), 30.0
    o, d = rays(3000, place + end / 2)
    hits = 0
    for a, b in zip(o, d):
        t, *normal = kernels._wall(tuple(a), tuple(b), tuple(place), tuple(end), height)
        # Cramer's rule for a + t b = place + s end + w up.
        s_true = np.linalg.solve(np.stack([-b, end, [0, 0, 1.0]], 1), a - place)
        inside = 0 <= s_true[1] <= 1 and 0 <= s_true[2] <= height
        assert np.isfinite(t) == inside
        if inside:
            hits += 1
            assert t == pytest.approx(s_true[0], rel=1e-9)
            assert np.dot(normal, b) < 0 and abs(np.dot(normal, end * [1, 1, 0])) < 1e-9
    assert hits > 100, rng


def track(coordinates, **properties):
    feature = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": coordinates},
               "properties": properties}  # fmt: skip
    return {"type": "FeatureCollection", "features": [feature], "crs": {"type": "name", "properties": {"name": UTM}}}


@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
@pytest.mark.parametrize("style", ["tubes", "curtains", "in the air"])
def test_lines_stand_where_they_are(style, exaggeration):
    terrain = ground()
    z = [100.0 / exaggeration] if style == "in the air" else []
    line = track([[500_200.0, 5_599_700.0, *z], [500_600.0, 5_599_700.0, *z]], speed=3.0)
    data = Dataset(line, style="tubes" if z else style, size=40.0)
    view = orograph.camera.around(terrain, (300, 200), azimuth=180, pitch=20, distance=None)
    scene = Scene.of(terrain, view, exaggeration=exaggeration, samples=4, data=data)
    bare = orograph.render(terrain, view, exaggeration=exaggeration)
    stood = stand(scene.theme.things, bare.pixels, bare.depth, scene)
    rows, cols = np.nonzero(stood.which >= 0)
    low = 80.0 if z else 0.0
    ends, _ = view.project(
        [[x, 5_599_700, up / exaggeration] for x in (500_200, 500_600) for up in (low, low + 40)], exaggeration
    )
    assert cols.min() == pytest.approx(ends[:, 0].min(), abs=8 if style != "curtains" else 2)
    assert cols.max() == pytest.approx(ends[:, 0].max(), abs=8 if style != "curtains" else 2)
    assert rows.min() == pytest.approx(ends[:, 1].min(), abs=4)
    assert rows.max() == pytest.approx(ends[:, 1].max(), abs=4)
    assert set(scene.theme.things.values) == {3.0}
    both = np.isfinite(stood.depth) & (stood.which >= 0)
    assert (stood.depth[both] <= bare.depth[both] + 1e-3).mean() > 0.98 or z


def test_what_a_ridge_hides_of_a_curtain_is_hidden():
    view = orograph.camera.around(ground(), (300, 200), azimuth=180, pitch=10, distance=None)
    seen = []
    for ridge in (False, True):
        terrain = ground(ridge=ridge)
        data = Dataset(track([[500_200.0, 5_599_850.0], [500_600.0, 5_599_850.0]], v=1.0), style="curtains", size=60.0)
        scene = Scene.of(terrain, view, data=data)
        bare = orograph.render(terrain, view)
        seen.append(int((stand(scene.theme.things, bare.pixels, bare.depth, scene).which >= 0).sum()))
    assert seen[0] > 500 and seen[1] == 0


def test_tracks_have_their_heights_as_values_and_their_legend():
    terrain = ground()
    line = track([[500_100.0, 5_599_700.0, 50], [500_400.0, 5_599_600.0, 150], [500_700.0, 5_599_500.0, 250]], kind="a")
    view = orograph.camera.whole(terrain, (300, 200))
    things = Scene.of(terrain, view, data=Dataset(line, variable="z", style="tubes")).theme.things
    assert things.values.tolist() == [100.0, 200.0]
    picture = orograph.render(terrain, view, data=Dataset(line, variable="z", style="tubes"), furniture=True)
    assert "z, " in picture.facts["description"] and "1 line" in picture.facts["description"]
    assert "places" not in picture.facts["description"]
    named = Scene.of(terrain, view, data=Dataset(line, variable="kind", style="curtains")).theme.things.legend
    assert [words for words, _ in named.classes] == ["a"]
    flat = track([[500_100.0, 5_599_700.0], [500_400.0, 5_599_600.0]], v=1.0)
    with pytest.raises(UsageError, match="no heights"):
        Scene.of(terrain, view, data=Dataset(flat, variable="z", style="tubes"))
    with pytest.raises(UsageError, match="no style bars of lines"):
        Scene.of(terrain, view, data=Dataset(flat, style="bars"))
    with pytest.raises(ReadError, match="No two consecutive samples of a track"):
        Scene.of(terrain, view, data=Dataset({"x": [500_100.0], "y": [5_599_700.0], "v": [1.0]}, style="tubes"))


@pytest.mark.parametrize("shape", ["box", "cone", "cylinder"])
def test_kernels_meet_what_embree_meets(shape):
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    radius, height, place = 25.0, 70.0, np.array([3.0, -5.0, 11.0])
    if shape == "box":
        solid = trimesh.creation.box(extents=(2 * radius, 2 * radius, height))
        solid.apply_translation([0, 0, height / 2])
    elif shape == "cone":
        solid = trimesh.creation.cone(radius=radius, height=height, sections=2048)
    else:
        solid = trimesh.creation.cylinder(radius=radius, height=height, sections=2048)
        solid.apply_translation([0, 0, height / 2])
    solid.apply_translation(place)
    o, d = rays(4000, place + np.array([0, 0, height / 2]))
    o, d = o[o[:, 2] > place[2]], d[o[:, 2] > place[2]]  # from above: what stands has no floor that is seen
    met, which, _ = RayMeshIntersector(solid).intersects_location(o, d, multiple_hits=False)
    true = np.full(len(o), np.inf)
    true[which] = np.linalg.norm(met - o[which], axis=1) / np.linalg.norm(d[which], axis=1)
    x, y, z = place
    if shape == "box":
        found = [
            kernels._box(tuple(a), tuple(b), (x - radius, y - radius, z), (x + radius, y + radius, z + height))
            for a, b in zip(o, d)
        ]
    else:
        tip = 0.0 if shape == "cone" else 1.0
        found = [kernels._turned(tuple(a), tuple(b), (x, y, z), radius, height, tip) for a, b in zip(o, d)]
    t = np.array([one[0] for one in found])
    floor = place[2] + 1e-3 >= (o + np.where(np.isfinite(true), true, 0)[:, None] * d)[:, 2]
    same = np.isfinite(t) == np.isfinite(true)
    assert (same | floor).mean() > 0.999
    both = np.isfinite(t) & np.isfinite(true) & ~floor
    assert both.sum() > 300
    assert np.quantile(np.abs(t - true)[both] * np.linalg.norm(d[both], axis=1), 0.999) < 0.05
    normals = np.array([one[1:] for one in found])[both]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert (np.einsum("ij,ij->i", normals, d[both]) < 1e-6).all()


def test_a_sphere_far_away_is_where_it_is():
    t, nx, _, _ = kernels._sphere((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1e7, 0.0, 0.0), 0.5)
    assert t == pytest.approx(1e7 - 0.5, abs=1e-6)
    assert nx == pytest.approx(-1)


UPRIGHT = (Kind.BAR, Kind.SPHERE, Kind.CONE, Kind.CYLINDER, Kind.FLAG)


@pytest.mark.parametrize("kind", UPRIGHT)
@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_a_thing_stands_on_its_place(kind, exaggeration):
    terrain = ground()
    view = orograph.camera.around(terrain, (300, 200), azimuth=180, pitch=20, distance=None)
    scene = Scene.of(terrain, view, exaggeration=exaggeration, samples=4)
    bare = orograph.render(terrain, view, exaggeration=exaggeration)
    x, y = 500_400.0, 5_599_700.0
    stood = stand(thing(kind, x, y), bare.pixels, bare.depth, scene)
    rows, cols = np.nonzero(stood.which >= 0)
    (foot, top), _ = view.project([[x, y, 0], [x, y, 60 / exaggeration]], exaggeration)
    assert len(rows) > (6 if kind == Kind.FLAG else 20)
    assert abs(rows.max() - foot[1]) < 12
    assert cols.min() - 1 <= foot[0] <= cols.max() + 1
    if kind != Kind.SPHERE:
        assert abs(rows.min() - top[1]) < 8
    changed = (stood.pixels != bare.pixels).any(-1)
    assert (changed & (stood.which < 0)).sum() < (2 if kind == Kind.FLAG else 0.5) * changed.sum()
    assert (stood.depth[stood.which >= 0] <= np.nan_to_num(bare.depth, nan=np.inf)[stood.which >= 0] + 1e-3).all()


def test_the_ground_hides_what_stands_behind_it():
    terrain = ground(ridge=True)
    view = orograph.View((500_400, 5_598_500, 100), (500_400, 5_599_700, 50), fov_y=30, width=200, height=150)
    scene = Scene.of(terrain, view)
    bare = orograph.render(terrain, view)
    here, behind = (stand(thing(Kind.BAR, 500_400, y), bare.pixels, bare.depth, scene) for y in (5_599_500, 5_599_900))
    assert (here.which >= 0).any()
    assert not (behind.which >= 0).any()
    np.testing.assert_array_equal(behind.pixels, bare.pixels)


def test_a_plan_shows_feet_as_they_are():
    terrain = ground()
    view = orograph.camera.plan(terrain, (400, 300))
    scene = Scene.of(terrain, view)
    bare = orograph.render(terrain, view)
    stood = stand(thing(Kind.BAR, 500_400, 5_599_700), bare.pixels, bare.depth, scene)
    area = (stood.which >= 0).sum() * view.pixel_metres**2
    assert area == pytest.approx(40 * 40, rel=0.1)


def test_slopes_do_not_cut_discs_in_a_plan():
    rows = np.arange(40.0)[:, None]
    terrain = orograph.terrain(
        np.broadcast_to(100 * rows, (40, 50)).astype(np.float32), transform=ground().grid.transform, crs=UTM
    )
    bare = orograph.render(terrain, "plan", size=(400, 300))
    disc = thing(Kind.CYLINDER, *(float(v) for v in terrain.grid.xy(25, 20)))
    stood = stand(disc, bare.pixels, bare.depth, Scene.of(terrain, bare.view))
    area = (stood.which >= 0).sum() * bare.view.pixel_metres**2
    assert area == pytest.approx(math.pi * float(disc.radius[0]) ** 2, rel=0.1)


def test_tiles_show_what_the_whole_shows():
    terrain = ground()
    view = orograph.camera.around(terrain, (240, 160), azimuth=200, pitch=30, distance=None)
    things = Things.joined([thing(kind, 500_100 + 120 * kind, 5_599_600) for kind in Kind])
    bare = orograph.render(terrain, view)
    whole = stand(things, bare.pixels, bare.depth, Scene.of(terrain, view))
    part = view.tile(64, 32, 120, 100)
    cut = np.s_[32:132, 64:184]
    tile = stand(things, bare.pixels[cut], bare.depth[cut], Scene.of(terrain, part))
    np.testing.assert_array_equal(tile.pixels, whole.pixels[cut])
    np.testing.assert_array_equal(tile.which, whole.which[cut])


def test_one_thread_draws_what_many_do():
    terrain = ground()
    view = orograph.camera.around(terrain, (240, 160), azimuth=200, pitch=30, distance=None)
    rng = np.random.default_rng(1)
    things = Things.joined([
        thing(int(k), x, y, 8, 30)
        for k, x, y in zip(rng.integers(0, 5, 60), *rng.uniform((500_050, 5_599_450), (500_750, 5_599_950), (60, 2)).T)
    ])  # fmt: skip
    bare = orograph.render(terrain, view)
    one, two = (stand(things, bare.pixels, bare.depth, Scene.of(terrain, view, jobs=jobs)) for jobs in (1, 3))
    np.testing.assert_array_equal(one.pixels, two.pixels)


def points_file(path):
    features = [
        {"type": "Feature", "properties": {"mag": m, "rms": 0.1 * m, "place": "x"},
         "geometry": {"type": "Point", "coordinates": [lon, lat, 5.0]}}
        for m, lon, lat in ((1.0, -2.9975, 50.5500), (3.0, -2.9930, 50.5485), (2.0, 10.0, 10.0))
    ]  # fmt: skip
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return str(path)


def test_points_of_geojson_and_tables_are_the_same(tmp_path):
    grid = ground().grid
    one = read_points(Dataset(points_file(tmp_path / "q.geojson"), variable="mag", uncertainty="rms"), grid)
    assert one.values.tolist() == [1.0, 3.0]
    np.testing.assert_allclose(one.sigma, [0.1, 0.3])
    table = tmp_path / "q.csv"
    table.write_text("Longitude;Latitude;mag\n-2.9975;50.55;1\n-2.993;50.5485;3\n10;10;2\n")
    two = read_points(Dataset(str(table)), grid)
    np.testing.assert_allclose(two.x, one.x)
    columns = {"x": one.x, "y": one.y, "mag": [1.0, np.nan]}
    assert read_points(Dataset(columns, variable="mag"), grid).values.tolist() == [1.0]


def test_points_of_other_vectors_are_the_same(tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    import struct

    grid = ground().grid
    one = read_points(Dataset(points_file(tmp_path / "q.geojson"), variable="mag"), grid)
    shapes = np.array([struct.pack("<BIdd", 1, 1, x, y) for x, y in zip(one.x, one.y)] + [None], object)
    path = tmp_path / "q.gpkg"
    pyogrio.raw.write(
        path, shapes, [np.array([*one.values, 9.0]), np.array(["a", "b", "c"], object)], ["mag", "place"],
        geometry_type="Point", crs=UTM,
    )  # fmt: skip
    two = read_points(Dataset(str(path)), grid)
    np.testing.assert_allclose(two.x, one.x)
    np.testing.assert_allclose(two.values, one.values)
    path.write_bytes(b"nothing")
    with pytest.raises(ReadError, match="cannot be read"):
        read_points(Dataset(str(path)), grid)


def test_points_that_cannot_be_meant_are_refused(tmp_path):
    grid = ground().grid
    path = points_file(tmp_path / "q.geojson")
    with pytest.raises(UsageError, match="mag"):
        read_points(Dataset(path), grid)
    with pytest.raises(UsageError, match="magnitude"):
        read_points(Dataset(path, variable="magnitude"), grid)
    with pytest.raises(ReadError, match="None of its 1 points"):
        read_points(Dataset({"lon": [50.0], "lat": [0.0], "v": [1.0]}), grid)
    with pytest.raises(ReadError, match="where the points lie"):
        read_points(Dataset({"a": [50.0], "b": [0.0]}), grid)
    (tmp_path / "broken.geojson").write_text("{")
    with pytest.raises(ReadError, match="not JSON"):
        read_points(Dataset(str(tmp_path / "broken.geojson")), grid)


@pytest.mark.parametrize("style", ["bars", "spheres", "cones", "discs", "flags"])
def test_pictures_have_points_and_their_legend(tmp_path, style):
    terrain = ground()
    view = orograph.camera.around(terrain, (300, 200), azimuth=180, pitch=35, distance=None)
    data = Dataset(points_file(tmp_path / "q.geojson"), variable="mag", style=style, uncertainty="rms")
    picture = orograph.render(terrain, view, data=data, priority="T+D+U+", furniture=True)
    bare = orograph.render(terrain, view, furniture=True)
    assert (picture.pixels != bare.pixels).any(-1).sum() > 100
    things = Scene.of(terrain, view, data=data).theme.things
    assert {1.0, 3.0} <= set(things.values[np.isfinite(things.values)])


def test_rasters_stand_on_a_lattice(tmp_path):
    terrain = ground()
    values = np.tile(np.linspace(0, 1, 80, dtype=np.float32), (60, 1))
    view = orograph.camera.whole(terrain, (300, 200))
    things = Scene.of(terrain, view, data=Dataset(values, style="bars", size=100.0)).theme.things
    assert len(things) == pytest.approx((600 / 50) * (800 / 50), rel=0.2)
    order = np.argsort(things.x, kind="stable")
    assert (np.diff(things.height[order]) > -2.0).all()


@pytest.mark.parametrize("style", ["spheres", "discs"])
@pytest.mark.parametrize("size", [None, 50.0])
def test_round_things_of_a_raster_do_not_touch(style, size):
    terrain = ground()
    data = Dataset(np.ones((60, 80), np.float32), style=style, size=size)
    things = Scene.of(terrain, orograph.camera.whole(terrain, (300, 200)), data=data).theme.things
    apart = np.diff(np.unique(np.round(things.x, 3))).min()
    assert 0.4 * apart < 2 * things.radius.max() < 0.7 * apart and (size is None or things.radius.max() <= size / 2)


@pytest.mark.parametrize("azimuth", [180.0, 0.0])
@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_columns_and_sections_reach_from_height_to_height_and_are_seen_from_both_sides(azimuth, exaggeration):
    terrain = ground()
    view = orograph.camera.around(terrain, (300, 200), azimuth=azimuth, pitch=12, distance=1500)
    scene = Scene.of(terrain, view, exaggeration=exaggeration, samples=4)
    bare = orograph.render(terrain, view, exaggeration=exaggeration)
    x, y = terrain.grid.xy(40.0, 30.0)
    one = np.ones(1)
    for kind, wide in ((Kind.COLUMN, 0.0), (Kind.SECTION, 40.0)):
        ends = np.array([[50.0, x + wide, y, 90.0]])
        made = Things(np.array([kind], np.int8), x * one, y * one, 0 * one, 20 * one, 40 * one,
                      np.array([[1.0, 0.0, 0.0]], np.float32), one, Legend(), ends)  # fmt: skip
        found = stand(made, bare.pixels, bare.depth, scene)
        for height, there in ((55.0, True), (85.0, True), (40.0, False), (100.0, False)):
            (u, v), _ = view.project(np.array([x + wide / 2, y, height]), exaggeration)
            assert (found.which[int(v), int(u)] == 0) == there, (kind, height)
