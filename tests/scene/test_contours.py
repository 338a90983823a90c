"""Contour lines of the CPU's pictures against where they must lie, on planes, cones, lakes; and the interval chosen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from scipy.ndimage import maximum_filter, minimum_filter

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.tables import Table
from orograph.memo import Memo
from orograph.rendering.cpu.draw import draw
from orograph.scene.contours import Contours, steepness, suitable
from orograph.scene.scene import Scene
from orograph.scene.theming import CASED, INK
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

METRES = 10.0


def make(heights: NDArray[np.floating]) -> Terrain:
    transform = Affine(METRES, 0, 500_000, 0, -METRES, 5_000_000)
    return in_memory(Dem(heights.astype(np.float32), Grid(heights.shape, transform, CRS.from_epsg(32632))))


def cone(side: int = 513, slope: float = 0.4) -> tuple[Terrain, tuple[float, float]]:
    """A cone 1000 m high about the middle of the raster, and its apex."""
    row, col = np.mgrid[:side, :side] - side // 2
    terrain = make(1000.0 - slope * METRES * np.hypot(row, col))
    x, y = (float(v) for v in terrain.grid.xy(side // 2, side // 2))
    return terrain, (x, y)


def cover(scene: Scene) -> NDArray[np.float64]:
    """How much darker contour lines make each pixel, as a part of what black lines would."""
    black = replace(scene.annotations.contours, color=(0.0, 0.0, 0.0), opacity=1.0, labels=False)
    without, with_ = (draw(scene.but(contours=c)).pixels for c in (None, black))
    linear = [np.where(p <= 10, p / 255 / 12.92, ((p / 255 + 0.055) / 1.055) ** 2.4) for p in (without, with_)]
    return 1 - linear[1].sum(-1) / linear[0].sum(-1)


def plain(terrain: Terrain, view: View, contours: Contours) -> Scene:
    return Scene.of(
        terrain, view, light="none", colormap="grey", water=None, samples=1, tolerance=0.0, contours=contours
    )  # fmt: skip


@pytest.mark.parametrize("standing", [False, True])
def test_lines_lie_where_the_cone_has_its_height(standing: bool) -> None:
    """In plan and in perspective: the centre of every line's coverage is less than half a pixel from the circle."""
    terrain, (x, y) = cone()
    if standing:
        view = View((x, y - 2500.0, 2600.0), (x, y - 700.0, 700.0), fov_y=30, width=300, height=220)
    else:
        view = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=40, width=300, height=220)
    scene = plain(terrain, view, Contours(100.0, 0))
    ink = cover(scene)
    angles = np.radians(np.arange(0, 360, 2.0))
    checked = 0
    for height in range(300, 1000, 100):
        radius = (1000.0 - height) / 0.4
        at = np.stack([x + radius * np.sin(angles), y + radius * np.cos(angles), np.full(len(angles), height)], -1)
        step = at + 1.0 * np.stack([np.sin(angles), np.cos(angles), np.full(len(angles), -0.4)], -1)
        (pixels, _), (beside, _) = view.project(at), view.project(step)
        for k in np.flatnonzero(((pixels > 12) & (pixels < [288, 208])).all(-1)):
            # Along the line of pixels (a row or a column) that crosses the contour most steeply.
            across = beside[k] - pixels[k]
            apart = np.linalg.norm(across) * 100 / 0.4
            if (
                apart < 14
                or (standing and angles[k] % (2 * math.pi) < math.pi / 2 + 0.5)
                or (standing and angles[k] > 1.5 * math.pi - 0.5)
            ):
                continue  # lines too close to be told apart, or on the side that is turned away
            axis = int(abs(across[1]) > abs(across[0]))
            other = int(pixels[k][1 - axis])
            c = pixels[k][axis]
            lo, hi = int(c) - 3, int(c) + 4
            line = ink[lo:hi, other] if axis else ink[other, lo:hi]
            # Where the circle itself passes this row or column, to first order along its tangent.
            tangent = np.array([-across[1], across[0]])
            t = (other + 0.5 - pixels[k][1 - axis]) / tangent[1 - axis] if abs(tangent[1 - axis]) > 1e-12 else 0.0
            true = pixels[k][axis] + t * tangent[axis]
            centre = float(((np.arange(lo, hi) + 0.5) * line).sum() / line.sum())
            assert line.sum() > 0.5 and abs(centre - true) < 0.5, (height, k, centre, true, line)
            checked += 1
    assert checked > 100


