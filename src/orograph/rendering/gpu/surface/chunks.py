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
from orograph.rendering.gpu.surface import resident
from orograph.rendering.gpu.surface.resident import ROOM, ResidentMeshes, RunPass
from orograph.store.chunk_code import HEADER, runs_of
from orograph.store.chunked import DEPTH, MET, ONES, PARTS, RAW, Layout, Words

CHUNK = np.dtype([("words", "<u4"), ("row", "<i4"), ("col", "<i4"), ("kind", "<u4")])
"""A chunk to be decoded: ``Chunk`` of ``shaders/chunk_code.wgsl``."""

PIECE = np.dtype(
    [("chunk", "<u4"), ("words", "<u4"), ("vertex", "<u4"), ("triangle", "<u4"), ("fringe", "<u4"), ("base", "<u4")]
)
"""A run of it: ``Run`` there."""

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

THREADS = 64
"""Of a workgroup; each decodes a run."""

VERTEX, TRIANGLE = 20, 12
"""Bytes."""

COARSER = 1.25
"""Factor by which a tolerance grows until its chunks fit."""

VERTICES, TRIANGLES, EDGES = (HEADER.index(name) for name in ("vertices", "triangles", "hung"))
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
    """Decodes chunks on a device (``shaders/chunk_code.wgsl``)."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._program = Program(
            device, "chunk_code", PARTS=PARTS, ONES=ONES, RAW=RAW, DEPTH=DEPTH, MET=MET, THREADS=THREADS
        )
        self._pipeline: Any = None

    def decode(
        self, layout: Layout, names: Sequence[tuple[int, int, int]], coded: Sequence[Words],
        places: Sequence[tuple[int, int]], vertices: Any, triangles: Any,
    ) -> None:  # fmt: skip
        """Have chunks decoded into two buffers.

        Args:
            names, coded: the chunks and their words. places: the numbers of their first vertices and triangles.
        """
        if not len(coded):
            return
        ends = np.cumsum([len(words) for words in coded])
        for share in np.split(
            np.arange(len(coded)), np.flatnonzero(np.diff(4 * ends // (self.device.largest // 2))) + 1
        ):
            some = share.tolist()
            group, count = self.prepare(
                layout,
                [names[k] for k in some],
                [coded[k] for k in some],
                [places[k] for k in some],
                vertices,
                triangles,
            )
            encoder = self.device.handle.create_command_encoder()
            self.record(encoder, group, count)
            self.device.queue.submit([encoder.finish()])

    def prepare(
        self, layout: Layout, names: Sequence[tuple[int, int, int]], coded: Sequence[Words],
        places: Sequence[tuple[int, int]], vertices: Any, triangles: Any,
    ) -> tuple[Any, int]:  # fmt: skip
        """Bring what is to be decoded to the device. Args: as of ``decode``. Returns: a bind group, how many runs."""
        if self._pipeline is None:
            self._pipeline = self._program.compute()
        words = np.concatenate([*coded, np.zeros(2, np.uint32)])
        begins = np.cumsum([0, *map(len, coded[:-1])])
        chunks, pieces = pieces_of(layout, names, words, begins, places)
        bound = {
            "chunks": self.device.buffer(chunks, "STORAGE", "chunks to decode"),
            "runs": self.device.buffer(pieces, "STORAGE", "runs to decode"),
            "coded": self.device.buffer(words, "STORAGE", "coded chunks"),
            "vertices": vertices, "triangles": triangles,
        }  # fmt: skip
        return self._program.bind(bound), len(pieces)

    def record(self, encoder: Any, group: Any, count: int, times: int = 1) -> None:
        """Record the decoding of what was prepared; more than once to measure it."""
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, group)
        for _ in range(times):
            pass_.dispatch_workgroups(-(-count // THREADS))
        pass_.end()


def pieces_of(
    layout: Layout, names: Sequence[tuple[int, int, int]], coded: Words, begins: NDArray[np.int64],
    places: Sequence[tuple[int, int]],
) -> tuple[NDArray[Any], NDArray[Any]]:  # fmt: skip
    """What the shader is told of chunks (``CHUNK``; the raster's last row and column first), and of their runs.

    Args:
        coded: the words of all. begins: where each chunk's begin. places: the numbers of their first vertices and
            triangles.
    """
    chunks = np.zeros(1 + len(names), CHUNK)
    chunks[0]["row"], chunks[0]["col"] = (side - 1 for side in layout.shape)
    rows = chunks[1:]
    level, i, j = np.array(names).T
    rows["words"], rows["row"], rows["col"] = begins, i << (layout.p + level), j << (layout.p + level)
    ends = np.array([[_ends(layout, a, b) for b in (0, 1)] for a in (0, 1)])
    rows["kind"] = layout.p + level | ends[i & 1, j & 1] << 8

    of, words, table = runs_of(coded, begins, layout.levels(0) + 2 * level)
    before = np.cumsum(table, 0) - table
    before -= before[np.searchsorted(of, np.arange(len(names)))[of]]  # in the same chunk
    pieces = np.zeros(len(of), PIECE)
    vertex, triangle = np.array(places).T
    pieces["chunk"], pieces["words"] = of + 1, words
    pieces["base"], pieces["vertex"] = vertex[of], vertex[of] + before[:, 1]
    pieces["triangle"] = triangle[of] + before[:, 2]
    pieces["fringe"] = (triangle + coded[begins + TRIANGLES])[of] + 2 * before[:, 3]
    return chunks, pieces


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
        self.most = int(share * 0.54) // VERTEX, int(share * 0.46) // TRIANGLE
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
        runs, of = resident.runs_of(INSTANCE, at[:, 1], counts)
        runs["vertex"] = at[of, 0]
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
