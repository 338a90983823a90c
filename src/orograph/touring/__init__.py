"""Tours: a camera that moves through key frames (``tour``), above a terrain (``course``), and its film (``film``)."""

from orograph.touring.keys import Key
from orograph.touring.tour import Tour, moves

__all__ = ["Key", "Tour", "moves"]
