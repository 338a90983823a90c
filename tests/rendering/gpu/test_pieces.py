"""Pieces of patches as instances: the picture is that of their triangles, and only new heights are brought."""

from __future__ import annotations

from typing import Any

import numpy as np
import plain
import pytest

from orograph.gpu.device import Device
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.lod.selection import PieceSet, TriangleMesh
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.surface.pieces import INSTANCE, Pieces
from orograph.scene.camera import whole
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.viewpoint import Camera, View

METHOD = "seamless-patches,segments=16"
MISSING = 1 << 20


def hills(shape: tuple[int, int] = (257, 300), gaps: float = 0.0) -> Any:
    return plain.terrain(plain.rough(np.random.default_rng(5), shape, gaps=gaps))


def selects(t: Any, view: View, text: str = METHOD) -> Any:
    method = chosen(text).make(t)
    return lambda tolerance: method.select(Camera.over(t.grid, view, 1.0), Goal(tolerance))


def turned(at: Any, turns: int, side: int) -> Any:
    for _ in range(turns):
        at = np.stack([at[..., 1], side - at[..., 0]], -1)
    return at


def drawn_by(device: Device, selection: Any, last: tuple[int, int]) -> Any:
    """What the shader draws of a selection: places (n, 3, 3) of triangles with an area, by a reading of its buffers."""
    heights = device.read_buffer(selection.vertices, np.float32)
    corners = device.read_buffer(selection.corners, np.uint32).reshape(-1, 3)
    parts = []
    for run in selection.runs:
        c = corners[run["first"] : run["first"] + run["count"]]
        p, big, turns = (int(run["how"]) >> k & 255 for k in (0, 8, 16))
        at = turned(np.stack([c >> 16 & 255, c >> 24], -1).astype(np.int64), turns, 1 << big)
        at = np.minimum((at << p >> big) + (run["row"], run["col"]), last)
        parts.append(np.concatenate([at[..., ::-1], heights[run["vertex"] + (c & 0xFFFF)][..., None]], -1))
    found = np.concatenate(parts)
    u, v = found[:, 1, :2] - found[:, 0, :2], found[:, 2, :2] - found[:, 0, :2]
    there = (u[:, 0] * v[:, 1] != u[:, 1] * v[:, 0]) & (found[..., 2].max(1) < MISSING / 2)
    return found[there]


@pytest.mark.parametrize("shape", [(257, 300), (65, 65), (33, 190)])
@pytest.mark.parametrize("gaps", [0.0, 0.01])
def test_what_is_drawn_are_the_triangles_of_the_selection(device: Device, shape: tuple[int, int], gaps: float) -> None:
    t = hills(shape, gaps)
    select = selects(t, whole(t, (300, 200)))
    selection = select(1.0)
    made = Pieces(device, MISSING, 1 << 26).ready(selection, select)
    ours, mesh = drawn_by(device, made, (shape[0] - 1, shape[1] - 1)), selection.tessellation()
    theirs = mesh.vertices[mesh.triangles]
    assert len(ours) == len(theirs) > 50
    key = [np.lexsort(one.reshape(-1, 9).T) for one in (ours, theirs)]
    np.testing.assert_array_equal(ours[key[0]], theirs[key[1]])


def test_only_new_pieces_are_brought(device: Device) -> None:
    t = hills()
    pieces, method = Pieces(device, MISSING, 1 << 27), chosen(METHOD).make(t)
    known: set[bytes] = set()
    for k in range(6):
        view = whole(t, (300, 200))
        eye = (view.eye[0] + 40.0 * k, view.eye[1] + 60.0 * k, view.eye[2] - 30.0 * k)
        view = View(eye, view.target, width=300, height=200)
        selection = method.select(Camera.over(t.grid, view, 1.0), Goal(1.0))
        names = [bytes((s,)) + one.tobytes() for s, one in zip(selection.shapes, selection.instances)]
        new = [name not in known for name in names]
        known |= set(names)
        made = pieces.ready(selection, lambda tolerance: selection)  # noqa: B023
        points = np.array([len(one.points) for one in method.topologies])
        shapes = sum(one.triangles.size for one in method.topologies) if k == 0 else 0
        assert pieces.sent == 4 * (int(points[selection.shapes[new]].sum()) + shapes)
        assert made.runs.nbytes <= INSTANCE.itemsize * (made.triangles / 64 + len(names))
        assert k == 0 or sum(new) < len(names) / 2


def test_a_full_pool_begins_anew_and_what_does_not_fit_is_coarser(device: Device) -> None:
    t = hills()
    select = selects(t, whole(t, (600, 400)))
    fine, coarse = select(0.5), select(4.0)
    points = np.array([len(one.points) for one in fine.topologies])
    size = 4 * int(points[fine.shapes].sum())
    pieces = Pieces(device, MISSING, size)
    first, last = pieces.ready(fine, select), (t.grid.rows - 1, t.grid.cols - 1)
    rest = pieces.ready(coarse, select)
    assert rest.vertices is not first.vertices
    assert len(drawn_by(device, rest, last)) == len(coarse.tessellation().triangles)
    assert len(drawn_by(device, first, last)) == len(fine.tessellation().triangles)  # a frame may still draw it
    less = Pieces(device, MISSING, size // 4).ready(fine, select)
    assert less.triangles < first.triangles / 2 and less.stats["tolerance"] > 0.5


def test_other_shapes_are_brought_anew(device: Device) -> None:
    t = hills()
    pieces, view = Pieces(device, MISSING, 1 << 26), whole(t, (300, 200))
    for text in (METHOD, "seamless-patches,segments=32", METHOD):
        select = selects(t, view, text)
        made = pieces.ready(select(1.0), select)
        assert len(drawn_by(device, made, (256, 299))) == len(select(1.0).tessellation().triangles)


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
