"""TINs as a kind of derived data: what a store records, and how they are opened or made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived, Nodes
from orograph.store.tins import MemoryTins, StoredTins, marks_spec, octaves, stored_levels, table_spec

if TYPE_CHECKING:
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain


class TinKind(Derived[dict[str, Any]]):
    """TINs of patches. Option: ``legs``."""

    name, version, group = "tins", 2, "tins"

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        return {"legs": found["legs"]}

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return what

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        shape, legs = at.grid.shape, what["legs"]
        for level in stored_levels(shape, legs):
            for name in ("error", "radius"):
                about = f"{name} of the TINs of diamonds; negative errors: none stands for it"
                yield table_spec(shape, level, name, at.shard, at.chunk), {"units": "m", "long_name": about}
        for octave in octaves(shape, legs):
            about = "samples that are vertices: 1 of the TINs of square diamonds, 2 of edge ones"
            yield marks_spec(shape, octave, legs, at.shard, at.chunk), {"long_name": about}

    def groups(self, what: dict[str, Any], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group

        nodes, data = super().groups(what, at)
        return {**nodes, self.group: group({"legs": what["legs"]})}, data

    def open(self, terrain: StoredTerrain, **options: Any) -> StoredTins:
        if self.of(terrain.record).get("legs") != options["legs"]:
            raise StoreError(
                f"This store has no TINs of patches of {options['legs']} segments.", path=terrain.url,
                remedy=f"Build it with them (`orograph.build(..., tins={options['legs']})`), or have them made.",
            )  # fmt: skip
        return StoredTins(terrain, int(options["legs"]))

    def compute(self, terrain: MemoryTerrain, **options: Any) -> MemoryTins:
        from orograph.store.tin_build import make_tins

        return make_tins(terrain, options["legs"])


TINS = TinKind()
