"""ROAM: a mesh that is carried from frame to frame by splits and merges in the order of two queues (see ``method``)."""

from orograph.lod.roam.method import Roam

__all__ = ["Roam"]
