"""What ``orograph.info`` reports about a file of points: number, place, density, heights. It does not triangulate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from orograph.progress import Progress


def facts_of_points(path: str, progress: Progress, options: Mapping[str, Any]) -> dict[str, Any]:
    """Describe a file of points.

    Args:
        options: how it is read (``orograph.terrain``).

    Raises:
        ReadError, UsageError: as ``read_scattered``; an option does not apply to points.
    """
    from orograph.dem.delaunay import spacing_of
    from orograph.dem.gridding import in_plane
    from orograph.dem.inspect import crs_text
    from orograph.dem.scattered import read_scattered
    from orograph.errors import ReadError, UsageError
    from orograph.store.given import options_of_points

    with progress.task("Reading points"):
        points = read_scattered(path, **options_of_points(options))
        warnings, size, spacing, flat = list(points.warnings), None, 0.0, None
        try:
            x, y, flat = in_plane(points, None)
            spacing, size = spacing_of(x, y), (float(np.ptp(x)), float(np.ptp(y)))
        except (ReadError, UsageError) as error:  # for the whole Earth
            warnings.append(error.what)
    return {
        "kind": "points",
        "crs": crs_text(points.crs),
        "points": len(points),
        "bounds": [float(v) for v in (points.x.min(), points.y.min(), points.x.max(), points.y.max())],
        "spacing_m": [spacing, spacing] if spacing > 0 else [None, None],
        "height_range": [float(points.z.min()), float(points.z.max())],
        "height_range_exact": True,
        "vertical_datum": points.vertical,
        "warnings": warnings,
        "_format": "points",
        "_crs": points.crs,
        "_georeferenced": True,
        "_size_m": size,
        "_terrain": None if flat is None else crs_text(flat),
    }


def lines_of_points(
    facts: Mapping[str, Any], crs: str, length: Callable[[float], str]
) -> list[tuple[str, str]]:  # fmt: skip
    """Labels and texts for people.

    Args:
        crs: the CRS as text. length: metres as text.
    """
    west, south, east, north = facts["bounds"]
    low, high = facts["height_range"]
    spacing, terrain = facts["spacing_m"][0], facts["_terrain"]
    across = "" if facts["_size_m"] is None else ", " + " × ".join(length(side) for side in facts["_size_m"])
    made = "" if terrain in (None, facts["crs"]) else f"; a terrain of them is in {terrain}"
    return [
        ("points", f"{facts['points']:,}"),
        ("spacing", "unknown" if spacing is None else f"one to {spacing:.3g} × {spacing:.3g} m"),
        ("CRS", crs + made),
        ("extent", f"x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}{across}"),
        ("heights", f"{low:.7g} to {high:.7g} m ({facts['vertical_datum'] or 'vertical datum unknown'})"),
    ]
