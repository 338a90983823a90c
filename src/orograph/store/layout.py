"""The names and the metadata of a store: what a Zarr tool sees, and what Orograph reads back.

A store is a Zarr v3 group::

    zarr.json                  written last; its attribute "orograph" makes the group a store
    heights/{k}/height         (rows_k, cols_k) float32, metres, NaN missing: the nested level k
    heights/{k}/x, y           sample coordinates (unless the grid is rotated); spatial_ref: the CRS, as CF has it
    mean/{k}/height            box means of 2^k × 2^k samples, k ≥ 1; x, y and spatial_ref as above
    tiles/{k}/minimum, maximum, error (float32), valid (uint8)
    diamonds/{k}/radius        uint8, coded: spheres of the diamonds of octave k (see ``Terrain.diamonds``)
    diamonds/{k}/exact…        uint8, coded: their errors, of each kind that was built
    diamonds/{k}/color         uint8, coded: how much coarser triangles change colours (``geovis.color_store``)
    patches/{k}/exact…         float32, metres: errors of patches of 16 segments a leg (see ``store.patches``)
    layers/NAME/{k}/BAND       uint8 or uint16, coded: layers that were put in later, such as baked light (``layers``)

so that ``xarray.open_zarr(store, group="heights/3")`` opens a level with its coordinates. The root carries the
*multiscales*, *spatial* and *proj* conventions (versions below), and Orograph's own record with a checksum over itself.
A build keeps its plan in ``build.json`` and what each finished task found in ``parts/`` until it is complete.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.error import ErrorKind
from orograph.error.quantise import ErrorCode, RadiusCode, nominal_radii
from orograph.errors import StoreError
from orograph.geo.grid import Grid, compose
from orograph.store.arrays import ArraySpec, crc32c
from orograph.store.diamonds import metric
from orograph.store.layers import GROUP, LayerRecord, layer_spec
from orograph.store.terrain import Shape, diamond_shape, exponent, level_count, level_shape, mean_shape, tile_shape

FORMAT = 2
"""The version of this layout; a reader refuses others."""

CHUNK = 256
ROOT = "zarr.json"
PLAN = "build.json"
PARTS = "parts"
TABLES = {"minimum": ("float32", math.nan), "maximum": ("float32", math.nan), "error": ("float32", 0.0)}
TABLES_AND_VALID = {**TABLES, "valid": ("uint8", 0.0)}

_RAW = "https://raw.githubusercontent.com/{}/refs/tags/v1/schema.json"
_SPEC = "https://github.com/{}/blob/v1/README.md"
CONVENTIONS = [
    {
        "schema_url": _RAW.format(repository),
        "spec_url": _SPEC.format(repository),
        "uuid": uuid,
        "name": name,
        "description": description,
    }
    for repository, uuid, name, description in (
        (
            "zarr-conventions/multiscales",
            "d35379db-88df-4056-af3a-620245f8e347",
            "multiscales",
            "Multiscale layout of zarr datasets",
        ),
        (
            "zarr-experimental/geo-proj",
            "f17cb550-5864-4468-aeb7-f3180cfb622f",
            "proj:",
            "Coordinate reference system information for geospatial data",
        ),
        (
            "zarr-conventions/spatial",
            "689b58e2-cf7b-45e0-9fff-9cfc0883d6b4",
            "spatial:",
            "Spatial coordinate information",
        ),
    )
]
"""Version 1 of the three conventions."""


def heights_spec(shape: Shape, level: int, shard: int, chunk: int) -> ArraySpec:
    """The nested heights of a level."""
    return ArraySpec(f"heights/{level}/height", level_shape(shape, level), shard, chunk)


def mean_spec(shape: Shape, level: int, shard: int, chunk: int) -> ArraySpec:
    """The box means of a level ≥ 1."""
    return ArraySpec(f"mean/{level}/height", mean_shape(shape, level), shard, chunk)


def table_spec(shape: Shape, level: int, name: str, shard: int, chunk: int) -> ArraySpec:
    """One of a level's tile tables."""
    dtype, fill = TABLES_AND_VALID[name]
    return ArraySpec(f"tiles/{level}/{name}", tile_shape(shape, level), shard, chunk, dtype, fill, ("tile_y", "tile_x"))


