"""The ray caster as a surface, a surface in front of another, and places from depths."""

from __future__ import annotations

import meshes
import numpy as np
import pytest

from orograph.geovis.missing import patches
from orograph.raycast.caster import Caster
from orograph.rendering.cpu.raster import MeshSurface
from orograph.rendering.gbuffer import GBuffer, Mark, Surface
from orograph.rendering.layered import Layered
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.viewpoint import Camera

CAMERA = (41.0, 90.0, 2500.0, (41.0, 30.0, 800.0))


def projection(name: str = "rotated", exaggeration: float = 1.5, **given: object) -> Projection:
    g = meshes.grid(name)
    seen = meshes.seen_from(g, *CAMERA, **{"width": 170, "height": 110, **given})
    return Projection.of(Camera.over(g, seen, exaggeration))


def surfaces(p: Projection) -> list[Surface]:
    heights = meshes.hills()
    heights[20:24, 30:37] = np.nan
    caster = Caster.of(heights, 2)
    found = patches(caster.stack.windows, heights.shape)
    assert found is not None
    ground, over = RaySurface(caster, p), RaySurface(Caster(found, heights.shape, 1), p)
    return [ground, Layered(ground, over), Layered(MeshSurface(*meshes.full(heights), p), over)]


@pytest.mark.parametrize("kind", ["plan", "perspective"])
@pytest.mark.parametrize("which", range(3))
def test_areas_change_no_bit_and_positions_show_what_pixels_do(kind: str, which: int) -> None:
    surface = surfaces(projection(projection=kind))[which]
    whole = surface.draw((0, 110, 0, 170))
    assert np.isfinite(whole.depth).mean() > 0.2
    for top, bottom, left, right in ((5, 99, 63, 70), (0, 1, 169, 170)):
        part = surface.draw((top, bottom, left, right))
        for a, b in zip(layers(part), layers(whole), strict=True):
            assert a.depth.shape == a.objects.shape == a.marks.shape == (bottom - top, right - left)
            assert np.array_equal(a.depth, b.depth[top:bottom, left:right], equal_nan=True)
            assert np.array_equal(a.objects, b.objects[top:bottom, left:right])
            assert np.array_equal(a.marks, b.marks[top:bottom, left:right])
    py, px = np.mgrid[0:110:3, 0:170:7].reshape(2, -1)
    single = surface.at(px + 0.5, py + 0.5)
    for a, b in zip(layers(single), layers(whole), strict=True):
        np.testing.assert_allclose(a.depth, b.depth[py, px], rtol=1e-9)
        assert np.array_equal(a.objects >= 0, np.isfinite(a.depth))


def layers(buffer: GBuffer) -> list[GBuffer]:
    return [buffer] if buffer.over is None else [buffer, buffer.over]


def test_a_patch_is_a_second_layer_where_it_is_in_front() -> None:
    p = projection()
    ground, rays, mesh = surfaces(p)
    area = (0, 110, 0, 170)
    bare, one, other = ground.draw(area), rays.draw(area), mesh.draw(area)
    assert bare.over is None
    assert one.over is not None and other.over is not None
    assert np.array_equal(one.depth, bare.depth, equal_nan=True)
    void_filled = np.isfinite(one.over.depth)
    assert void_filled.sum() > 50
    assert not (one.over.depth[void_filled] >= bare.depth[void_filled]).any()
    assert np.array_equal(one.over.marks, np.where(void_filled, np.uint8(Mark.VOID_FILL), np.uint8(0)))
    assert (one.over.objects[~void_filled] == -1).all()
    # The mesh's edges are on the caster's, so only what lies on them can differ.
    assert (np.isfinite(other.over.depth) != void_filled).mean() < 1e-3
    assert rays.side == ground.side


@pytest.mark.parametrize("name", meshes.GRIDS)
@pytest.mark.parametrize("kind", ["plan", "perspective"])
def test_a_place_is_where_its_pixel_and_depth_are(name: str, kind: str) -> None:
    g = meshes.grid(name)
    view = meshes.seen_from(g, *CAMERA, projection=kind)
    rng = np.random.default_rng(2)
    place = rng.random((50, 3)) * [82, 60, 900]
    x, y = g.xy(place[:, 0], place[:, 1])
    pixels, depth = view.project(np.stack([x, y, place[:, 2]], -1), 2.0)
    for seen in (view, view.tile(5, 6, 20, 30)):
        p = Projection.of(Camera.over(g, seen, 2.0))
        np.testing.assert_allclose(p.place(pixels[:, 0], pixels[:, 1], depth), place, rtol=0, atol=1e-7)
        moved = (place - p.o) @ p.matrix().T
        if kind == "perspective":
            moved[:, :2] /= moved[:, 2:]
        np.testing.assert_allclose(moved, np.column_stack([pixels, depth]), rtol=0, atol=1e-6)
    assert np.isnan(p.place(pixels[:1, 0], pixels[:1, 1], np.array([np.nan]))).all()
