"""Chunks that the GPU decodes: to the bit as the description has them, and drawn as the same chunks that are not."""

from __future__ import annotations

import time
from typing import Any

import chunk_reference as reference
import numpy as np
import plain
import pytest

from orograph.dem.raster import Dem
from orograph.gpu.device import Device, open_device
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.chunks import Chunks, Decoder
from orograph.scene.camera import whole
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.chunk_code import HEADER, decoded
from orograph.store.chunked import MISSING, Kind
from orograph.store.chunked_build import MemoryChunks
from orograph.viewpoint import Camera

SHAPES = [(65, 65), (100, 77), (33, 140), (3, 3), (2, 3)]
CODED = "chunked-lod,cells=16,compressed=yes"


@pytest.mark.stress
@pytest.mark.parametrize("how", ["usual", "portable"])
def test_meshes_are_those_of_the_description_to_the_bit(device: Device, how: str) -> None:
    own = open_device(portable=True) if how == "portable" else device
    decoder = Decoder(own)
    for shape in SHAPES if how == "usual" else SHAPES[1:2]:
        for gaps in (0.0, 0.06):
            chunks = MemoryChunks(
                plain.terrain(plain.rough(np.random.default_rng(shape), shape, gaps=gaps)), Kind(16, 0.0, True)
            )
            layout, levels = chunks.layout, range(chunks.layout.top + 1)
            names = [(k, i, j) for k in levels for i, j in np.ndindex(layout.chunks(k))]
            words = [chunks.words(*name) for name in names]
            made = [_plainly(one, layout, *name) for one, name in zip(words, names, strict=True)]
            ends = np.cumsum([(0, 0), *((len(v), len(t)) for v, t in made)], axis=0)
            vertices = own.buffer(20 * int(ends[-1, 0]), "STORAGE|COPY_SRC")
            triangles = own.buffer(12 * int(ends[-1, 1]), "STORAGE|COPY_SRC")
            places = [(v, t) for v, t in ends[:-1].tolist()]
            decoder.decode(layout, names, words, places, vertices, triangles)
            got_v, got_t = own.read_buffer(vertices, np.int32), own.read_buffer(triangles, np.uint32)
            wanted = [[MISSING if n is None else n for n in v] for one, _ in made for v in one]
            np.testing.assert_array_equal(got_v.reshape(-1, 5), wanted)
            corners = [[~n | 1 << 31 if n < 0 else n for n in t] for _, some in made for t in some]
            np.testing.assert_array_equal(got_t.reshape(-1, 3), corners)


@pytest.mark.stress
def test_large_chunks_are_decoded_whole(device: Device) -> None:
    """A chunk of 60,000 triangles."""
    chunks = MemoryChunks(plain.terrain(plain.rough(np.random.default_rng(1), (257, 257))), Kind(128, 0.01, True))
    name, layout = (chunks.layout.top, 0, 0), chunks.layout
    words = chunks.words(*name)
    mesh = decoded(words, layout, *name)
    assert (
        len(mesh.triangles) > 60_000 and words[HEADER.index("hung")] == 0
    )  # (one chunk, at whose sides the raster ends)
    buffers = [device.buffer(n, "STORAGE|COPY_SRC") for n in (20 * len(mesh.places), 12 * len(mesh.triangles))]
    Decoder(device).decode(layout, [name], [words], [(0, 0)], *buffers)
    got_v, got_t = (device.read_buffer(buffer, np.int32) for buffer in buffers)
    wanted = np.column_stack([mesh.places, mesh.heights, mesh.targets, mesh.low])
    np.testing.assert_array_equal(got_v.reshape(-1, 5), wanted)
    np.testing.assert_array_equal(got_t.reshape(-1, 3), mesh.triangles)


def _plainly(words: Any, layout: Any, level: int, i: int, j: int) -> Any:
    side = layout.side(level)
    return reference.decode(words, layout.shape, side, (i * side, j * side), layout.corners(level, i, j).tolist())


def hills(shape: tuple[int, int] = (301, 420)) -> Any:
    """Whole metres, a hole in them."""
    t = plain.terrain(np.rint(plain.rough(np.random.default_rng(4), shape, amplitude=400.0)), cell=20.0)
    z = t.heights.copy()
    z[100:110, 200:215] = np.nan
    return in_memory(Dem(z, t.grid))


