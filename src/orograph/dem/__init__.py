"""One elevation raster: reading, joining, resampling, synthesising, and checking for suspicious values."""

from orograph.dem.raster import Dem
from orograph.dem.reading import read
from orograph.dem.source import Source

__all__ = ["Dem", "Source", "read"]