def test_lines_are_as_wide_as_asked_and_index_lines_twice() -> None:
    col = np.mgrid[:400, :400][1]
    terrain = make(col * METRES * 0.25 + 3.0)
    x, y = (float(v) for v in terrain.grid.xy(200, 200))
    view = View((x, y, 900.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=20, width=300, height=60)
    ink = cover(plain(terrain, view, Contours(20.0, 5, width=1.5))).mean(0)
    px = np.arange(300) + 0.5
    height = (x + (px - 150) * view.pixel_metres - float(terrain.grid.xy(0, 0)[0])) * 0.25 + 3.0
    for level in range(440, 580, 20):
        near = np.abs(height - level) < 0.25 * view.pixel_metres * 6
        assert ink[near].sum() == pytest.approx(3.0 if level % 100 == 0 else 1.5, abs=0.12), level


def test_level_ground_and_water_have_none() -> None:
    """A plain of exactly a contour's height, and a lake: no blot; its banks have their lines."""
    heights = np.full((300, 300), 200.0)
    heights[:, 150:] += np.arange(150) * 3.0
    terrain = make(heights)
    x, y = (float(v) for v in terrain.grid.xy(150, 150))
    view = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=20, width=200, height=160)
    ink = cover(plain(terrain, view, Contours(50.0)))
    assert ink[:, :95].max() < 0.02 and ink[:, 110:].max() > 0.9
    wet = cover(plain(terrain, view, Contours(50.0)).but(water=310.0))
    metres = (np.arange(200) + 0.5 - 100) * view.pixel_metres * 0.3 + 200
    assert wet[:, metres < 305].max() < 0.02 and wet[:, metres > 345].max() > 0.9


def test_the_interval_suits_relief_and_scale() -> None:
    terrain, (x, y) = cone()
    assert steepness(terrain) == pytest.approx(0.4, rel=0.02)
    far = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=40, width=300, height=220)
    found = [Contours().fitted(terrain, replace(far, fov_y=f), Memo()).interval for f in (40.0, 4.0, 0.4)]
    assert found[0] > found[1] > found[2] and all(
        v / 10 ** math.floor(math.log10(v)) == pytest.approx(round(v / 10 ** math.floor(math.log10(v)))) for v in found
    )
    assert {round(suitable(s, far) / 10 ** math.floor(math.log10(suitable(s, far)) + 1e-9)) for s in
            np.geomspace(0.01, 2, 40)} == {1, 2, 5}  # fmt: skip
    # On the steepest slopes lines stay apart by pixels, and not by many times as many as need be.
    for steep in np.geomspace(0.01, 2, 40):
        assert 2.5 < suitable(steep, far) / steep / far.pixel_metres < 10
    assert steepness(make(np.zeros((40, 40)))) > 0


def test_low_relief_has_some_lines_at_any_scale() -> None:
    terrain, (x, y) = cone()
    low, high = terrain.height_range
    for fov in (0.4, 4.0, 40.0, 120.0):
        view = View((x, y, 90_000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=fov, width=300, height=220)
        interval = Contours().fitted(terrain, view, Memo()).interval
        assert interval is not None and math.floor(high / interval) - math.floor(low / interval) >= 3
    assert suitable(0.5, view, 1.0) == pytest.approx(0.2) and suitable(0.5, view, 0.9) == pytest.approx(0.2)
    assert suitable(0.5, view, 0.0) == suitable(0.5, view)


@pytest.mark.parametrize("ground", ["#0a0614", "#21918c", "#fde725"])
def test_lines_with_a_casing_are_legible_over_any_color(ground: str) -> None:
    """Along them luminances of neighbouring pixels differ by a factor of 1.7 (as WCAG measures contrast)."""
    terrain, (x, y) = cone()
    rgb = bytes(int(ground[i : i + 2], 16) for i in (1, 3, 5))
    view = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=40, width=300, height=220)
    scene = Scene.of(terrain, view, light="none", water=None, colormap=Table("one", (rgb + b"\xff") * 2), tolerance=0.0)

    def contrast(casing: float | None) -> float:
        lines = Contours(200.0, index=0, labels=False, opacity=0.85, color=INK, casing=casing)
        srgb = draw(scene.but(contours=lines)).pixels / 255
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        light = linear @ [0.2126, 0.7152, 0.0722] + 0.05
        plain = np.abs(draw(scene).pixels.astype(int) - draw(scene.but(contours=lines)).pixels).max(-1) > 8
        most = maximum_filter(light, 5) / minimum_filter(light, 5)
        return float(np.median(most[plain]))

    assert contrast(CASED) > 1.7
    if ground == "#0a0614":
        assert contrast(None) > 1.7  # casings of their own, since the ground is dark