@pytest.mark.parametrize(
    "how", [{}, {"wireframe": True}, {"contours": Contours(50.0)}, {"light": "raytraced", "rays": 2}]
)
def test_pictures_are_those_of_uncompressed_chunks(device: Device, how: dict[str, Any]) -> None:
    """Of whole metres nothing is lost but less than a step of what moves and of skirts."""
    t = hills()
    scene = Scene.of(t, whole(t, (200, 140)), method=CODED, tolerance=1.5, samples=1, **how)
    coded, plainly = (draw(scene.but(method=m), device=device) for m in (CODED, "chunked-lod,cells=16"))
    mesh = coded.facts["mesh"]
    assert mesh["height_error"] == 0 and mesh["chunks"] == plainly.facts["mesh"]["chunks"]
    assert mesh["triangles"] == plainly.facts["mesh"]["triangles"]
    off = np.abs(coded.pixels.astype(int) - plainly.pixels.astype(int)).max(-1)
    assert (off > 2).mean() < 0.01 and off.mean() < 0.2
    both = np.isfinite(coded.depth) & np.isfinite(plainly.depth)
    assert (np.isfinite(coded.depth) == np.isfinite(plainly.depth)).mean() > 0.999
    assert np.quantile(np.abs(coded.depth - plainly.depth)[both] / coded.depth[both], 0.99) < 1e-5


def test_the_cpu_draws_what_the_gpu_decodes(device: Device) -> None:
    t = hills()
    t = in_memory(Dem(t.read(0, 0, 301, 0, 420) * np.float32(1.037), t.grid))  # of no lattice
    scene = Scene.of(t, whole(t, (200, 140)), method=CODED, tolerance=3.0, samples=1)
    ours, theirs = draw(scene, device=device), draw_cpu(scene)
    assert ours.facts["mesh"]["triangles"] == theirs.facts["mesh"]["triangles"]
    assert 0 < ours.facts["mesh"]["height_error"] == theirs.facts["mesh"]["height_error"]
    both = np.isfinite(ours.depth) & np.isfinite(theirs.depth)
    assert np.quantile(np.abs(ours.depth - theirs.depth)[both] / ours.depth[both], 0.99) < 1e-4


def test_chunks_are_decoded_once_until_there_is_no_more_room(device: Device) -> None:
    t = hills()
    method = chosen(CODED).make(t)
    view = whole(t, (300, 200))

    def select(tolerance: float) -> Any:
        return method.select(Camera.over(t.grid, view, 1.0), Goal(tolerance))

    chunks = Chunks(device, 1 << 27)
    first = chunks.ready(select(4.0), select)
    used = first.meshes.used
    again = chunks.ready(select(4.0), select)
    assert again.meshes is first.meshes and again.meshes.used == used
    np.testing.assert_array_equal(again.runs, first.runs)
    finer = chunks.ready(select(0.5), select)
    assert finer.triangles == finer.stats["triangles"] > first.triangles
    assert (finer.runs["count"] <= 64).all() and finer.runs["count"].sum() == finer.triangles
    small = Chunks(device, 1 << 20)  # what does not fit is coarser
    less = small.ready(select(0.5), select)
    assert less.triangles < finer.triangles and less.stats["tolerance"] > 0.5
    room = small.most
    assert all(used <= most for used, most in zip(less.meshes.used, room, strict=True))


def test_frames_follow_the_camera(device: Device) -> None:
    t, size = hills(), (160, 100)
    renderer = Renderer(device, t)
    target = device.texture(size, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    scene = Scene.of(t, whole(t, size), method=CODED, tolerance=2.0, samples=1)
    first = renderer.draw(target, "rgba8unorm", scene)
    assert first.patches > 0 and not first.current  # patches stand in
    for _ in range(500):
        stats = renderer.draw(target, "rgba8unorm", scene)
        if stats.current:
            break
        time.sleep(0.02)
    assert stats.current and stats.patches == 0 and stats.triangles > 1000
    assert renderer.resident is not None and renderer.tree is None and renderer.mesh is None
    assert len(renderer.resident.tessellation().triangles) == pytest.approx(stats.triangles, rel=0.02)
    renderer.close()
