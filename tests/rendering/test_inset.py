"""The map beside a perspective: what it marks as seen is what the picture shows."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from rasterio.transform import from_origin

import orograph
from orograph.geovis.data.dataset import Dataset
from orograph.rendering.furniture.lettering import Style
from orograph.rendering.furniture.pieces import above_map, arrow
from orograph.rendering.inset import eye_on, in_view, inset_of
from orograph.rendering.large import draw_large
from orograph.scene.scene import Scene


def ground(rows=61, cols=83, cell=(30.0, 20.0)):
    y, x = np.mgrid[:rows, :cols]
    heights = (80 * np.sin(x / 5) * np.cos(y / 4)).astype(np.float32)
    return orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, *cell), crs="EPSG:32630")


def close(terrain, size=(400, 300), exaggeration=1.0):
    return orograph.camera.around(terrain, size, azimuth=215, pitch=40, distance=700.0, exaggeration=exaggeration)


@pytest.mark.parametrize("exaggeration", [1.0, 2.0])
def test_what_is_marked_is_what_the_picture_shows(exaggeration):
    terrain = ground()
    view = close(terrain, exaggeration=exaggeration)
    flat = orograph.render(terrain, orograph.camera.plan(terrain, (160, 90)))
    seen = in_view(flat, view, exaggeration)
    assert 0.02 < seen.mean() < 0.9
    picture = orograph.render(terrain, view, exaggeration=exaggeration)
    places = picture.places()
    places = places[np.isfinite(places[..., 0])]
    xy, _ = flat.view.project(places)
    col, row = np.floor(xy).astype(int).T
    around = sum(np.roll(seen, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)) > 0
    assert around[row, col].all() and seen[row, col].mean() > 0.95  # (pixels at the border are of both sides)
    # What is marked is seen, or behind what is seen.
    xy, depth = view.project(flat.places()[seen], exaggeration)
    col, row = np.floor(xy).astype(int).T
    assert (picture.depth[row, col] < 1.02 * depth).mean() > 0.99


def test_the_eye_is_where_it_is_or_at_the_nearest_border():
    terrain = ground()
    flat = orograph.camera.plan(terrain, (160, 90))
    view = close(terrain)
    x, y = eye_on(flat, view)
    origin, across, down, *_ = flat.ray_basis()
    np.testing.assert_allclose((origin + x * across + y * down)[:2], view.eye[:2], atol=1e-6)
    far = orograph.camera.around(terrain, (400, 300), azimuth=270, pitch=10, distance=1e5)
    assert eye_on(flat, far)[0] == 0


def test_the_map_has_the_datas_colours():
    terrain = ground()
    data = Dataset(np.mgrid[:61, :83][1].astype(np.float32), colormap="viridis")
    scene = Scene.of(terrain, close(terrain), data=data, inset=True, furniture=True, light="none")
    found = inset_of(scene, orograph.rendering.cpu.draw.draw).astype(int)
    rows, cols = found.shape[:2]
    assert (cols > rows) and abs(cols / rows - 83 * 30 / (61 * 20)) < 0.1
    flat = orograph.render(terrain, orograph.camera.plan(terrain, (cols, rows)), data=data, light="none")
    same = (found == flat.pixels).all(-1)
    seen = in_view(flat, scene.view, 1.0)
    assert same[seen].mean() > 0.5 and not same[~seen & np.isfinite(flat.depth)].any()


@pytest.mark.parametrize("top", [True, False])
def test_the_piece_holds_the_map_pixel_for_pixel(top):
    style, pixels = Style(14.0, None), np.random.default_rng(0).integers(0, 255, (70, 95, 3), np.uint8)
    piece = above_map(arrow(30.0, style) if top else None, pixels, style)
    ((left, y, right, bottom, tile),) = piece.patterns
    assert (right - left, bottom - y) == (95, 70) and tile is pixels
    assert left >= 0 and right <= piece.width and bottom <= piece.height
    assert [text[2] for text in piece.texts].count("N") == 1 + top


def test_it_stands_in_perspectives_with_furniture_alone():
    terrain, size = ground(), (500, 400)
    perspective, plan = close(terrain, size), orograph.camera.plan(terrain, size)
    for view, furniture, differs in ((perspective, True, True), (perspective, False, False), (plan, True, False)):
        one, two = (orograph.render(terrain, view, furniture=furniture, inset=i).pixels for i in (False, True))
        assert np.array_equal(one, two) != differs


def test_large_pictures_have_the_same(tmp_path):
    terrain = ground()
    scene = Scene.of(terrain, close(terrain, (500, 400)), furniture=True, inset=True, aids="grid=200", title="A")
    draw_large(scene, tmp_path / "large.png", pixels=40_000)
    whole = orograph.render(terrain, scene.view, furniture=True, inset=True, aids="grid=200", title="A")
    large = np.asarray(Image.open(tmp_path / "large.png").convert("RGB"))
    np.testing.assert_array_equal(large, whole.pixels)


@pytest.mark.stress
def test_the_gpu_has_it_too(device):
    terrain = ground()
    cpu, gpu = (
        orograph.render(terrain, close(terrain, (500, 400)), furniture=True, inset=True, backend=one, tolerance=0.1)
        for one in ("cpu", "gpu")
    )
    assert (np.abs(cpu.pixels.astype(int) - gpu.pixels).max(-1) > 40).mean() < 0.01
