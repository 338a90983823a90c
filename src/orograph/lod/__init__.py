"""Engines: one file per published method, all with the same face (``lod.engine.Engine``)."""
