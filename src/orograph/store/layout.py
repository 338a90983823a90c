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
    source/{i}/height          the samples of a source lattice that was resampled, in its own type (see ``lattices``)
    layers/NAME/{k}/BAND       uint8 or uint16, coded: layers that were put in later, such as baked light (``layers``)

so that ``xarray.open_zarr(store, group="heights/3")`` opens a level with its coordinates. The root carries the
*multiscales*, *spatial* and *proj* conventions (``conventions``), and Orograph's own record with its own checksum.
A build keeps its plan in ``build.json`` and what each finished task found in ``parts/`` until it is complete.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from typing import Any

from affine import Affine
from pyproj import CRS

from orograph.error import ErrorKind
from orograph.error.quantise import ErrorCode, RadiusCode, nominal_radii
from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.store.arrays import ArraySpec
from orograph.store.conventions import (
    consolidated,
    group,
    level_transform,
    put_coordinates,
    root_attributes,
    spatial_attributes,
)
from orograph.store.diamonds import metric
from orograph.store.digests import Digests, crc32c, digest_of
from orograph.store.lattices import SOURCE, LatticeRecord
from orograph.store.layers import GROUP, LayerRecord, layer_spec
from orograph.store.places import ROOT
from orograph.store.storage import Storage
from orograph.store.terrain import (
    Resampled,
    Shape,
    diamond_shape,
    exponent,
    level_count,
    level_shape,
    mean_shape,
    tile_shape,
)

FORMAT = 4
"""The version of this layout; a reader refuses others."""

KNOWN: frozenset[str] = frozenset()
"""What else a store may need of its reader (``Record.needs``)."""

CHUNK = 256
PARTS = "parts"
TABLES = {"minimum": ("float32", math.nan), "maximum": ("float32", math.nan), "error": ("float32", 0.0)}
TABLES_AND_VALID = {**TABLES, "valid": ("uint8", 0.0)}


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
        resampled: what was lost when its sources were resampled; None if every sample is a source's own.
        lattices: the source lattices that it keeps.
        inputs: the files and options it was built with (``store.inputs``); None if from no files.
        digests: of all its objects but the root.
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
    resampled: Resampled | None = None
    lattices: tuple[LatticeRecord, ...] = ()
    inputs: dict[str, Any] | None = None
    digests: Digests = field(default_factory=Digests, compare=False)

    @property
    def shard_count(self) -> int:
        """Shards of all its arrays."""
        return sum(spec.shards[0] * spec.shards[1] for spec in array_specs(self))

    def to_json(self) -> dict[str, Any]:
        crs = self.grid.crs
        low, high = self.height_range
        record: dict[str, Any] = {
            "format": FORMAT,
            "needs": [],
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
            "inputs": self.inputs,
            "errors": {kind: code.to_json() for kind, code in self.errors.items()},
            "radius": None if self.radius is None else self.radius.to_json(),
            "resampled": None if self.resampled is None else self.resampled.to_json(),
            "lattices": [lattice.to_json() for lattice in self.lattices],
        }
        if self.layers:
            record["layers"] = {name: layer.to_json() for name, layer in self.layers.items()}
        if self.patches:
            record["patches"] = self.patches
        if self.colors:
            record["colors"] = self.colors
        record["digests"] = self.digests.to_json()
        return {**record, "checksum": _checksum(record)}

    @classmethod
    def from_json(cls, record: dict[str, Any], url: str) -> Record:
        """Read the record back.

        Raises:
            StoreError: it has another format than this reader, or it fails its checksum.
        """
        _understood(record, url)
        said = record.get("checksum")
        if said != _checksum({key: value for key, value in record.items() if key != "checksum"}):
            raise StoreError(
                "The record of the store in zarr.json fails its checksum.", path=url, remedy=rebuild(record, url)
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
            None if record["resampled"] is None else Resampled.from_json(record["resampled"]),
            tuple(LatticeRecord.from_json(lattice) for lattice in record["lattices"]),
            record["inputs"],
            Digests.from_json(record["digests"]),
        )


