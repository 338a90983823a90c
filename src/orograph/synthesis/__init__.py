"""Terrain by example: windows of an endless terrain that looks like a given one, and detail beyond the data."""
