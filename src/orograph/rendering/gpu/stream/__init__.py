"""Terrain and imagery that views need, read by threads into atlases on the GPU."""
