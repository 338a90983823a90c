"""Errors and spheres of diamonds as derived data: two numbers for every vertex of the hierarchy, read by windows.

Entry (i, j) of level k belongs to the vertex (i·2^k, j·2^k). Where i or j is odd it is the diamond of octave k at that
vertex; where both are even it is 0 and meaningless, except at the top level (``levels`` − 1): its arrays are the padded
square of side 2^(n − top) + 1 and hold the octaves above as well, the diamond at (row, col) in entry (row >> top, col
>> top). The square's four corners are not diamonds (0). ``store.diamonds`` lays them out, ``error.diamonds`` computes
them, ``error.quantise`` encodes them.

*Errors*, float32 metres: "exact" (a bound, the tightest), "wedgie" (ROAM's looser one) or "midpoint" (no bound); no
less than those of the diamond's children; +inf where the diamond is *mixed* (part of its region is surface, part hole).

*Radii*, float32 metres: the sphere of this radius around the vertex (squeezed, its height filled where it is missing)
holds the region's corners and the children's spheres. Negative where the diamond is *empty* (no surface in its region,
which may lie beyond the raster); then its magnitude is meaningless.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from orograph.error import KINDS, ErrorKind
from orograph.error.quantise import ErrorCode, RadiusCode, nominal_radii
from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived
from orograph.store.diamonds import metric, place
from orograph.store.terrain import Heights, Shape, diamond_shape, exponent, level_count

if TYPE_CHECKING:
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain


class DiamondTable(Protocol):
    """Errors and radii of one kind."""

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        """Errors and radii of the entries ``[row0, row1) × [col0, col1)`` of a level.

        Both may be shared with a cache: they are read-only; copy them to change them.

        Raises:
            UsageError: there is no such level, or the window is not inside ``diamond_shape(level)``.
            DamagedChunkError: a chunk of a store fails its checksum.
        """

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """The errors alone, as ``read`` gives them."""


@dataclass(frozen=True, slots=True)
class DiamondCodes:
    """How a store encodes them.

    Attributes:
        errors: codes by kind. radius: the code for all kinds; None if there are no errors.
    """

    errors: dict[ErrorKind, ErrorCode] = field(default_factory=dict)
    radius: RadiusCode | None = None

    def __bool__(self) -> bool:
        return bool(self.errors)


def diamond_spec(shape: Shape, level: int, name: str, shard: int, chunk: int) -> ArraySpec:
    """The array of a level's codes, for a kind of errors or "radius"."""
    return ArraySpec(f"diamonds/{level}/{name}", diamond_shape(shape, level), shard, chunk, "uint8", 0.0)


def check_kind(kind: str) -> ErrorKind:
    """The kind of errors of that name.

    Raises:
        UsageError: there is none.
    """
    if kind not in KINDS:
        raise UsageError(f"There is no error called {kind!r}; the kinds are {', '.join(KINDS)}.")
    return kind


class Diamonds(Derived[DiamondCodes]):
    """Errors of diamonds, of the requested kinds, and their spheres. Option: ``error``, a kind."""

    name, version, group = "diamonds", 1, "diamonds"

    def nothing(self) -> DiamondCodes:
        return DiamondCodes()

    def parse(self, found: dict[str, Any], grid: Grid) -> DiamondCodes:
        nominal = nominal_radii(metric(grid), exponent(grid.shape))
        errors = {kind: ErrorCode(**code) for kind, code in found["errors"].items()}
        return DiamondCodes(errors, RadiusCode(nominal, **found["radius"]))

    def to_json(self, what: DiamondCodes) -> dict[str, Any]:
        assert what.radius is not None
        return {
            "errors": {kind: code.to_json() for kind, code in what.errors.items()}, "radius": what.radius.to_json()
        }  # fmt: skip

    def arrays(self, what: DiamondCodes, at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        assert what.radius is not None
        codes: list[tuple[str, ErrorCode | RadiusCode]] = [*what.errors.items(), ("radius", what.radius)]
        for level in range(level_count(at.grid.shape)):
            for name, code in codes:
                spec = diamond_spec(at.grid.shape, level, name, at.shard, at.chunk)
                yield spec, {"long_name": f"{name} of diamonds, coded", "code": code.to_json()}

    def open(self, terrain: StoredTerrain, **options: Any) -> DiamondTable:
        kind = check_kind(options["error"])
        codes = self.of(terrain.record)
        if kind not in codes.errors or codes.radius is None:
            raise StoreError(
                f"This store has no {kind} errors.",
                path=terrain.url,
                remedy="Build it again with them "
                f"(`orograph.build(..., errors={(*codes.errors, kind)}, overwrite=True)`).",
            )
        return StoredDiamonds(terrain, kind, codes.errors[kind], codes.radius)

    def compute(self, terrain: MemoryTerrain, **options: Any) -> DiamondTable:
        kind = check_kind(options["error"])
        return MemoryDiamonds(terrain, *terrain.diamonds(kind))


class MemoryDiamonds:
    """Errors and spheres of a terrain in memory."""

    def __init__(self, terrain: MemoryTerrain, errors: list[Heights], radii: list[Heights]) -> None:
        self.terrain, self.errors, self.radii = terrain, errors, radii

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        return self.values(level, row0, row1, col0, col1), self.radii[level][row0:row1, col0:col1]

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.terrain.check_window(self.terrain.diamond_shape(level), row0, row1, col0, col1)
        return self.errors[level][row0:row1, col0:col1]


class StoredDiamonds:
    """Errors and spheres of a store."""

    def __init__(self, terrain: StoredTerrain, kind: ErrorKind, code: ErrorCode, radius: RadiusCode) -> None:
        self.terrain, self.kind, self.code, self.radius = terrain, kind, code, radius
        self._top: Heights | None = None

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, Heights]:
        errors, window = self.values(level, row0, row1, col0, col1), (row0, row1, col0, col1)
        if level == self.terrain.levels - 1:
            return errors, self._top_radii()[row0:row1, col0:col1]
        return errors, self.radius.decode(self._codes("radius", level, *window), row0, col0, level)

    def values(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.terrain.check_window(self.terrain.diamond_shape(level), row0, row1, col0, col1)
        return self.code.decode(self._codes(self.kind, level, row0, row1, col0, col1))

    def _codes(self, name: str, level: int, row0: int, row1: int, col0: int, col1: int) -> Any:
        terrain = self.terrain
        sizes = terrain.record.shard, terrain.record.chunk
        array = terrain.opened(
            f"diamonds/{name}", level, lambda: diamond_spec(terrain.grid.shape, level, name, *sizes)
        )  # fmt: skip
        return array.read(row0, row1, col0, col1)

    def _top_radii(self) -> Heights:
        """The decoded radii of the top level, which covers several octaves."""
        if self._top is None:
            level = self.terrain.levels - 1
            side, _ = self.terrain.diamond_shape(level)
            codes = self._codes("radius", level, 0, side, 0, side)
            radii = np.zeros((side, side), np.float32)
            for octave in range(level, self.terrain.n):
                step = 1 << (octave - level)
                place(radii, self.radius.decode(codes[::step, ::step], 0, 0, octave), octave, 0, 0, level)
            radii.flags.writeable = False
            self._top = radii
        return self._top


DIAMONDS = Diamonds()
