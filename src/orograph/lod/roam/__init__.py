"""ROAM: a mesh that is carried from frame to frame by splits and merges in the order of two queues (see ``engine``)."""

from orograph.lod.roam.engine import Roam

__all__ = ["Roam"]
