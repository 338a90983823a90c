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
    from orograph import errors
    from orograph import measuring as measure
    from orograph.dem import Dem, read
    from orograph.fetching import fetch
    from orograph.geo import Grid
    from orograph.geovis.data.dataset import Dataset, Uncertainty
    from orograph.geovis.data.focus import Focus
    from orograph.geovis.layers import Layer, basemap
    from orograph.lighting import make as light
    from orograph.lighting.bake import bake
    from orograph.lighting.sun import Sun
    from orograph.lod.describe import methods
    from orograph.rendering.api import render
    from orograph.rendering.picture import Picture
    from orograph.scene import camera
    from orograph.scene.aids import Aids
    from orograph.scene.contours import Contours
    from orograph.scene.ghosts import Ghost
    from orograph.scene.silhouettes import Silhouettes
    from orograph.store import Terrain, open, terrain
    from orograph.store.publishing import publish
    from orograph.tessellation import Tessellation
    from orograph.touring.tour import Tour
    from orograph.verbs.best_view import best_view
    from orograph.verbs.build import build
    from orograph.verbs.check import check
    from orograph.verbs.compare import compare
    from orograph.verbs.contours import contours
    from orograph.verbs.difference import difference
    from orograph.verbs.doctor import doctor
    from orograph.verbs.export import export
    from orograph.verbs.info import info
    from orograph.verbs.manifest import manifest
    from orograph.verbs.movie import movie
    from orograph.verbs.synth import synth
    from orograph.verbs.tessellate import tessellate
    from orograph.verbs.tin import tin
    from orograph.verbs.tour import tour
    from orograph.viewer.notebook import view
    from orograph.viewpoint import View

    __version__: str

__all__ = [
    "Aids",
    "Contours",
    "Dataset",
    "Dem",
    "Focus",
    "Ghost",
    "Grid",
    "Layer",
    "Picture",
    "Silhouettes",
    "Sun",
    "Terrain",
    "Tessellation",
    "Tour",
    "Uncertainty",
    "View",
    "__version__",
    "bake",
    "basemap",
    "best_view",
    "build",
    "camera",
    "check",
    "compare",
    "contours",
    "difference",
    "doctor",
    "errors",
    "export",
    "fetch",
    "info",
    "light",
    "manifest",
    "measure",
    "methods",
    "movie",
    "open",
    "publish",
    "read",
    "render",
    "synth",
    "terrain",
    "tessellate",
    "tin",
    "tour",
    "view",
]

_HOMES = {
    "Aids": "orograph.scene.aids",
    "Contours": "orograph.scene.contours",
    "Dataset": "orograph.geovis.data.dataset",
    "Dem": "orograph.dem",
    "Focus": "orograph.geovis.data.focus",
    "Ghost": "orograph.scene.ghosts",
    "Grid": "orograph.geo",
    "Layer": "orograph.geovis.layers",
    "Picture": "orograph.rendering.picture",
    "Silhouettes": "orograph.scene.silhouettes",
    "Sun": "orograph.lighting.sun",
    "Terrain": "orograph.store",
    "Tessellation": "orograph.tessellation",
    "Tour": "orograph.touring.tour",
    "Uncertainty": "orograph.geovis.data.dataset",
    "View": "orograph.viewpoint",
    "bake": "orograph.lighting.bake",
    "basemap": "orograph.geovis.layers",
    "best_view": "orograph.verbs.best_view",
    "build": "orograph.verbs.build",
    "camera": "orograph.scene.camera:",
    "check": "orograph.verbs.check",
    "compare": "orograph.verbs.compare",
    "contours": "orograph.verbs.contours",
    "difference": "orograph.verbs.difference",
    "doctor": "orograph.verbs.doctor",
    "errors": "orograph.errors:",
    "export": "orograph.verbs.export",
    "fetch": "orograph.fetching",
    "info": "orograph.verbs.info",
    "light": "orograph.lighting:make",
    "manifest": "orograph.verbs.manifest",
    "measure": "orograph.measuring:",
    "methods": "orograph.lod.describe",
    "movie": "orograph.verbs.movie",
    "open": "orograph.store",
    "publish": "orograph.store.publishing",
    "read": "orograph.dem",
    "render": "orograph.rendering.api",
    "synth": "orograph.verbs.synth",
    "terrain": "orograph.store",
    "tessellate": "orograph.verbs.tessellate",
    "tin": "orograph.verbs.tin",
    "tour": "orograph.verbs.tour",
    "view": "orograph.viewer.notebook",
}
"""Where each name is: MODULE; MODULE:NAME if the module calls it otherwise; MODULE: if the name is the module itself.
"""


if not TYPE_CHECKING:  # (type checkers look for names themselves)

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from importlib.metadata import version

            return version("orograph")
        if name not in _HOMES:
            raise AttributeError(f"module 'orograph' has no attribute {name!r}{_meant(name)}")
        module, colon, called = _HOMES[name].partition(":")
        home = importlib.import_module(module)
        return home if colon and not called else getattr(home, called or name)


def _meant(name: str) -> str:
    """The end of a message: what to use instead of an unknown name; "" if nothing is similar."""
    from importlib.util import find_spec

    if name.startswith("_") or find_spec(f"orograph.{name}") is not None:  # (a module, which is imported next)
        return ""
    import difflib

    products = importlib.import_module("orograph.lighting.products")
    elsewhere = importlib.import_module("orograph.scene.wording").ELSEWHERE
    made = {one.replace("-", "_"): one for one in products.names()}
    made |= {one.replace("-", "_"): meant for one, meant in products.MEANT.items()}
    called = {one: f"orograph.{one}" for one in __all__} | {one: f"orograph.{here}" for one, here in elsewhere.items()}
    called |= {one: f'orograph.light(dem, "{product}")' for one, product in made.items()}
    if name in called:
        return f". Use {called[name]}."
    close = dict.fromkeys(called[one] for one in difflib.get_close_matches(name, called, 2, 0.6))
    return f". Did you mean {' or '.join(close)}?" if close else ""


def __dir__() -> list[str]:
    return sorted(__all__)


if "xarray" in sys.modules:  # da.orograph, only if xarray is in use: importing it costs time
    importlib.import_module("orograph.accessor")
