"""A concurrent binary tree: a mesh of which every triangle decides by itself, made for the GPU (see ``method``)."""

from orograph.lod.cbt.method import Cbt

__all__ = ["Cbt"]
