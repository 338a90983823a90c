"""Light on terrain: its inclination, horizons, sky, openness, shadows; the products by name and in one call each.

>>> from orograph import lighting
>>> lighting.hillshade(heights, 315, 45, cell=30.0)  # doctest: +SKIP

Names are imported when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orograph.lighting.api import (
        Map,
        ambient_occlusion,
        apertures,
        aspect,
        hillshade,
        horizons,
        insolation,
        make,
        normals,
        openness,
        shadows,
        sky_view_factor,
        slope,
        sunshine,
        visible_sky,
    )

__all__ = [
    "Map",
    "ambient_occlusion",
    "apertures",
    "aspect",
    "hillshade",
    "horizons",
    "insolation",
    "make",
    "normals",
    "openness",
    "shadows",
    "sky_view_factor",
    "slope",
    "sunshine",
    "visible_sky",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'orograph.lighting' has no attribute {name!r}")
    return getattr(importlib.import_module("orograph.lighting.api"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
