"""Stages of a build that make derived data of a terrain whose heights (and what else they need) are written.

Each reads the store like any reader, using the record that the building process leaves in ``parts/``.
"""

from __future__ import annotations

import json
import math
import threading
from dataclasses import replace
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.error import KINDS, ErrorKind
from orograph.store.chunked import Kind, Words, lengths_spec, words_spec
from orograph.store.chunked_kind import rows_of, spooled
from orograph.store.digests import Digests, Spot
from orograph.store.executing import Found, ShardStage
from orograph.store.layout import Record, dumps
from orograph.store.parts import pack, unpack
from orograph.store.patches import LEGS, PatchErrors, spec, stored_levels
from orograph.store.places import HANDED, PARTS
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import StoredTerrain
from orograph.store.terrain import Heights
from orograph.store.writer import ShardWriter

if TYPE_CHECKING:
    from orograph.store.chunked_build import Reached

KNOWN = f"{HANDED}/record.json"
"""The current state of the store, for other processes."""

RUN = 1024
"""Chunks per task."""


class Written(NamedTuple):
    """Chunks of a task. Attributes: lengths: the word count of each. words: all words."""

    lengths: NDArray[np.int64]
    words: Words


LEVELS, FINEST = f"{HANDED}/levels", f"{HANDED}/finest.json"
"""Where workers find the levels of all vertices, and the error of level 0 with the number of vertices."""

CACHE = 64 << 20
"""Bytes of decoded chunks that a worker's terrain caches."""


def known(storage: Storage, keyed: bool) -> StoredTerrain:
    """The terrain of the store being built, as the building process left it; ``keyed``: see ``Digests``."""
    record = Record.from_json(json.loads(storage.get(KNOWN) or b"{}"), storage.url)
    return StoredTerrain(storage, replace(record, digests=Digests(record.digests.listed, keyed)), CACHE, 1)


class TerrainStage(ShardStage[Found]):
    """Work on a terrain.

    Args:
        terrain: what is written so far. writer: writes the results.
    """

    def __init__(self, terrain: StoredTerrain, writer: ShardWriter) -> None:
        self.terrain, self.writer = terrain, writer

    def hand_over(self) -> None:
        self.writer.keep(KNOWN, dumps(self.terrain.record.to_json()))

    def key(self, spot: Spot) -> str:
        return f"{PARTS}/{self.name}/{self.number}.{spot[0]}.{spot[1]}.part"


class PatchStage(TerrainStage[Heights]):
    """Errors of patches, for one kind of error.

    Args:
        kind: the kind of error; its diamonds are already written.
    """

    name, label = "patches", "Errors of patches"

    def __init__(self, terrain: StoredTerrain, writer: ShardWriter, kind: ErrorKind) -> None:
        super().__init__(terrain, writer)
        self.kind, self.number = kind, KINDS.index(kind)
        self.making = PatchErrors(terrain, terrain.derived("diamonds", error=kind), LEGS)

    def tasks(self) -> list[Spot]:
        return self.making.tasks()

    def make(self, spot: Spot) -> Heights:
        found = self.making.block(spot)
        self.writer.keep(self.key(spot), pack({"errors": found}))
        return found

    def found(self, spot: Spot, proof: bool = True) -> Heights | None:
        data = self.writer.storage.get(self.key(spot))
        try:
            return None if data is None else unpack(data)["errors"]
        except ValueError:
            return None

    def add(self, spot: Spot, found: Heights) -> None:
        self.making.take(spot, found)

    def finish(self) -> None:
        record, errors = self.terrain.record, self.making.finished()
        for level in stored_levels(record.grid.shape):
            self.writer.array(spec(record.grid.shape, level, self.kind, record.shard, record.chunk), errors[level])


