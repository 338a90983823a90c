"""Checks of a raster of heights: the faults that silently make wrong pictures.

Each check gives a sentence with the finding and the remedy; none changes anything. The commonest faults are degrees
taken for metres, feet, undeclared nodata values, and rasters that are not heights at all.
"""

from __future__ import annotations

import math
import re

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from orograph.dem.fills import WINDOWS, suspected_fills
from orograph.dem.source import Source
from orograph.dem.statistics import Statistics
from orograph.geo.ellipsoid import Ellipsoid
from orograph.geo.grid import Grid

_USUAL_NODATA = (-32768, -32767, -9999, -99999, -999, -9998, -10000, 32767, 65535, 9999, 99999, -2147483648, 4294967295)
_HIGHEST, _DEEPEST = 8850.0, -11000.0  # Everest (8849 m, 2020) and Challenger Deep (10 935 m), of Earth's solid surface
_FLOOR_KM, _TOP_KM = -12.0, 25.0  # of solid surfaces, kilometres: Earth's trenches, Olympus Mons
_GEOID_FORMATS = frozenset({"GTX", "BYN", "NGSGEOID"})
_NOT_HEIGHTS = frozenset(
    {"slope", "aspect", "hillshade", "shade", "curvature", "skyview", "roughness", "landcover", "landform", "landforms"}
    | {"nlcd", "temperature", "theta", "latitude", "longitude", "lat", "lon", "red", "green", "blue", "intensity"}
    | {"vegetation", "difference", "depth"}
)
_UNIT_WORDS = {"cm": "cm", "centimetres": "cm", "centimeters": "cm", "ft": "ft", "feet": "ft", "mm": "mm", "km": "km"}


def spacing_metres(grid: Grid) -> tuple[float, float]:
    """Distance between neighbouring samples along a row and along a column, metres.

    Of a geographic grid at its centre, on its ellipsoid; of a projected one in the metres of its plane; without a CRS
    the coordinates are assumed to be metres.
    """
    crs = grid.crs
    if crs is None:
        return grid.spacing
    factor = _unit(crs)
    if not crs.is_geographic:
        x, y = grid.spacing
        return x * factor, y * factor
    a, b, _, d, e, _ = grid.transform[:6]
    degrees = math.degrees(factor)
    centre = float(grid.xy((grid.cols - 1) / 2, (grid.rows - 1) / 2)[1]) * degrees
    lengths = Ellipsoid.of(crs).degree_lengths(max(-90.0, min(90.0, centre)))
    east, north = float(lengths[0]) * degrees, float(lengths[1]) * degrees
    return math.hypot(a * east, d * north), math.hypot(b * east, e * north)


def crs_text(crs: CRS | None) -> str | None:
    """ "EPSG:nnnn" (or another authority's code) if it has one, else its WKT; None for no CRS."""
    if crs is None:
        return None
    code = crs.to_authority()
    return ":".join(code) if code is not None else crs.to_wkt()


def suspicions(source: Source, found: Statistics) -> list[str]:
    """Warnings for the user: those from the header, then those about the heights."""
    return [*source.warnings, *_about_place(source), *_about_heights(source, found)]


def doubtful_heights(source: Source, low: float, high: float, windows: int = WINDOWS) -> list[str]:
    """``suspicions`` about the heights alone, where only the lowest and the highest are known (metres).

    Args:
        windows: how many to read to look for fills; 0: none.
    """
    return _about_heights(source, Statistics(low, high, 1.0, math.nan, True), windows)


