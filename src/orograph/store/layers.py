"""Named layers of a store: quantised rasters on the terrain's grid at every level, such as baked light.

A layer ``NAME`` lies beside the heights as ``layers/NAME/{k}/BAND``, one array per level and band. Level 0 has the
terrain's samples; a sample of level k stands for the block of 2^k × 2^k of them that a box mean of the heights stands
for (``Terrain.mean_shape``), averaged from the exact values of level 0 as the layer prescribes.

Values v between ``low`` and ``high`` are codes 1 to n = 2^bits − 1: v = low + (code − 1) · (high − low) / (n − 1),
rounded to the nearest, those beyond to the end of the range; 0 is missing. These are CF's ``scale_factor``,
``add_offset`` and ``_FillValue``, which the arrays carry, so other tools read physical units; the largest error is half
a step, stated as ``quantisation_error``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.derived import At, Attributes, Derived, Nodes
from orograph.store.terrain import Heights, Shape, level_count, mean_shape

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain

Codes = NDArray[np.uint8] | NDArray[np.uint16]
Bits = Literal[8, 16]

GROUP = "layers"
"""The group of a store that holds its layers."""

PARTIAL = f"{GROUP}/.partial"
"""The folder in which layers are made until they are complete."""


@dataclass(frozen=True, slots=True)
class LayerBand:
    """One raster of a layer, and how its values are encoded.

    Attributes:
        name: the name of its arrays: letters, digits, hyphens and points.
        unit: the unit of its values.
        low, high: the values of the codes 1 and 2^bits − 1.
        bits: the bits of a code.
    """

    name: str
    unit: str
    low: float
    high: float
    bits: Bits = 8

    @property
    def dtype(self) -> str:
        return f"uint{self.bits}"

    @property
    def step(self) -> float:
        """The step between two codes."""
        return float((self.high - self.low) / (2**self.bits - 2))

    @property
    def error(self) -> float:
        """The largest error of a value between ``low`` and ``high``."""
        return self.step / 2

    def encode(self, values: NDArray[Any]) -> Codes:
        """Codes of values of any shape; 0 for NaN."""
        scaled = (np.clip(values, self.low, self.high) - self.low) / self.step + 1.5
        return np.where(np.isnan(values), 0.0, scaled).astype(self.dtype)

    def decode(self, codes: Codes) -> Heights:
        """float32 values of codes; NaN for 0."""
        table = (self.low + (np.arange(2**self.bits) - 1.0) * self.step).astype(np.float32)
        table[0] = np.nan
        return np.asarray(table[codes])

    def attributes(self) -> dict[str, Any]:
        """Attributes of its arrays, after CF."""
        return {
            "units": self.unit, "scale_factor": self.step, "add_offset": self.low - self.step, "_FillValue": 0,
            "quantisation_error": self.error, "valid_range": [1, 2**self.bits - 1], "grid_mapping": "spatial_ref",
        }  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        return {"name": self.name, "unit": self.unit, "low": self.low, "high": self.high, "bits": self.bits}


@dataclass(frozen=True, slots=True)
class LayerRecord:
    """A store's record of a layer.

    Attributes:
        name: the layer's name.
        doc: a description.
        bands: its rasters.
        averaging: how samples of coarser levels are averaged.
        options: what it was made with (JSON).
        source: fingerprint of the heights it was made from (``Record.source``).
    """

    name: str
    doc: str
    bands: tuple[LayerBand, ...]
    averaging: str
    options: dict[str, Any]
    source: str

    def to_json(self) -> dict[str, Any]:
        return {
            "doc": self.doc, "bands": [band.to_json() for band in self.bands], "averaging": self.averaging,
            "options": self.options, "source": self.source,
        }  # fmt: skip

    @classmethod
    def from_json(cls, name: str, record: dict[str, Any]) -> LayerRecord:
        bands = tuple(LayerBand(**band) for band in record["bands"])
        return cls(name, record["doc"], bands, record["averaging"], record["options"], record["source"])


def layer_spec(shape: Shape, name: str, level: int, band: LayerBand, shard: int, chunk: int) -> ArraySpec:
    """The codes of a band at a level; ``shape`` is the terrain's, ``name`` that of the layer (or of its folder)."""
    return ArraySpec(
        f"{GROUP}/{name}/{level}/{band.name}", mean_shape(shape, level), shard, chunk, band.dtype, 0.0
    )  # fmt: skip