def diamond_spec(shape: Shape, level: int, name: str, shard: int, chunk: int) -> ArraySpec:
    """The codes of a level's diamonds: of a kind of errors, or "radius"."""
    return ArraySpec(f"diamonds/{level}/{name}", diamond_shape(shape, level), shard, chunk, "uint8", 0.0)


@dataclass(frozen=True, slots=True)
class Record:
    """What a complete store says of itself under ``orograph``.

    Attributes:
        grid: of level 0.
        name: of the terrain.
        vertical: name of the vertical datum, None if unknown.
        shard, chunk: samples along their sides.
        height_range: lowest and highest valid sample, nan if there is none.
        valid_fraction: of all samples.
        source: fingerprint of what it was built from.
        errors: the kinds of errors it has of its diamonds, and how they are coded.
        radius: how their radii are coded; None if it has no errors.
        layers: by name.
        patches: of which patches it has the errors: legs and kappa (``store.patches``); empty if of none.
        colors: of which colours it has the errors (``geovis.color_store``); empty if of none.
    """

    grid: Grid
    name: str
    vertical: str | None
    shard: int
    chunk: int
    height_range: tuple[float, float]
    valid_fraction: float
    source: str
    errors: dict[ErrorKind, ErrorCode] = field(default_factory=dict)
    radius: RadiusCode | None = None
    layers: dict[str, LayerRecord] = field(default_factory=dict)
    patches: dict[str, float] = field(default_factory=dict)
    colors: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        crs = self.grid.crs
        low, high = self.height_range
        record: dict[str, Any] = {
            "format": FORMAT,
            "complete": True,
            "name": self.name,
            "vertical": self.vertical,
            "shape": list(self.grid.shape),
            "transform": list(self.grid.transform[:6]),
            "crs": None if crs is None else crs.to_wkt(),
            "levels": level_count(self.grid.shape),
            "shard": self.shard,
            "chunk": self.chunk,
            "height_range": None if math.isnan(low) else [low, high],
            "valid_fraction": self.valid_fraction,
            "source": self.source,
            "errors": {kind: code.to_json() for kind, code in self.errors.items()},
            "radius": None if self.radius is None else self.radius.to_json(),
        }
        if self.layers:
            record["layers"] = {name: layer.to_json() for name, layer in self.layers.items()}
        if self.patches:
            record["patches"] = self.patches
        if self.colors:
            record["colors"] = self.colors
        return {**record, "checksum": _checksum(record)}

    @classmethod
    def from_json(cls, record: dict[str, Any], url: str) -> Record:
        """Read the record back.

        Raises:
            StoreError: it has another format than this reader, or it fails its checksum.
        """
        number = record.get("format")
        if number != FORMAT:
            older = isinstance(number, int) and number < FORMAT
            raise StoreError(
                f"It has store format {number}, and this version reads format {FORMAT}.",
                path=url,
                remedy="Build the store again (orograph build --overwrite)."
                if older
                else "Update Orograph (pip install -U orograph).",
            )
        said = record.get("checksum")
        if said != _checksum({key: value for key, value in record.items() if key != "checksum"}):
            raise StoreError(
                "The record of the store in zarr.json fails its checksum.",
                path=url,
                remedy="Build the store again (orograph build --overwrite).",
            )
        crs = None if record["crs"] is None else CRS.from_wkt(record["crs"])
        rows, cols = record["shape"]
        low, high = record["height_range"] or (math.nan, math.nan)
        grid = Grid((rows, cols), Affine(*record["transform"]), crs)
        radius = record["radius"]
        return cls(
            grid,
            record["name"],
            record["vertical"],
            record["shard"],
            record["chunk"],
            (low, high),
            record["valid_fraction"],
            record["source"],
            {kind: ErrorCode(**code) for kind, code in record["errors"].items()},
            None if radius is None else RadiusCode(nominal_radii(metric(grid), exponent(grid.shape)), **radius),
            {name: LayerRecord.from_json(name, layer) for name, layer in record.get("layers", {}).items()},
            record.get("patches", {}),
            record.get("colors", {}),
        )


def _checksum(record: dict[str, Any]) -> str:
    return f"{crc32c(json.dumps(record, sort_keys=True).encode()):08x}"


def dumps(document: dict[str, Any]) -> bytes:
    """JSON as it is written: the same bytes for the same document."""
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


def level_transform(grid: Grid, level: int, mean: bool) -> Affine:
    """The geotransform of a level: blocks for means; for nested heights cells centred on the samples they keep."""
    scale = Affine.scale(1 << level)
    if mean:
        return compose(grid.transform, scale)
    return compose(grid.transform, Affine.translation(0.5, 0.5), scale, Affine.translation(-0.5, -0.5))


