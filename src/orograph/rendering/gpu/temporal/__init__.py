"""Samples of a pixel over time: gathered at rest, and while the camera moves."""
