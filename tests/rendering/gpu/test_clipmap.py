"""Rings drawn out of toroidal textures: the triangles of the selection, and only new heights are brought."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import plain
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.geovis.layers import Layer
from orograph.gpu.device import Device
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.lod.selection import ClipRings, TriangleMesh
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream.image_tiles import ImageTiles
from orograph.rendering.gpu.surface import ground
from orograph.rendering.gpu.surface.clipmap import BLOCK, HeldRings, blocks_of, ready_of
from orograph.rendering.lookup import LEAST
from orograph.scene.camera import whole
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.viewpoint import Camera, View

MOST = 1 << 28


def hills(shape: tuple[int, int] = (600, 533), **how: Any) -> Any:
    return plain.terrain(plain.rough(np.random.default_rng(5), shape), **how)


def low(t: Any, col: float, row: float, size: tuple[int, int] = (240, 160)) -> View:
    """From a few cells above the ground, looking inwards."""
    ahead = col + (60 if col < 400 else -60), row + (25 if row < 400 else -25)
    (x, y), (u, v) = t.grid.xy(col, row), t.grid.xy(*ahead)
    top, spacing = t.height_range[1], max(t.grid.spacing)
    return View((float(x), float(y), top + 4 * spacing), (float(u), float(v), top - 9 * spacing), width=size[0],
                height=size[1])  # fmt: skip


def as_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the uploaded mesh in place of the rings."""

    def ready(selection: ClipRings, _: Any) -> TriangleMesh:
        mesh = selection.tessellation()
        return TriangleMesh(method=selection.method, bound=selection.bound, stats=mesh.stats, mesh=mesh)

    monkeypatch.setattr(ground, "ready_of", lambda shape, most: ready)


@pytest.mark.stress
@pytest.mark.parametrize(
    ("text", "how", "place"),
    [
        ("clipmap,n=63", {"wireframe": True}, (300, 200)),
        ("clipmap,n=63", {"contours": Contours(50.0), "normals": "faces"}, (3, 590)),
        ("clipmap,n=63,blend=no", {}, (531, 2)),
        ("clipmap,n=63,rings=promise", {}, (300, 200)),
    ],
)
def test_pictures_are_those_of_the_uploaded_mesh(
    device: Device, monkeypatch: pytest.MonkeyPatch, text: str, how: dict[str, Any], place: tuple[int, int]
) -> None:
    t = hills()
    scene = Scene.of(t, low(t, *place), method=text, tolerance=1.5, samples=1, **how)
    ours = draw(scene, device=device)
    as_triangles(monkeypatch)
    theirs = draw(scene, device=device)
    assert ours.facts["mesh"] | {"refine_ms": 0} == theirs.facts["mesh"] | {"refine_ms": 0}
    there = np.isfinite(theirs.depth)
    assert np.array_equal(np.isfinite(ours.depth), there) and there.mean() > 0.2
    np.testing.assert_allclose(ours.depth[there], theirs.depth[there], rtol=5e-6)
    off = np.abs(ours.pixels.astype(int) - theirs.pixels).max(-1)
    assert off.max() <= 1 and (off > 0).mean() < 1e-3  # (heights blend in single precision)


