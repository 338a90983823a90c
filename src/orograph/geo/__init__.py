"""Where things are: grids, ellipsoids and bodies, ECEF and local frames, vertical datums."""

from orograph.geo.ellipsoid import BODIES, EARTH, MARS, MOON, Ellipsoid
from orograph.geo.grid import Grid
from orograph.geo.local import LocalFrame
from orograph.geo.vertical import Geoid

__all__ = ["BODIES", "EARTH", "MARS", "MOON", "Ellipsoid", "Geoid", "Grid", "LocalFrame"]
