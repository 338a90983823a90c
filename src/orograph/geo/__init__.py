"""Where things are: grids, ellipsoids and bodies, ECEF and local frames, vertical datums."""

from orograph.geo.grid import Grid

__all__ = ["Grid"]
