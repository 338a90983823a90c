"""Translate Python's names in messages to the window's words: as its panels call things, or its options at the
start."""

from __future__ import annotations

from orograph.scene import wording

STARTED = {"max_memory": "--memory", "gpu_memory": "--gpu-memory", "adapter": "--adapter", "jobs": "--jobs"}
"""Options of opening the window that no panel has."""

PANELS = {
    "colormap": "colours",
    "fov_y": "field of view",
    "relief": "slope shading",
    "shadows": "cast shadows",
    "sky": "sky and haze",
}
"""Options whose panel label differs from their name."""


def called(name: str) -> str:
    """What the window calls an argument."""
    return STARTED.get(name) or PANELS.get(name) or name.replace("_", " ")


def spoken(text: str) -> str:
    """A library text whose Python in backticks is translated to the window's words."""
    return wording.spoken(text, called)
