"""The points that a terrain was gridded from, kept beside it: their triangulation in sample coordinates.

``points/places``: int32, two numbers a point, column and row on the lattice (``dem.delaunay``); ``points/heights``:
float32, one a point; ``points/triangles``: int32, three numbers a triangle. Each is stored in rows of a chunk's
length, with zeros after the last number. The group records their counts, and the lattice's bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.derived import At, Attributes, Derived, Nodes

if TYPE_CHECKING:  # (a store can be read without the raster reader)
    from orograph.dem.delaunay import Gridded, Surface
    from orograph.store.layout import Record
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain
    from orograph.store.writer import ShardWriter

PARTS = {
    "places": ("int32", 2, "points", "columns and rows on a lattice of 2^-bits of a sample"),
    "heights": ("float32", 1, "points", "heights of the points"),
    "triangles": ("int32", 3, "triangles", "corners of the triangles between the points"),
}
"""For each array its type, numbers per entry, what its entries are, and a description."""


def rows_spec(name: str, count: int, shard: int, chunk: int) -> ArraySpec:
    """The array for this many numbers."""
    return ArraySpec(f"points/{name}", (max(1, -(-count // chunk)), chunk), shard, chunk, PARTS[name][0], 0.0)


class PointsKind(Derived[dict[str, Any]]):
    """The points of a terrain. It has no options."""

    name, version, group = "points", 1, "points"

    def nothing(self) -> dict[str, Any]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, Any]:
        return {name: int(found[name]) for name in ("points", "triangles", "bits")}

    def to_json(self, what: dict[str, Any]) -> dict[str, Any]:
        return what

    def arrays(self, what: dict[str, Any], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        for name, (_, each, of, about) in PARTS.items():
            units = {"units": "m"} if name == "heights" else {}
            yield rows_spec(name, each * what[of], at.shard, at.chunk), {"long_name": about, **units}

    def groups(self, what: dict[str, Any], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group

        nodes, data = super().groups(what, at)
        return {**nodes, self.group: group(what)}, data

    def open(self, terrain: StoredTerrain, **options: Any) -> Surface:
        what = self.of(terrain.record)
        if not what:
            raise StoreError(
                "This store was not built from points.", path=terrain.url, remedy="Build one from a file of points."
            )
        sizes = terrain.record.shard, terrain.record.chunk
        found = {}
        for name, (_, each, of, _) in PARTS.items():
            spec = rows_spec(name, each * what[of], *sizes)
            array = terrain.opened(f"points/{name}", 0, lambda: spec)  # noqa: B023
            found[name] = array.read(0, spec.shape[0], 0, spec.shape[1]).ravel()[: each * what[of]].reshape(-1, each)
        x, y = np.ascontiguousarray(found["places"].T.astype(np.int64))
        from orograph.dem.delaunay import Surface

        return Surface(x, y, found["heights"][:, 0].copy(), found["triangles"].copy(), what["bits"])

    def compute(self, terrain: MemoryTerrain, **options: Any) -> Surface:
        surface = getattr(terrain.samples, "surface", None)
        if surface is None:
            raise StoreError("This terrain was not gridded from points.", path=terrain.name)
        found: Surface = surface
        return found

    def remedy(self, url: str, keys: list[str]) -> str | None:
        return f"Its points are damaged: build {url} again from its file of points."


POINTS = PointsKind()


def put_points(record: Record, surface: Surface, writer: ShardWriter) -> Record:
    """Write the points of a terrain; returns the record with them."""
    arrays: dict[str, NDArray[Any]] = {
        "places": np.stack([surface.x, surface.y], -1), "heights": surface.z, "triangles": surface.triangles,
    }  # fmt: skip
    for name, values in arrays.items():
        spec = rows_spec(name, values.size, record.shard, record.chunk)
        whole = np.zeros(spec.shape, spec.dtype)
        whole.ravel()[: values.size] = values.ravel()
        writer.array(spec, whole)
    what = {"points": len(surface.z), "triangles": len(surface.triangles), "bits": surface.bits}
    return POINTS.put(record, what)


class StoredPoints:
    """The surface of a stored terrain's points, as its original samples (``store.terrain.Samples``)."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self._terrain = terrain
        self._gridded: Gridded | None = None

    @property
    def surface(self) -> Surface:
        """The triangulation of the points."""
        found: Surface = self._terrain.derived("points")
        return found

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in the terrain's CRS on the surface; NaN where there is none.

        Raises:
            DamagedChunkError, StoreReplacedError: as ``Terrain.read``.
        """
        if self._gridded is None:
            from orograph.dem.delaunay import Gridded

            self._gridded = Gridded(self.surface)
        return self._gridded.at(*self._terrain.grid.index(np.atleast_1d(x), np.atleast_1d(y)))