def test_large_pictures_have_lines_for_print() -> None:
    terrain, (x, y) = cone(65)
    view = View((x, y, 5000.0), (x, y, 0.0), projection="plan", width=4400, height=3300)
    fitted = Contours(10.0).fitted(terrain, view, Memo())
    assert fitted.width == 3.0 and fitted.type_size == 36.0 and fitted.step == 50.0
    tile = Contours(10.0).fitted(terrain, view.tile(0, 0, 64, 64), Memo())
    assert tile == fitted


def test_what_makes_no_sense_is_refused() -> None:
    for wrong in ({"interval": 0.0}, {"interval": math.nan}, {"index": -1}, {"width": 0.0}, {"opacity": 2.0},
                  {"color": (2.0, 0.0, 0.0)}):  # fmt: skip
        with pytest.raises(UsageError):
            Contours(**wrong)  # type: ignore[arg-type]
    terrain, _ = cone()
    view = View((0.0, 0.0, 9.0), (0.0, 1.0, 0.0))
    assert Scene.of(terrain, view, contours=None).annotations.contours is None
    assert Scene.of(terrain, view, contours=20).annotations.contours == Contours(20.0)


def test_lines_over_a_coarse_mesh_in_plan_are_those_without_one() -> None:
    terrain, (x, y) = cone()
    view = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=30, width=200, height=160)
    scene = plain(terrain, view, Contours(50.0))
    camera = View((x, y - 9000.0, 4000.0), (x, y, 0.0), width=64, height=48)
    bare, over = cover(scene), cover(scene.but(method="soar", tolerance=None, mesh_view=camera))
    assert bare.max() > 0.95
    np.testing.assert_allclose(over, bare, atol=0.02)


@pytest.mark.parametrize("wireframe", [False, True])
def test_lines_over_a_coarse_mesh_lie_where_the_terrain_has_their_height(wireframe: bool) -> None:
    """At a slant on a mesh that is pixels off: what is inked has a contour's height, to less than its half width."""
    terrain, (x, y) = cone()
    view = View((x, y - 5200.0, 3300.0), (x, y - 300.0, 700.0), fov_y=35, width=240, height=180)
    scene = plain(terrain, view, Contours(100.0, 0, labels=False, color=(0.0, 0.0, 0.0), opacity=1.0, width=2.0))
    scene = scene.but(method="soar", tolerance=6.0, wireframe=wireframe)
    without, with_ = (draw(scene.but(contours=c)) for c in (None, scene.annotations.contours))
    assert with_.facts["mesh"]["triangles"] < 400
    light = without.pixels.astype(int).sum(-1)
    inked = (with_.pixels.astype(int).sum(-1) < 0.3 * light) & (light > 200)
    o0, _, _, d0, du, dv = view.ray_basis()
    px, py = np.meshgrid(np.arange(240) + 0.5, np.arange(180) + 0.5)
    at = o0 + with_.depth[..., None] * (d0 + px[..., None] * du + py[..., None] * dv)
    height = 1000.0 - 0.4 * np.hypot(at[..., 0] - x, at[..., 1] - y)
    rate = np.hypot(*np.gradient(height))
    off = np.abs(height - 100.0 * np.round(height / 100.0)) / rate
    assert inked.sum() > 400
    assert np.quantile(off[inked], 0.98) < 1.2
    # The mesh's own heights are elsewhere: lines of those would not be the terrain's.
    assert np.nanmax(np.abs(at[..., 2] - height) / rate) > 3