def _understood(record: dict[str, Any], url: str) -> None:
    """Raise StoreError unless this reader knows the store's format and all that it needs."""
    number = record.get("format")
    update = "Update Orograph (pip install -U orograph)."
    if number != FORMAT:
        older = isinstance(number, int) and number < FORMAT
        raise StoreError(
            f"It has store format {number}, and this version reads format {FORMAT}.",
            path=url,
            remedy=rebuild(record, url) if older else update,
        )
    unknown = [need for need in record.get("needs", ()) if need not in KNOWN]
    if unknown:
        raise StoreError(f"It needs a reader that knows {', '.join(unknown)}.", path=url, remedy=update)


def rebuild(record: dict[str, Any], url: str) -> str:
    """The command that builds a store again, as far as its record tells."""
    inputs = record.get("inputs")
    files, options = "dem", ""
    if isinstance(inputs, dict):
        files = repr([file["path"] for file in inputs["files"]])
        options = "".join(f"{name}={value!r}, " for name, value in inputs["options"].items())
    return f"Build it again: `orograph.build({files}, {url!r}, {options}overwrite=True)`."


def _checksum(record: dict[str, Any]) -> str:
    return f"{crc32c(json.dumps(record, sort_keys=True).encode()):08x}"


def dumps(document: dict[str, Any]) -> bytes:
    """JSON as it is written: the same bytes for the same document."""
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


def array_specs(record: Record) -> list[ArraySpec]:
    """Every array of a store that lies in shards."""
    from orograph.store.patches import spec as patch_spec
    from orograph.store.patches import stored_levels

    shape, sizes = record.grid.shape, (record.shard, record.chunk)
    diamonds = [*record.errors, *(["radius"] if record.radius else []), *(["color"] if record.colors else [])]
    found = []
    for level in range(level_count(shape)):
        found.append(heights_spec(shape, level, *sizes))
        if level:
            found.append(mean_spec(shape, level, *sizes))
        found += [table_spec(shape, level, name, *sizes) for name in TABLES_AND_VALID]
        found += [diamond_spec(shape, level, name, *sizes) for name in diamonds]
        if record.patches and level in stored_levels(shape, int(record.patches["legs"])):
            found += [patch_spec(shape, level, kind, *sizes) for kind in record.errors]
        found += [layer_spec(shape, x.name, level, band, *sizes) for x in record.layers.values() for band in x.bands]
    return [*found, *(lattice.spec(number, *sizes) for number, lattice in enumerate(record.lattices))]


