"""Chunks of ``chunked-lod`` that the GPU decodes itself: their words are uploaded, a compute pass makes meshes of them.

The meshes stay there (``surface.resident``). A frame uploads only 20 bytes for every ``RUN`` triangles: a run of one
chunk's triangles, and how far its vertices have moved.

A vertex takes 20 bytes (row, column, height, height in the coarser mesh, the skirt's lower end), a triangle 12.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.lod.selection import CodedChunks
from orograph.rendering.gpu.surface.resident import ROOM, ResidentMeshes, RunPass, runs_of
from orograph.store.chunk_code import BLOCK, HEADER, Decoded, decoded, hung_edges
from orograph.store.chunked import PARTS, Layout, Words

JOB = np.dtype(
    [
        ("words", "<u4"), ("scratch", "<u4"), ("vertex", "<u4"), ("triangle", "<u4"), ("row", "<i4"), ("col", "<i4"),
        ("kind", "<u4"), ("spare", "<u4"),
    ]
)  # fmt: skip
"""A chunk to be decoded: ``Job`` of ``shaders/chunk_code.wgsl``."""

INSTANCE = np.dtype([("first", "<u4"), ("count", "<u4"), ("vertex", "<u4"), ("step", "<f4"), ("left", "<f4")])
"""A run of triangles: ``Run`` of ``shaders/chunk_draw.wgsl``."""

RUNS = {
    "array_stride": INSTANCE.itemsize,
    "step_mode": "instance",
    "attributes": [
        {"format": "uint32x3", "offset": 0, "shader_location": 0},
        {"format": "float32x2", "offset": 12, "shader_location": 1},
    ],
}

LARGE = 1 << 18, 1 << 22
"""Triangles above which a chunk is left to the CPU, on software and on hardware, because a workgroup would take long.
(And Mesa's software Vulkan silently ends a thread's loops after 65,535 iterations in total: here 10 for
every 64 triangles.)"""

SOFTWARE, HARDWARE = (64, 0), (256, 1)
"""Threads that decode a chunk, and how many consecutive triangles each takes at a time (0: its share of a level)."""

VERTEX, TRIANGLE, NODE = 20, 12, 32
"""Bytes."""

HUNG = np.uint32(1 << 31)
"""Marks a corner as the lower end of the skirt."""

SCRATCH = 32 << 20, 512 << 20
"""Bytes of scratch per dispatch, on software and on hardware, where dispatches wait for one another; the
last of its chunks may exceed it."""

COARSER = 1.25
"""Factor by which a tolerance grows until its chunks fit."""

VERTICES, TRIANGLES, EDGES, WIDEST = (HEADER.index(name) for name in ("vertices", "triangles", "hung", "widest"))
FLAGS = HEADER.index("flags")


@dataclass(slots=True, eq=False)
class Meshes:
    """Meshes in the GPU's memory.

    Attributes:
        source: the source of the chunks. vertices, triangles: the buffers. room: their capacities.
        used: the used part. places: by a chunk's name, the numbers of its first vertex and triangle.
    """

    source: Any
    vertices: Any
    triangles: Any
    room: tuple[int, int]
    used: tuple[int, int] = (0, 0)
    places: dict[tuple[int, int, int], tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DecodedChunks(ResidentMeshes):
    """Chunks whose meshes are on the GPU.

    Attributes:
        meshes: the pool that holds them.
    """

    meshes: Meshes


class Decoder:
    """Decodes chunks on a device (``shaders/chunk_code.wgsl``); very large ones on the CPU."""

    def __init__(self, device: Device) -> None:
        self.device = device
        software = device.adapter.software
        threads, run = SOFTWARE if software else HARDWARE
        self._large, scratch = (of[0 if software else 1] for of in (LARGE, SCRATCH))
        self._scratch = min(scratch, device.largest // 2)
        self._program = Program(device, "chunk_code", BLOCK=BLOCK, PARTS=PARTS, THREADS=threads, RUN=run)
        self._pipeline: Any = None

    def decode(
        self, layout: Layout, names: Sequence[tuple[int, int, int]], coded: Sequence[Words],
        places: Sequence[tuple[int, int]], vertices: Any, triangles: Any,
    ) -> None:  # fmt: skip
        """Have chunks decoded into two buffers.

        Args:
            names, coded: the chunks and their words. places: the numbers of their first vertices and triangles.
        """
        if self._pipeline is None:
            self._pipeline = self._program.compute()
        jobs: list[tuple[int, int]] = []
        size = 0
        for k, words in enumerate(coded):
            if int(words[TRIANGLES]) > self._large:
                self._on_cpu(decoded(words, layout, *names[k]), places[k], layout, names[k], vertices, triangles)
                continue
            jobs.append((k, size))
            size += -(-(int(words[VERTICES]) - 4) // BLOCK) + 2 * int(words[WIDEST]) * NODE // 4
            if 4 * size > self._scratch:
                self._dispatch(jobs, size, layout, names, coded, places, vertices, triangles)
                jobs, size = [], 0
        if jobs:
            self._dispatch(jobs, size, layout, names, coded, places, vertices, triangles)

    def _dispatch(
        self, jobs: list[tuple[int, int]], size: int, layout: Layout, names: Sequence[tuple[int, int, int]],
        coded: Sequence[Words], places: Sequence[tuple[int, int]], vertices: Any, triangles: Any,
    ) -> None:  # fmt: skip
        """Decode some chunks. ``jobs``: their numbers and the offsets of their scratch; ``size``: its words."""
        which, scratch = np.array(jobs).T
        some = [coded[k] for k, _ in jobs]
        table = np.zeros(1 + len(jobs), JOB)
        table[0]["row"], table[0]["col"] = (side - 1 for side in layout.shape)
        rows = table[1:]
        rows["words"] = np.cumsum([0, *map(len, some[:-1])])
        rows["scratch"] = scratch
        rows["vertex"], rows["triangle"] = np.array(places)[which].T
        level, i, j = np.array(names)[which].T
        side = layout.side(level)
        rows["row"], rows["col"] = i * side, j * side
        ends = np.array([[_ends(layout, a, b) for b in (0, 1)] for a in (0, 1)])
        rows["kind"] = layout.p + level | ends[i & 1, j & 1] << 8
        bound = {
            "jobs": self.device.buffer(table, "STORAGE", "chunks to decode"),
            "coded": self.device.buffer(np.concatenate([*some, np.zeros(2, np.uint32)]), "STORAGE", "coded chunks"),
            "scratch": self.device.buffer(4 * size, "STORAGE", "nodes of chunks"),
            "vertices": vertices, "triangles": triangles,
        }  # fmt: skip
        encoder = self.device.handle.create_command_encoder()
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, self._program.bind(bound))
        pass_.dispatch_workgroups(len(jobs))
        pass_.end()
        self.device.queue.submit([encoder.finish()])

    def _on_cpu(
        self, mesh: Decoded, place: tuple[int, int], layout: Layout, name: tuple[int, int, int], vertices: Any,
        triangles: Any,
    ) -> None:  # fmt: skip
        """Upload a chunk that the CPU decoded."""
        rows = np.column_stack([mesh.places, mesh.heights, mesh.targets, mesh.low]).astype(np.int32)
        p, q = hung_edges(mesh, layout, *name).astype(np.uint32).T
        skirt = np.stack([q, p, p | HUNG, q, p | HUNG, q | HUNG], 1).reshape(-1, 3)
        corners = np.concatenate([mesh.triangles.astype(np.uint32), skirt])
        self.device.queue.write_buffer(vertices, place[0] * VERTEX, rows)
        self.device.queue.write_buffer(triangles, place[1] * TRIANGLE, corners)


def _ends(layout: Layout, i: int, j: int) -> int:
    """For a chunk of this row and column (only their parity counts), two bits for each corner: whether it lies at the
    end of the side, along rows and along columns."""
    side = layout.side(0)
    at_end = (layout.corners(0, i, j) - (i * side, j * side)) // side
    return int((at_end.reshape(-1) << np.arange(8)).sum())


class Chunks:
    """Uploads coded chunks to the GPU and has them decoded there.

    Args:
        most: bytes available for meshes; up to twice as many while frames still draw the last ones.
    """

    def __init__(self, device: Device, most: int) -> None:
        self.device = device
        share = min(most, 2 * device.largest)
        self.most = int(share * 0.45) // VERTEX, int(share * 0.55) // TRIANGLE
        self._decoder = Decoder(device)
        self._meshes: Meshes | None = None

    def ready(self, selection: CodedChunks, again: Callable[[float], CodedChunks]) -> DecodedChunks:
        """Return a selection on the GPU; coarser if memory does not hold it.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            StoreError: chunks cannot be read. DeviceLimitError: the device's memory is full.
        """
        heads, tolerance = self._heads(selection), float(selection.stats["tolerance"] or 0.25)
        while len(heads) > 4 and any(size > most for size, most in zip(_needed(heads), self.most, strict=True)):
            tolerance *= COARSER
            selection = again(tolerance)
            heads = self._heads(selection)
        meshes = self._made(selection, heads)
        at = np.array([meshes.places[name] for name in selection.names], np.int64).reshape(-1, 2)
        counts = heads[:, TRIANGLES] + (2 * heads[:, EDGES] if selection.skirts else 0)
        runs, of = runs_of(INSTANCE, at[:, 1], counts, at[:, 0])
        runs["step"] = 2.0 ** ((heads[of, FLAGS] & 255) - 64)
        runs["left"] = selection.left[of]
        return DecodedChunks(
            method=selection.method, bound=selection.bound, stats=selection.stats, meshes=meshes,
            vertices=meshes.vertices, corners=meshes.triangles, runs=runs, triangles=int(counts.sum()), given=selection,
        )  # fmt: skip

    def _heads(self, selection: CodedChunks) -> NDArray[np.int64]:
        found = np.array([words[: len(HEADER)] for words in selection.words], np.int64)
        return found.reshape(-1, len(HEADER))

    def _made(self, selection: CodedChunks, heads: NDArray[np.int64]) -> Meshes:
        """Return the pool with these meshes; missing ones are decoded."""
        meshes = self._meshes
        lacking = [k for k, name in enumerate(selection.names) if meshes is None or name not in meshes.places]
        needed = _needed(heads[lacking])
        if meshes is None or meshes.source is not selection.source or _over(meshes.used, needed, meshes.room):
            lacking = list(range(len(heads)))
            room = [min(max(2 * size, ROOM), most) for size, most in zip(_needed(heads), self.most, strict=True)]
            meshes = self._meshes = Meshes(
                selection.source, self.device.buffer(room[0] * VERTEX, "STORAGE|COPY_SRC", "vertices of chunks"),
                self.device.buffer(room[1] * TRIANGLE, "STORAGE|COPY_SRC", "triangles of chunks"), (room[0], room[1]),
            )  # fmt: skip
        sizes = np.stack([heads[lacking, VERTICES], heads[lacking, TRIANGLES] + 2 * heads[lacking, EDGES]], 1)
        ends = np.cumsum(sizes, 0) + np.array(meshes.used)
        names = [selection.names[k] for k in lacking]
        places = [(v, t) for v, t in (ends - sizes).tolist()]
        words = [selection.words[k] for k in lacking]
        self._decoder.decode(selection.layout, names, words, places, meshes.vertices, meshes.triangles)
        meshes.places.update(zip(names, places, strict=True))
        if len(ends):
            meshes.used = int(ends[-1, 0]), int(ends[-1, 1])
        return meshes


def _needed(heads: NDArray[np.int64]) -> tuple[int, int]:
    """Vertices and triangles of chunks, all skirts included."""
    return int(heads[:, VERTICES].sum()), int((heads[:, TRIANGLES] + 2 * heads[:, EDGES]).sum())


def _over(used: tuple[int, int], more: tuple[int, int], room: tuple[int, int]) -> bool:
    return used[0] + more[0] > room[0] or used[1] + more[1] > room[1]


class ChunkPass(RunPass):
    """Draws decoded chunks into depth and marks. Args: as for ``FacePass``."""

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "chunk_draw", camera, field, missing, RUNS, PARTS=PARTS)
