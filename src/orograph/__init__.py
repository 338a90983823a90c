"""Orograph: terrain visualisation for Python.

>>> import orograph
>>> dem = orograph.read("dem.tif")                                       # doctest: +SKIP
>>> terrain = orograph.build(["tiles/n36.tif", "tiles/n37.tif"], "area.oro")  # doctest: +SKIP
>>> picture = orograph.render(terrain)                                   # doctest: +SKIP
>>> picture.save("relief.png")                                           # doctest: +SKIP
>>> view = orograph.camera.around(terrain, (1280, 720), azimuth=225, pitch=30, distance=None)  # doctest: +SKIP
>>> orograph.render(terrain, view, sky=True, exaggeration=1.5)           # doctest: +SKIP

Names are imported when they are first used, so that ``import orograph`` costs nothing.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orograph.dem import Dem, read
    from orograph.fetching import fetch
    from orograph.geo import Grid
    from orograph.geovis.layers import Layer
    from orograph.lighting import make as light
    from orograph.lighting.bake import bake
    from orograph.lighting.sun import Sun
    from orograph.lod.describe import methods
    from orograph.rendering.api import render
    from orograph.rendering.picture import Picture
    from orograph.scene import camera
    from orograph.scene.contours import Contours
    from orograph.scene.silhouettes import Silhouettes
    from orograph.store import Terrain, build, open, terrain
    from orograph.viewer.notebook import view
    from orograph.viewpoint import View

__all__ = [
    "Contours",
    "Dem",
    "Grid",
    "Layer",
    "Picture",
    "Silhouettes",
    "Sun",
    "Terrain",
    "View",
    "bake",
    "build",
    "camera",
    "fetch",
    "light",
    "methods",
    "open",
    "read",
    "render",
    "terrain",
    "view",
]

_HOMES = {
    "Contours": "orograph.scene.contours",
    "Dem": "orograph.dem",
    "Grid": "orograph.geo",
    "Layer": "orograph.geovis.layers",
    "Picture": "orograph.rendering.picture",
    "Silhouettes": "orograph.scene.silhouettes",
    "Sun": "orograph.lighting.sun",
    "Terrain": "orograph.store",
    "View": "orograph.viewpoint",
    "bake": "orograph.lighting.bake",
    "build": "orograph.store",
    "camera": "orograph.scene",
    "fetch": "orograph.fetching",
    "light": "orograph.lighting:make",
    "methods": "orograph.lod.describe",
    "open": "orograph.store",
    "read": "orograph.dem",
    "render": "orograph.rendering.api",
    "terrain": "orograph.store",
    "view": "orograph.viewer.notebook",
}
"""Where each name is, as MODULE, or MODULE:NAME where it has another name there."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'orograph' has no attribute {name!r}")
    module, _, called = _HOMES[name].partition(":")
    return getattr(importlib.import_module(module), called or name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


if "xarray" in sys.modules:  # da.orograph, for those who use xarray; others need not pay for it
    importlib.import_module("orograph.accessor")
