"""Errors of patches, which decide about regular pieces of the hierarchy instead of single triangles (``lod.patches``).

A *patch* is a right triangle divided d = 2·log2(L) levels further down, into L² triangles (each of its legs has L
segments). P(D), the error of a patch diamond D, is the largest of D's DAG descendants exactly d levels below it: its
patches' triangles are among theirs, and P is monotonic because a child's descendants are among its parent's. It is
found by passing every diamond's error d levels upwards, which costs about as much as making errors monotonic does.

*Saturated*, P′(D) = max(P(D), κ·P′(children)): with nested spheres a parent's bound in pixels is then κ times its
children's or more, so that its geomorph ends before theirs begins.

*Missing ground*: diamonds that are part ground, part missing (``mixed``) have infinite errors. Here they count with a
bound of the vertical distance wherever both surfaces exist: the errors of the store's levels over the tile, or the
range of heights. A negative sign marks them.

A build stores P′ for L = 16 (float32, an entry for 1/192 of the samples); for other L, other stores and arrays in
memory it is computed on first use. Metres, float32.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived, Nodes
from orograph.store.diamond_table import check_kind
from orograph.store.diamonds import blank_top, place
from orograph.store.terrain import Heights, Shape, Terrain, TileTable, diamond_shape, level_count

if TYPE_CHECKING:
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain

KAPPA = 1.25
"""κ: a patch is morphed while the bound of its parent's error grows from 1/κ of the tolerance to all of it."""

SATURATION = KAPPA * (1.0 + 2.0**-10)
"""κ in the tables: larger than κ by a margin for rounding."""

NOTHING = np.float32(2.0**-100)
"""Marks the P′ of a mixed diamond, whose value holds wherever there is ground."""


BLOCK = 64
"""Minimum patch diamonds along the side of a work area."""

REACH = 4
"""How many patch diamonds the DAG's arrows reach beyond their origin (less than 3.5, including squeezed ones)."""


LEGS = 16
"""Default L."""


def spec(shape: Shape, level: int, kind: ErrorKind, shard: int, chunk: int) -> ArraySpec:
    """The stored P′ of a level, float32 in the layout of ``diamond_table``."""
    return ArraySpec(f"patches/{level}/{kind}", diamond_shape(shape, level), shard, chunk, "float32", 0.0)


def stored_levels(shape: Shape, legs: int = LEGS) -> range:
    """The levels that have patch diamonds."""
    top = level_count(shape) - 1
    return range(min(legs.bit_length() - 1, top), top + 1)


def patch_errors(
    terrain: Terrain, kind: ErrorKind, legs: int, *, jobs: int | None = None, progress: Progress = SILENT
) -> list[Heights]:
    """P′ of all patch diamonds, in the layout of ``diamond_table``: an array for each level.

    Octaves below log2(L) have no patch diamonds (their patches would be finer than the raster) and have 0. Several
    threads read errors block by block; the result is 1/L² of the raster.

    Args:
        terrain: the ground. kind: of error. legs: L.
        jobs: threads (default: all processors). progress: gets reports on blocks.
    """
    making = PatchErrors(terrain, terrain.derived("diamonds", error=kind), legs)
    making.take_all(jobs, progress)
    return making.finished()


class Table(Protocol):
    """Values of diamonds (``diamond_table``)."""

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """The values of the entries ``[row0, row1) × [col0, col1)`` of a level."""


class ColorTable(NamedTuple):
    """Colour errors as a table of diamonds."""

    color: Callable[[int, int, int, int, int], Heights]

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """See ``Table``."""
        return self.color(level, row0, row1, col0, col1)