class ChunkStage(TerrainStage[Written]):
    """Meshes of chunks. A task makes consecutive chunks of a level, row by row.

    Results wait in a temporary file until all are there. The building process computes the levels of all vertices
    (``Reached``, a byte each); workers map its file. Workers that build into a bucket compute them themselves.

    Args:
        kind: the kind of chunks. spool: the file where results wait; None if chunks are only made, not combined.

    Attributes:
        rows: rows of words by level, once the stage is finished.
    """

    name, label = "chunks", "Making chunks"

    def __init__(self, terrain: StoredTerrain, writer: ShardWriter, kind: Kind, spool: IO[bytes] | None = None) -> None:
        from orograph.store.chunked_build import MemoryChunks

        super().__init__(terrain, writer)
        self.chunks, self.spool = MemoryChunks(terrain, kind, None if spool is not None else self._handed()), spool
        self.rows: list[int] = []
        self._at: dict[Spot, tuple[int, int]] = {}
        self._lengths = [np.zeros(self._count(level), np.uint32) for level in range(self.chunks.layout.top + 1)]
        self._lock = threading.Lock()

    def hand_over(self) -> None:
        super().hand_over()
        error, levels = self.chunks.reached
        storage = self.writer.storage
        if isinstance(storage, FolderStorage):
            data: Any = levels.data
            storage.put(LEVELS, [data])
            storage.put(FINEST, [dumps({"error": error, "vertices": len(levels)})])

    def _handed(self) -> Reached | None:
        """The building process's results for this task."""
        from orograph.store.chunked_build import Reached

        storage = self.writer.storage
        if not isinstance(storage, FolderStorage) or (text := storage.get(FINEST)) is None:
            return None
        facts = json.loads(text)
        # (Copy-on-write: for read-only arrays, kernels would be compiled once more.)
        levels: Any = np.memmap(storage.path / LEVELS, np.uint8, "c", shape=(int(facts["vertices"]),))
        return Reached(facts["error"], np.asarray(levels))

    def tasks(self) -> list[Spot]:
        levels = range(self.chunks.layout.top + 1)
        return [(level, run) for level in levels for run in range(-(-self._count(level) // RUN))]

    def make(self, spot: Spot) -> Written:
        level, _ = spot
        cols = self.chunks.layout.chunks(level)[1]
        found = [self.chunks.words(level, *divmod(at, cols)) for at in self._run(spot)]
        made = Written(np.array([len(words) for words in found], np.int64), np.concatenate(found))
        self.writer.keep(self.key(spot), pack(made._asdict()))
        return made

    def found(self, spot: Spot, proof: bool = True) -> Written | None:
        data = self.writer.storage.get(self.key(spot))
        try:
            return None if data is None else Written(**unpack(data))
        except ValueError:
            return None

    def add(self, spot: Spot, found: Written) -> None:
        assert self.spool is not None
        run = self._run(spot)
        self._lengths[spot[0]][run.start : run.stop] = found.lengths
        with self._lock:
            self._at[spot] = self.spool.tell(), found.words.nbytes
            self.spool.write(found.words.data)

    def finish(self) -> None:
        assert self.spool is not None
        layout, record = self.chunks.layout, self.terrain.record
        for level, lengths in enumerate(self._lengths):
            with spooled() as file:
                for spot in (spot for spot in self.tasks() if spot[0] == level):
                    at, size = self._at[spot]
                    self.spool.seek(at)
                    file.write(self.spool.read(size))
                count = rows_of(int(lengths.sum(dtype=np.int64)), record.chunk)
                file.truncate(4 * count * record.chunk)  # zeros after the last
                file.flush()
                block = np.memmap(file, np.uint32, "r", shape=(count, record.chunk))
                per_chunk = lengths_spec(layout, level, record.shard, record.chunk)
                self.writer.array(per_chunk, lengths.reshape(layout.chunks(level)))
                self.writer.array(words_spec(level, count, record.shard, record.chunk), block)
            self.rows.append(count)

    def _count(self, level: int) -> int:
        """Chunks of a level."""
        return math.prod(self.chunks.layout.chunks(level))

    def _run(self, spot: Spot) -> range:
        """The numbers of a task's chunks."""
        level, run = spot
        return range(run * RUN, min((run + 1) * RUN, self._count(level)))