def bowl(view: View, sides: int = 65, bend: float = 0.01) -> tuple[Terrain, NDArray[np.float64]]:
    """A paraboloid of revolution, and the heights (height, width) at which rays through the pixels' centres meet it."""
    row, col = np.mgrid[:sides, :sides] - sides // 2
    terrain = make(1000.0 - bend * METRES**2 * (row**2 + col**2))
    x, y = (float(v) for v in terrain.grid.xy(sides // 2, sides // 2))
    o0, ou, ov, d0, du, dv = view.ray_basis()
    px, py = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    o = o0 + px[..., None] * ou + py[..., None] * ov - [x, y, 0]
    d = d0 + px[..., None] * du + py[..., None] * dv
    # 1000 - bend·|o + t d|² = height: the first root.
    a = bend * (d[..., 0] ** 2 + d[..., 1] ** 2)
    b = 2 * bend * (o[..., 0] * d[..., 0] + o[..., 1] * d[..., 1]) + d[..., 2]
    c = bend * (o[..., 0] ** 2 + o[..., 1] ** 2) + o[..., 2] - 1000.0
    with np.errstate(invalid="ignore"):  # beyond the horizon
        t = 2 * c / (-b + np.sqrt(b * b - 4 * a * c))
    return terrain, np.asarray(o[..., 2] + t * d[..., 2])


@pytest.mark.parametrize("standing", [False, True])
def test_far_beyond_a_sample_lines_are_smooth(standing: bool) -> None:
    """A sample covers fifty pixels: lines are those of the surface, not of the triangles between its samples."""
    x, y = 500_000 + METRES * 32.5, 5_000_000 - METRES * 32.5
    if standing:
        view = View((x + 20.0, y - 130.0, 1030.0), (x, y - 50.0, 975.0), fov_y=30, width=300, height=220)
    else:
        view = View((x, y - 70.0, 2000.0), (x, y - 70.0, 0.0), projection="plan", fov_y=2.5, width=300, height=220)
    terrain, heights = bowl(view)
    ink = cover(plain(terrain, view, Contours(4.0, 0)))
    rate = np.hypot(*np.gradient(heights))
    away = np.abs(heights / 4.0 - np.round(heights / 4.0)) * 4.0 / rate  # pixels
    clear = (4.0 / rate > 8.0) & (rate < 2.0)
    clear[:2] = clear[-2:] = clear[:, :2] = clear[:, -2:] = False
    on, off = clear & (away < 0.2), clear & (away > 1.4)
    assert on.sum() > 300 and off.sum() > 10_000
    assert ink[on].min() > 0.5 and ink[off].max() < 0.1


def test_of_lines_that_run_together_nothing_is_left_on_ledges() -> None:
    """Steep ground of steps a few pixels wide, contours a pixel apart: no specks where a step is level."""
    row = np.mgrid[:400, :400][0]
    rough = np.random.default_rng(5).normal(0, 8.0, (400, 400))
    terrain = make(2000.0 - 0.7 * METRES * row + rough)
    x, y = (float(v) for v in terrain.grid.xy(200, 200))
    view = View((x, y, 9000.0), (x, y, 0.0), projection="plan", fov_y=20, width=220, height=220)
    ink = cover(plain(terrain, view, Contours(2 * view.pixel_metres * 0.7, 0)))
    assert ink.max() < 0.05 and ink.mean() < 1e-4


def test_ground_at_the_height_of_the_sea_has_no_outline() -> None:
    """A firth a sample or two wide, and a pond of a few samples, both at exactly 0 m: where water is drawn there is no
    line of 0 m around them and no label; a hollow below 0 m has its line."""
    row, col = np.mgrid[:120, :140].astype(np.float64)
    heights = 12.0 + 0.9 * np.abs(col - 60) + 0.3 * row
    heights[:, :45] = 0.0
    heights[30, 45:80] = heights[31, 60:70] = 0.0
    heights[60:62, 90:93] = 0.0
    heights[90:96, 90:96] = -8.0
    terrain = make(heights)
    x, y = (float(v) for v in terrain.grid.xy(70, 60))
    view = View((x, y, 5000.0), (x, y, 0.0), up=(0, 1, 0), projection="plan", fov_y=13.5, width=420, height=360)
    scene = plain(terrain, view, Contours(1000.0, 1)).but(water="auto")
    ink = cover(scene)
    picture = draw(scene)
    pixel_row, pixel_col = np.mgrid[:360, :420]
    at_col, at_row = terrain.grid.index(*picture.grid.xy(pixel_col.ravel(), pixel_row.ravel()))
    at_col, at_row = at_col.reshape(ink.shape), at_row.reshape(ink.shape)
    assert ink[at_row < 80].max() < 0.05
    hollow = (abs(at_row - 92.5) < 5) & (abs(at_col - 92.5) < 5)
    assert ink[hollow].max() > 0.8
    assert picture.facts["shader"]["contours"]["labels"] == 0
