"""Measuring on the true surface: full resolution, true metres whatever the exaggeration, exact for the triangulation.

>>> from orograph.geovis import measure
>>> hit = measure.pick(terrain, view, (640.5, 360.5))         # doctest: +SKIP
>>> measure.profile(terrain, [(e0, n0), (e1, n1)]).length     # doctest: +SKIP
>>> measure.area(terrain, corners).surface                    # doctest: +SKIP
>>> measure.line_of_sight(terrain, a, b).obstruction          # doctest: +SKIP
>>> measure.viewshed(terrain, a, radius=20_000).save("v.tif")  # doctest: +SKIP

Points are (easting, northing) in the terrain's CRS; ``Places(terrain).of_lonlat`` brings degrees there.
"""

from __future__ import annotations

from orograph.geovis.measure.area import Area, area
from orograph.geovis.measure.pick import Hit, pick, place, slope_aspect
from orograph.geovis.measure.places import Places
from orograph.geovis.measure.profile import Profile, profile
from orograph.geovis.measure.sight import Mark, Sight, line_of_sight
from orograph.geovis.measure.viewshed import Viewshed, viewshed

__all__ = [
    "Area",
    "Hit",
    "Mark",
    "Places",
    "Profile",
    "Sight",
    "Viewshed",
    "area",
    "line_of_sight",
    "pick",
    "place",
    "profile",
    "slope_aspect",
    "viewshed",
]
