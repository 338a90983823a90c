"""Normals: computed ones are smooth far beyond a sample, stored ones know only vertices, derivatives only facets, and
sampled ones see the weights of texture units."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lighting.sun import Sun
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.cpu.shading import illumination
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.frame import Normals, Overlay
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

METRES, SIDE = 20.0, 257
EAST, NORTH = 500_000.0, 5_000_000.0


def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth hills of a few hundred metres' length (x east, y south of the first sample)."""
    return 300 + 40 * np.sin(x / 130.0) + 30 * np.cos(y / 110.0)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    y, x = np.mgrid[:SIDE, :SIDE] * METRES
    grid = Grid((SIDE, SIDE), Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
    return in_memory(Dem(height(x, y).astype(np.float32), grid))


def scene(terrain: Terrain, pixels_per_cell: float, width: int = 400) -> Scene:
    """A plan of the terrain's middle in grey, lit by a sun at 45°, without shadows."""
    x, y = EAST + METRES / 2 + 128.3 * METRES, NORTH - METRES / 2 - 128.4 * METRES
    fov = 2 * np.degrees(np.arctan(12 * METRES / pixels_per_cell / 2000.0))
    view = View((x, y, 2300.0), (x, y, 300.0), projection="plan", fov_y=fov, width=width, height=24)
    return Scene.of(
        terrain, view, sun=Sun(300.0, 45.0), shadows=False, colormap="grey", water=None, relief=1.0, samples=1,
        tolerance=0.5,
    )  # fmt: skip


def line(device: Device, s: Scene, normals: Normals) -> NDArray[np.float64]:
    """Light along the middle row, without the tint it falls on; green, from half floats before they become bytes."""
    renderer = Renderer(device, s.terrain)
    texture = device.texture((s.view.width, s.view.height), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    rows = []
    try:
        for lit in (s, s.but(light="none")):
            renderer.draw(
                texture.create_view(), "rgba8unorm", lit, overlay=Overlay(normals=normals), wait=True, samples=1
            )
            light = renderer._targets.light  # type: ignore[union-attr]
            rows.append(device.read_texture(light, np.float16, 4)[12, :, 1].astype(float))
    finally:
        renderer.close()
    return rows[0] / rows[1]


def truth(s: Scene) -> NDArray[np.float64]:
    """The cosine of the sun's angle on the smooth surface along that row, and the part of the sky above it."""
    to_sun, _, _ = illumination(s.lighting.sun)
    px = np.arange(s.view.width) + 0.5
    x = s.view.target[0] + (px - s.view.width / 2) * s.view.pixel_metres - EAST - METRES / 2
    y = np.full_like(x, NORTH - METRES / 2 - s.view.target[1]) + 0.5 * s.view.pixel_metres
    e = 1e-3
    gx, gy = (height(x + e, y) - height(x - e, y)) / (2 * e), -(height(x, y + e) - height(x, y - e)) / (2 * e)
    return (to_sun[2] - gx * to_sun[0] - gy * to_sun[1]) / np.sqrt(1 + gx**2 + gy**2)


def test_far_beyond_a_sample_there_are_neither_facets_nor_bands(device: Device, terrain: Terrain) -> None:
    """A pixel is 1/200 of a cell: two cells are seen. Bytes step by one at most, and second differences of the
    light have no jump at the borders of cells or triangles, where those of facets do."""
    s = scene(terrain, 200.0)
    kinks = {}
    for normals in ("computed", "derivatives"):
        shade = line(device, s, normals)  # type: ignore[arg-type]
        wide = np.convolve(shade, np.ones(21) / 21, "valid")  # half floats are rounded
        kinks[normals] = float(np.abs(np.diff(wide, 2)).max())
        if normals == "computed":
            assert np.abs(np.diff(shade)).max() < 2e-3  # no step anywhere: the whole range is gone through evenly
    assert kinks["computed"] < 2e-4 < 5 * kinks["computed"] < kinks["derivatives"], kinks
    pixels = draw(s, device=device).pixels[12].astype(int)
    assert np.abs(np.diff(pixels, axis=0)).max() <= 1


def test_computed_slopes_follow_the_smooth_surface(device: Device, terrain: Terrain) -> None:
    """Over 20 cells at 20 pixels each: computed slopes are those of the analytic surface but for a hundredth or two;
    those stored at the vertices of a coarse mesh, and those of its facets, are off by times as much."""
    s = scene(terrain, 20.0)
    true = truth(s)
    off = {}
    for normals in ("computed", "stored", "derivatives"):
        shade = line(device, s.but(tolerance=25.0), normals)  # type: ignore[arg-type]
        a = np.stack([true, np.ones_like(true)], 1)
        fit, *_ = np.linalg.lstsq(a, shade, rcond=None)
        off[normals] = float(np.abs(shade - a @ fit).max() / abs(fit[0]))
    assert off["computed"] < 0.04, off
    assert off["stored"] > 1.5 * off["computed"] and off["derivatives"] > 2 * off["computed"], off


def test_stored_and_computed_agree_where_the_mesh_is_as_fine_as_the_data(device: Device, terrain: Terrain) -> None:
    s = scene(terrain, 20.0).but(tolerance=0.002)
    apart = np.abs(line(device, s, "stored") - line(device, s, "computed"))
    assert apart.max() < 0.03, apart.max()


@pytest.mark.parametrize("slow", [False, True])
def test_bytes_show_no_bands_far_beyond_a_sample(device: Device, terrain: Terrain, slow: bool) -> None:
    """A byte's step is spread: the mean of 16 × 8 pixels is what the light is there, not the nearest byte."""
    s = scene(terrain, 120.0)
    pixels = (draw_cpu(s) if slow else draw(s, device=device)).pixels[4:20, :, 1].astype(float)
    means = pixels.reshape(16, -1, 8).mean((0, 2))
    assert np.ptp(means) > 1.0  # bytes tell two or three steps
    assert (np.abs(np.diff(means)) < 0.005).mean() < 0.2


def blended(z: NDArray[np.float32], col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights between samples as a texture unit finds them, by the book: bilinear, weights in steps of 1/256."""
    col, row = (np.round(v * 256) / 256 for v in (col, row))
    i, j = np.floor(row).astype(int), np.floor(col).astype(int)
    f, g = col - j, row - i
    return (z[i, j] * (1 - f) + z[i, j + 1] * f) * (1 - g) + (z[i + 1, j] * (1 - f) + z[i + 1, j + 1] * f) * g


def sampled(s: Scene) -> NDArray[np.float64]:
    """The cosine of the sun's angle by heights half a pixel to every side of the middle row's pixels."""
    z = s.terrain.read(0, 0, SIDE, 0, SIDE)
    step = s.view.pixel_metres / METRES
    px = (np.arange(s.view.width) + 0.5 - s.view.width / 2) * step
    x, y = s.terrain.grid.index(*s.view.target[:2])
    col, row = float(x) + px, np.full_like(px, float(y) + 0.5 * step)
    gx = (blended(z, col + step / 2, row) - blended(z, col - step / 2, row)) / s.view.pixel_metres
    gy = (blended(z, col, row - step / 2) - blended(z, col, row + step / 2)) / s.view.pixel_metres
    to_sun, _, _ = illumination(s.lighting.sun)
    return (to_sun[2] - gx * to_sun[0] - gy * to_sun[1]) / np.sqrt(1 + gx**2 + gy**2)


@pytest.mark.parametrize("pixels_per_cell", [8.0, 60.0, 200.0])
def test_sampled_slopes_are_those_of_blended_heights(device: Device, terrain: Terrain, pixels_per_cell: float) -> None:
    s = scene(terrain, pixels_per_cell).but(tolerance=0.002)
    shade, book = line(device, s, "sampled"), sampled(s)
    known = book < 0.999  # (a slope at the rounding of a weight falls this way or that)
    a = np.stack([book, np.ones_like(book)], 1)[known]
    fit, *_ = np.linalg.lstsq(a, shade[known], rcond=None)
    off = np.abs(shade[known] - a @ fit) / abs(fit[0])
    assert np.median(off) < 0.01 and (off > 0.05).mean() < 0.06, (np.median(off), (off > 0.05).mean())
    # From far beyond a sample weights of 8 bits show: neighbours see the same two heights, or none between.
    jumps = {n: float(np.abs(np.diff(line(device, s, n))).max()) for n in ("sampled", "computed")}
    assert (jumps["sampled"] > 20 * jumps["computed"]) == (pixels_per_cell > 100), jumps


@pytest.mark.cases(3)
@pytest.mark.parametrize("turn", [0.0, 40.0, 200.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_sampled_slopes_know_their_direction(device: Device, turn: float, mirrored: bool) -> None:
    """A tilted plane on grids that are turned and mirrored is lit alike by every way of finding its slope."""
    transform = Affine.translation(EAST, NORTH) @ Affine.rotation(turn) @ Affine.scale(METRES, 20.0 if mirrored else -9)
    grid = Grid((SIDE, SIDE), transform, CRS.from_epsg(32632))
    x, y = grid.xy(*np.meshgrid(np.arange(SIDE), np.arange(SIDE)))
    plane = in_memory(Dem((300 + 0.4 * (x - EAST) - 0.2 * (y - NORTH)).astype(np.float32), grid))
    at = tuple(float(v) for v in grid.xy(SIDE / 2, SIDE / 2))
    s = scene(plane, 9.0)
    s = s.but(view=View((*at, 9000.0), (*at, 300.0), projection="plan", fov_y=2.0, width=60, height=24))
    found = {normals: line(device, s, normals) for normals in ("computed", "sampled", "derivatives")}  # type: ignore[arg-type]
    for shade in found.values():
        np.testing.assert_allclose(shade, np.median(found["computed"]), rtol=0.02)
