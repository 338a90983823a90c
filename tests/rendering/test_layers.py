"""Layers in the CPU's pictures: filtered as 64 rays a pixel would see them, composited as said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import scenes
from affine import Affine
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.drape import Drape
from orograph.geovis.layers import Layer
from orograph.rendering.cpu.draw import draw
from orograph.rendering.cpu.shading import WATER
from orograph.scene.camera import plan
from orograph.scene.scene import Scene
from orograph.viewpoint import View

METRES = 2000.0
HEIGHT = 10.0
WEST, NORTH = 500_000.0, 4_000_000.0


def flat() -> scenes.MemoryTerrain:
    return scenes.terrain(np.full((65, 65), HEIGHT, np.float32), Affine(METRES / 65, 0, WEST, 0, -METRES / 65, NORTH))


def image(path: Path, pixels: NDArray[np.uint8]) -> str:
    """pixels (rows, cols, 3 or 4) over the whole terrain."""
    rows, cols, bands = pixels.shape
    with rasterio.open(
        path, "w", driver="GTiff", count=bands, height=rows, width=cols, dtype="uint8", crs="EPSG:32611",
        transform=Affine(METRES / cols, 0, WEST, 0, -METRES / rows, NORTH),
    ) as file:  # fmt: skip
        file.write(np.moveaxis(pixels, -1, 0))
    return str(path)


def board(square: int = 8, side: int = 2000) -> NDArray[np.uint8]:
    """A checkerboard, colours below the shoulder."""
    a = np.indices((side, side)) // square
    return np.repeat(np.where(a.sum(0) % 2, 200, 20).astype(np.uint8)[..., None], 3, 2)


def supersampled(view: View, pixels: NDArray[np.uint8], n: int = 8) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Linear means (height, width) of n² rays a pixel of the nearest texel of an image on the plane; which pixels lie
    wholly on it."""
    linear = srgb_to_linear(pixels[..., 0] / 255.0)
    total, inside = np.zeros((view.height, view.width)), np.ones((view.height, view.width), bool)
    o0, ou, ov, d0, du, dv = view.ray_basis()
    for i in range(n):
        for j in range(n):
            px, py = np.meshgrid(np.arange(view.width) + (j + 0.5) / n, np.arange(view.height) + (i + 0.5) / n)
            o = o0 + px[..., None] * ou + py[..., None] * ov
            d = d0 + px[..., None] * du + py[..., None] * dv
            with np.errstate(divide="ignore", invalid="ignore"):
                at = o + ((HEIGHT - o[..., 2]) / d[..., 2])[..., None] * d
            u, v = (at[..., 0] - WEST) / METRES * linear.shape[1], (NORTH - at[..., 1]) / METRES * linear.shape[0]
            there = (d[..., 2] < 0) & (u >= 0) & (u < linear.shape[1]) & (v >= 0) & (v < linear.shape[0])
            inside &= there
            total[there] += linear[v[there].astype(int), u[there].astype(int)]
    return total / n**2, inside


@pytest.mark.parametrize("heading", [0.0, 37.0])
def test_at_a_grazing_angle_it_is_what_many_rays_see(tmp_path: Path, heading: float) -> None:
    pixels = board()
    path = image(tmp_path / "board.tif", pixels)
    middle = np.array([WEST + METRES / 2, NORTH - METRES / 2])
    ahead = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])
    eye, target = middle - 800 * ahead, middle + 100 * ahead
    view = View((*eye, 70.0), (*target, HEIGHT), fov_y=30, width=180, height=110)
    terrain = flat()
    scene = Scene.of(terrain, view, light="none", layers=(Layer(path),), samples=1, water=None)
    truth, inside = supersampled(view, pixels)
    inside[:2] = inside[-2:] = False
    picture = draw(scene)
    ours = srgb_to_linear(picture.pixels[..., 0] / 255.0)
    # What an isotropic filter of the footprint's mean width makes of it.
    o0, _, _, d0, du, dv = view.ray_basis()
    px, py = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    d = d0 + px[..., None] * du + py[..., None] * dv
    at = o0 + picture.depth[..., None].astype(np.float64) * d
    slant = np.abs(d[..., 2]) / np.linalg.norm(d, axis=-1)
    width = picture.depth * view.pixel_slope / np.sqrt(np.clip(slant, 0.1, 1))
    drape = Drape.open(path, terrain.grid)
    plain = drape.sample(at[..., 0].ravel(), at[..., 1].ravel(), width.ravel()).reshape(*px.shape, 4)[..., 0]
    assert inside.sum() > 4000

    def error(found: NDArray[np.floating]) -> float:
        return float(np.sqrt(np.mean((found - truth)[inside] ** 2)))

    assert error(ours) < 0.6 * error(plain)
    assert error(ours) < 0.06  # of a contrast of 0.57
    # It is not merely grey: the board is seen where many rays see it, as strongly within a quarter.
    assert np.std(ours[inside]) > 0.75 * np.std(truth[inside])


