"""What ``orograph.info`` found, as text for people."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from orograph.geo.grid import name_of

if TYPE_CHECKING:
    from orograph.store.layers import LayerRecord


def describe(facts: Mapping[str, Any], bold: Callable[[str], str] = str, mark: Callable[[str], str] = str) -> str:
    """The facts as text for people; ``bold`` and ``mark`` style titles and warning signs."""
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
    if facts["lonlat"] is not None and not facts["_crs"].is_geographic:
        west, south, east, north = facts["lonlat"]
        line("", f"longitudes {west:.6g} to {east:.6g}, latitudes {south:.6g} to {north:.6g}")
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
    """What the color errors were computed from."""
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
        return f"{text} ({name_of(crs)})"
    method = crs.coordinate_operation.method_name if crs.coordinate_operation is not None else ""
    return f"{name_of(crs) or crs.name}" + (f", {method}" if method and method != "unknown" else "") + " (no code)"


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
