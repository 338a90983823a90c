"""Silhouettes against where they must be: a hemisphere's outline, the crease of a ridge that hides nothing, none on
plains, planes and the raster's border."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.rendering.cpu.draw import draw
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

EAST, NORTH = 500_000.0, 5_000_000.0
BLACK = Silhouettes(2.0, 1.0, (0.0, 0.0, 0.0))


def make(heights: NDArray[np.floating], metres: float) -> Terrain:
    transform = Affine(metres, 0, EAST, 0, -metres, NORTH)
    return in_memory(Dem(heights.astype(np.float32), Grid(heights.shape, transform, CRS.from_epsg(32632))))


def hemisphere(metres: float = 2.0, radius: float = 200.0) -> tuple[Terrain, NDArray[np.float64]]:
    """A hemisphere on a plain, and the sphere's centre."""
    row, col = np.mgrid[:601, :601] - 300
    away = np.hypot(row, col) * metres
    terrain = make(np.sqrt(np.maximum(radius**2 - away**2, 0.0)), metres)
    x, y = (float(v) for v in terrain.grid.xy(300, 300))
    return terrain, np.array([x, y, 0.0])


def inked(scene: Scene) -> NDArray[np.float64]:
    """How much of each pixel lines cover, by what they darken."""
    linear = []
    for lines in (None, scene.annotations.silhouettes):
        c = draw(scene.but(silhouettes=lines)).pixels / 255
        linear.append(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))
    return 1 - linear[1].sum(-1) / linear[0].sum(-1)


def plain(terrain: Terrain, view: View, lines: Silhouettes = BLACK, samples: int = 4) -> Scene:
    return Scene.of(
        terrain, view, light="none", colormap="grey", water=None, samples=samples, tolerance=0.0, silhouettes=lines,
    )  # fmt: skip


@pytest.mark.parametrize("samples", [1, 4])
def test_a_hemisphere_has_its_outline(samples: int) -> None:
    """Rays that touch the sphere lie on a cone about its centre; where they touch above the plain there is a line, its
    middle less than half a pixel away, and none elsewhere."""
    terrain, centre = hemisphere()
    eye = centre + np.array([0.0, -900.0, 420.0])
    view = View(tuple(eye), tuple(centre), fov_y=36, width=300, height=240)
    lines = replace(BLACK, creases=0.0)  # which go on for some pixels where the sphere meets the plain
    ink = inked(plain(terrain, view, lines, samples).but(depths=(5e3, 1e5)))  # no line is far away
    distance = float(np.linalg.norm(eye - centre))
    touch = 200.0**2 / distance  # of the circle's middle from the centre, towards the eye
    wide = np.sqrt(200.0**2 - touch**2)
    to_eye = (eye - centre) / distance
    across = np.array([1.0, 0.0, 0.0])
    above = np.cross(to_eye, across) * -1
    above = above if above[2] > 0 else -above
    turn = np.radians(np.linspace(-180, 180, 721))
    ring = centre + touch * to_eye + wide * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * above)
    seen = ring[ring[:, 2] > 12.0]  # above the plain, and well in front of it
    pixels, _ = view.project(seen)
    rows, cols = np.nonzero(ink > 0.08)
    away = np.array([np.hypot(*(pixels - [c + 0.5, r + 0.5]).T).min() for r, c in zip(rows, cols, strict=True)])
    low = rows > pixels[:, 1].max() + 1  # where the sphere meets the plain the line ends
    assert len(rows) > 200 and away[~low].max() < 2.2 and low.sum() < 25
    # Its middle: the mean place of ink along the outline's normal.
    off = []
    middle = view.project(centre + touch * to_eye)[0]
    for p in pixels[::9]:
        normal = (p - middle) / np.linalg.norm(p - middle)
        near = np.hypot(cols + 0.5 - p[0], rows + 0.5 - p[1]) < 4
        side = (cols[near] + 0.5 - p[0]) * normal[0] + (rows[near] + 0.5 - p[1]) * normal[1]
        bend = ((cols[near] + 0.5 - p[0]) * -normal[1] + (rows[near] + 0.5 - p[1]) * normal[0]) ** 2 / (
            2 * np.linalg.norm(p - middle)
        )
        off.append(np.average(side + bend, weights=ink[rows[near], cols[near]]))
    assert abs(np.mean(off)) < 0.3 and np.abs(off).max() < 0.7, (np.mean(off), np.abs(off).max())
    # As wide as asked.
    column = ink[: int(middle[1]), 150]
    assert column.sum() == pytest.approx(2.0, abs=0.35)


def ridge(steep: float, metres: float = 10.0) -> Terrain:
    """A smooth ridge from west to east through the raster's middle, steepest at ``steep`` on both flanks."""
    row = np.mgrid[:401, :401][0] - 200
    return make(steep * 600.0 * np.sqrt(np.e / 2) * np.exp(-((row * metres / 600.0) ** 2)), metres)


