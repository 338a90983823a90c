"""The options of a scene (``parts.OPTIONS``) as type checkers and editors know them; a test compares the names.

Options with several forms (objects, tuples, the command line's texts) are ``Any`` here; ``parts`` checks them.
"""

from __future__ import annotations

from typing import Any, Literal

from orograph.folders import Amount
from orograph.scene.parts import Light, SurfaceNormals
from orograph.store.typed import Reading


class SceneOptions(Reading, total=False):
    """The scene's options (``orograph.render``), and how the terrain is read."""

    sun: Any
    light: Light
    shadows: bool
    rays: int
    lamps: Any
    discs: Any
    relief: float | str | None
    sky: bool
    depths: tuple[float, float] | str | None
    colormap: Any
    range: tuple[float, float] | str | None
    layers: Any
    water: Literal["auto", "none"] | float | str | None
    data: Any
    priority: Any
    focus: Any
    flight: Any
    ghosts: Any
    contours: Any
    silhouettes: Any
    aids: Any
    furniture: bool
    inset: bool
    title: str | None
    exaggeration: float
    samples: int
    tolerance: float | None
    method: str
    triangles: int | None
    wireframe: bool
    normals: SurfaceNormals
    mesh_view: Any
    detail: Any
    max_memory: Amount | None
    jobs: int | None
