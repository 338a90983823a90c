"""The CPU backend: rays against windows of heights (``rays``), triangles of any mesh (``raster``)."""
