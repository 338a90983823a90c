"""Tiles of a picture are what the whole picture shows there, to the bit: no seam can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from affine import Affine
from scenes import NORTH_UP, hills, holes, terrain

from orograph.errors import NothingInViewError, UsageError
from orograph.geovis.layers import Layer
from orograph.lighting.sun import Sun
from orograph.memo import Memo
from orograph.rendering.cpu.draw import draw
from orograph.scene import camera
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene

SIZE = (333, 190)
CUTS = ((0, 0, 64, 16), (64, 16, 128, 96), (50, 37, 101, 77), (300, 150, 33, 40), (0, 189, 333, 1))


def ground():
    heights = holes(hills(140, 180))
    heights[90:125, 60:110] = 640.0  # a lake
    return terrain(heights)


def scenes(tmp_path):
    land = ground()
    image = tmp_path / "image.tif"
    with rasterio.open(image, "w", driver="GTiff", width=40, height=30, count=3, dtype="uint8", crs="EPSG:32611",
                       transform=NORTH_UP @ Affine.scale(3, 3)) as file:  # fmt: skip
        file.write(np.random.default_rng(3).integers(0, 255, (3, 30, 40), np.uint8))
    oblique = camera.around(land, SIZE, azimuth=200, pitch=25, distance=3000)
    turned = replace(oblique, up=(0.3, 0.1, 1.0))
    return {
        "paper": Scene.of(land, oblique),
        "sky": Scene.of(
            land, camera.around(land, SIZE, azimuth=140, pitch=4, distance=2500), sun=Sun(130, 9), sky=True
        ),
        "turned": Scene.of(land, turned, exaggeration=2.0, samples=7, jobs=2),
        "drape": Scene.of(land, oblique, layers=(Layer(str(image)),), sky=True),
        "plan": Scene.of(land, camera.plan(land, SIZE, azimuth=150), samples=3),
        "coarse": Scene.of(land, oblique, tolerance=3.0),
        "plain": Scene.of(land, oblique, samples=1, shadows=False, water=None),
        "mesh": Scene.of(land, oblique, method="soar", tolerance=2.0),
    }  # fmt: skip


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["paper", "sky", "turned", "drape", "plan", "coarse", "plain", "mesh"])
def test_a_tile_is_the_whole_there(tmp_path, name):
    scene = scenes(tmp_path)[name]
    whole = draw(scene)
    memo = Memo()
    counts = dict.fromkeys(whole.facts["shown"], 0)
    for x, y, w, h in (*CUTS, *((x, y, min(170, SIZE[0] - x), min(100, SIZE[1] - y))
                                for y in range(0, SIZE[1], 100) for x in range(0, SIZE[0], 170))):  # fmt: skip
        tile = draw(scene.but(view=scene.view.tile(x, y, w, h)), memo=memo)
        np.testing.assert_array_equal(tile.pixels, whole.pixels[y : y + h, x : x + w])
        np.testing.assert_array_equal(tile.depth, whole.depth[y : y + h, x : x + w])
        if (x, y, w, h) not in CUTS:
            for what, n in tile.facts["shown"].items():
                counts[what] += n
    assert counts == whole.facts["shown"] and counts["ground"] > 0


@pytest.mark.stress
def test_a_tile_may_have_silhouettes_and_labels():
    """Silhouettes need a wider rim than labels."""
    scene = Scene.of(ground(), camera.around(ground(), SIZE, azimuth=200, pitch=25, distance=3000), samples=1,
                     silhouettes=True, contours=Contours())  # fmt: skip
    whole = draw(scene)
    assert whole.facts["shader"]["contours"]["labels"] > 0
    for x, y, w, h in CUTS:
        tile = draw(scene.but(view=scene.view.tile(x, y, w, h)))
        np.testing.assert_array_equal(tile.pixels, whole.pixels[y : y + h, x : x + w])


def test_a_plan_s_tile_knows_its_place():
    land = ground()
    whole = draw(Scene.of(land, camera.plan(land, SIZE, azimuth=150)))
    tile = draw(Scene.of(land, whole.view.tile(50, 37, 101, 77)))
    np.testing.assert_allclose(tile.grid.xy(3.0, 4.0), whole.grid.xy(53.0, 41.0), rtol=0, atol=1e-6)


def test_what_a_tile_cannot_have():
    land = ground()
    view = camera.whole(land, SIZE)
    with pytest.raises(UsageError, match="furniture"):
        draw(Scene.of(land, view.tile(0, 0, 10, 10), furniture=True))
    with pytest.raises(UsageError, match="wireframe"):
        draw(Scene.of(land, view.tile(0, 0, 10, 10), method="soar", wireframe=True))
    # A tile of nothing but paper is part of a picture; a picture of nothing is none.
    assert not np.isfinite(draw(Scene.of(land, view.tile(0, 0, 10, 10))).depth).any()
    away = camera.View((500_000.0, 4_100_000.0, 900.0), (500_000.0, 4_200_000.0, 900.0), width=333, height=190)
    with pytest.raises(NothingInViewError):
        draw(Scene.of(land, away.tile(0, 0, 10, 10)))


@pytest.mark.stress
def test_what_is_kept_changes_nothing(tmp_path):
    """Pictures drawn one after the other, each as if it were the first."""
    memo = Memo()
    pictures = {}
    for _ in range(2):
        for name, scene in scenes(tmp_path).items():
            got = draw(scene, memo=memo).pixels
            alone = pictures.setdefault(name, draw(scene).pixels)
            np.testing.assert_array_equal(got, alone)


def test_a_grain_of_ground_between_the_surveyed_pixels_is_found():
    land = terrain(hills(3, 3, tall=1.0))
    x, y = (float(v) for v in land.grid.xy(1.0, 1.0))
    view = camera.View((x, y, 60_000.0), (x, y, 0.0), up=(0, 1, 0), fov_y=60, width=1300, height=1300)
    picture = draw(Scene.of(land, view))
    assert 0 < np.isfinite(picture.depth).sum() < 30
