"""Whether PROJ transforms positions between datums as accurately as possible, or silently falls back to less.

The best ways between many datums (NAD27, OSGB36, DHDN…) need a grid file. Where PROJ lacks it, it takes a lesser
way, and where there is none, longitudes and latitudes as they are ("ballpark"): up to some hundred metres off. Between
CRSs of one datum there is nothing to lose. Units: metres.
"""

from __future__ import annotations

import math
import warnings
from typing import Any

from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup


def approximation(
    source: CRS, target: CRS, bounds: tuple[float, float, float, float], tolerance: float = 0.0
) -> str | None:
    """A sentence if the best transformation from ``source`` to ``target`` is not the one used; None if it is.

    Args:
        bounds: (west, south, east, north) of the area in coordinates of ``source``.
        tolerance: metres by which positions may silently be off; roughly taken ones are always told.
    """
    if _same_datum(source, target):
        return None
    try:
        taken = Transformer.from_crs(source, target, always_xy=True)
        west, south, east, north = bounds
        taken.transform((west + east) / 2, (south + north) / 2)
        taken = taken.get_last_used_operation()  # of several ways PROJ takes the one for the place
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # pyproj's own, which names the first grid only
            group = TransformerGroup(source, target, always_xy=True, area_of_interest=_area(source, bounds))
    except ProjError:
        return None  # no way at all: an error where the positions are asked for
    rough = "ballpark" in (taken.description or "").lower()
    accuracy = taken.accuracy if taken.accuracy is not None and taken.accuracy >= 0 else math.inf
    if not rough and accuracy <= tolerance:
        return None
    known = (o for o in group.unavailable_operations if any(not g.available for g in o.grids))
    best = next((o for o in known if rough or 0 <= o.accuracy < accuracy), None)
    if best is None and not rough:
        return None
    how = f"From {_datum(source)} to {_datum(target)} "
    if rough:
        now = "positions are not transformed, which may put them some hundred metres off"
    else:
        now = "a less accurate transformation is used" + (
            f", good to about {accuracy:g} m" if accuracy < math.inf else ""
        )
    if best is None:
        return how + f"PROJ has no transformation here: {now}."
    missing = [g.short_name for g in best.grids if not g.available]
    good = f" (good to {best.accuracy:g} m)" if best.accuracy > 0 else ""
    return how + (
        f"the best transformation{good} needs {' and '.join(missing)}, which PROJ lacks; {now} (PROJ's projsync "
        "fetches it, or set PROJ_NETWORK=ON)."
    )


def same_body(a: CRS, b: CRS) -> bool:
    """Whether two CRSs may belong to one planet or moon: their ellipsoids' radii differ by less than 1 %.

    The ellipsoids in use for Earth differ by one in ten thousand; Venus, the body most like it, by one in twenty.
    """
    one, other = a.ellipsoid, b.ellipsoid
    if one is None or other is None:
        return True
    return abs(one.semi_major_metre / other.semi_major_metre - 1) < 0.01


def _datum(crs: CRS) -> str:
    geodetic = crs.geodetic_crs
    return crs.name if geodetic is None else geodetic.name


def _same_datum(source: CRS, target: CRS) -> bool:
    a, b = source.geodetic_crs, target.geodetic_crs
    return a is None or b is None or a == b or (a.datum is not None and a.datum == b.datum)


def _area(crs: CRS, bounds: tuple[float, float, float, float]) -> Any:
    """The area in degrees; None (everywhere) if it cannot be found."""
    try:
        west, south, east, north = Transformer.from_crs(crs, 4326, always_xy=True).transform_bounds(*bounds)
    except ProjError:
        return None
    if not all(abs(v) < 720 for v in (west, south, east, north)):
        return None
    west, east = ((v + 180) % 360 - 180 if abs(v) > 180 else v for v in (west, east))
    return AreaOfInterest(west, max(-90.0, south), east, min(90.0, north))
