"""Deferred light and colour on the GPU: what the shading pass looks up, and the pass."""
