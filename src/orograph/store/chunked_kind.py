"""Chunks' meshes as a kind of derived data: what a store records about them, and how to open, make and write them."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any

from orograph.errors import OutputError, StoreError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.chunked import Kind, Layout, lengths_spec, words_spec
from orograph.store.chunked_stored import StoredChunks
from orograph.store.derived import At, Attributes, Derived, Nodes

if TYPE_CHECKING:
    from orograph.store.chunked_build import MemoryChunks
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain


class ChunkedKind(Derived[dict[str, Any]]):
    """Meshes of chunks. Options: those of ``chunked.Kind``, as requested.

    A record holds these, the ``error`` of level 0 in metres, and for each level the ``rows`` of its words.
    """

    name, version, group = "chunked", 3, "chunked"

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        return {name: found[name] for name in (*Kind._fields, "error", "rows")}

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return what

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        layout = Layout(at.grid.shape, what["cells"])
        for level, rows in enumerate(what["rows"]):
            yield lengths_spec(layout, level, at.shard, at.chunk), {"long_name": "words that each chunk's mesh takes"}
            about = "meshes of chunks: splits, heights, skirts, corners"
            yield words_spec(level, rows, at.shard, at.chunk), {"long_name": about}

    def groups(self, what: dict[str, Any], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group

        nodes, data = super().groups(what, at)
        return {**nodes, self.group: group({name: what[name] for name in ("cells", "error", "compressed")})}, data

    def open(self, terrain: StoredTerrain, **options: Any) -> StoredChunks:
        found, kind = self.of(terrain.record), Kind(**options)
        if any(found.get(name) != value for name, value in kind._asdict().items()):
            raise StoreError(
                f"This store has no{' compressed' if kind.compressed else ''} chunks of {kind.cells} cells"
                + (f" and {kind.finest:g} m." if kind.finest else "."),
                path=terrain.url,
                remedy=f"Build it with them (`orograph.build(..., chunked={kind})`), or let the method make them.",
            )
        return StoredChunks(terrain, found)

    def compute(self, terrain: MemoryTerrain, **options: Any) -> MemoryChunks:
        from orograph.store.chunked_build import MemoryChunks

        return MemoryChunks(terrain, Kind(**options))


CHUNKED = ChunkedKind()


def rows_of(words: int, chunk: int) -> int:
    """Return the rows for this many words, at least one."""
    return max(1, -(-words // chunk))


@contextmanager
def spooled() -> Iterator[IO[bytes]]:
    """Open an unnamed temporary file.

    Raises:
        OutputError: the disk of temporary files is full.
    """
    try:
        with tempfile.TemporaryFile(prefix="orograph-") as file:
            yield file
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise OutputError(
            "There is no room for temporary data while chunks are made.", path=tempfile.gettempdir(),
            remedy="Set the environment variable TMPDIR to a folder on a larger disk.",
        ) from error  # fmt: skip
