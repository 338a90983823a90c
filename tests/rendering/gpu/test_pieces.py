"""Pieces of patches as instances: the picture is that of their triangles, and heights are those of the atlas."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import plain
import pytest

from orograph.errors import StoreError
from orograph.gpu.device import Device
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.lod.selection import PieceSet, TriangleMesh
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream import residency
from orograph.rendering.gpu.stream.residency import Residency
from orograph.rendering.gpu.stream.tiles import MISSING
from orograph.rendering.gpu.surface.pieces import INSTANCE, Pieces
from orograph.scene.camera import whole
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.viewpoint import Camera, View

METHOD = "seamless-patches,segments=16"


def hills(shape: tuple[int, int] = (257, 300), gaps: float = 0.0, amplitude: float = 80.0) -> Any:
    return plain.terrain(plain.rough(np.random.default_rng(5), shape, gaps=gaps, amplitude=amplitude))


def selects(t: Any, view: View, text: str = METHOD) -> Any:
    method = chosen(text).make(t)
    return lambda tolerance: method.select(Camera.over(t.grid, view, 1.0), Goal(tolerance))


def turned(at: Any, turns: int, side: int) -> Any:
    for _ in range(turns):
        at = np.stack([at[..., 1], side - at[..., 0]], -1)
    return at


def tiles_of(device: Device, t: Any, budget: int = 1 << 24) -> Residency:
    return Residency(device, t, 2 * budget, 1 << 26, None)


def made(device: Device, tiles: Residency, selection: Any, select: Any) -> Any:
    """A selection ready to be drawn, its tiles there."""
    pieces = Pieces(device, tiles).ready(selection, select)
    assert tiles.hold(pieces.tiles, wait=True)
    return pieces


def atlas(device: Device, tiles: Residency) -> Any:
    """Tiles (slots, 257, 257) as they are on the GPU."""
    heights = tiles.heights.texture
    layers = np.stack([device.read_texture(heights, np.float32, 1, layer=k) for k in range(heights.size[2])])
    return layers.reshape(-1, 4, 257, 4, 257).swapaxes(2, 3).reshape(-1, 257, 257)


def drawn_by(device: Device, tiles: Residency, selection: Any, last: tuple[int, int]) -> Any:
    """What the shader draws of a selection: places (n, 3, 3) of triangles with an area, by a reading of its buffers."""
    stored, pages = atlas(device, tiles), tiles.heights.pages
    corners = device.read_buffer(selection.corners, np.uint32).reshape(-1, 3)
    parts = []
    for run in selection.runs:
        c = corners[run["first"] : run["first"] + run["count"]]
        p, big, turns, level = (int(run["how"]) >> k & 255 for k in (0, 8, 16, 24))
        at = turned(np.stack([c & 255, c >> 8], -1).astype(np.int64), turns, 1 << big)
        cell = (at << p >> big) + (run["row"], run["col"])
        tile = np.array((run["row"], run["col"])) >> level + 8
        page = int(pages[tiles.heights.tables.index((level, *tile.tolist()))])
        assert page > 0
        i, j = np.moveaxis((cell >> level) - tile * 256, -1, 0)
        z = stored[page - 1][i, j]
        parts.append(np.concatenate([np.minimum(cell, last)[..., ::-1], z[..., None]], -1))
    found = np.concatenate(parts)
    u, v = found[:, 1, :2] - found[:, 0, :2], found[:, 2, :2] - found[:, 0, :2]
    there = (u[:, 0] * v[:, 1] != u[:, 1] * v[:, 0]) & (found[..., 2].max(1) < MISSING / 2)
    return found[there]


@pytest.mark.parametrize("shape", [(257, 300), (65, 65), (33, 190), (700, 530)])
@pytest.mark.parametrize("gaps", [0.0, 0.01])
def test_what_is_drawn_are_the_triangles_of_the_selection(device: Device, shape: tuple[int, int], gaps: float) -> None:
    t = hills(shape, gaps)
    select = selects(t, whole(t, (300, 200)))
    selection, tiles = select(1.0), tiles_of(device, t)
    ours = drawn_by(device, tiles, made(device, tiles, selection, select), (shape[0] - 1, shape[1] - 1))
    mesh = selection.tessellation()
    theirs = mesh.vertices[mesh.triangles]
    assert len(ours) == len(theirs) > 30
    key = [np.lexsort(one.reshape(-1, 9).T) for one in (ours, theirs)]
    np.testing.assert_array_equal(ours[key[0]], theirs[key[1]])


def test_coarse_pieces_beside_a_large_hole_are_those_of_the_selection(device: Device) -> None:
    """Tiles of coarse levels fill holes smaller than a cell; no piece that is drawn takes such a height."""
    heights = plain.rough(np.random.default_rng(2), (513, 513), amplitude=40.0)
    heights[130:401, 100:333] = np.nan
    t = plain.terrain(heights)
    select = selects(t, whole(t, (300, 200)))
    selection, tiles = select(6.0), tiles_of(device, t)
    assert len(np.unique(selection.instances["level"])) > 3
    ours = drawn_by(device, tiles, made(device, tiles, selection, select), (512, 512))
    mesh = selection.tessellation()
    theirs = mesh.vertices[mesh.triangles]
    key = [np.lexsort(one.reshape(-1, 9).T) for one in (ours, theirs)]
    np.testing.assert_array_equal(ours[key[0]], theirs[key[1]])


def test_a_frame_brings_new_tiles_and_runs_only(device: Device) -> None:
    t = hills((520, 600))
    tiles, method = tiles_of(device, t), chosen(METHOD).make(t)
    pieces, known = Pieces(device, tiles), {tiles.heights.tables.total - 1}
    for k in range(4):
        view = whole(t, (300, 200))
        target = (view.target[0] + 4000.0 * (k - 2), view.target[1], view.target[2])
        view = View((target[0], target[1] - 3000.0, 1500.0), target, width=300, height=200)
        selection = method.select(Camera.over(t.grid, view, 1.0), Goal(1.0))
        ready = pieces.ready(selection, lambda tolerance: selection)  # noqa: B023
        assert pieces.sent == (4 * sum(one.triangles.size for one in method.topologies) if k == 0 else 0)
        assert ready.runs.nbytes <= INSTANCE.itemsize * (ready.triangles / 64 + len(selection.instances))
        tiles.came.clear()
        assert tiles.hold(ready.tiles, wait=True)
        new = set(ready.tiles.tolist()) - known
        assert {tiles.heights.tables.index(key) for key in tiles.came} == new
        known |= new


@pytest.mark.stress
def test_tiles_that_do_not_fit_make_it_coarser_and_others_make_room(device: Device) -> None:
    t = hills((1025, 1537), amplitude=2000.0)
    select = selects(t, whole(t, (600, 400)))
    tiles = tiles_of(device, t, 0)
    assert tiles.heights.capacity < tiles.heights.tables.total
    fine = select(0.5)
    ready = made(device, tiles, fine, select)
    assert len(ready.tiles) <= tiles.most_held and ready.stats["tolerance"] > 0.5
    assert ready.triangles < fine.stats["triangles"]
    assert len(drawn_by(device, tiles, ready, (1024, 1536))) == len(ready.tessellation().triangles)


def test_other_shapes_are_brought_anew(device: Device) -> None:
    t = hills()
    tiles, view = tiles_of(device, t), whole(t, (300, 200))
    for text in (METHOD, "seamless-patches,segments=32", METHOD):
        select = selects(t, view, text)
        drawn = drawn_by(device, tiles, made(device, tiles, select(1.0), select), (256, 299))
        assert len(drawn) == len(select(1.0).tessellation().triangles)


def test_while_tiles_come_the_frame_shows_what_was_there(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches, and then the last selection, until all tiles of the next one are there."""
    t = hills((520, 600), amplitude=1000.0)
    gate = threading.Event()
    make = residency.make_tile

    def late(*given: Any) -> Any:
        gate.wait(10)
        return make(*given)

    monkeypatch.setattr(residency, "make_tile", late)
    scene = Scene.of(t, whole(t, (200, 140)), method=METHOD, tolerance=1.0, samples=1)
    renderer = Renderer(device, t)
    target = device.texture((200, 140), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")

    def frames(until: Any) -> Any:
        for _ in range(2000):
            stats = renderer.draw(target.create_view(), "rgba8unorm", scene)
            if until(stats):
                return stats
            time.sleep(0.005)
        raise AssertionError(stats)

    selected = renderer._ground._selected
    stats = frames(lambda _: selected._coming is not None)
    assert stats.patches > 0 and not stats.current and renderer.busy
    gate.set()
    stats = frames(lambda one: one.current)
    assert stats.patches == 0 and stats.triangles > 1000
    gate.clear()
    scene = scene.but(tolerance=0.25)
    before = stats.triangles
    stats = frames(lambda one: one.current or selected._coming is not None)
    gate.set()
    assert stats.current or stats.triangles == before
    assert frames(lambda one: one.current).triangles > before
    renderer.close()


def test_a_tile_that_cannot_be_read_is_told(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches go on, and nothing is waited for."""
    t = hills((520, 600), amplitude=1000.0)
    make = residency.make_tile

    def broken(terrain: Any, kind: Any, key: Any) -> Any:
        if kind == "heights":
            raise StoreError("It is gone.")
        return make(terrain, kind, key)

    monkeypatch.setattr(residency, "make_tile", broken)
    scene = Scene.of(t, whole(t, (200, 140)), method=METHOD, tolerance=1.0, samples=1)
    renderer = Renderer(device, t)
    target = device.texture((200, 140), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    selected = renderer._ground._selected
    for _ in range(2000):
        stats = renderer.draw(target.create_view(), "rgba8unorm", scene)
        if selected.failure:
            break
        time.sleep(0.005)
    assert "It is gone." in stats.failed and stats.patches > 0 and not selected.busy
    with pytest.raises(StoreError, match="It is gone"):
        renderer.draw(target.create_view(), "rgba8unorm", scene, wait=True)
    renderer.close()


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    "how", [{}, {"wireframe": True}, {"contours": Contours(50.0, labels=False)}, {"normals": "faces"}]
)
@pytest.mark.parametrize("gaps", [0.0, 0.001])
def test_pictures_are_those_of_the_same_triangles(
    device: Device, monkeypatch: pytest.MonkeyPatch, gaps: float, how: dict[str, Any]
) -> None:
    """Welded and brought whole, as any method's are: the same to the pixel."""
    t = hills(gaps=gaps)
    scene = Scene.of(t, whole(t, (200, 140)), method=METHOD, tolerance=1.5, samples=1, **how)
    ours = draw(scene, device=device)

    def welded(self: Any, selection: PieceSet, again: Any) -> TriangleMesh:
        mesh = selection.tessellation()
        return TriangleMesh(method=selection.method, bound=selection.bound, stats=mesh.stats, mesh=mesh)

    monkeypatch.setattr(Pieces, "ready", welded)
    theirs = draw(scene, device=device)
    np.testing.assert_array_equal(ours.depth, theirs.depth)
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)
    assert ours.facts["mesh"]["triangles"] == theirs.facts["mesh"]["triangles"]
