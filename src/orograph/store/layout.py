"""The names and the metadata of a store: what a Zarr tool sees, and what Orograph reads back.

A store is a Zarr v3 group::

    zarr.json                  written last; its attribute "orograph" makes the group a store
    heights/{k}/height         (rows_k, cols_k) float32, metres, NaN missing: the nested level k
    heights/{k}/x, y           sample coordinates (unless the grid is rotated); spatial_ref: the CRS, as CF has it
    mean/{k}/height            box means of 2^k × 2^k samples, k ≥ 1; x, y and spatial_ref as above
    tiles/{k}/minimum, maximum, error (float32), valid (uint8)
    diamonds/{k}/radius        uint8, coded: spheres of the diamonds of octave k (``diamond_table``)
    diamonds/{k}/exact…        uint8, coded: their errors, of each kind that was built
    colors/{k}/color           uint8, coded: how much coarser triangles change colours (``geovis.color_store``)
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
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from affine import Affine
from pyproj import CRS

from orograph.errors import StoreError
from orograph.geo.grid import Grid, wkt_of
from orograph.store.array_spec import ArraySpec
from orograph.store.coding import Coding, Packing
from orograph.store.conventions import (
    consolidated,
    group,
    level_transform,
    put_coordinates,
    root_attributes,
    spatial_attributes,
)
from orograph.store.derived import At, Derived
from orograph.store.digests import Digests, crc32c, digest_of
from orograph.store.lattices import SOURCE, LatticeRecord
from orograph.store.places import ROOT
from orograph.store.progressive import Scheme
from orograph.store.registry import KINDS
from orograph.store.storage import Storage
from orograph.store.terrain import (
    Resampled,
    Shape,
    level_count,
    level_shape,
    mean_shape,
    tile_shape,
)
from orograph.store.versions import Edition

FORMAT = 4
"""The version of this layout; a reader refuses others."""

CODEC, VERSION = "codec", "version"
KNOWN = frozenset({CODEC, VERSION})
"""Other features that a store may require from its reader (``Record.needs``)."""

CHUNK = 256
TABLES = {"minimum": ("float32", math.nan), "maximum": ("float32", math.nan), "error": ("float32", 0.0)}
TABLES_AND_VALID = {**TABLES, "valid": ("uint8", 0.0)}


def heights_spec(shape: Shape, level: int, shard: int, chunk: int, coding: Coding | None = None) -> ArraySpec:
    """The nested heights of a level."""
    packing = None if coding is None else coding.heights
    spec = ArraySpec(f"heights/{level}/height", level_shape(shape, level), shard, chunk, packing=packing)
    if coding is None or coding.codec != "progressive":
        return spec
    if level == level_count(shape) - 1:
        return replace(spec, packing=Packing(coding.step * coding.factor, coding.codec))
    scheme = Scheme(coding.factor, level >= (shard // chunk).bit_length())
    return replace(spec, scheme=scheme, coarser=heights_spec(shape, level + 1, shard, chunk, coding))


def mean_spec(shape: Shape, level: int, shard: int, chunk: int, coding: Coding | None = None) -> ArraySpec:
    """The box means of a level ≥ 1."""
    packing = None if coding is None else coding.means
    return ArraySpec(f"mean/{level}/height", mean_shape(shape, level), shard, chunk, packing=packing)


def table_spec(shape: Shape, level: int, name: str, shard: int, chunk: int) -> ArraySpec:
    """One of a level's tile tables."""
    dtype, fill = TABLES_AND_VALID[name]
    return ArraySpec(f"tiles/{level}/{name}", tile_shape(shape, level), shard, chunk, dtype, fill, ("tile_y", "tile_x"))


