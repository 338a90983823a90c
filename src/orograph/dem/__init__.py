"""One elevation raster: reading it, joining several, resampling, synthesising, looking for what is suspicious."""

from orograph.dem.raster import Dem
from orograph.dem.reading import read
from orograph.dem.source import Source

__all__ = ["Dem", "Source", "read"]