def metadata(record: Record) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Every small object of a complete store: (all but the root, the root), keys to bytes."""
    grid, shard, chunk = record.grid, record.shard, record.chunk
    levels = level_count(grid.shape)
    nodes: dict[str, dict[str, Any]] = {"heights": _group(), "tiles": _group()}
    data: dict[str, bytes] = {}
    if levels > 1:
        nodes["mean"] = _group()
    names = {"heights": "nested subsample", "mean": "mean of the valid samples of each block"}
    for level in range(levels):
        for kind, make in (("heights", heights_spec), ("mean", mean_spec)):
            if kind == "mean" and level == 0:
                continue
            spec = make(grid.shape, level, shard, chunk)
            transform = level_transform(grid, level, kind == "mean")
            path = f"{kind}/{level}"
            nodes[path] = _group(_spatial(Grid(spec.shape, transform, grid.crs)))
            attributes = {
                "units": "m",
                "standard_name": "surface_altitude",
                "long_name": f"terrain height, {names[kind]}, level {level}",
                "grid_mapping": "spatial_ref",
            }
            nodes[spec.path] = spec.metadata(attributes)
            _coordinates(path, Grid(spec.shape, transform, grid.crs), nodes, data)
        nodes[f"tiles/{level}"] = _group()
        for name in TABLES_AND_VALID:
            spec = table_spec(grid.shape, level, name, shard, chunk)
            nodes[spec.path] = spec.metadata({"units": "m"} if name != "valid" else {"flag_values": [0, 1, 2]})
    if record.radius is not None:
        nodes["diamonds"] = _group()
        codes: dict[str, dict[str, Any]] = {kind: code.to_json() for kind, code in record.errors.items()}
        codes["radius"] = record.radius.to_json()
        for level in range(levels):
            nodes[f"diamonds/{level}"] = _group()
            for diamond, code in codes.items():
                spec = diamond_spec(grid.shape, level, diamond, shard, chunk)
                nodes[spec.path] = spec.metadata({"long_name": f"{diamond} of diamonds, coded", "code": code})
    if record.colors:
        nodes.setdefault("diamonds", _group())
        for level in range(levels):
            nodes.setdefault(f"diamonds/{level}", _group())
            spec = diamond_spec(grid.shape, level, "color", shard, chunk)
            told: dict[str, Any] = {
                "long_name": "color errors of diamonds, (code / 15.9)² ΔE",
                "made_with": record.colors,
            }
            nodes[spec.path] = spec.metadata(told)
    if record.patches:
        from orograph.store.patches import spec as patch_spec
        from orograph.store.patches import stored_levels

        nodes["patches"] = _group(dict(record.patches))
        for level in stored_levels(grid.shape, int(record.patches["legs"])):
            nodes[f"patches/{level}"] = _group()
            for kind in record.errors:
                spec = patch_spec(grid.shape, level, kind, shard, chunk)
                about = f"{kind} of patches, saturated; negative where ground is missing"
                nodes[spec.path] = spec.metadata({"units": "m", "long_name": about})
    for layer in record.layers.values():
        nodes.setdefault(GROUP, _group())
        _layer(record, layer, nodes, data)
    for path in [path for path, node in nodes.items() if node["node_type"] == "group"]:
        below = {p[len(path) + 1 :]: node for p, node in nodes.items() if p.startswith(path + "/")}
        nodes[path] = {**nodes[path], "consolidated_metadata": _consolidated(below)}
    root = {
        **_group({**_root_attributes(record), "orograph": record.to_json()}),
        "consolidated_metadata": _consolidated(
            {path: {k: v for k, v in node.items() if k != "consolidated_metadata"} for path, node in nodes.items()}
        ),
    }
    data.update({f"{path}/{ROOT}": dumps(node) for path, node in nodes.items()})
    return data, {ROOT: dumps(root)}


def _layer(record: Record, layer: LayerRecord, nodes: dict[str, dict[str, Any]], data: dict[str, bytes]) -> None:
    """The groups and arrays of a layer."""
    said = {"long_name": layer.doc, "averaging": layer.averaging, "made_with": layer.options}
    nodes[f"{GROUP}/{layer.name}"] = _group(said)
    for level in range(level_count(record.grid.shape)):
        grid = Grid(
            mean_shape(record.grid.shape, level), level_transform(record.grid, level, mean=True), record.grid.crs
        )  # fmt: skip
        path = f"{GROUP}/{layer.name}/{level}"
        nodes[path] = _group(_spatial(grid))
        for band in layer.bands:
            spec = layer_spec(record.grid.shape, layer.name, level, band, record.shard, record.chunk)
            name = {"long_name": f"{layer.doc}, {band.name}, level {level}"}
            nodes[spec.path] = spec.metadata({**name, **band.attributes()})
        _coordinates(path, grid, nodes, data)


def _consolidated(nodes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    # zarr-python wants the children of a group one after the other
    in_order = dict(sorted(nodes.items(), key=lambda item: (item[0].count("/"), item[0])))
    return {"kind": "inline", "must_understand": False, "metadata": in_order}


def _group(attributes: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"zarr_format": 3, "node_type": "group", "attributes": attributes or {}}


def _spatial(grid: Grid) -> dict[str, Any]:
    """The spatial and proj conventions' attributes of a grid."""
    attributes: dict[str, Any] = {
        "spatial:dimensions": ["y", "x"],
        "spatial:shape": list(grid.shape),
        "spatial:transform": list(grid.transform[:6]),
        "spatial:bbox": list(grid.bounds()),
        "spatial:registration": "pixel",
    }
    if grid.crs is not None:
        authority = grid.crs.to_authority(min_confidence=100)
        if authority:
            attributes["proj:code"] = ":".join(authority)
        attributes["proj:wkt2"] = grid.crs.to_wkt()
    conventions = [c for c in CONVENTIONS if c["name"] == "spatial:" or (c["name"] == "proj:" and grid.crs is not None)]
    return {"zarr_conventions": conventions, **attributes}


