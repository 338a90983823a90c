"""Results of measurements as text for people: names and values, the same on the command line and in the window.

Values include their units.
"""

from __future__ import annotations

from orograph.measuring.area import Area
from orograph.measuring.pick import Hit
from orograph.measuring.profile import Profile
from orograph.measuring.sight import Sight
from orograph.measuring.zones import Zone

Row = tuple[str, str, str]
"""A name, its value, and an addition for wide lines."""


def metres(value: float | None, digits: int = 2) -> str:
    """A length."""
    return "–" if value is None else f"{value:,.{digits}f} m"


def about(error: float | None) -> str:
    """The error of resampled heights; nothing if they were not resampled."""
    return "" if error is None else f"resampled, ± {error:.3g} m" if error < 1000 else f"resampled, ± {error:.0f} m"


def square(value: float) -> str:
    """An area."""
    return f"{value:,.1f} m²" + (f"  ({value / 1e6:,.4f} km²)" if value >= 1e5 else "")


def cubic(value: float) -> str:
    """A volume."""
    return f"{value:,.1f} m³" + (f"  ({value / 1e9:,.4f} km³)" if abs(value) >= 1e8 else "")


def place(lon: float | None, lat: float | None, east: float, north: float, name: str = "place") -> list[Row]:
    """A place in the terrain's CRS and, if known, in degrees."""
    degrees = [] if lon is None or lat is None else [("", f"lon {lon:.6f}, lat {lat:.6f}", "")]
    return [(name, f"{east:.2f}, {north:.2f}", ""), *degrees]


def zone_rows(zone: Zone) -> list[Row]:
    """A polygon's areas, heights and slopes."""
    if zone.area is None:
        return [("not measured", zone.problem, "")]
    found = _area(zone.area)
    if zone.known:
        found += [
            ("heights", f"{metres(zone.lowest)} to {metres(zone.highest)}, mean {metres(zone.mean)}, "
             f"standard deviation {metres(zone.std)}", ""),
            ("slopes", f"mean {zone.slope_mean:.2f}°, median {zone.slope_median:.2f}°, 90th percentile "
             f"{zone.slope_90:.2f}°, {zone.steeper:.1%} above {zone.steeper_than:g}°", ""),
        ]  # fmt: skip
    return [*found, ("samples", f"{zone.samples:,}", f", {zone.known:,} with a height")]


def lines(result: Hit | Profile | Area | Sight) -> list[Row]:
    """A measurement as rows of names and values."""
    if isinstance(result, Hit):
        return _hit(result)
    if isinstance(result, Profile):
        return _profile(result)
    return _area(result) if isinstance(result, Area) else _sight(result)


def _hit(hit: Hit) -> list[Row]:
    found = place(hit.longitude, hit.latitude, hit.easting, hit.northing)
    for name, height, error, what in (
        ("height", hit.height, hit.height_error, ", the data's own: the one to quote"),
        ("of the surface", hit.surface_height, None, ", which pictures show and all else is measured on"),
    ):
        aside = "" if error is None else f" ({about(error)})"
        known = height is not None
        found.append((name, metres(height, 3) + aside if known else "no data here", what if known else ""))
    if hit.slope is not None:
        aspect = "level" if hit.aspect is None else f"{hit.aspect:.1f}° grid, {hit.true_aspect:.1f}° true"
        found += [("slope", f"{hit.slope:.2f}°", ""), ("aspect", aspect, "")]
    if hit.distance is not None:
        found.append(("from the eye", metres(hit.distance), ""))
    return found


def _profile(line: Profile) -> list[Row]:
    found = [
        ("on the ground", metres(line.length), ""), ("straight", metres(line.straight), ""),
        ("horizontal", metres(float(line.distance[-1])), f", on the grid {metres(line.grid)} (scale {line.scale:.6f})"),
        ("geodesic", metres(line.geodesic), ""),
        ("climb, descent", f"+{metres(line.climb)}, −{metres(line.descent)}", ""),
        ("lowest, highest", f"{metres(line.lowest)}, {metres(line.highest)}", ""),
    ]  # fmt: skip
    if line.height_error is not None:
        found.append(("heights", about(line.height_error), ""))
    return (
        [
            *found,
            ("without data", metres(line.missing), f", bridged by {metres(line.bridged)} of the length on the ground"),
        ]
        if line.missing
        else found
    )


def _area(area: Area) -> list[Row]:
    found = [
        ("plan", square(area.plan), f", on the grid {area.plan_grid:,.1f} m²"),
        ("surface", square(area.surface), f", on the grid {area.surface_grid:,.1f} m²"),
        ("perimeter", metres(area.perimeter), ""), ("mean height", metres(area.mean_height), ""),
    ]  # fmt: skip
    if area.missing_grid:
        found.append(("without data", f"{area.missing_grid:,.1f} m²", " of the grid, in no surface"))
    if area.above is not None:
        found += [(f"above {area.level:g} m", cubic(area.above), ""),
                  (f"below {area.level:g} m", cubic(area.below or 0.0), "")]  # fmt: skip
    return found


def _sight(sight: Sight) -> list[Row]:
    found = [("visible", "yes" if sight.visible else "no", ""),
             ("distance", metres(float(sight.profile.distance[-1])), "")]  # fmt: skip
    if (mark := sight.obstruction) is not None:
        found.append(("obstructed at", f"{metres(mark.distance)}, height {metres(mark.height)}", ""))
        found += place(mark.longitude, mark.latitude, mark.easting, mark.northing, "")
        found.append(("target needs", f"{metres(sight.needed)} above ground", ""))
    if (mark := sight.tightest) is not None:
        found.append(("least clearance", f"{metres(mark.clearance)} at {metres(mark.distance)}", ""))
    if sight.profile.missing:
        found.append(("without data", metres(sight.profile.missing), ", assumed to hide nothing"))
    return found