class StoredLayer:
    """A layer of a terrain, opened for reading from any number of threads; ask a terrain for it (``Terrain.layer``).

    Attributes:
        name, doc, averaging, options: see ``LayerRecord``.
        bands: its rasters, in the order in which ``read`` returns them.
        levels: the same number as the terrain's.
    """

    def __init__(self, record: LayerRecord, shape: Shape, array: Callable[[LayerBand, int], ShardedArray]) -> None:
        self.record = record
        self.name, self.doc, self.averaging, self.options = record.name, record.doc, record.averaging, record.options
        self.bands = record.bands
        self.levels = level_count(shape)
        self._shape, self._array = shape, array

    def shape(self, level: int) -> Shape:
        """(rows, cols) of a level: blocks of 2^level × 2^level samples, like ``Terrain.mean_shape``."""
        if not 0 <= level < self.levels:
            raise UsageError(f"Layer {self.name!r} has levels 0 to {self.levels - 1}, not {level}.")
        return mean_shape(self._shape, level)

    def codes(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Codes:
        """Stored codes of a window, for decoding elsewhere (in a shader).

        Args:
            level: of the layer. row0, row1, col0, col1: a half-open window inside ``shape(level)``.

        Returns:
            (bands, rows, cols) uint8 or uint16; 0 is missing, see ``LayerBand`` for the others.

        Raises:
            UsageError: there is no such level, or the window is not inside it.
            DamagedChunkError: a chunk fails its checksum.
        """
        codes: Codes = np.asarray(np.stack(self.planes(level, row0, row1, col0, col1)), self.bands[0].dtype)
        return codes

    def planes(self, level: int, row0: int, row1: int, col0: int, col1: int) -> list[Codes]:
        """As ``codes``, but each band is a separate array (rows, cols)."""
        rows, cols = self.shape(level)
        if not (0 <= row0 <= row1 <= rows and 0 <= col0 <= col1 <= cols):
            raise UsageError(
                f"The window of rows {row0} to {row1} and columns {col0} to {col1} is not inside the {rows}×{cols} "
                f"samples of this level of {self.name!r}."
            )
        return [self._array(band, level).read(row0, row1, col0, col1) for band in self.bands]

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Values of a window: (bands, rows, cols) float32 in the bands' units, NaN where missing.

        Args and raises: as ``codes``.
        """
        codes = self.codes(level, row0, row1, col0, col1)
        return np.stack([band.decode(each) for band, each in zip(self.bands, codes, strict=True)])

    def __repr__(self) -> str:
        options = ", ".join(f"{key} {value}" for key, value in self.options.items() if value is not None)
        return f"<Layer {self.name!r} ({options}), {len(self.bands)} bands, {self.levels} levels>"


class Layers(Derived[dict[str, LayerRecord]]):
    """Layers by name. Options: ``layer``, a name, and the options that it must have been made with."""

    name, version, group, later, shared = "layers", 1, GROUP, True, True

    def nothing(self) -> dict[str, LayerRecord]:
        return {}

    def parse(self, found: dict[str, Any], grid: Grid) -> dict[str, LayerRecord]:
        return {name: LayerRecord.from_json(name, layer) for name, layer in found["layers"].items()}

    def to_json(self, what: dict[str, LayerRecord]) -> dict[str, Any]:
        return {"layers": {name: layer.to_json() for name, layer in what.items()}}

    def arrays(self, what: dict[str, LayerRecord], at: At) -> Iterator[tuple[ArraySpec, Attributes]]:
        for layer in what.values():
            for level in range(level_count(at.grid.shape)):
                for band in layer.bands:
                    about = {"long_name": f"{layer.doc}, {band.name}, level {level}"}
                    spec = layer_spec(at.grid.shape, layer.name, level, band, at.shard, at.chunk)
                    yield spec, {**about, **band.attributes()}

    def groups(self, what: dict[str, LayerRecord], at: At) -> tuple[Nodes, dict[str, bytes]]:
        from orograph.store.conventions import group, level_transform, put_coordinates, spatial_attributes

        nodes: Nodes = {GROUP: group()}
        data: dict[str, bytes] = {}
        for layer in what.values():
            attributes = {"long_name": layer.doc, "averaging": layer.averaging, "made_with": layer.options}
            nodes[f"{GROUP}/{layer.name}"] = group(attributes)
            for level in range(level_count(at.grid.shape)):
                transform = level_transform(at.grid, level, mean=True)
                grid = Grid(mean_shape(at.grid.shape, level), transform, at.grid.crs)
                path = f"{GROUP}/{layer.name}/{level}"
                nodes[path] = group(spatial_attributes(grid))
                put_coordinates(path, grid, nodes, data)
        return nodes, data

    def open(self, terrain: StoredTerrain, **options: Any) -> StoredLayer:
        name = options.pop("layer")
        there = self.of(terrain.record)
        if name not in there:
            others = f"; it has {', '.join(there)}" if there else ""
            raise StoreError(
                f"This terrain has no layer {name!r}{others}.",
                path=terrain.url,
                remedy=f"Bake it into a store: `orograph.bake(store, [{name!r}])`.",
            )
        record = there[name]
        again = f"Bake it again (`orograph.bake({terrain.url!r}, [{name!r}])`)."
        if record.source != terrain.record.source:
            raise StoreError(f"Its layer {name!r} was made from other heights.", path=terrain.url, remedy=again)
        for key, wanted in options.items():
            if key not in record.options:
                raise UsageError(f"Layer {name!r} is not made with {key!r}, but {', '.join(record.options)}.")
            if record.options[key] != wanted:
                raise StoreError(
                    f"Its layer {name!r} was made with {key} {_said(record.options[key])}, not {_said(wanted)}.",
                    path=terrain.url,
                    remedy=again,
                )
        shape, sizes = terrain.grid.shape, (terrain.record.shard, terrain.record.chunk)

        def array(band: LayerBand, level: int) -> ShardedArray:
            return terrain.opened(f"{name}/{band.name}", level, lambda: layer_spec(shape, name, level, band, *sizes))

        return StoredLayer(record, shape, array)

    def remedy(self, url: str, keys: list[str]) -> str | None:
        layers = sorted({key.split("/")[1] for key in keys if key.count("/") > 1})
        return f"Bake again: `orograph.bake({url!r}, {layers}, overwrite=True)`." if layers else None


def _said(value: Any) -> str:
    return "unlimited" if value is None else str(value)


LAYERS = Layers()
