"""Color errors of diamonds as derived data: how much colours change in coarser triangles, one byte each.

``geovis.color_errors`` defines them, ``geovis.color_store`` makes them and adds them to complete stores. They are
laid out like errors (``diamond_table``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived
from orograph.store.terrain import Shape, diamond_shape, level_count

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain


def color_spec(shape: Shape, level: int, shard: int, chunk: int) -> ArraySpec:
    """Describe the array of a level's codes."""
    return ArraySpec(f"colors/{level}/color", diamond_shape(shape, level), shard, chunk, "uint8", 0.0)


class Colors(Derived[dict[str, Any]]):
    """Color errors of one choice of colours, which a record describes (``color_store.made_with``). No options."""

    name, version, group, later = "colors", 1, "colors", True

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        made: dict[str, Any] = found["made_with"]
        return made

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return {"made_with": what}

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        found = {"long_name": "color errors of diamonds, (code / 15.9)² ΔE", "made_with": what}
        for level in range(level_count(at.grid.shape)):
            yield color_spec(at.grid.shape, level, at.shard, at.chunk), found

    def open(self, terrain: StoredTerrain, **options: Any) -> ColorCodes:
        if not self.of(terrain.record):
            raise StoreError(
                "This store has no color errors.",
                path=terrain.url,
                remedy="Make them: `orograph.geovis.color_store.store_colors`.",
            )
        return ColorCodes(terrain)

    def remedy(self, url: str, keys: list[str]) -> str:
        return "Make its color errors again (`orograph.geovis.color_store.store_colors`)."


class ColorCodes:
    """The color errors of a store."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self.terrain = terrain

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.uint8]:
        """Return the codes of the entries ``[row0, row1) × [col0, col1)`` of a level."""
        terrain, record = self.terrain, self.terrain.record
        terrain.check_window(terrain.diamond_shape(level), row0, row1, col0, col1)
        array = terrain.opened(
            "colors", level, lambda: color_spec(terrain.grid.shape, level, record.shard, record.chunk)
        )  # fmt: skip
        codes: NDArray[np.uint8] = array.read(row0, row1, col0, col1)
        return codes


COLORS = Colors()
