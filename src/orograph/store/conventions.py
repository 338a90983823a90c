"""Metadata for other Zarr tools: groups, the conventions that they follow, and CF coordinates.

The *multiscales*, *spatial* and *proj* conventions (versions defined here) say where a raster lies and which levels it
has; coordinates along x and y and a ``spatial_ref`` let xarray and rioxarray open a level by itself.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.geo.grid import Grid, compose, wkt_of
from orograph.store.digests import crc32c
from orograph.store.terrain import level_count, level_shape

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


def level_transform(grid: Grid, level: int, mean: bool) -> Affine:
    """The geotransform of a level: blocks for means; for nested heights, cells centred on the samples."""
    scale = Affine.scale(1 << level)
    if mean:
        return compose(grid.transform, scale)
    return compose(grid.transform, Affine.translation(0.5, 0.5), scale, Affine.translation(-0.5, -0.5))


def consolidated(nodes: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The metadata of everything below a group, as the group stores them."""
    # zarr-python wants the children of a group in sorted order
    in_order = dict(sorted(nodes.items(), key=lambda item: (item[0].count("/"), item[0])))
    return {"kind": "inline", "must_understand": False, "metadata": in_order}


def group(attributes: dict[str, Any] | None = None) -> dict[str, Any]:
    """The metadata of a group."""
    return {"zarr_format": 3, "node_type": "group", "attributes": attributes or {}}


def spatial_attributes(grid: Grid) -> dict[str, Any]:
    """The spatial and proj conventions' attributes of a grid."""
    attributes: dict[str, Any] = {
        "spatial:dimensions": ["y", "x"],
        "spatial:shape": list(grid.shape),
        "spatial:transform": list(grid.transform[:6]),
        "spatial:bbox": list(grid.bounds()),
        "spatial:registration": "pixel",
    }
    if grid.crs is not None:
        code = _code(grid.crs)
        if code:
            attributes["proj:code"] = code
        attributes["proj:wkt2"] = wkt_of(grid.crs)
    conventions = [c for c in CONVENTIONS if c["name"] == "spatial:" or (c["name"] == "proj:" and grid.crs is not None)]
    return {"zarr_conventions": conventions, **attributes}


@lru_cache(maxsize=8)
def _code(crs: CRS) -> str:
    """AUTHORITY:CODE of a CRS, "" if it has none.

    It is cached, because finding it takes a tenth of a second and all arrays have one.
    """
    return ":".join(crs.to_authority(min_confidence=100) or ())


def root_attributes(grid: Grid) -> dict[str, Any]:
    """The root's attributes: its place and its levels."""
    spatial = spatial_attributes(grid)
    layout: list[dict[str, Any]] = []
    for level in range(level_count(grid.shape)):
        step = float(1 << level)
        entry: dict[str, Any] = {
            "asset": f"heights/{level}",
            "transform": {"scale": [step, step], "translation": [(1 - step) / 2] * 2},
            "spatial:shape": list(level_shape(grid.shape, level)),
            "spatial:transform": list(level_transform(grid, level, mean=False)[:6]),
        }
        if level:
            entry["derived_from"] = f"heights/{level - 1}"
        layout.append(entry)
    return {
        **spatial,
        "zarr_conventions": [CONVENTIONS[0], *spatial["zarr_conventions"]],
        "multiscales": {"layout": layout, "resampling_method": "nearest"},
    }


def put_coordinates(path: str, grid: Grid, nodes: dict[str, dict[str, Any]], data: dict[str, bytes]) -> None:
    """CF coordinates of a level (small, unsharded arrays) for xarray and rioxarray."""
    a, b, c, d, e, f = grid.transform[:6]
    if b == 0 and d == 0:
        x = grid.xy(np.arange(grid.cols), 0)[0]
        y = grid.xy(0, np.arange(grid.rows))[1]
        titles = ("projection_x_coordinate", "m"), ("projection_y_coordinate", "m")
        if grid.crs is not None and grid.crs.is_geographic:
            titles = ("longitude", "degrees_east"), ("latitude", "degrees_north")
        for name, values, (title, units) in zip(("x", "y"), (x, y), titles):
            attributes = {"standard_name": title, "axis": name.upper(), "units": units}
            nodes[f"{path}/{name}"] = _small(values, (name,), attributes)
            data[f"{path}/{name}/c/0"] = _with_checksum(values)
    reference = np.zeros((), np.int64)
    about = {"GeoTransform": " ".join(repr(v) for v in (c, a, b, f, d, e))}
    if grid.crs is not None:
        about["crs_wkt"] = about["spatial_ref"] = str(wkt_of(grid.crs))
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
