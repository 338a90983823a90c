"""``orograph.info``: what a DEM or a store is, and what is suspicious about it, for people or (``--json``) programs.

The keys are fixed: kind ("dem", "store", "terrain" or "points"), path, crs, transform (a b c d e f as in GDAL and
affine), shape [rows, cols], points (how many a file of points holds), bounds [west, south, east, north] (of such a
file, in its CRS), spacing_m [x, y], height_range [min, max] (metres), height_range_exact, valid_fraction, dtype,
nodata, vertical_datum, attribution (whom its makers want to be named), version (of a store that is updated), versions
(older ones that are kept beside it), levels, side, errors (the kinds that a store has), colors (what its color errors
are of: drape, colormap, sun, relief), resampled (what a store lost when its source was brought to another grid, metres:
rms, largest, summit_loss, highest, highest_loss), codec (how a store that is not lossless keeps its heights: name,
step, max_error, and largest and rms, how far they are off, metres), keeps_source (whether the source's samples are in
it), layers (those baked into it), parts (what of a store takes how many bytes), size_bytes, warnings. What is unknown
or absent, and every number that is not finite, is null.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph.progress import Progress
from orograph.reporting import reporting

if TYPE_CHECKING:
    from orograph.dem.area import Area
    from orograph.store.layers import LayerRecord
    from orograph.store.terrain import Terrain


KEYS = (
    "kind", "path", "crs", "transform", "shape", "points", "bounds", "spacing_m", "height_range", "height_range_exact",
    "valid_fraction", "dtype", "nodata", "vertical_datum", "attribution", "version", "versions", "levels", "side",
    "errors", "colors", "resampled", "codec", "keeps_source", "layers", "parts", "size_bytes", "warnings",
)  # fmt: skip
"""The keys, in their order."""


def info(
    source: Any, *, exact: bool | None = None, bbox: Sequence[float] | str | None = None, clip: Any = None,
    jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> Facts:  # fmt: skip
    """What heights are, and what is suspicious about them.

    Args:
        source: whatever ``orograph.terrain`` takes. Of a file as little is read as need be; several are one terrain.
        exact: whether every sample of a raster is read however large it is; None: only of small ones.
        bbox: west, south, east, north in degrees: of this area only. clip: of what lies in polygons only (GeoJSON, a
            file or an object; shapely's, geopandas'). Of a store the area is told as terrain, not the store's insides.
        jobs: threads. progress: hears of what is being done; False: nothing is said.
        reading: how a file is read: ``band``, ``nodata``, ``spacing``… (``orograph.terrain``).

    Returns:
        a dict, which prints as the command line has it; its keys are told above (those with "_" are for people).

    Raises:
        ReadError, StoreError: it cannot be read.
        UsageError: it is nothing that holds heights, none lie in the area, or an option does not fit.
    """
    from orograph.dem.area import Area
    from orograph.dem.folders import is_folder
    from orograph.dem.handles import is_manifest
    from orograph.dem.scattered import is_points
    from orograph.store.detect import is_store
    from orograph.store.given import files_of

    heard = reporting(progress)
    files = files_of(source)
    area = Area.of(bbox, clip)
    store = files is not None and len(files) == 1 and is_store(files[0])
    points = files is not None and len(files) == 1 and is_points(files[0])
    many = files is None or len(files) > 1 or is_manifest(files[0]) or (not store and is_folder(files[0]))
    if files is None or many or ((store or points) and area is not None):
        from orograph.store.opening import terrain

        part = {} if area is None else {"bbox": bbox, "clip": clip}
        how = {} if store else reading  # (a store says itself how it was read)
        return _terrain_facts(terrain(source, heard, jobs=jobs, called="info", **part, **how))
    if points:
        from orograph.verbs.info_points import facts_of_points

        found = facts_of_points(files[0], heard, reading)
        empty: dict[str, Any] = {name: [] for name in ("errors", "versions", "layers", "attribution")}
        return Facts({**dict.fromkeys(KEYS), **empty, "path": files[0], "size_bytes": _size(files[0]), **found})
    return _store_facts(files[0]) if store else _dem_facts(files[0], heard, exact, area, jobs, reading)


class Facts(dict[str, Any]):
    """Facts by name, which read as a person wants them."""

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
    from orograph.store.given import said_of_files
    from orograph.store.terrain import exponent, level_count

    with Source.open(path, **said_of_files(options)) as opened:
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
    from orograph.store.places import kept

    with store.open(path) as terrain:
        found = _terrain_facts(terrain)
        return Facts({
            **found,
            "kind": "store",
            "path": path,
            "version": terrain.version,
            "versions": [] if terrain.remote else [number for number, _ in kept(terrain.url)],
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


def _finite(value: float | int | None) -> float | int | None:
    return value if value is not None and math.isfinite(value) else None


def _size(path: str) -> int | None:
    """Bytes on disk of a file, or of all files in a folder; None for what is not on this disk."""
    file = Path(path)
    if file.is_file():
        return file.stat().st_size
    if not file.is_dir():
        return None
    return _files(file)


def _parts(path: str, errors: Sequence[str], layers: Sequence[str]) -> dict[str, int] | None:
    """Bytes on disk of what a store consists of; None for what is not on this disk."""
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


def describe(facts: Mapping[str, Any], bold: Callable[[str], str] = str, mark: Callable[[str], str] = str) -> str:
    """The facts as a person reads them; ``bold`` and ``mark`` style titles and the signs of warnings."""
    size = "" if facts["size_bytes"] is None else f", {_bytes(facts['size_bytes'])}"
    lines = [bold(str(facts["path"])) + f"  ({facts['_format']}{size})"]

    def line(label: str, text: str) -> None:
        lines.append(f"  {label:<9}{text}")

    if facts["kind"] == "points":
        from orograph.verbs.info_points import lines_of_points

        for label, text in lines_of_points(facts, _crs_line(facts), _length):
            line(label, text)
        return "\n".join([*lines, *(mark("  ! ") + text for text in facts["warnings"])])
    rows, cols = facts["shape"]
    band, bands, description = facts.get("_bands", (1, 1, ""))
    of = f", band {band} of {bands}" if bands > 1 else ""
    line(
        "samples", f"{rows} rows × {cols} columns, {facts['dtype']}{of}" + (f" ({description})" if description else "")
    )
    x, y = facts["spacing_m"]
    line("spacing", f"{x:.6g} × {y:.6g} m" + _degrees(facts) if x is not None else "unknown")
    line("CRS", _crs_line(facts))
    line("extent", _extent(facts))
    low, high = facts["height_range"]
    if low is None:
        line("heights", "none")
    else:
        about = "" if facts["height_range_exact"] else "about "
        datum = facts["vertical_datum"] or "vertical datum unknown"
        line("heights", f"{about}{low:.7g} to {high:.7g} m ({datum})" + _scaling(facts))
    line("valid", _valid(facts))
    line(
        "terrain", f"{facts['levels']} level{'s' if facts['levels'] > 1 else ''} in a square of {facts['side']} samples"
    )
    if facts["kind"] == "store":
        if facts["version"] is not None:
            older = ", ".join(f"@{number}" for number in facts["versions"])
            line("version", f"{facts['version']}" + (f"; kept beside it: {older}" if older else ""))
        if facts["_resampled"] is not None:
            kept = "its samples are kept" if facts["keeps_source"] else "its samples are not kept"
            line("source", f"resampled: {facts['_resampled']}; {kept}")
        line("codec", str(facts["_codec"] or "lossless, float32"))
        line("errors", ", ".join(facts["errors"]) or "none (`orograph.build(..., errors=('exact',))`)")
        line("colors", _colors(facts["colors"]) or "none (`orograph.geovis.color_store.store_colors`)")
        line("layers", ", ".join(_layer(layer) for layer in facts["_layers"].values()) or "none (`orograph.bake`)")
        samples = rows * cols
        for name, size_of in (facts["parts"] or {}).items():
            line("", f"{_bytes(size_of):>10}  {name}, {size_of / samples:.2f} bytes per sample")
    for text in facts["attribution"]:
        line("credit", text)
    for text in facts["warnings"]:
        lines.append(mark("  ! ") + text)
    return "\n".join(lines)


def _colors(colors: Mapping[str, Any] | None) -> str:
    """What color errors are of."""
    if not colors:
        return ""
    of = f"the image {colors['drape']['name']}" if colors["drape"] else f"the tint {colors['colormap'] or 'alpine'}"
    sun = colors["sun"]
    light = "" if sun is None else f", sun at {sun[0]:g}°, {sun[1]:g}° high"
    return f"of {of}{light}, relief × {colors['relief']:g}"


def _layer(layer: LayerRecord) -> str:
    """A baked layer and how it was made."""
    made = ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in layer.options.items()
                     if v is not None and v is not False)  # fmt: skip
    return f"{layer.name} ({layer.bands[0].bits} bits; {made})"


def _valid(facts: Mapping[str, Any]) -> str:
    share = facts["valid_fraction"]
    text = "all" if share == 1 else "none" if share == 0 else f"{min(max(share, 0.0001), 0.9999):.2%}"
    if facts["kind"] == "store":
        return text
    nodata = facts["_nodata"]
    rule = "no nodata value declared" if nodata is None else f"nodata {nodata:.9g}".replace("nan", "NaN")
    if facts["_masked"]:
        rule = "by its mask" + ("" if nodata is None else f" and {rule}")
    sampled = "" if facts["height_range_exact"] else " of the samples looked at (`exact` reads all)"
    if facts.get("_clipped"):
        rule += "; missing outside the polygons"
    return f"{text}{sampled} ({rule})"


def _crs_line(facts: Mapping[str, Any]) -> str:
    crs = facts["_crs"]
    if crs is None:
        return "none" if facts["_georeferenced"] else "none: the file does not say where it lies"
    text = facts["crs"]
    if len(text) < 40:
        return f"{text} ({_name(crs, text)})"
    method = crs.coordinate_operation.method_name if crs.coordinate_operation is not None else ""
    return f"{crs.name}" + (f", {method}" if method and method != "unknown" else "") + " (no code)"


def _name(crs: Any, code: str) -> str:
    """A CRS's name; the code's own where a file leaves it away."""
    if crs.name.lower() not in ("unnamed", "unknown", ""):
        return str(crs.name)
    return str(type(crs).from_user_input(code).name)


def _degrees(facts: Mapping[str, Any]) -> str:
    crs = facts["_crs"]
    if crs is None or not crs.is_geographic:
        return ""
    a, b, _, d, e, _ = facts["transform"]
    return f" at its centre ({math.hypot(a, d):.6g} × {math.hypot(b, e):.6g} {crs.axis_info[0].unit_name}s)"


def _extent(facts: Mapping[str, Any]) -> str:
    a, b, c, d, e, f = facts["transform"]
    rows, cols = facts["shape"]
    corners = [(a * i + b * j + c, d * i + e * j + f) for i in (0, cols) for j in (0, rows)]
    xs, ys = [p[0] for p in corners], [p[1] for p in corners]
    turned = " (rotated)" if b or d else ""
    x, y = facts["spacing_m"]
    across = "" if x is None else f", {_length(x * cols)} × {_length(y * rows)}"
    return f"x {min(xs):.10g} to {max(xs):.10g}, y {min(ys):.10g} to {max(ys):.10g}{across}{turned}"


def _scaling(facts: Mapping[str, Any]) -> str:
    if facts.get("_encoding"):
        return f", decoded from {facts['_encoding']} colours"
    scale, offset, unit = facts.get("_scaling", (1.0, 0.0, 1.0))
    said = []
    if scale != 1 or offset != 0:
        said.append(f"stored × {scale:.7g}" + (f" + {offset:.7g}" if offset else ""))
    if unit != 1:
        said.append(f"1 unit = {unit:.9g} m")
    return f", {', '.join(said)}" if said else ""


def _length(metres: float) -> str:
    return (
        f"{metres / 1000:,.0f} km"
        if metres >= 1e6
        else f"{metres / 1000:.4g} km"
        if metres >= 1000
        else f"{metres:.4g} m"
    )


def _bytes(size: int) -> str:
    for unit, factor in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size} bytes"
