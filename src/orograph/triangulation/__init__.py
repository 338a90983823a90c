"""Triangulations that grow in flat arrays, their deviation from a terrain, and a heap of their triangles."""
