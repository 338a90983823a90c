"""Measuring on the true surface: full resolution, true metres whatever the exaggeration, exact for the triangulation.

>>> from orograph import measuring
>>> hit = measuring.pick(terrain, view, (640.5, 360.5))         # doctest: +SKIP
>>> measuring.profile(terrain, [(e0, n0), (e1, n1)]).length     # doctest: +SKIP
>>> measuring.area(terrain, corners).surface                    # doctest: +SKIP
>>> measuring.line_of_sight(terrain, a, b).obstruction          # doctest: +SKIP
>>> measuring.viewshed(terrain, a, radius=20_000).save("v.tif")  # doctest: +SKIP

Points are (easting, northing) in the terrain's CRS, or with ``lonlat=True`` (longitude, latitude) in degrees.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orograph.errors import absent
from orograph.measuring.area import Area, area
from orograph.measuring.flood import flood
from orograph.measuring.height_error import HeightError
from orograph.measuring.pick import Hit, heights, pick, place, save_hits, slope_aspect
from orograph.measuring.places import Places
from orograph.measuring.probable import Probable, contours, probable_viewshed, slope
from orograph.measuring.profile import Profile, profile
from orograph.measuring.sight import Mark, Sight, line_of_sight
from orograph.measuring.sight import line_of_sight as los
from orograph.measuring.viewshed import Viewshed, viewshed
from orograph.measuring.zones import Zone, Zones, areas

__all__ = [
    "Area",
    "HeightError",
    "Hit",
    "Mark",
    "Places",
    "Probable",
    "Profile",
    "Sight",
    "Viewshed",
    "Zone",
    "Zones",
    "area",
    "areas",
    "contours",
    "flood",
    "heights",
    "line_of_sight",
    "los",
    "pick",
    "place",
    "probable_viewshed",
    "profile",
    "save_hits",
    "slope",
    "slope_aspect",
    "viewshed",
]


if not TYPE_CHECKING:  # (type checkers look for names themselves)

    def __dir__() -> list[str]:
        return __all__

    def __getattr__(name: str) -> object:
        raise absent("orograph.measure", name, __all__)
