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
    from orograph.geo import Grid
    from orograph.geovis.layers import Layer
    from orograph.light.bake import bake
    from orograph.picture import Contours, Picture, Silhouettes, Sun, camera, render
    from orograph.store import Terrain, build, open, terrain
    from orograph.view import View

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
    "open",
    "read",
    "render",
    "terrain",
]

_HOMES = {
    "Contours": "orograph.picture",
    "Dem": "orograph.dem",
    "Grid": "orograph.geo",
    "Layer": "orograph.geovis.layers",
    "Picture": "orograph.picture",
    "Silhouettes": "orograph.picture",
    "Sun": "orograph.picture",
    "Terrain": "orograph.store",
    "View": "orograph.view",
    "bake": "orograph.light.bake",
    "build": "orograph.store",
    "camera": "orograph.picture",
    "open": "orograph.store",
    "read": "orograph.dem",
    "render": "orograph.picture",
    "terrain": "orograph.store",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'orograph' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


if "xarray" in sys.modules:  # da.orograph, for those who use xarray; others need not pay for it
    importlib.import_module("orograph.dem.accessor")
