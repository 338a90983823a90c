"""Batches that stay on the GPU: only new ones are brought, and the picture is that of their triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
import plain
import pytest

from orograph.gpu.device import Device
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.lod.selection import TinBatches, TriangleMesh
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.surface.batches import INSTANCE, SAMPLE, TRIANGLE, Batches
from orograph.scene.camera import whole
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.viewpoint import Camera, View


def hills(gaps: float = 0.0) -> Any:
    return plain.terrain(plain.rough(np.random.default_rng(5), (257, 300), gaps=gaps))


def selects(t: Any, text: str, view: View) -> Any:
    method = chosen(text).make(t)
    return lambda tolerance: method.select(Camera.over(t.grid, view, 1.0), Goal(tolerance))


def drawn_by(device: Device, selection: Any) -> Any:
    """What the shader draws of a selection: places (n, 3, 3) of triangles, by a reading of its buffers."""
    samples = device.read_buffer(selection.vertices, np.uint8).view(SAMPLE)
    corners = device.read_buffer(selection.corners, np.uint32).reshape(-1, 3)
    parts = []
    for run in selection.runs:
        s = samples[run["vertex"] + corners[run["first"] : run["first"] + run["count"]]]
        between = s["between"].astype(np.int64)
        z = s["coarse"] + run["share"] * (s["height"] - s["coarse"])
        parts.append(
            np.stack([s["col"] + (between & 0xFFFF) / 65536, s["row"] + (between >> 16) / 65536, z.astype(float)], -1)
        )
    return np.concatenate(parts)


@pytest.mark.parametrize("text", ["bdam,legs=8", "bdam,legs=8,geomorph=yes", "chunked-lod,cells=16"])
def test_what_is_drawn_are_the_triangles_of_the_selection(device: Device, text: str) -> None:
    t = hills(0.002)
    select = selects(t, text, whole(t, (300, 200)))
    selection = select(1.5)
    made = Batches(device, 1 << 26).ready(selection, select)
    assert made.triangles == made.runs["count"].sum() == sum(len(b.triangles) for b in selection.batches)
    wanted = np.concatenate([batch.drawn[batch.triangles] for batch in selection.batches])
    np.testing.assert_allclose(drawn_by(device, made), wanted, rtol=2e-7, atol=2e-5)


def test_only_new_batches_are_brought(device: Device) -> None:
    t = hills()
    batches = Batches(device, 1 << 27)
    method = chosen("bdam,legs=8").make(t)
    known: dict[int, Any] = {}
    for k in range(6):
        view = whole(t, (300, 200))
        eye = (view.eye[0] + 40.0 * k, view.eye[1] + 60.0 * k, view.eye[2] - 30.0 * k)
        view = View(eye, view.target, width=300, height=200)
        selection = method.select(Camera.over(t.grid, view, 1.0), Goal(1.0))
        new = [one for one in selection.batches if known.get(id(one.vertices)) is not one.vertices]
        known |= {id(one.vertices): one.vertices for one in selection.batches}
        made = batches.ready(selection, lambda tolerance: selection)  # noqa: B023
        assert batches.sent == sum(SAMPLE.itemsize * len(b.vertices) + TRIANGLE * len(b.triangles) for b in new)
        assert made.runs.nbytes < INSTANCE.itemsize * (made.triangles / 64 + len(selection.batches) + 1)
        assert (batches.sent == 0) == (not new) and (k == 0 or len(new) < len(selection.batches) / 2)


def test_a_full_pool_begins_anew_and_what_does_not_fit_is_coarser(device: Device) -> None:
    t = hills()
    select = selects(t, "bdam,legs=8", whole(t, (600, 400)))
    fine, coarse = select(0.5), select(4.0)
    size = sum(len(one.triangles) for one in fine.batches) * 24
    batches = Batches(device, 3 * size)
    first = batches.ready(fine, select)
    rest = TinBatches(method="bdam", bound=None, batches=coarse.batches)
    for _ in range(2):
        again = batches.ready(rest, select)
    assert again.triangles == sum(len(one.triangles) for one in coarse.batches)
    small = Batches(device, size // 8)
    less = small.ready(fine, select)
    assert less.triangles < first.triangles / 2 and less.stats["tolerance"] > 0.5


@pytest.mark.cases(1)
@pytest.mark.parametrize("how", [{}, {"wireframe": True}, {"contours": Contours(50.0)}, {"normals": "faces"}])
@pytest.mark.parametrize("text", ["bdam,legs=8", "bdam,legs=8,geomorph=yes"])
def test_pictures_are_those_of_the_same_triangles(
    device: Device, monkeypatch: pytest.MonkeyPatch, text: str, how: dict[str, Any]
) -> None:
    """Welded and brought whole, as any method's are."""
    t = hills(0.001)
    scene = Scene.of(t, whole(t, (200, 140)), method=text, tolerance=1.5, samples=1, **how)
    ours = draw(scene, device=device)

    def welded(self: Any, selection: TinBatches, again: Any) -> TriangleMesh:
        mesh = selection.tessellation()
        return TriangleMesh(method=selection.method, bound=selection.bound, stats=mesh.stats, mesh=mesh)

    monkeypatch.setattr(Batches, "ready", welded)
    theirs = draw(scene, device=device)
    assert ours.facts["mesh"]["triangles"] == theirs.facts["mesh"]["triangles"]
    off = np.abs(ours.pixels.astype(int) - theirs.pixels.astype(int)).max(-1)
    assert off.mean() < 0.05 and (off > 2).mean() < 0.005
    assert (np.isfinite(ours.depth) == np.isfinite(theirs.depth)).mean() > 0.999
