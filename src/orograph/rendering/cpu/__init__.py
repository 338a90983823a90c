"""The CPU backend: rays or triangles into hits, hits into light and colour."""