def test_far_ground_is_grey_and_does_not_sparkle(tmp_path: Path) -> None:
    path = image(tmp_path / "board.tif", board(1))
    view = View((WEST + 1000, NORTH - 1990, 60.0), (WEST + 1000, NORTH - 500, HEIGHT), fov_y=20, width=120, height=60)
    picture = draw(Scene.of(flat(), view, light="none", layers=(Layer(path),), samples=1, water=None))
    seen = np.isfinite(picture.depth) & (picture.depth > 900)
    ours = srgb_to_linear(picture.pixels[..., 0] / 255.0)[seen]
    grey = srgb_to_linear(np.array([20, 200]) / 255.0).mean()
    assert seen.sum() > 300 and np.abs(ours - grey).max() < 0.05


def test_layers_lie_one_above_another(tmp_path: Path) -> None:
    terrain = flat()
    view = plan(terrain, (64, 64))
    bare = Scene.of(terrain, view, light="none", water=None)
    tint = srgb_to_linear(draw(bare).pixels[32, 32] / 255.0)
    one = np.empty((50, 50, 4), np.uint8)
    one[:] = 120, 60, 30, 255
    one[:, 25:, 3] = 128
    two = np.empty((70, 70, 3), np.uint8)
    two[:] = 90, 150, 200
    a, b = Layer(image(tmp_path / "a.tif", one), 0.5), Layer(image(tmp_path / "b.tif", two), 0.25, blend="multiply")
    first, second = srgb_to_linear(one[0, 0, :3] / 255.0), srgb_to_linear(two[0, 0] / 255.0)

    def over(c: NDArray[np.floating], own: float) -> NDArray[np.floating]:
        return c * (1 - 0.5 * own) + first * 0.5 * own

    def times(c: NDArray[np.floating]) -> NDArray[np.floating]:
        return c * 0.75 + c * second * 0.25

    for layers, west, east in (
        ((a,), over(tint, 1), over(tint, 128 / 255)),
        ((a, b), times(over(tint, 1)), times(over(tint, 128 / 255))),
        ((b, a), over(times(tint), 1), over(times(tint), 128 / 255)),
    ):
        got = srgb_to_linear(draw(bare.but(layers=layers)).pixels / 255.0)
        np.testing.assert_allclose(got[32, 16], west, atol=0.006)
        np.testing.assert_allclose(got[32, 48], east, atol=0.006)


def test_what_is_hidden_costs_nothing_and_shows_nothing(tmp_path: Path) -> None:
    terrain = flat()
    scene = Scene.of(terrain, plan(terrain, (64, 64)))
    hidden = (Layer("not there.tif", visible=False), Layer("nor there.tif", 0.0))
    np.testing.assert_array_equal(draw(scene).pixels, draw(scene.but(layers=hidden)).pixels)


def test_less_detail_is_read_where_less_is_seen(tmp_path: Path) -> None:
    """A picture from afar holds a coarse part of a large image, and is the same as with all of it."""
    from orograph.memo import Memo

    path = image(tmp_path / "board.tif", board(64))
    terrain = flat()
    scene = Scene.of(terrain, plan(terrain, (64, 64)), light="none", layers=(Layer(path),), samples=1, water=None)
    memo = Memo()
    picture = draw(scene, memo=memo)
    (drape,) = [made for made, _ in memo._held["drape"].values()]
    assert drape.step >= 4 and drape.tiles is None
    truth, inside = supersampled(scene.view, board(64))
    ours = srgb_to_linear(picture.pixels[..., 0] / 255.0)
    assert np.sqrt(np.mean((ours - truth)[inside] ** 2)) < 0.12


def test_an_image_covers_water(tmp_path: Path) -> None:
    heights = scenes.hills(200, 200, tall=60)
    heights[:, :120] = 0  # a lake, of which the image covers the northern half
    ground = scenes.terrain(heights, Affine(METRES / 200, 0, WEST, 0, -METRES / 200, NORTH))
    pixels = np.zeros((100, 100, 4), np.uint8)
    pixels[:50] = 200, 40, 40, 255
    scene = Scene.of(ground, plan(ground, (200, 200)), light="none", layers=(Layer(image(tmp_path / "i.tif", pixels)),))
    picture = draw(scene)
    y, x = np.nonzero(np.isfinite(picture.depth))
    west, east, top, bottom = x.min(), x.max(), y.min(), y.max()
    tall, wide = bottom - top, east - west
    lake = slice(west + wide // 10, west + wide // 3)
    assert np.abs(picture.pixels[top + tall // 10 : top + tall // 3, lake].astype(int) - [200, 40, 40]).max() <= 2
    water = picture.pixels[bottom - tall // 3 : bottom - tall // 10, lake].astype(int)
    assert np.abs(water - np.round(linear_to_srgb(WATER) * 255)).max() <= 2
    # What is counted is what is seen: half of the lake is water, half of all is draped.
    ground_seen = picture.facts["shown"]["ground"]
    assert abs(picture.facts["shown"]["water"] / ground_seen - 0.3) < 0.03
    assert abs(picture.facts["shown"]["draped"] / ground_seen - 0.5) < 0.03