def test_a_ridge_that_hides_nothing_has_a_crease() -> None:
    """Its far flank is seen at 4° at least: the line lies where n · v is least along a column, by its closed form."""
    terrain = ridge(0.43)
    x, y = (float(v) for v in terrain.grid.xy(200, 200))
    view = View((x, y - 5400.0, 2900.0), (x, y, 0.0), fov_y=14, width=200, height=160)
    for samples in (1, 4):
        scene = plain(terrain, view, samples=samples).but(depths=(1e4, 1e5))
        assert inked(scene.but(silhouettes=replace(BLACK, creases=0.0))).max() < 0.02
        ink = inked(scene)
        north = np.linspace(0.0, 1500.0, 3001)
        height = 0.43 * 600.0 * np.sqrt(np.e / 2) * np.exp(-((north / 600.0) ** 2))
        fall = -2 * north / 600.0**2 * height
        at = np.stack([np.full(len(north), x), y + north, height], -1)
        to_eye = np.array(view.eye) - at
        facing = (to_eye[:, 2] - fall * to_eye[:, 1]) / np.linalg.norm(to_eye, axis=1) / np.sqrt(1 + fall**2)
        assert facing.min() > 0.02  # nothing is hidden
        row = view.project(at[facing.argmin()])[0][1]
        middle = ink[:, 60:140]
        found = (middle * (np.arange(160)[:, None] + 0.5)).sum(0) / middle.sum(0)
        assert middle.max(0).min() > 0.4
        assert np.abs(found - row).max() < 1.5, (found, row)
        assert np.ptp(found) < 0.6  # straight: it does not jump from pixel to pixel


@pytest.mark.stress
def test_gentle_ridges_have_no_crease_and_lines_come_by_degrees() -> None:
    """Tilting a camera by degrees changes how heavy the crease is by degrees, from nothing."""
    terrain = ridge(0.43)
    x, y = (float(v) for v in terrain.grid.xy(200, 200))
    weights = []
    for pitch in np.arange(26.0, 56.0, 1.0):
        a = np.radians(pitch)
        view = View((x, y - 6000 * np.cos(a), 6000 * np.sin(a)), (x, y, 0.0), fov_y=14, width=60, height=160)
        scene = plain(terrain, view, samples=4).but(depths=(1e4, 1e5))
        weights.append(inked(scene)[:, 20:40].sum(0).mean())
    assert weights[0] > 0.5 and max(weights[-10:]) < 0.02
    assert np.abs(np.diff(weights)).max() < 0.25, weights


def test_plains_and_borders_have_none() -> None:
    """A grazing view over waves that hide nothing and over a plane, up to the raster's end against the sky."""
    row, col = np.mgrid[:800, :800]
    flat, waves = make(0.02 * row, 20.0), make(1.5 * np.sin(row / 7.0) * np.sin(col / 9.0), 20.0)
    for terrain in (flat, waves):
        view = View((EAST + 8000, NORTH - 15_900, 260.0), (EAST + 8000, NORTH - 8000, 0.0), width=300, height=160)
        ink = inked(plain(terrain, view))
        assert (ink > 0.15).mean() < 0.002, (ink > 0.15).mean()


def askew() -> tuple[Terrain, View]:
    """Waves that hide nothing and end within the raster, as what was projected does; all of it from the south."""
    row, col = np.mgrid[:700, :700]
    ground = 1.5 * np.sin(row / 7.0) * np.sin(col / 9.0)
    u, v = (col - 350) * 0.995 + (row - 350) * 0.1, (row - 350) * 0.995 - (col - 350) * 0.1
    terrain = make(np.where(np.maximum(abs(u), abs(v)) < 300, ground, np.nan), 20.0)
    view = View(
        (EAST + 7000, NORTH - 32_000, 14_000.0), (EAST + 7000, NORTH - 7000, 0.0), fov_y=38, width=300, height=160
    )
    return terrain, view


def test_none_where_the_ground_ends_within_the_raster() -> None:
    assert (inked(plain(*askew())) > 0.15).mean() == 0


def test_lines_grow_faint_and_thin_with_distance_and_with_what_is_hidden() -> None:
    """Three walls, one behind the other; and a low one, hardly before the next ground."""
    row = np.mgrid[:1000, :300][0]
    z = np.zeros((1000, 300))
    for at, high in ((900, 60.0), (700, 150.0), (300, 500.0)):
        z[(row >= at - 2) & (row <= at + 2)] = high
    terrain = make(z, 20.0)
    view = View((EAST + 3000, NORTH - 19_900, 300.0), (EAST + 3000, NORTH - 10_000, 100.0), width=120, height=400)
    ink = inked(plain(terrain, view))[:, 60]
    lines = [
        ink[max(k - 3, 0) : k + 4].sum()
        for k in range(len(ink))
        if ink[k] > 0.1 and ink[k] == ink[max(k - 4, 0) : k + 5].max()
    ]
    assert len(lines) >= 3
    assert lines[-1] > 1.2 * lines[0]  # rows count downwards: the last is the nearest


def test_none_in_a_plan_and_the_same_in_tiles() -> None:
    terrain, centre = hemisphere()
    plan = View((*centre[:2], 2000.0), tuple(centre), projection="plan", width=120, height=100)
    assert np.abs(inked(plain(terrain, plan))).max() == 0
    view = View(tuple(centre + np.array([0.0, -900.0, 420.0])), tuple(centre), fov_y=36, width=320, height=240)
    whole = draw(plain(terrain, view)).pixels
    tile = draw(plain(terrain, view.tile(64, 32, 128, 112))).pixels
    assert np.array_equal(tile, whole[32:144, 64:192])


def test_what_makes_no_sense_is_refused() -> None:
    for wrong in ({"width": 0.0}, {"width": 99.0}, {"opacity": -1.0}, {"color": (0.0, 0.0)}, {"creases": 1.5}):
        with pytest.raises(UsageError):
            Silhouettes(**wrong)  # type: ignore[arg-type]