def _about_place(source: Source) -> list[str]:
    grid, crs = source.grid, source.grid.crs
    if crs is None:
        return []
    west, south, east, north = grid.bounds()
    findings: list[str] = []
    if crs.is_geographic:
        if west < -360.5 or east > 540.5 or south < -91 or north > 91:
            findings.append(
                f"Its CRS is in degrees, but its coordinates reach {max(map(abs, (west, south, east, north))):,.0f}: "
                "the CRS is wrong."
            )
        elif east > 180 + abs(grid.transform.a) and west < 180:
            findings.append(f"Its longitudes run from {west:.6g}° to {east:.6g}°, across 180° E.")
        return findings
    factor = _unit(crs)
    if abs(factor - 1) > 1e-9 and not _undeclared_feet(source):
        findings.append(f"Its CRS is in units of {factor:.9g} m ({_unit_name(crs)}).")
    if "Pseudo-Mercator" in crs.name or crs.to_epsg() == 3857:
        stretch = _mercator_stretch(grid)
        if stretch > 1.02:
            findings.append(
                f"It is in Web Mercator, whose metres are up to {stretch:.2f} times too long here: distances and "
                "relief are distorted (give `crs` of a UTM zone to build or render)."
            )
    return findings


def _about_heights(source: Source, found: Statistics, windows: int = WINDOWS) -> list[str]:
    findings: list[str] = []
    if min(source.shape) < 2:
        findings.append("It has one row or column of samples; a surface needs at least two of each.")
    low, high = found.low, found.high
    for value in sorted(source.undeclared):
        findings.append(f"It contains the number {value:g}, undeclared as nodata: treated as missing.")
    if math.isnan(low):
        findings.append("None of its samples is valid." if found.exact else "No valid sample was found.")
        return findings
    word = _not_heights(source)
    if word:
        findings.append(f"It is called {word!r}, which does not suggest heights.")
    undeclared = [n for n in _USUAL_NODATA if _is(source, n, low) or _is(source, n, high)]
    for number in undeclared:
        which = "lowest" if _is(source, number, low) else "highest"
        findings.append(
            f"Its {which} stored number is {number}, a usual nodata value that it does not declare "
            f"(give `nodata={number}` if it means missing)."
        )
    if low == high:
        findings.append(f"All its valid heights are {low:g} m.")
    if found.valid_fraction < 0.5:
        findings.append(f"{1 - found.valid_fraction:.0%} of its samples are missing.")
    if _undeclared_feet(source):
        findings.append(
            f"Its CRS is in feet ({_unit_name(source.grid.crs)}), but the unit of its heights is not declared: assumed "
            'to be metres (give `vertical_unit="ft"` or `vertical_unit="us-ft"` if they are feet).'
        )
    if source.picture:
        return findings
    if not undeclared:
        findings.extend(_about_units(source, found))
        findings.extend(suspected_fills(source, _USUAL_NODATA, windows) if windows else [])
    if source.dtype in ("uint8", "int8") and source.encoding is None and source.scale == 1 and source.bands < 3:
        findings.append("Its numbers have 8 bits: heights in steps of a metre at best, or shades of a picture.")
    return findings


def _undeclared_feet(source: Source) -> bool:
    """Whether the coordinates are in feet and the unit of the heights is not declared."""
    crs = source.grid.crs
    if crs is None or crs.is_geographic:
        return False
    return 0.3 < _unit(crs) < 0.31 and source.unit_factor == 1 and not source.unit


def _unit_name(crs: CRS | None) -> str:
    """The name of the unit of a CRS's first axis."""
    return str(crs.axis_info[0].unit_name) if crs is not None and crs.axis_info else "unit"