@dataclass(frozen=True, slots=True)
class Record:
    """A complete store's description of itself, under ``orograph``.

    Attributes:
        grid: the grid of level 0.
        name: the terrain's name.
        vertical: name of the vertical datum, None if unknown.
        shard, chunk: samples along their sides.
        height_range: lowest and highest valid sample, nan if there is none.
        valid_fraction: the valid fraction of all samples.
        source: fingerprint of what it was built from.
        derived: its derived data, by name (``store.derived``).
        resampled: the loss when its sources were resampled; None if every sample is an original one.
        lattices: the source lattices that it keeps.
        inputs: the files and options it was built with (``store.inputs``); None if not built from files.
        digests: of all its objects except the root.
        attribution: the credits that the makers of its heights ask for.
        coding: how it encodes its heights; None: float32, lossless.
        version: for an updated store in a bucket: which version of it this is (``versions``); None: its objects
            lie under their plain keys.
    """

    grid: Grid
    name: str
    vertical: str | None
    shard: int
    chunk: int
    height_range: tuple[float, float]
    valid_fraction: float
    source: str
    derived: dict[str, Any] = field(default_factory=dict)
    resampled: Resampled | None = None
    lattices: tuple[LatticeRecord, ...] = ()
    inputs: dict[str, Any] | None = None
    digests: Digests = field(default_factory=Digests, compare=False)
    attribution: tuple[str, ...] = ()
    coding: Coding | None = None
    version: Edition | None = None

    @property
    def shard_count(self) -> int:
        """Shards of all its arrays."""
        return sum(spec.shards[0] * spec.shards[1] for spec in array_specs(self))

    def to_json(self) -> dict[str, Any]:
        low, high = self.height_range
        record: dict[str, Any] = {
            "format": FORMAT,
            "needs": [name for name, what in ((CODEC, self.coding), (VERSION, self.version)) if what is not None],
            "name": self.name,
            "vertical": self.vertical,
            "shape": list(self.grid.shape),
            "transform": list(self.grid.transform[:6]),
            "crs": wkt_of(self.grid.crs),
            "levels": level_count(self.grid.shape),
            "shard": self.shard,
            "chunk": self.chunk,
            "height_range": None if math.isnan(low) else [low, high],
            "valid_fraction": self.valid_fraction,
            "source": self.source,
            "inputs": self.inputs,
            "resampled": None if self.resampled is None else self.resampled.to_json(),
            "lattices": [lattice.to_json() for lattice in self.lattices],
        }
        if self.attribution:
            record["attribution"] = list(self.attribution)
        if self.coding is not None:
            record[CODEC] = self.coding.to_json()
        if self.version is not None:
            record[VERSION] = self.version._asdict()
        record["derived"] = {
            kind.name: {"version": kind.version, **kind.to_json(kind.of(self))}
            for kind in KINDS.values()
            if kind.name in self.derived
        }
        record["digests"] = self.digests.to_json()
        return {**record, "checksum": _checksum(record)}

    @classmethod
    def from_json(cls, record: dict[str, Any], url: str) -> Record:
        """Read the record back.

        Raises:
            StoreError: it has another format than this reader, or it fails its checksum.
        """
        _understood(record, url)
        checksum = record.get("checksum")
        if checksum != _checksum({key: value for key, value in record.items() if key != "checksum"}):
            raise StoreError(
                "The record of the store in zarr.json fails its checksum.", path=url, remedy=rebuild(record, url)
            )
        crs = None if record["crs"] is None else CRS.from_wkt(record["crs"])
        rows, cols = record["shape"]
        low, high = record["height_range"] or (math.nan, math.nan)
        grid = Grid((rows, cols), Affine(*record["transform"]), crs)
        derived = {
            name: KINDS[name].parse(entry, grid)
            for name, entry in record["derived"].items()
            if name in KINDS and entry["version"] == KINDS[name].version
        }
        return cls(
            grid,
            record["name"],
            record["vertical"],
            record["shard"],
            record["chunk"],
            (low, high),
            record["valid_fraction"],
            record["source"],
            derived,
            None if record["resampled"] is None else Resampled.from_json(record["resampled"]),
            tuple(LatticeRecord.from_json(lattice) for lattice in record["lattices"]),
            record["inputs"],
            Digests.from_json(record["digests"], VERSION in record),
            tuple(record.get("attribution", ())),
            Coding.from_json(record[CODEC]) if CODEC in record else None,
            Edition.from_json(record[VERSION]) if VERSION in record else None,
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
    """The command that rebuilds a store, as far as its record determines it."""
    inputs = record.get("inputs")
    files, options = "dem", ""
    if isinstance(inputs, dict):
        files = repr([file["path"] for file in inputs["files"]])
        options = "".join(f"{name}={value!r}, " for name, value in inputs["options"].items())
    if codec := record.get(CODEC):
        options += f"codec={codec['name']!r}, max_error={codec['max_error'] or 'auto'!r}, "
    return f"Build it again: `orograph.build({files}, {url!r}, {options}overwrite=True)`."


def _checksum(record: dict[str, Any]) -> str:
    return f"{crc32c(json.dumps(record, sort_keys=True).encode()):08x}"


def dumps(document: dict[str, Any]) -> bytes:
    """JSON as stored: the same bytes for the same document."""
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


def derived_arrays(record: Record) -> Iterator[tuple[Derived[Any], ArraySpec, dict[str, Any]]]:
    """Every array of derived data with its kind and its attributes."""
    at = At(record.grid, record.shard, record.chunk)
    for kind in KINDS.values():
        if kind.name in record.derived:
            for spec, attributes in kind.arrays(kind.of(record), at):
                yield kind, spec, attributes


def array_specs(record: Record) -> list[ArraySpec]:
    """Every array of a store that lies in shards."""
    shape, sizes = record.grid.shape, (record.shard, record.chunk)
    found = []
    for level in range(level_count(shape)):
        found.append(heights_spec(shape, level, *sizes, record.coding))
        if level:
            found.append(mean_spec(shape, level, *sizes, record.coding))
        found += [table_spec(shape, level, name, *sizes) for name in TABLES_AND_VALID]
    found += [spec for _, spec, _ in derived_arrays(record)]
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
            spec = make(grid.shape, level, shard, chunk, record.coding)
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
    for each in KINDS.values():
        if each.name in record.derived:
            groups, objects = each.groups(each.of(record), At(grid, shard, chunk))
            nodes.update(groups)
            data.update(objects)
    for _, spec, attributes in derived_arrays(record):
        nodes[spec.path] = spec.metadata(attributes)
    for number, lattice in enumerate(record.lattices):
        path = f"{SOURCE}/{number}"
        nodes.setdefault(SOURCE, group())
        nodes[path] = group(spatial_attributes(lattice.grid))
        nodes[f"{path}/height"] = lattice.spec(number, shard, chunk).metadata(lattice.attributes())
        put_coordinates(path, lattice.grid, nodes, data)
    shared = {kind.group for kind in KINDS.values() if kind.shared}
    for path in [path for path, node in nodes.items() if node["node_type"] == "group" and path not in shared]:
        below = {p[len(path) + 1 :]: node for p, node in nodes.items() if p.startswith(path + "/")}
        nodes[path] = {**nodes[path], "consolidated_metadata": consolidated(below)}
    data.update({f"{path}/{ROOT}": dumps(node) for path, node in nodes.items()})
    root = {
        **group(root_attributes(record.grid)),
        "consolidated_metadata": consolidated(
            {path: {k: v for k, v in node.items() if k != "consolidated_metadata"} for path, node in nodes.items()}
        ),
    }
    digests = Digests(record.digests.of(nodes), record.digests.keyed)  # of the shards of arrays still in the store
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
            storage.put(record.digests.place(key, digest_of(content)), [content])
    for key, content in root.items():
        storage.put(key, [content])
