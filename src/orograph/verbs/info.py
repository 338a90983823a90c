"""``orograph.info``: describe a DEM or a store and what looks suspicious in it, for people or (``--json``) programs.

The keys are fixed: kind ("dem", "store", "terrain" or "points"), path, crs, transform (a b c d e f as in GDAL and
affine), shape [rows, cols], points (how many a file of points holds), bounds [west, south, east, north] (of such a
file, in its CRS), lonlat [west, south, east, north] (of a raster's samples, in degrees, as ``bbox`` takes them),
spacing_m [x, y], height_range [min, max] (metres), height_range_exact, valid_fraction, dtype,
nodata, vertical_datum, attribution (the credit that its makers ask for), version (of a store that is updated), versions
(older ones kept beside it), levels, side, errors (the kinds that a store has), colors (what its color errors are of:
drape, colormap, sun, relief), resampled (what a store lost when its source was brought to another grid, metres: rms,
largest, summit_loss, highest, highest_loss), codec (how a lossy store encodes its heights: name, step, max_error, and
the largest and rms error, metres), keeps_source (whether the source's samples are in it), layers (those baked into it),
parts (how many bytes each part of a store takes), size_bytes, warnings. What is unknown or absent, and every number
that is not finite, is null.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph._named import answering
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.verbs.info_text import describe

if TYPE_CHECKING:
    from orograph.dem.area import Area
    from orograph.geo.grid import Grid
    from orograph.store.terrain import Terrain


KEYS = (
    "kind", "path", "crs", "transform", "shape", "points", "bounds", "lonlat", "spacing_m", "height_range",
    "height_range_exact", "valid_fraction", "dtype", "nodata", "vertical_datum", "attribution", "version", "versions",
    "levels", "side", "errors", "colors", "resampled", "codec", "keeps_source", "layers", "parts", "size_bytes",
    "warnings",
)  # fmt: skip
"""The keys, in their order."""


@answering
def info(
    source: Any, *, exact: bool | None = None, bbox: Sequence[float] | str | None = None, clip: Any = None,
    jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> Facts:  # fmt: skip
    """What heights are, and what is suspicious about them.

    Args:
        source: whatever ``orograph.terrain`` takes. As little of a file is read as possible; several files are one
        terrain.
        exact: whether to read every sample of a raster whatever its size; None: only of small ones.
        bbox: west, south, east, north in degrees: of this area only. clip: of what lies in polygons only (GeoJSON, a
            file or an object; shapely's, geopandas'). For a store this describes the area as a terrain, not the store's
            contents.
        jobs: threads. progress: gets progress reports; False: silent.
        reading: how a file is read: ``band``, ``nodata``, ``spacing``… (``orograph.terrain``).

    Returns:
        a dict, which prints as on the command line; its keys are listed above (those with "_" are for people).

    Raises:
        ReadError, StoreError: it cannot be read.
        UsageError: it does not hold heights, none lie in the area, or an option does not apply.
    """
    from orograph.dem.folders import is_folder
    from orograph.dem.handles import is_manifest
    from orograph.dem.scattered import is_points
    from orograph.store.detect import is_store
    from orograph.store.given import files_of

    heard = reporting(progress)
    files = files_of(source)
    area = None
    if bbox is not None or clip is not None:
        from orograph.dem.area import Area

        area = Area.of(bbox, clip)
    store = files is not None and len(files) == 1 and is_store(files[0])
    points = files is not None and len(files) == 1 and is_points(files[0])
    many = files is None or len(files) > 1 or is_manifest(files[0]) or (not store and is_folder(files[0]))
    if files is None or many or ((store or points) and area is not None):
        from orograph.store.opening import terrain

        part = {} if area is None else {"bbox": bbox, "clip": clip}
        how = {} if store else reading  # (a store knows how it was read)
        return _terrain_facts(terrain(source, heard, jobs=jobs, called="info", **part, **how))
    if points:
        from orograph.verbs.info_points import facts_of_points

        found = facts_of_points(files[0], heard, reading)
        empty: dict[str, Any] = {name: [] for name in ("errors", "versions", "layers", "attribution")}
        return Facts({**dict.fromkeys(KEYS), **empty, "path": files[0], "size_bytes": _size(files[0]), **found})
    return _store_facts(files[0]) if store else _dem_facts(files[0], heard, exact, area, jobs, reading)


class Facts(dict[str, Any]):
    """Facts by name; prints as text for people."""

    def __repr__(self) -> str:
        return describe(self)

    def _repr_html_(self) -> str:
        import html

        return f"<pre>{html.escape(describe(self))}</pre>"


def _dem_facts(
    path: str, progress: Progress, exact: bool | None, area: Area | None, jobs: int | None, options: Any
) -> Facts:
    from orograph.dem.inspect import crs_text, spacing_metres, suspicions
    from orograph.dem.source import Source
    from orograph.dem.statistics import statistics
    from orograph.store.given import options_of_files
    from orograph.store.terrain import exponent, level_count

    with Source.open(path, **options_of_files(options)) as opened:
        source: Any = opened if area is None else area.cut([opened])[0]
        spacing = spacing_metres(source.grid)
        found = statistics(source, spacing[0], exact=exact, jobs=jobs, progress=progress)
        warnings = suspicions(source, found)
    crs = source.grid.crs
    return Facts(
        {
            "kind": "dem",
            "path": path,
            "crs": crs_text(crs),
            "transform": list(source.grid.transform[:6]),
            "shape": list(source.grid.shape),
            "points": None,
            "bounds": None,
            "lonlat": _lonlat(source.grid),
            "spacing_m": [_finite(v) for v in spacing],
            "height_range": [_finite(found.low), _finite(found.high)],
            "height_range_exact": found.exact,
            "valid_fraction": found.valid_fraction,
            "dtype": source.dtype,
            "nodata": _finite(source.nodata),
            "vertical_datum": source.vertical,
            "attribution": list(source.attribution),
            "version": None,
            "versions": [],
            "levels": level_count(source.grid.shape),
            "side": (1 << exponent(source.grid.shape)) + 1,
            "errors": [],
            "colors": None,
            "resampled": None,
            "codec": None,
            "keeps_source": None,
            "layers": [],
            "parts": None,
            "size_bytes": _size(path),
            "warnings": warnings,
            "_format": source.driver,
            "_crs": crs,
            "_nodata": source.nodata,
            "_masked": source.masked,
            "_clipped": area is not None and bool(area.polygons),
            "_bands": (source.band, source.bands, source.description),
            "_scaling": (source.scale, source.offset, source.unit_factor),
            "_georeferenced": source.georeferenced,
            "_encoding": source.encoding,
        }
    )


def _store_facts(path: str) -> Facts:
    from orograph import store
    from orograph.store.colors import COLORS
    from orograph.store.layers import LAYERS
    from orograph.store.versions import older

    with store.open(path) as terrain:
        found = _terrain_facts(terrain)
        return Facts({
            **found,
            "kind": "store",
            "path": path,
            "version": terrain.version,
            "versions": [number for number, _ in older(terrain.storage)],
            "errors": list(terrain.errors),
            "colors": COLORS.of(terrain.record) or None,
            "codec": None if terrain.record.coding is None else terrain.record.coding.to_json(),
            "keeps_source": terrain.samples is not None,
            "parts": _parts(terrain.url, terrain.errors, tuple(terrain.layers)),
            "size_bytes": _size(terrain.url),
            "_resampled": terrain.resampled,
            "_codec": terrain.record.coding,
            "_layers": LAYERS.of(terrain.record),
            "_format": "terrain store",
        })  # fmt: skip


def _terrain_facts(terrain: Terrain) -> Facts:
    from orograph.dem.inspect import crs_text, spacing_metres

    low, high = terrain.height_range
    return Facts({
        "kind": "terrain",
        "path": terrain.name,
        "crs": crs_text(terrain.grid.crs),
        "transform": list(terrain.grid.transform[:6]),
        "shape": list(terrain.grid.shape),
        "points": None,
        "bounds": None,
        "lonlat": _lonlat(terrain.grid),
        "spacing_m": [_finite(v) for v in spacing_metres(terrain.grid)],
        "height_range": [_finite(low), _finite(high)],
        "height_range_exact": True,
        "valid_fraction": terrain.valid_fraction,
        "dtype": "float32",
        "nodata": None,
        "vertical_datum": terrain.vertical,
        "attribution": list(terrain.attribution),
        "version": None,
        "versions": [],
        "levels": terrain.levels,
        "side": terrain.side,
        "errors": [],
        "colors": None,
        "resampled": None if terrain.resampled is None else terrain.resampled.to_json(),
        "codec": None,
        "keeps_source": None,
        "layers": list(terrain.layers),
        "parts": None,
        "size_bytes": None,
        "warnings": [],
        "_format": "in memory",
        "_crs": terrain.grid.crs,
        "_georeferenced": True,
        "_nodata": None,
        "_masked": False,
    })  # fmt: skip


def _lonlat(grid: Grid) -> list[float] | None:
    from orograph.dem.area import lonlat_bounds

    found = lonlat_bounds(grid)
    return None if found is None else [round(v, 9) for v in found]


def _finite(value: float | int | None) -> float | int | None:
    return value if value is not None and math.isfinite(value) else None


def _size(path: str) -> int | None:
    """Bytes on disk of a file, or of all files in a folder; None if it is not on this disk."""
    file = Path(path)
    if file.is_file():
        return file.stat().st_size
    if not file.is_dir():
        return None
    return _files(file)


def _parts(path: str, errors: Sequence[str], layers: Sequence[str]) -> dict[str, int] | None:
    """Bytes on disk of each part of a store; None if it is not on this disk."""
    folder = Path(path)
    if not folder.is_dir():
        return None
    parts = {"heights": _files(folder / "heights")}
    for kind in (*errors, "radius"):
        found = sum(_files(level / kind) for level in (folder / "diamonds").glob("*"))
        if found:
            parts["spheres" if kind == "radius" else f"{kind} errors"] = found
    if (folder / "tins").is_dir():
        parts["TINs"] = _files(folder / "tins")
    if (folder / "chunked").is_dir():
        parts["chunks"] = _files(folder / "chunked")
    if (folder / "quadtin").is_dir():
        parts["QuadTIN"] = _files(folder / "quadtin")
    if (folder / "colors").is_dir():
        parts["color errors"] = _files(folder / "colors")
    for name in layers:
        parts[name] = _files(folder / "layers" / name)
    if (folder / "source").is_dir():
        parts["samples of the source"] = _files(folder / "source")
    rest = _files(folder) - sum(parts.values())
    return {**parts, "means, extremes and the rest": rest}


def _files(folder: Path) -> int:
    return sum((Path(root) / name).stat().st_size for root, _, names in os.walk(folder) for name in names)
