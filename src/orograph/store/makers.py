"""How a build makes derived data, and a repair remakes them: tasks over shards, from what is already written.

Each maker writes the arrays of its kind and returns the record with them, or unchanged if the terrain cannot have any.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.progress import Progress
from orograph.store.chunked import Kind
from orograph.store.chunked_kind import CHUNKED, rows_of, spooled
from orograph.store.diamond_table import DIAMONDS, DiamondCodes
from orograph.store.executing import Executor
from orograph.store.layout import Record
from orograph.store.patches import KAPPA, LEGS, PATCHES
from orograph.store.quadtin_kind import QUADTIN
from orograph.store.quadtin_layout import DEPTHS, SIDE, lengths_spec, summary_spec, words_spec
from orograph.store.stored import CACHE_BYTES, StoredTerrain
from orograph.store.terrain import diamond_shape, exponent
from orograph.store.tin_kind import TINS
from orograph.store.tins import marks_spec, octaves, table_spec
from orograph.store.tins import stored_levels as stored_tin_levels
from orograph.store.writer import ShardWriter


class Work(NamedTuple):
    """How derived data are made.

    Attributes:
        errors: the requested kinds of errors.
        writer: writes shards; all heights, means and tables are written.
        jobs: threads. executor: runs the work by shard. progress: receives progress.
        tins: segments along a leg of the finest patches, above which TINs are made; None: no TINs.
        chunked: the kind of chunks whose meshes are made; None: none.
        quadtin: error in metres and splitting of the QuadTIN; None: none.
    """

    errors: tuple[ErrorKind, ...]
    writer: ShardWriter
    jobs: int
    executor: Executor
    progress: Progress
    tins: int | None = None
    chunked: Kind | None = None
    quadtin: tuple[float, str] | None = None

    def terrain(self, record: Record) -> StoredTerrain:
        """The terrain as written so far."""
        return StoredTerrain(self.writer.storage, record, CACHE_BYTES, 1)


def make_diamonds(record: Record, work: Work) -> Record:
    """Errors and spheres of all diamonds."""
    from orograph.store.survey import Errors
    from orograph.store.survey_groups import ErrorGroups

    if not work.errors:
        return record
    first = work.terrain(record).tiles(0)
    sizes = record.shard, record.chunk
    survey = Errors(record.grid, work.writer, *sizes, first, work.errors, record.coding)
    levels = work.executor.groups(survey.name, record.grid.shape, record.shard)
    work.executor.run(ErrorGroups(survey, levels) if levels else survey, work.progress)
    return DIAMONDS.put(record, DiamondCodes(survey.codes, survey.radius))


def make_patches(record: Record, work: Work) -> Record:
    """Errors of patches, from those of diamonds."""
    from orograph.store.derived_stages import PatchStage

    shape = record.grid.shape
    if not work.errors or np.isnan(record.height_range[0]) or 1 << exponent(shape) <= LEGS:
        return record
    terrain = work.terrain(record)
    for kind in work.errors:
        work.executor.run(PatchStage(terrain, work.writer, kind), work.progress)
    return PATCHES.put(record, {"legs": LEGS, "kappa": KAPPA, "errors": list(work.errors)})


def make_tins(record: Record, work: Work) -> Record:
    """TINs of patches, from heights; their marks wait in temporary files."""
    shape, legs = record.grid.shape, work.tins
    if legs is None or np.isnan(record.height_range[0]) or 1 << exponent(shape) <= legs:
        return record
    from orograph.store.tin_build import made_by
    from orograph.store.tin_stage import Bands

    terrain = work.terrain(record)
    found = made_by(terrain, legs, Bands(terrain, work.writer, legs, work.executor), work.progress)
    for level in stored_tin_levels(shape, legs):
        rows, cols = diamond_shape(shape, level)
        for name, values in zip(("error", "radius"), found.read(level, 0, rows, 0, cols)):
            work.writer.array(table_spec(shape, level, name, record.shard, record.chunk), values)
    for octave in octaves(shape, legs):
        one = marks_spec(shape, octave, legs, record.shard, record.chunk)
        work.writer.array(one, found.marks(octave, 0, one.shape[0], 0, one.shape[1]))
    return TINS.put(record, {"legs": legs})


def make_chunked(record: Record, work: Work) -> Record:
    """Meshes of chunks, from ``midpoint`` errors; results wait in a temporary file."""
    from orograph.store.derived_stages import ChunkStage

    if work.chunked is None or np.isnan(record.height_range[0]) or min(record.grid.shape) < 2:
        return record
    with spooled() as spool:
        stage = ChunkStage(work.terrain(record), work.writer, work.chunked, spool)
        work.executor.run(stage, work.progress)
    return CHUNKED.put(record, {**work.chunked._asdict(), "error": stage.chunks.error, "rows": stage.rows})


def make_quadtin(record: Record, work: Work) -> Record:
    """The hierarchy of a QuadTIN, from heights or points; its blocks wait in temporary files."""
    if work.quadtin is None or np.isnan(record.height_range[0]) or min(record.grid.shape) < 2:
        return record
    from orograph.store.quadtin_grow import Making
    from orograph.store.quadtin_make import Here, Rounds, made
    from orograph.store.quadtin_stage import Tasks

    finest, split = work.quadtin
    sizes = record.shard, record.chunk
    lengths: list[list[int]] = [[] for _ in DEPTHS]
    rows = []
    with ExitStack() as stack:
        files = [stack.enter_context(spooled()) for _ in DEPTHS]

        def keep(part: int, words: NDArray[np.uint32]) -> None:
            lengths[part].append(len(words))
            files[part].write(words.tobytes())

        terrain = work.terrain(record)
        making = Making(terrain, finest, split == "deviation")
        rounds: Rounds = Tasks(terrain, work.writer, making, work.executor, work.progress)
        if here := work.executor.here:
            rounds = Here(making, stack.enter_context(spooled()), here, work.progress)
        layout, facts, summary = made(making, rounds, keep)
        for part, (file, counts) in enumerate(zip(files, lengths)):
            rows.append(rows_of(sum(counts), record.chunk))
            file.truncate(4 * rows[-1] * record.chunk)  # zeros after the last
            file.flush()
            block = np.memmap(file, np.uint32, "r", shape=(rows[-1], record.chunk))
            per_block = np.array(counts, np.uint32).reshape(layout.across, layout.across)
            work.writer.array(lengths_spec(layout.across, part, *sizes), per_block)
            work.writer.array(words_spec(part, rows[-1], *sizes), block)
    spec = summary_spec(layout.across, *sizes)
    whole = np.zeros(spec.shape, np.uint32)
    numbers = np.concatenate([array.reshape(-1) for array in summary]).view(np.uint32)
    whole.reshape(-1)[: len(numbers)] = numbers
    work.writer.array(spec, whole)
    return QUADTIN.put(record, {"asked": [finest, split], "side": SIDE, "rows": rows, **facts._asdict()})


MAKERS: dict[str, Callable[[Record, Work], Record]] = {
    DIAMONDS.name: make_diamonds, PATCHES.name: make_patches, TINS.name: make_tins,
    CHUNKED.name: make_chunked, QUADTIN.name: make_quadtin,
}  # fmt: skip
"""Makers by name of the kind, each after those that it needs."""
