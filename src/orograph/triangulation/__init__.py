"""Triangulations that grow in flat arrays, how far they are from a terrain, and a heap of their triangles."""
