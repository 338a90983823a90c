"""``orograph.render``: from a terrain, a DEM or a path to a picture, in one call."""

from __future__ import annotations

import difflib
import inspect
import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geovis.layers import Given, layers_of
from orograph.lighting.sun import Given as GivenSun
from orograph.lighting.sun import Sun, sun_of
from orograph.progress import SILENT, Progress
from orograph.rendering.backends import BACKENDS, draw
from orograph.rendering.memory import check_memory
from orograph.rendering.picture import Picture
from orograph.scene.contours import lines_of
from orograph.scene.parts import Light
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.lighting.aperture import Lamp
    from orograph.scene.contours import Contours

CAMERA = ("azimuth", "pitch", "distance", "lonlat", "look_at", "fov", "fov_y", "projection", "eye", "target")
"""What the command line has options for, and here a view."""


def render(
    terrain: Terrain | Dem | str | os.PathLike[str],
    view: View | None = None,
    *,
    size: tuple[int, int] = (1280, 720),
    sun: GivenSun = (315.0, 45.0),
    shadows: bool = True,
    light: Light = "relief",
    rays: int = 64,
    lamps: Sequence[Lamp] = (),
    discs: Sequence[tuple[Sun, tuple[float, float, float]]] = (),
    exaggeration: float = 1.0,
    relief: float | None = None,
    colormap: str | None = None,
    layers: Given | Iterable[Given] = (),
    water: Literal["auto"] | float | None = "auto",
    contours: Contours | float | None = None,
    silhouettes: Silhouettes | bool | None = None,
    sky: bool = False,
    furniture: bool = False,
    title: str | None = None,
    depths: tuple[float, float] | None = None,
    samples: int = 4,
    tolerance: float | None = None,
    method: str = "auto",
    triangles: int | None = None,
    wireframe: bool = False,
    mesh_view: View | None = None,
    max_memory: int | None = None,
    jobs: int | None = None,
    backend: Literal["cpu", "gpu"] = "cpu",
    progress: Progress = SILENT,
    **unknown: Any,
) -> Picture:
    """Draw a relief picture.

    Args:
        terrain: an opened terrain, a DEM in memory, or the path of a DEM or a store.
        view: the camera, made with ``orograph.View(eye, target)`` in the terrain's CRS, or for a terrain by
            ``orograph.camera`` (the module ``orograph.scene.camera``): ``whole(terrain, size)``,
            ``around(terrain, size, azimuth=225, pitch=30, distance=None)``, ``standing(terrain, size, (lon, lat,
            height), (lon, lat))`` or ``plan(terrain, size)``. None: all of the terrain, from the south.
        size: (width, height) in pixels where there is no view; with one, the view's own count. Default 1280 × 720.
        sun: (azimuth, altitude): degrees clockwise from grid north, degrees above the horizon; a datetime with zone,
            or such a time as text, for the real sun over the terrain's middle; or a ``Sun``. Default 315, 45.
        shadows: whether the ground casts shadows. Default True.
        light: how it falls: "relief" (shadows by the skyline, a sky-view factor for the sky), "ao" (ambient occlusion),
            "aperture" (ambient apertures), "raytraced" (rays to the sun's disc and to the sky) or "none". What is baked
            into a store (``orograph.bake``) is used. Default "relief".
        rays: with "raytraced", to each disc of light and to the sky. Default 64.
        lamps: points of light (``lighting.aperture.Lamp.at``), with "aperture" and "raytraced". Default none.
        discs: further suns, with their colours; (1, 1, 1) is about that of the sun at 45°. Default none.
        exaggeration: factor by which heights are stretched on the screen. Default 1.
        relief: factor on slopes for shading only; 1 is nature. Default None: 1 to 6, more for gentle land.
        colormap: colours of heights: alpine, mars, grey or any name of the cmap catalogue. Default None: alpine.
        layers: images and rasters laid over the ground, bottom to top: paths, or ``orograph.Layer``s, which also say
            opacity, colour map and more; in any CRS. Default: none.
        water: "auto" finds lakes and seas by their flatness, a number is a water level in metres, None draws none.
            Default "auto".
        contours: lines of equal height: metres from line to line, or a ``Contours`` (``orograph.Contours()`` finds an
            interval itself). Default None: none.
        silhouettes: lines along ridges and creases: True, or a ``Silhouettes``. Default None.
        sky: draw sky and haze instead of paper. Default False.
        furniture: add a title, a colour bar, a north arrow and a scale bar. Default False.
        title: the title of the furniture. Default None: the terrain's name.
        depths: with a sky, metres from the nearest to the farthest ground, between which haze grows. Default None:
            those of the ground in view.
        samples: rays per pixel where the picture has edges; 1 leaves them jagged. Default 4.
        tolerance: pixels by which the ground may be displaced; 0 draws every sample. Default None: 0 up to 16.8 million
            samples, else 0.5. With a method: what that is to keep. Default None: 1.
        method: draw the mesh that this method makes, with light on its faces: "soar", "roam,error=wedgie"…
            (``orograph.methods()`` tells all and their options). Default "auto": the terrain itself.
        triangles: with a method: at most so many, instead of a tolerance. Default None.
        wireframe: with a method, draw its triangles' edges over the relief. Default False.
        mesh_view: the camera that the method selects for, to look at its mesh from elsewhere. Default None: ``view``.
        max_memory: bytes to keep within. Default None: no limit.
        jobs: threads. Default None: all processors.
        backend: "cpu", or "gpu": the same picture drawn by a graphics processor (or, with a warning, by the CPU where
            there is none). Default "cpu".
        progress: hears of what is being done, and of warnings. Default: nothing is said.

    Returns:
        a ``Picture``: ``save(path)``, ``pixels`` (height, width, 3) uint8, ``depth`` (height, width) float32 metres.

    Raises:
        ReadError, StoreError: the path cannot be read.
        UsageError: an option is unknown or makes no sense, or the picture does not fit into memory.
        NothingInViewError: the picture would be empty.
    """
    if unknown:
        raise _unknown(next(iter(unknown)))
    if backend not in BACKENDS:
        raise UsageError(f"There is no backend {backend!r}; there are {', '.join(BACKENDS)}.")
    check_memory((view.width, view.height) if view is not None else size, max_memory)
    if isinstance(terrain, (str, os.PathLike)):
        from orograph.scene.prepare import prepare

        terrain = prepare([os.fspath(terrain)], max_memory=max_memory, jobs=jobs, progress=progress)
    elif isinstance(terrain, Dem):
        from orograph.store import terrain as in_memory

        terrain = in_memory(terrain)
    if view is None:
        from orograph.rendering.furniture.furnish import insets
        from orograph.scene.camera import NO_INSETS, whole

        view = whole(terrain, size, exaggeration=exaggeration, insets=insets(size) if furniture else NO_INSETS)
    scene = Scene.of(
        terrain, view, sun=sun_of(sun, terrain.grid), shadows=shadows, light=light, rays=rays, lamps=tuple(lamps),
        discs=tuple(discs), exaggeration=exaggeration, colormap=colormap, layers=layers_of(layers), sky=sky,
        water=water, contours=lines_of(contours),
        silhouettes=Silhouettes() if silhouettes is True else silhouettes or None, relief=relief, samples=samples,
        tolerance=tolerance, method=method, triangles=triangles, wireframe=wireframe,
        mesh_view=mesh_view, furniture=furniture, title=title, depths=depths, max_memory=max_memory, jobs=jobs,
    )  # fmt: skip
    return draw(scene, progress, backend=backend)


def _unknown(name: str) -> UsageError:
    """The error of an option that there is not, naming those that may be meant."""
    options = [
        p.name for p in inspect.signature(render).parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    if name in CAMERA:
        remedy = "Where to look from is said by a view: see orograph.camera, or orograph.View."
    elif close := difflib.get_close_matches(name, options, 3, 0.6):
        remedy = f"Did you mean {' or '.join(close)}?"
    else:
        remedy = f"There are {', '.join(options[1:])}."
    return UsageError(f"render has no option {name!r}.", remedy=remedy)
