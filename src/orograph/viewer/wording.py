"""Python's names in messages, in the window's words: as its panels call things, or its options where it begins."""

from __future__ import annotations

from orograph.scene import wording

STARTED = {"max_memory": "--memory", "gpu_memory": "--gpu-memory", "adapter": "--adapter", "jobs": "--jobs"}
"""What is said when the window is opened, and of which no panel knows."""

PANELS = {
    "colormap": "colors",
    "fov_y": "field of view",
    "relief": "slopes shaded as",
    "shadows": "cast shadows",
    "sky": "sky and haze",
}
"""What panels call an option otherwise than by its name."""


def called(name: str) -> str:
    """What the window calls an argument."""
    return STARTED.get(name) or PANELS.get(name) or name.replace("_", " ")


def spoken(text: str) -> str:
    """A text of the library with its Python in backticks in the window's words."""
    return wording.spoken(text, called)
