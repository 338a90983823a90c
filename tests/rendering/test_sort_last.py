"""Sort-last: parts of a surface, put together by depth, show what the whole shows."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import hills, holes, terrain

import orograph
from orograph.errors import UsageError
from orograph.hierarchy.clip_stack import Rectangle
from orograph.progress import SILENT
from orograph.raycast.caster import Caster
from orograph.raycast.select import load
from orograph.rendering import sort_last
from orograph.rendering.composited import Composited, frame_of, put_nearer, split, split_triangles, windows_of
from orograph.rendering.cpu import draw
from orograph.rendering.cpu.raster import MeshSurface
from orograph.rendering.gbuffer import GBuffer
from orograph.rendering.large import draw_large
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.rendering.ways import Way
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.store.clusters import Cluster
from orograph.store.worker_state import forget, learn
from orograph.viewpoint import Camera

SIZE = (257, 150)


def ground(rows=700, cols=900):
    heights = holes(hills(rows, cols))
    heights[90:125, 60:110] = 640.0
    return terrain(heights)


def views(land):
    return {
        "around": camera.around(land, SIZE, azimuth=215, pitch=22, distance=9000),
        "low": camera.around(land, SIZE, azimuth=130, pitch=4, distance=6000),
        "down": camera.around(land, SIZE, azimuth=10, pitch=85, distance=15000),
        "plan": camera.plan(land, SIZE),
    }


@pytest.mark.parametrize("name", ["around", "low", "down", "plan"])
@pytest.mark.parametrize("count", [2, 7])
def test_parts_of_heights_show_what_the_whole_shows(name, count):
    land = ground()
    view = views(land)[name]
    projection, shape = Projection.of(Camera.over(land.grid, view)), land.grid.shape
    windows = [Rectangle.whole(2, land.shape(2)), Rectangle(1, 64, 301, 64, 401), Rectangle(0, 200, 521, 300, 701)]
    whole = RaySurface(Caster(load(land, windows), shape), projection)
    boxes = split(windows, shape, count)
    parts = [RaySurface(Caster(load(land, windows_of(windows, box)), shape), projection) for box in boxes]
    area = 0, SIZE[1], 0, SIZE[0]
    one, many = whole.draw(area).depth, Composited(parts).draw(area)
    assert len(boxes) == count and len(np.unique(many.objects)) > min(count, 2)
    np.testing.assert_array_equal(np.isnan(one), np.isnan(many.depth))
    np.testing.assert_allclose(many.depth, one, rtol=1e-9, atol=1e-6)
    framed = GBuffer.empty(one.shape)  # what each is asked for is enough
    for number, (part, box) in enumerate(zip(parts, boxes, strict=True)):
        frame = frame_of(box, land.height_range, projection)
        if frame is not None:
            where = np.s_[frame[0] : frame[1], frame[2] : frame[3]]
            put_nearer(framed, where, part.draw(frame).depth, number)
    np.testing.assert_allclose(framed.depth, one, rtol=1e-9, atol=1e-6)
    rng = np.random.default_rng(0)
    px, py = rng.uniform(0, SIZE[0], 999), rng.uniform(0, SIZE[1], 999)
    np.testing.assert_allclose(Composited(parts).at(px, py).depth, whole.at(px, py).depth, rtol=1e-9, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(2, 3000), st.integers(2, 3000), st.integers(0, 4), st.integers(1, 9), st.randoms(use_true_random=False)
)
def test_boxes_cover_a_terrain_once_and_windows_nest(rows, cols, level, count, random):
    def shape(k):
        return -(-rows // (1 << k)) if rows > 1 << k else 2, -(-cols // (1 << k)) if cols > 1 << k else 2

    windows = [Rectangle.whole(level, shape(level))]
    for k in range(level - 1, -1, -1):
        outer = windows[-1]
        if min(outer.shape) < 12:
            break
        r, c = (2 * (first + 2 * random.randint(0, 2)) for first in (outer.row0, outer.col0))
        windows.append(Rectangle(k, r, min(2 * outer.row1 - 5, shape(k)[0]), c, min(2 * outer.col1 - 5, shape(k)[1])))
    boxes = split(windows, (rows, cols), count)
    assert 1 <= len(boxes) <= count
    area = sum((b.row1 - b.row0) * (b.col1 - b.col0) for b in boxes)
    assert area == (rows - 1) * (cols - 1)
    for a in boxes:
        for b in boxes:
            apart = a.row1 <= b.row0 or b.row1 <= a.row0 or a.col1 <= b.col0 or b.col1 <= a.col0
            assert a is b or apart
        cut = windows_of(windows, a)
        assert cut and cut[0].level == level
        for w in cut:
            assert w.row0 % 2 == w.col0 % 2 == 0
            for first, end, low, high in ((w.row0, w.row1, a.row0, a.row1), (w.col0, w.col1, a.col0, a.col1)):
                assert end - first >= 2
                if w.level == level:
                    assert first << level <= low and (end - 1) << level >= min(high, (end - 1) << level)
        for outer, inner in pairwise(cut):
            assert inner.row0 >> 1 >= outer.row0 and inner.col0 >> 1 >= outer.col0
            assert inner.row1 - 1 <= 2 * (outer.row1 - 1) + 1 and inner.col1 - 1 <= 2 * (outer.col1 - 1) + 1


def test_parts_hold_as_many_samples_each():
    windows = [Rectangle.whole(5, (512, 512)), Rectangle(2, 512, 2048, 512, 2048), Rectangle(0, 2200, 4000, 2100, 4200)]
    boxes = split(windows, (16384, 16384), 8)
    held = [sum(w.samples for w in windows_of(windows, box)) for box in boxes]
    assert max(held) < 1.35 * sum(held) / len(held)


def test_parts_of_a_mesh_show_what_the_whole_shows():
    rng = np.random.default_rng(4)
    land = ground(130, 170)
    view = camera.around(land, SIZE, azimuth=215, pitch=25, distance=2500)
    projection = Projection.of(Camera.over(land.grid, view))
    rows, cols = land.grid.shape
    heights = land.read(0, 0, rows, 0, cols)
    y, x = (a.ravel() for a in np.mgrid[0:rows:3, 0:cols:3])
    vertices = np.stack([x, y, np.nan_to_num(heights[y, x], nan=500.0)], 1).astype(np.float64)
    wide = len(range(0, cols, 3))
    corner = (np.arange(len(range(0, rows, 3)) - 1)[:, None] * wide + np.arange(wide - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + wide, corner + 1], 1), np.stack([corner + 1, corner + wide, corner + wide + 1], 1)]
    ).astype(np.int32)
    triangles = triangles[rng.permutation(len(triangles))]
    shares = split_triangles(vertices, triangles, 5)
    assert sorted(np.concatenate(shares).tolist()) == list(range(len(triangles)))
    assert max(map(len, shares)) - min(map(len, shares)) <= 5
    parts = [MeshSurface(vertices, triangles[share], projection) for share in shares]
    area = 0, SIZE[1], 0, SIZE[0]
    whole = MeshSurface(vertices, triangles, projection).draw(area)
    np.testing.assert_array_equal(Composited(parts).draw(area).depth, whole.depth)


class Future:
    def __init__(self, make):
        self.make = make

    def result(self):
        return self.make()


class Client:
    """Stands for a cluster's client: ``alive`` workers, whose tasks are done when they are asked for; some die."""

    status = "running"

    def __init__(self, recipe, deaths=0):
        self.recipe, self.deaths, self.asked = recipe, deaths, []

    def nthreads(self):
        return {f"tcp://{k}": 1 for k in range(3)}

    def submit(self, function, ident, *args, workers, **_):
        self.asked.append(workers[0])
        if self.deaths:
            self.deaths -= 1
            return Future(lambda: (_ for _ in ()).throw(RuntimeError("the worker died")))
        return Future(lambda: function(ident, *args))