def patch_colors(
    terrain: Terrain, color: Callable[[int, int, int, int, int], Heights], legs: int, *, jobs: int | None = None,
    progress: Progress = SILENT,
) -> list[Heights]:  # fmt: skip
    """Colour errors of all patch diamonds, ΔE, in the layout of ``diamond_table``: the largest of their triangles.

    Args:
        color: colour errors of diamonds (``lod.field``). terrain, legs, jobs, progress: as for ``patch_errors``.
    """
    making = PatchErrors(terrain, ColorTable(color), legs)
    making.take_all(jobs, progress)
    return by_level(terrain, making.P)


class PatchErrors:
    """The computation of P′ of all patch diamonds of a terrain.

    Blocks of P come in any order, from any thread; then the rest follows.

    Args:
        terrain, legs: as for ``patch_errors``. table: the errors.
    """

    def __init__(self, terrain: Terrain, table: Table, legs: int) -> None:
        self.terrain, self.table, self.q = terrain, table, legs.bit_length() - 1
        self.spread = terrain.height_range[1] - terrain.height_range[0]
        self.size = max(BLOCK, 1024 >> self.q)
        self.P = {k: np.zeros(octave_shape(terrain, k), np.float32) for k in range(self.q, terrain.n)}

    def tasks(self) -> list[tuple[int, int]]:
        """The blocks: the octave, and the number of the block in it, row by row."""
        octaves = range(self.q, self.terrain.n)
        return [(k, at) for k in octaves for at in range(math.prod(self._blocks(k)))]

    def block(self, spot: tuple[int, int]) -> Heights:
        """P of a block's diamonds."""
        k, (i, j) = spot[0], self._begin(spot)
        rows, cols = octave_shape(self.terrain, k)
        end = min(i + self.size, rows), min(j + self.size, cols)
        return _block(self.terrain, self.table, k, self.q, (i, j), end, self.spread)

    def take(self, spot: tuple[int, int], found: Heights) -> None:
        """Store the result of a block."""
        k, (i, j) = spot[0], self._begin(spot)
        self.P[k][i : i + found.shape[0], j : j + found.shape[1]] = found

    def take_all(self, jobs: int | None, progress: Progress) -> None:
        """Make all blocks, in this process."""

        def one(spot: tuple[int, int]) -> None:
            self.take(spot, self.block(spot))

        tasks = self.tasks()
        with progress.task("Errors of patches", len(tasks)) as task:
            for _ in map_ordered(one, tasks, jobs):
                task.advance()

    def finished(self) -> list[Heights]:
        """P′, an array for each level, once all blocks are there."""
        last: Heights | None = None
        signed = {}
        for k, P in self.P.items():
            saturate(P, last)
            last = P
            mixed = np.isinf(octave_window(self.terrain, self.table, k, (0, 0), P.shape))
            signed[k] = np.where(mixed, -np.maximum(P, NOTHING), P)
        return by_level(self.terrain, signed)

    def _blocks(self, k: int) -> Shape:
        """Blocks of an octave along each axis."""
        rows, cols = octave_shape(self.terrain, k)
        return -(-rows // self.size), -(-cols // self.size)

    def _begin(self, spot: tuple[int, int]) -> Shape:
        """The first diamond of a block."""
        row, col = divmod(spot[1], self._blocks(spot[0])[1])
        return row * self.size, col * self.size


def by_level(terrain: Terrain, octaves: dict[int, Heights]) -> list[Heights]:
    """Values by octave as arrays by level, in the layout of ``diamond_table``."""
    top = terrain.levels - 1
    result = [np.zeros((0, 0), np.float32) for _ in range(top)]
    result.append(blank_top(terrain.grid.shape, np.float32, 0))
    for k, values in octaves.items():
        if k < top:
            result[k] = values
        else:
            place(result[top], values, k, 0, 0, top)
    return result


def octave_shape(terrain: Terrain, k: int) -> Shape:
    """Entries of an octave: those of its level, or for higher octaves every 2^j-th of the padded square."""
    level = min(k, terrain.levels - 1)
    rows, cols = terrain.diamond_shape(level)
    return ((rows - 1) >> (k - level)) + 1, ((cols - 1) >> (k - level)) + 1


def octave_window(terrain: Terrain, table: Table, k: int, begin: Shape, end: Shape) -> Heights:
    """The errors of an octave's entries ``[begin, end)``."""
    level = min(k, terrain.levels - 1)
    s = k - level
    spans = [(a << s, ((b - 1) << s) + 1) for a, b in zip(begin, end, strict=True)]
    errors = table.values(level, *spans[0], *spans[1])
    return errors[:: 1 << s, :: 1 << s]


def _block(
    terrain: Terrain, table: Table, k: int, q: int, begin: Shape, end: Shape, spread: float
) -> Heights:  # fmt: skip
    """P of the patch diamonds ``[begin, end)`` of an octave."""
    shapes = [octave_shape(terrain, j) for j in range(k - q, k + 1)]
    first = [max(v - REACH, 0) for v in begin]
    windows = []
    for step, shape in enumerate(shapes):
        last = [min(((v + REACH) << (q - step)) + 1, side) for v, side in zip(end, shape, strict=True)]
        windows.append((max(last[0] - (first[0] << (q - step)), 0), max(last[1] - (first[1] << (q - step)), 0)))
    if min(windows[0]) <= 0:  # the padded square continues where finer levels end
        return np.zeros((end[0] - begin[0], end[1] - begin[1]), np.float32)
    at = first[0] << q, first[1] << q
    errors = octave_window(terrain, table, k - q, at, (at[0] + windows[0][0], at[1] + windows[0][1]))
    lifted = _lifted(finite_errors(errors, terrain, k - q, at, spread), q, windows)
    here = begin[0] - first[0], begin[1] - first[1]
    return lifted[here[0] : here[0] + end[0] - begin[0], here[1] : here[1] + end[1] - begin[1]]


def finite_errors(errors: Heights, terrain: Terrain, k: int, at: Shape, spread: float) -> Heights:
    """The errors of a window; those of mixed diamonds are replaced by a bound for where both surfaces exist."""
    mixed = np.isinf(errors)
    if not mixed.any():
        return errors
    i, j = np.nonzero(mixed)
    i, j = i + at[0], j + at[1]
    top = terrain.levels - 1
    # A square diamond's triangles are cells of level k + 1; an edge one's lie between the levels k and k + 1.
    bound = np.full(len(i), spread)
    if k + 1 <= top:
        coarse, fine = _tile_bound(terrain.tiles(k + 1), k + 1, k, i, j), _tile_bound(terrain.tiles(k), k, k, i, j)
        bound = np.minimum(bound, np.where((i & j & 1) == 1, coarse, coarse + fine))
    result = errors.copy()
    result[mixed] = np.nextafter(bound.astype(np.float32), np.float32(np.inf))
    return result


def _tile_bound(table: TileTable, level: int, k: int, i: NDArray[Any], j: NDArray[Any]) -> NDArray[np.float64]:
    """The largest error of a level's tiles that touch the vertices (i, j) of an octave."""
    found = np.zeros(len(i))
    rows, cols = table.error.shape
    shift = 8 + level - k
    for back_row in (0, 1):
        for back_col in (0, 1):
            r = np.clip((i - back_row) >> shift, 0, rows - 1)
            c = np.clip((j - back_col) >> shift, 0, cols - 1)
            found = np.maximum(found, table.error[r, c])
    return found


def _lifted(errors: Heights, q: int, shapes: list[Shape]) -> Heights:
    """The errors of a window of an octave, passed 2q levels upwards.

    Args:
        shapes: of the windows of that octave and the q above; all begin at the same sample, of even entries.
    """
    from orograph.error.monotony import close  # compiled code, which readers of stores do not need

    if q == 0:
        return errors.copy()
    edges = errors.copy()
    edges[1::2, 1::2] = 0.0
    close(np.zeros((0, 0), np.float32), 0, edges)
    squares = np.ascontiguousarray(errors)
    for shape in shapes[1:]:
        below, edges = edges, np.zeros(shape, np.float32)
        close(below, 1, edges)
        below, squares = squares, np.zeros(shape, np.float32)
        close(below, 1, squares)
    edges[1::2, 1::2] = squares[1::2, 1::2]
    return edges


def saturate(here: Heights, below: Heights | None, kappa: float = SATURATION) -> None:
    """Turn an octave's P into P′, given that of the octave below: at least κ times those below in the DAG."""
    from orograph.error.monotony import close

    factor = np.float32(kappa)
    if below is not None:
        raised = np.zeros_like(here)
        close(below * factor, 1, raised)
        raised[1::2, 1::2] = 0.0
        np.maximum(here, raised, out=here)
    edges = here * factor
    edges[1::2, 1::2] = 0.0
    close(np.zeros((0, 0), np.float32), 0, edges)
    np.maximum(here[1::2, 1::2], edges[1::2, 1::2], out=here[1::2, 1::2])


class Patches(Derived[dict[str, Any]]):
    """P′ of patches of ``LEGS`` segments, for every kind of errors of the store. Options: ``error``, ``legs``."""

    name, version, group, needs = "patches", 1, "patches", ("diamonds",)

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        return {"legs": found["legs"], "kappa": found["kappa"], "errors": found["errors"]}

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return what

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        for level in stored_levels(at.grid.shape, what["legs"]):
            for kind in what["errors"]:
                about = f"{kind} of patches, saturated; negative where ground is missing"
                yield spec(at.grid.shape, level, kind, at.shard, at.chunk), {"units": "m", "long_name": about}

    def groups(self, what: dict[str, Any], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group

        nodes, data = super().groups(what, at)
        return {**nodes, self.group: group({name: what[name] for name in ("legs", "kappa")})}, data

    def open(self, terrain: StoredTerrain, **options: Any) -> PatchTable:
        entry, kind = self.of(terrain.record), check_kind(options["error"])
        here = entry.get("legs"), entry.get("kappa")
        if here != (options["legs"], KAPPA) or kind not in entry["errors"]:
            raise StoreError(
                f"This store has no {kind} errors of patches with {options['legs']} segments.", path=terrain.url,
                remedy="They can be made in memory: `orograph.store.patches.patch_errors`.",
            )  # fmt: skip
        return PatchTable(terrain, kind, int(options["legs"]))

    def compute(self, terrain: MemoryTerrain, **options: Any) -> MemoryPatches:
        kind = check_kind(options["error"])
        return MemoryPatches(terrain, patch_errors(terrain, kind, options["legs"]))


class MemoryPatches:
    """P′ in memory, an array for each level."""

    def __init__(self, terrain: Terrain, errors: list[Heights]) -> None:
        self.terrain, self.errors = terrain, errors

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """As ``PatchTable.read``; levels finer than patches are empty."""
        return self.errors[level][row0:row1, col0:col1]


class PatchTable:
    """P′ of a store."""

    def __init__(self, terrain: StoredTerrain, kind: ErrorKind, legs: int) -> None:
        self.terrain, self.kind, self.levels = terrain, kind, stored_levels(terrain.grid.shape, legs)

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """P′ of the entries ``[row0, row1) × [col0, col1)`` of a level, negative where mixed, 0 on levels finer than
        patches.

        Raises: as for ``diamond_table.DiamondTable.read``.
        """
        terrain, record = self.terrain, self.terrain.record
        terrain.check_window(terrain.diamond_shape(level), row0, row1, col0, col1)
        if level not in self.levels:
            return np.zeros((row1 - row0, col1 - col0), np.float32)
        array = terrain.opened(
            f"patches/{self.kind}", level,
            lambda: spec(terrain.grid.shape, level, self.kind, record.shard, record.chunk),
        )  # fmt: skip
        found: Heights = array.read(row0, row1, col0, col1)
        return found


PATCHES = Patches()
