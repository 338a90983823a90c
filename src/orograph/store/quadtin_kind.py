"""QuadTINs' hierarchies as a kind of derived data: what a store records about them, and how to open or make them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived, Nodes
from orograph.store.points import POINTS
from orograph.store.quadtin_layout import (
    DEPTHS,
    SPLITS,
    Facts,
    MemoryQuadTin,
    StoredQuadTin,
    layout_of,
    lengths_spec,
    summary_spec,
    words_spec,
)

if TYPE_CHECKING:
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain


def checked_quadtin(quadtin: Any) -> tuple[float, str]:
    """Parse the error in metres and the splitting rule of a hierarchy.

    Raises:
        UsageError: they are invalid.
    """
    pair = tuple(quadtin) if isinstance(quadtin, (tuple, list)) else ()
    if len(pair) != 2 or not isinstance(pair[0], (int, float)) or not 0 <= pair[0] < math.inf or pair[1] not in SPLITS:
        raise UsageError(
            "'quadtin' must be the error of the finest triangles in metres, 0 or more, and one of "
            f"{', '.join(SPLITS)}, not {quadtin!r}.", remedy='The default of quadtin is (0, "nearest").',
        )  # fmt: skip
    return float(pair[0]), str(pair[1])


class QuadTinKind(Derived[dict[str, Any]]):
    """The hierarchy of a QuadTIN. Options: ``finest``, as requested; ``split``.

    A record holds both, as ``asked``; the ``side`` of blocks; the ``rows`` of each part's words; and ``Facts``.
    """

    name, version, group = "quadtin", 1, "quadtin"
    needs = (POINTS.name,)

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        return {name: found[name] for name in ("asked", "side", "rows", *Facts._fields)}

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return what

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        across = layout_of(at.grid.shape, what["side"]).across
        yield summary_spec(across, at.shard, at.chunk), {"long_name": "what there is to know of blocks"}
        for part in range(len(DEPTHS)):
            about = f"words of each block's triangles to depth {DEPTHS[part]}"
            yield lengths_spec(across, part, at.shard, at.chunk), {"long_name": about}
            about = "vertices and triangles of blocks"
            yield words_spec(part, what["rows"][part], at.shard, at.chunk), {"long_name": about}

    def groups(self, what: dict[str, Any], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group

        nodes, data = super().groups(what, at)
        return {**nodes, self.group: group({name: what[name] for name in ("asked", "finest")})}, data

    def open(self, terrain: StoredTerrain, **options: Any) -> StoredQuadTin:
        found, wanted = self.of(terrain.record), [options["finest"], options["split"]]
        if found.get("asked") != wanted:
            raise StoreError(
                f"This store has no QuadTIN of finest={wanted[0]:g} and split={wanted[1]}.", path=terrain.url,
                remedy=f"Build it with one (`orograph.build(..., quadtin=({wanted[0]:g}, {wanted[1]!r}))`), or let the "
                       "method make it.",
            )  # fmt: skip
        return StoredQuadTin(terrain, found)

    def compute(self, terrain: MemoryTerrain, **options: Any) -> MemoryQuadTin:
        from orograph.store.quadtin_make import make_quadtin

        return make_quadtin(terrain, options["finest"], options["split"])


QUADTIN = QuadTinKind()