@pytest.mark.stress
def test_cells_need_not_be_square_nor_samples_many(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    for t in (hills((70, 400), stretch=1.8), hills((2, 90))):
        scene = Scene.of(t, whole(t, (120, 80)), method="clipmap,n=63", tolerance=0.5, samples=1)
        ours = draw(scene, device=device)
        with monkeypatch.context() as patched:
            as_triangles(patched)
            theirs = draw(scene, device=device)
        assert np.isfinite(ours.depth).any()
        np.testing.assert_allclose(ours.depth, theirs.depth, rtol=5e-6)


@pytest.mark.stress
def test_only_new_heights_are_brought_and_the_rest_stays_in_its_place(device: Device) -> None:
    t = hills()
    moving = Renderer(device, t)
    rings: Any = moving._ground.surfaces[HeldRings]
    method = chosen("clipmap,n=63").make(t)
    held: dict[int, Any] = {}
    for k in range(5):
        view = low(t, 200 + 9.7 * k + (150 if k == 3 else 0), 180 + 5.3 * k, (120, 80))
        scene = Scene.of(t, view, method="clipmap,n=63", tolerance=0.0, samples=1)
        ours = draw(scene, device=device, renderer=moving)
        selection = method.select(Camera.over(t.grid, view, 1.0), Goal(0.0))
        new = 0
        for w in selection.stack:
            now = np.zeros((1200, 1200), bool)
            now[w.row0 : w.row1, w.col0 : w.col1] = True
            new += int((now & ~held.get(w.level, np.zeros_like(now))).sum())
            held[w.level] = now
        assert rings.sent == 4 * new + 64 * len(selection.stack) + 12 * len(blocks_of(selection))
        assert np.array_equal(ours.pixels, draw(scene, device=device).pixels)
    moving.close()


def test_blocks_are_those_in_view_beside_the_hole() -> None:
    t = hills()
    selection = chosen("clipmap,n=63").make(t).select(Camera.over(t.grid, low(t, 300, 200), 1.0), Goal(0.0))
    found = {tuple(block) for block in blocks_of(selection).tolist()}
    wanted = set()
    for k, (w, seen) in enumerate(zip(selection.stack, selection.seen)):
        hole = selection.stack[k + 1].around(w.level) if k + 1 < len(selection.stack) else None
        for row in range(w.row0, w.row1 - 1):
            for col in range(w.col0, w.col1 - 1):
                i, j = row // BLOCK, col // BLOCK
                inner = hole and hole.row0 <= row < hole.row1 - 1 and hole.col0 <= col < hole.col1 - 1
                if not inner and seen[i - w.row0 // BLOCK, j - w.col0 // BLOCK]:
                    wanted.add((i, j, k))
    assert found == wanted


def test_what_splits_along_missing_ground_or_does_not_fit_is_drawn_as_triangles() -> None:
    t = hills()
    selection = chosen("clipmap,n=63").make(t).select(Camera.over(t.grid, low(t, 300, 200), 1.0), Goal(0.0))
    assert isinstance(ready_of(t.grid.shape, MOST)(selection, None), HeldRings)
    assert isinstance(ready_of(t.grid.shape, 1000)(selection, None), TriangleMesh)
    t = plain.terrain(plain.rough(np.random.default_rng(5), (200, 200), gaps=0.01))
    selection = chosen("clipmap,n=63").make(t).select(Camera.over(t.grid, whole(t, (99, 66)), 1.0), Goal(0.0))
    assert isinstance(ready_of(t.grid.shape, MOST)(selection, None), TriangleMesh)


def plane(tmp_path: Path) -> tuple[Any, Layer]:
    """A tilted plane, and a layer of random squares of eight pixels of 15 m over it."""
    rows, cols = np.mgrid[:600, :533]
    grid = Grid((600, 533), Affine(30.0, 0.0, 5e5, 0.0, -30.0, 4e6), CRS.from_epsg(32632))
    t = in_memory(Dem((0.1 * rows + 0.07 * cols).astype(np.float32), grid))
    colors = np.random.default_rng(2).integers(20, 230, (3, 150, 133), np.uint8).repeat(8, 1).repeat(8, 2)
    path, transform = tmp_path / "layer.tif", Affine(15.0, 0.0, 5e5, 0.0, -15.0, 4e6)
    with rasterio.open(
        path, "w", driver="GTiff", count=3, width=colors.shape[2], height=colors.shape[1], dtype="uint8",
        transform=transform, crs="EPSG:32632", tiled=True,
    ) as file:  # fmt: skip
        file.write(colors)
    return t, Layer(str(path))


@pytest.mark.stress
def test_a_layer_over_rings_blends_as_it_does_without_them(device: Device, tmp_path: Path) -> None:
    """On a plane rings change nothing but where triangles end: the colours may not show where that is."""
    t, layer = plane(tmp_path)
    view = low(t, 300, 200)
    how: dict[str, Any] = {"layers": (layer,), "light": "none", "samples": 1, "tolerance": 0.0}
    rings = draw(Scene.of(t, view, method="clipmap,n=63", **how), device=device)
    other = draw(Scene.of(t, view, method="chunked-lod", **how), device=device)
    selection = chosen("clipmap,n=63").make(t).select(Camera.over(t.grid, view, 1.0), Goal(0.0))
    assert len(selection.stack) > 3
    there = np.isfinite(rings.depth)
    assert np.array_equal(there, np.isfinite(other.depth)) and there.mean() > 0.2
    off = np.abs(rings.pixels.astype(int) - other.pixels).max(-1)[there]
    assert rings.pixels[there].std(axis=0).max() > 10 and (off > 2).mean() < 2e-3


@pytest.mark.stress
def test_colours_come_as_the_eye_moves_and_none_comes_twice(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under moving rings a frame brings the tiles that its view wants and the views before it did not."""
    t, layer = plane(tmp_path)
    came: list[int] = []
    read = ImageTiles.tile

    def tile(sheet: ImageTiles, place: int) -> Any:
        came.append(place)
        return read(sheet, place)

    monkeypatch.setattr(ImageTiles, "tile", tile)
    moving, held = Renderer(device, t), set[int]()
    for k in range(6):
        view = low(t, 60 + 35.0 * (k - k // 3), 80 + 20.0 * (k - k // 3), (120, 80))
        scene = Scene.of(
            t, view, method="clipmap,n=63", layers=(layer,), light="none", samples=1, tolerance=0.0, depths=(1.0, 1e5)
        )
        came.clear()
        ours = draw(scene, device=device, renderer=moving)
        (sheet,) = (held.sheet for held in moving.imagery._held.values())
        wanted = set(sheet.tree.of(view, 1.0, pixels=LEAST)[0].tolist())
        assert sorted(came) == sorted(wanted - held)
        assert came or k in (0, 3), k  # (the third view is drawn twice)
        held |= wanted
        off = np.abs(ours.pixels.astype(int) - draw(scene, device=device).pixels)
        assert off.max() <= 1  # (of a texel's place in the atlas)
    moving.close()