def metadata(record: Record) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Every small object of a complete store: (all but the root, the root), keys to bytes."""
    grid, shard, chunk = record.grid, record.shard, record.chunk
    levels = level_count(grid.shape)
    nodes: dict[str, dict[str, Any]] = {"heights": group(), "tiles": group()}
    data: dict[str, bytes] = {}
    if levels > 1:
        nodes["mean"] = group()
    names = {"heights": "nested subsample", "mean": "mean of the valid samples of each block"}
    for level in range(levels):
        for kind, make in (("heights", heights_spec), ("mean", mean_spec)):
            if kind == "mean" and level == 0:
                continue
            spec = make(grid.shape, level, shard, chunk)
            transform = level_transform(grid, level, kind == "mean")
            path = f"{kind}/{level}"
            nodes[path] = group(spatial_attributes(Grid(spec.shape, transform, grid.crs)))
            attributes = {
                "units": "m",
                "standard_name": "surface_altitude",
                "long_name": f"terrain height, {names[kind]}, level {level}",
                "grid_mapping": "spatial_ref",
            }
            nodes[spec.path] = spec.metadata(attributes)
            put_coordinates(path, Grid(spec.shape, transform, grid.crs), nodes, data)
        nodes[f"tiles/{level}"] = group()
        for name in TABLES_AND_VALID:
            spec = table_spec(grid.shape, level, name, shard, chunk)
            nodes[spec.path] = spec.metadata({"units": "m"} if name != "valid" else {"flag_values": [0, 1, 2]})
    if record.radius is not None:
        nodes["diamonds"] = group()
        codes: dict[str, dict[str, Any]] = {kind: code.to_json() for kind, code in record.errors.items()}
        codes["radius"] = record.radius.to_json()
        for level in range(levels):
            nodes[f"diamonds/{level}"] = group()
            for diamond, code in codes.items():
                spec = diamond_spec(grid.shape, level, diamond, shard, chunk)
                nodes[spec.path] = spec.metadata({"long_name": f"{diamond} of diamonds, coded", "code": code})
    if record.colors:
        nodes.setdefault("diamonds", group())
        for level in range(levels):
            nodes.setdefault(f"diamonds/{level}", group())
            spec = diamond_spec(grid.shape, level, "color", shard, chunk)
            told: dict[str, Any] = {
                "long_name": "color errors of diamonds, (code / 15.9)² ΔE",
                "made_with": record.colors,
            }
            nodes[spec.path] = spec.metadata(told)
    if record.patches:
        from orograph.store.patches import spec as patch_spec
        from orograph.store.patches import stored_levels

        nodes["patches"] = group(dict(record.patches))
        for level in stored_levels(grid.shape, int(record.patches["legs"])):
            nodes[f"patches/{level}"] = group()
            for kind in record.errors:
                spec = patch_spec(grid.shape, level, kind, shard, chunk)
                about = f"{kind} of patches, saturated; negative where ground is missing"
                nodes[spec.path] = spec.metadata({"units": "m", "long_name": about})
    for number, lattice in enumerate(record.lattices):
        path = f"{SOURCE}/{number}"
        nodes.setdefault(SOURCE, group())
        nodes[path] = group(spatial_attributes(lattice.grid))
        nodes[f"{path}/height"] = lattice.spec(number, shard, chunk).metadata(lattice.attributes())
        put_coordinates(path, lattice.grid, nodes, data)
    for layer in record.layers.values():
        nodes.setdefault(GROUP, group())
        _layer(record, layer, nodes, data)
    for path in [path for path, node in nodes.items() if node["node_type"] == "group"]:
        if path == GROUP or path.split("/")[0] == "diamonds":
            continue  # what comes later must not change them
        below = {p[len(path) + 1 :]: node for p, node in nodes.items() if p.startswith(path + "/")}
        nodes[path] = {**nodes[path], "consolidated_metadata": consolidated(below)}
    data.update({f"{path}/{ROOT}": dumps(node) for path, node in nodes.items()})
    root = {
        **group(root_attributes(record.grid)),
        "consolidated_metadata": consolidated(
            {path: {k: v for k, v in node.items() if k != "consolidated_metadata"} for path, node in nodes.items()}
        ),
    }
    digests = Digests(record.digests.of(nodes))  # of the shards of what is still in the store
    digests.listed.update({key: bytearray(digest_of(content)) for key, content in data.items()})
    digests.listed[ROOT] = bytearray(root_digest(root))
    root["attributes"]["orograph"] = replace(record, digests=digests).to_json()
    return data, {ROOT: dumps(root)}


def root_digest(root: dict[str, Any]) -> bytes:
    """The digest of the root's document without Orograph's record."""
    attributes = {key: value for key, value in root["attributes"].items() if key != "orograph"}
    return digest_of(json.dumps({**root, "attributes": attributes}, sort_keys=True).encode())


def publish(storage: Storage, record: Record) -> None:
    """Write all small objects that differ from what ``record.digests`` lists; the root last, which makes them count."""
    others, root = metadata(record)
    for key, content in others.items():
        if bytes(record.digests.listed.get(key, b"")) != digest_of(content):
            storage.put(key, [content])
    for key, content in root.items():
        storage.put(key, [content])


def _layer(record: Record, layer: LayerRecord, nodes: dict[str, dict[str, Any]], data: dict[str, bytes]) -> None:
    """The groups and arrays of a layer."""
    said = {"long_name": layer.doc, "averaging": layer.averaging, "made_with": layer.options}
    nodes[f"{GROUP}/{layer.name}"] = group(said)
    for level in range(level_count(record.grid.shape)):
        grid = Grid(
            mean_shape(record.grid.shape, level), level_transform(record.grid, level, mean=True), record.grid.crs
        )  # fmt: skip
        path = f"{GROUP}/{layer.name}/{level}"
        nodes[path] = group(spatial_attributes(grid))
        for band in layer.bands:
            spec = layer_spec(record.grid.shape, layer.name, level, band, record.shard, record.chunk)
            name = {"long_name": f"{layer.doc}, {band.name}, level {level}"}
            nodes[spec.path] = spec.metadata({**name, **band.attributes()})
        put_coordinates(path, grid, nodes, data)
