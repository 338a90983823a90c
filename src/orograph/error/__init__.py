"""Errors in object space and on the screen, and bounding volumes: arrays in, arrays out."""
