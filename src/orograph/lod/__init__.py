"""Engines: one file or package per published method, all with the same face (``lod.engine.Engine``)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from orograph.errors import UsageError

if TYPE_CHECKING:
    from orograph.lod.engine import Engine

ENGINES = {
    "top-down": ("orograph.lod.top_down", "TopDown"),
    "roam": ("orograph.lod.roam", "Roam"),
    "blow": ("orograph.lod.threshold_spheres", "Blow"),
    "stateless": ("orograph.lod.stateless", "Stateless"),
    "soar": ("orograph.lod.soar", "Soar"),
    "batched": ("orograph.lod.triangle_patches", "Batched"),
}
"""Name to (module, class)."""


def engine_of(name: str) -> type[Engine]:
    """An engine's class by its name.

    Raises:
        UsageError: there is none of that name.
    """
    if name not in ENGINES:
        raise UsageError(f"There is no engine {name!r}; there are {', '.join(ENGINES)}.")
    module, kind = ENGINES[name]
    engine: type[Engine] = getattr(importlib.import_module(module), kind)
    return engine