def _root_attributes(record: Record) -> dict[str, Any]:
    spatial = _spatial(record.grid)
    layout: list[dict[str, Any]] = []
    for level in range(level_count(record.grid.shape)):
        step = float(1 << level)
        entry: dict[str, Any] = {
            "asset": f"heights/{level}",
            "transform": {"scale": [step, step], "translation": [(1 - step) / 2] * 2},
            "spatial:shape": list(level_shape(record.grid.shape, level)),
            "spatial:transform": list(level_transform(record.grid, level, mean=False)[:6]),
        }
        if level:
            entry["derived_from"] = f"heights/{level - 1}"
        layout.append(entry)
    return {
        **spatial,
        "zarr_conventions": [CONVENTIONS[0], *spatial["zarr_conventions"]],
        "multiscales": {"layout": layout, "resampling_method": "nearest"},
    }


def _coordinates(path: str, grid: Grid, nodes: dict[str, dict[str, Any]], data: dict[str, bytes]) -> None:
    """CF coordinates of a level (small, unsharded arrays) for xarray and rioxarray."""
    a, b, c, d, e, f = grid.transform[:6]
    if b == 0 and d == 0:
        x = grid.xy(np.arange(grid.cols), 0)[0]
        y = grid.xy(0, np.arange(grid.rows))[1]
        for name, values, title in (("x", x, "projection_x_coordinate"), ("y", y, "projection_y_coordinate")):
            attributes = {"standard_name": title, "axis": name.upper(), "units": "m"}
            nodes[f"{path}/{name}"] = _small(values, (name,), attributes)
            data[f"{path}/{name}/c/0"] = _with_checksum(values)
    reference = np.zeros((), np.int64)
    about = {"GeoTransform": " ".join(repr(v) for v in (c, a, b, f, d, e))}
    if grid.crs is not None:
        about["crs_wkt"] = about["spatial_ref"] = grid.crs.to_wkt()
    nodes[f"{path}/spatial_ref"] = _small(reference, (), about)
    data[f"{path}/spatial_ref/c"] = _with_checksum(reference)


def _small(values: NDArray[Any], dimensions: tuple[str, ...], attributes: dict[str, Any]) -> dict[str, Any]:
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(values.shape),
        "data_type": str(values.dtype),
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(values.shape)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0,
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
        "dimension_names": list(dimensions),
        "attributes": attributes,
    }


def _with_checksum(values: NDArray[Any]) -> bytes:
    data = values.astype(values.dtype.newbyteorder("<")).tobytes()
    return data + crc32c(data).to_bytes(4, "little")