def _about_units(source: Source, found: Statistics) -> list[str]:
    low, high = found.low, found.high
    ellipsoid = _ellipsoid(source.grid.crs)
    radius = ellipsoid.a if ellipsoid is not None else math.inf
    if math.isfinite(radius) and 0.5 * radius < low and high < 1.5 * radius:
        return [
            f"Its heights ({low:,.0f} to {high:,.0f} m) look like radii, distances from the centre of the body (radius "
            f"{radius:,.0f} m), not heights above its surface."
        ]
    if source.driver in _GEOID_FORMATS or {"geoid", "undulation"} & set(_words(source.description)):
        return ["It is a geoid grid: heights of a geoid above the ellipsoid (for `geoid`), not of the ground."]
    findings: list[str] = []
    words = re.findall(r"(?<![a-z0-9])[a-z]+", source.name.lower())  # 2km is a spacing
    word = next((word for word in words if word in _UNIT_WORDS), None)
    if word is not None and source.unit_factor == 1 and not source.unit:
        unit = _UNIT_WORDS[word]
        findings.append(
            f"Its name says {word!r}, but the unit of its heights is not declared: assumed to be metres (give "
            f"`vertical_unit={unit!r}` if they are not)."
        )
    on_earth = radius == math.inf or 6.3e6 < radius < 6.4e6
    if on_earth and (high > _HIGHEST or low < _DEEPEST):
        worst = high if high > _HIGHEST else low
        than = "higher than Mount Everest" if high > _HIGHEST else "deeper than any ocean"
        findings.append(
            f"Its heights reach {worst:,.0f} m, {than}: are they in feet or centimetres "
            '(`vertical_unit="ft"` or `vertical_unit="cm"`), or is there an undeclared nodata value (`nodata`)?'
        )
    dx, dy = spacing_metres(source.grid)
    extent = max(dx * source.grid.cols, dy * source.grid.rows)
    if found.slope > 2:
        findings.append(
            f"From sample to sample it rises or falls {found.slope:.3g} times the spacing on average, steeper than "
            "any landscape: the declared spacing or unit of heights is wrong"
            + ("." if source.georeferenced else " (give `spacing=METRES`).")
        )
    elif 0 < high - low < 1e-4 * extent and extent > 1000 and low > _FLOOR_KM and high < _TOP_KM:
        findings.append(
            f"Its heights span only {high - low:.3g} m over {extent / 1000:,.3g} km: are they in kilometres or degrees?"
        )
    if low >= -180 and high <= 360 and source.encoding is None and _looks_like_coordinates(source):
        findings.append("Its values change evenly from sample to sample: are they longitudes or latitudes in degrees?")
    return findings


def _looks_like_coordinates(source: Source) -> bool:
    """Whether, in a window in the middle, all rows (or columns) rise or fall throughout, by almost even steps."""
    rows, cols = source.shape
    if min(rows, cols) < 8:
        return False
    r, c = max(0, rows // 2 - 32), max(0, cols // 2 - 32)
    heights = source.read(r, min(r + 64, rows), c, min(c + 64, cols)).astype(np.float64)
    for axis in (0, 1):
        first = np.diff(heights, axis=axis)
        if np.isnan(first).any():
            return False
        one_way = bool((first > 0).all() or (first < 0).all())
        if one_way and float(np.abs(np.diff(first, axis=axis)).mean()) < 0.3 * abs(float(first.mean())):
            return True
    return False


def _not_heights(source: Source) -> str | None:
    """The word in the band's description, or in the file's name, that suggests something else."""
    words = [*_words(source.description), *_words(source.name)]
    return next((word for word in words if word in _NOT_HEIGHTS), None)


def _words(text: str) -> list[str]:
    return re.split(r"[^a-z]+", text.lower())


def _is(source: Source, number: int, height: float) -> bool:
    """Whether a height comes from a stored number that is not the declared nodata."""
    if source.encoding is not None or number == source.nodata:
        return False
    return float(np.float32((number * source.scale + source.offset) * source.unit_factor)) == height


def _ellipsoid(crs: CRS | None) -> Ellipsoid | None:
    try:
        return None if crs is None else Ellipsoid.of(crs)
    except ValueError:
        return None


def _unit(crs: CRS) -> float:
    """Metres (or radians) per unit of the CRS's first axis."""
    return float(crs.axis_info[0].unit_conversion_factor) if crs.axis_info else 1.0


def _mercator_stretch(grid: Grid) -> float:
    """The maximum factor by which the metres are too long, over the raster's extent."""
    if grid.crs is None or grid.crs.geodetic_crs is None:
        return 1.0
    try:
        there = Transformer.from_crs(grid.crs, grid.crs.geodetic_crs, always_xy=True)
        col, row = np.meshgrid([0.0, grid.cols - 1], np.linspace(0, grid.rows - 1, 5))
        lat = np.abs(np.asarray(there.transform(*grid.xy(col.ravel(), row.ravel()))[1]))
    except ProjError:
        return 1.0
    lat = lat[lat < 89.9]
    return 1 / math.cos(math.radians(float(lat.max()))) if lat.size else 1.0