@pytest.fixture
def casting():
    made = []

    def make(scene, deaths=0):
        recipe = sort_last.Recipe(scene, 1 << 28)
        cluster = Cluster(Client(recipe, deaths), recipe)
        learn(cluster.ident, recipe)
        made.append(cluster.ident)
        return sort_last.Casting(cluster, 3)

    yield make
    for ident in made:
        forget(ident)


@pytest.mark.stress
@pytest.mark.parametrize(
    "options",
    [
        {"tolerance": 0.5, "sky": True},
        {"contours": True, "silhouettes": True},
        {"method": "restricted-quadtree", "tolerance": 1.0},
    ],
    ids=["rays", "lines", "mesh"],
)
def test_pictures_are_those_of_one_process(casting, options):
    land = ground(300, 420)
    scene = Scene.of(land, camera.around(land, SIZE, azimuth=215, pitch=18, distance=5000), **options)
    one = draw.draw(scene)
    made = casting(scene, deaths=3)
    many = draw.session(made)(scene)
    apart = np.abs(one.pixels.astype(int) - many.pixels.astype(int)).max(2)
    assert (apart > 1).sum() == 0 and (apart > 0).mean() < 0.001
    np.testing.assert_allclose(many.depth, one.depth, rtol=1e-6)
    assert made.cluster.imbalance() >= 1 and made.cluster.moved > 0


def test_render_gives_a_picture(casting, monkeypatch, tmp_path):
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path))
    land = ground(300, 420)
    view = camera.around(land, SIZE, azimuth=215, pitch=18, distance=5000)

    @contextmanager
    def by_parts(scene, **_):
        made = casting(scene)
        yield draw.session(made), made.cluster

    monkeypatch.setattr(sort_last, "by_parts", by_parts)
    one = orograph.render(land, view, samples=1, max_memory=16 << 20)
    many = orograph.render(land, view, samples=1, max_memory=16 << 20, workers=3, sort_last=True)
    assert np.abs(one.pixels.astype(int) - many.pixels.astype(int)).max() <= 1
    np.testing.assert_allclose(many.depth, one.depth, rtol=1e-6)
    assert many.facts["moved_bytes"] > 0 and not list(tmp_path.iterdir())


@pytest.mark.stress
def test_a_real_cluster(tmp_path):
    pytest.importorskip("distributed")
    land = ground(300, 420)
    scene = Scene.of(land, camera.around(land, SIZE, azimuth=215, pitch=18, distance=5000), furniture=True)
    draw_large(scene, tmp_path / "one.png")
    facts = Way(workers=2, sort_last=True).into(scene, tmp_path / "a.png", SILENT)
    from PIL import Image

    one, two = (np.asarray(Image.open(tmp_path / name)).astype(int) for name in ("one.png", "a.png"))
    assert np.abs(one - two).max() <= 1
    assert 1.0 <= facts["imbalance"] <= 2.0 and facts["moved_bytes"] > 0


def test_what_is_not_drawn_so(tmp_path):
    land = ground(60, 60)
    scene = Scene.of(land, camera.whole(land, SIZE), method="soar", wireframe=True)
    with pytest.raises(UsageError, match="wireframe"):
        sort_last.draw_by_parts(scene, tmp_path / "a.png", workers=2)
    with pytest.raises(UsageError, match="needs workers"):
        sort_last.draw_by_parts(Scene.of(land, camera.whole(land, SIZE)), tmp_path / "a.png")
