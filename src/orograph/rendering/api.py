"""``orograph.render``: from a terrain, a DEM or a path to a picture, in one call.

Its keyword arguments are the options of ``scene.parts``, which also provide the signature and the documentation.
"""

from __future__ import annotations

import difflib
import inspect
import os
import textwrap
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Literal, Unpack, cast

from orograph._named import answering
from orograph.errors import UsageError
from orograph.geovis.layers import layers_of
from orograph.lod.options import Described
from orograph.progress import Progress
from orograph.rendering.backends import BACKENDS, draw
from orograph.rendering.memory import check_memory
from orograph.rendering.panels import draw_panels
from orograph.rendering.picture import Picture
from orograph.reporting import reporting
from orograph.scene.camera import NO_INSETS, plan, view_of, whole
from orograph.scene.methods import check_promise
from orograph.scene.parts import OPTIONS, check_options
from orograph.scene.scene import Scene
from orograph.scene.sizes import Size, size_of
from orograph.scene.typed import SceneOptions
from orograph.scene.wording import MEANT
from orograph.store.given import READING
from orograph.store.opening import terrain as opened
from orograph.store.typed import Reading
from orograph.viewpoint import View

AROUND = "view=orograph.camera.around(terrain, size, azimuth=225, pitch=30, distance=None)"
STANDING = "view=orograph.camera.standing(terrain, size, (lon, lat, height), (lon, lat))"
CAMERA = {
    **dict.fromkeys(("azimuth", "azim", "pitch", "elev", "tilt", "distance", "side", "from", "from_"), AROUND),
    **dict.fromkeys(("lonlat", "look_at"), STANDING),
    **dict.fromkeys(("projection", "plan", "map"), 'view="plan", or view=orograph.camera.plan(terrain, size)'),
    **dict.fromkeys(("eye", "target", "fov", "fov_y", "up"), "view=orograph.View(eye, target, fov_y=30)"),
    "camera": 'view="plan" for a map, view=orograph.View(eye, target, fov_y=30), or made by orograph.camera',
}
"""Command-line options that are part of a view here."""

PLACED = frozenset({"extent", "bounds", "coords"})
"""Names that people give the place of an array."""

SAVED = frozenset({"output", "out", "path", "filename", "outfile", "save"})
"""Names that people give a file to write."""

FLAGS = {one.key.replace("-", "_"): one.name for one in OPTIONS.values() if one.flag and one.key != one.name}
"""Names of options on the command line or in other tools, and here."""


@answering
def render(
    terrain: Any,
    view: View | str | os.PathLike[str] | None = None,
    *,
    size: Size = (1280, 720),
    backend: Literal["cpu", "gpu"] = "cpu",
    conservative: bool = False,
    each: str | None = None,
    progress: Progress | bool | None = None,
    **options: Unpack[SceneOptions],
) -> Picture:
    """Draw a relief picture.

    Args:
        terrain: whatever ``orograph.terrain`` takes: a path or URL, a list of them, a Terrain, a Dem, a DataArray or
            Dataset, an open rasterio dataset or (dataset, window), an array with ``transform`` and ``crs``…
        view: the camera, made with ``orograph.View(eye, target)`` in the terrain's CRS, or for a terrain by
            ``orograph.camera`` (the module ``orograph.scene.camera``): ``whole(terrain, size)``,
            ``around(terrain, size, azimuth=225, pitch=30, distance=None)``, ``standing(terrain, size, (lon, lat,
            height), (lon, lat))`` or ``plan(terrain, size)``; "plan": that; or the path of a VIEW.json. None: all
            of the terrain, from the south.
        size: (width, height) in pixels if no view is given; a view has its own size. Default 1280 × 720.
        backend: "cpu", or "gpu": the same picture drawn by a graphics processor (or, with a warning, by the CPU if
            there is none). Default "cpu".
        conservative: refuse a ``method`` that does not promise the tolerance for every sample in view.
        each: several panels instead of one picture, all with one camera, one scale and one legend: "view" (a map beside
            the relief), "data" (one for each, with scales of their own), or "member", "band" or "time" of the first
            data, all or some: "member=1-6", "time=T12".
        progress: gets progress reports and warnings. Default: long work has a bar in terminals and notebooks, warnings
            are Python's; False: silent.
        options: see below.

    Returns:
        a ``Picture``: ``save(path)``, ``pixels`` (height, width, 3) uint8, ``depth`` (height, width) float32 metres.

    Raises:
        ReadError, StoreError: the path cannot be read.
        UsageError: an option is unknown or makes no sense, or the picture does not fit into memory.
        NothingInViewError: the picture would be empty.
    """
    chosen = cast("dict[str, Any]", options)
    reading = {name: chosen.pop(name) for name in READING if name in chosen}
    heard = reporting(progress)
    check_names(chosen, "render", inspect.signature(render).parameters)
    if backend not in BACKENDS:
        raise UsageError(f"There is no backend {backend!r}; the backends are {', '.join(BACKENDS)}.")
    if conservative:
        check_promise(chosen.get("method", "auto"), backend)
    check_options(chosen)
    max_memory, jobs = OPTIONS["max_memory"].worded(chosen.get("max_memory")), chosen.get("jobs")
    size = size_of(size)
    check_memory((view.width, view.height) if isinstance(view, View) else size, max_memory)
    terrain = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="render", **reading)
    from orograph.rendering.furniture.furnish import insets

    layers = layers_of(chosen.get("layers"))
    beside = chosen.get("furniture") and each is None  # (panels have none of their own)
    free = insets(size, terrain.attribution, layers) if beside else NO_INSETS
    stretch = chosen.get("exaggeration", 1.0)
    flat = isinstance(view, str) and view == "plan"
    automatic, view = view is None or flat, view_of(view, terrain, size, exaggeration=stretch, insets=free)
    if each is not None:
        camera = partial(plan, terrain) if flat else partial(whole, terrain, exaggeration=stretch)
        again = camera if automatic else None
        return draw_panels(terrain, view, each, chosen, backend=backend, again=again, progress=heard)
    scene = Scene.of(terrain, view, **chosen)
    if automatic:
        from orograph.rendering.standing import with_room

        free = insets(size, terrain.attribution, layers, scene.keys) if beside else NO_INSETS
        again = partial(plan, terrain, size) if flat else partial(whole, terrain, size, exaggeration=stretch)
        scene = with_room(scene, partial(again, insets=free))
    return draw(scene, heard, backend=backend)


def check_names(options: Mapping[str, Any], called: str, own: Iterable[str] = ()) -> None:
    """Raise UsageError for an unknown option of a scene; the error suggests similar ones.

    Args:
        called: the function that takes them. own: its other arguments.
    """
    for name in options:
        if name in OPTIONS:
            continue
        known = list(dict.fromkeys((*own, *OPTIONS, *READING)))
        if name in CAMERA:
            remedy = f"Here the camera is given as a view: {CAMERA[name]}."
        elif name in PLACED:
            remedy = "An array lies where its transform= and crs= say; bbox= draws a part of the ground."
        elif name in SAVED:
            remedy = "Save the result: `picture.save('relief.png')`."
        elif name in FLAGS or name in MEANT:
            remedy = f"It is called {FLAGS.get(name) or MEANT[name]} here."
        elif close := difflib.get_close_matches(name, known, 3, 0.6):
            remedy = f"Did you mean {' or '.join(close)}?"
        else:
            remedy = f"The options are {', '.join(known[1:])}."
        raise UsageError(f"{called} has no option {name!r}.", remedy=remedy)


def _document() -> None:
    """Give ``render`` the signature and the documentation of a scene's options."""
    own = inspect.signature(render)
    *before, _ = own.parameters.values()
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=one.default, annotation=one.annotation)
        for name, one in OPTIONS.items()
    ]
    kinds = Reading.__annotations__
    more += [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kinds[name].__forward_arg__)
        for name in READING
    ]
    setattr(render, "__signature__", own.replace(parameters=[*before, *more]))  # noqa: B010
    if render.__doc__ is not None:  # (there is none with -OO)
        texts = {name: _text(one) for name, one in OPTIONS.items()}
        texts[", ".join(READING)] = "how the terrain is read, as for ``orograph.terrain``."
        told = "".join(
            textwrap.fill(
                f"{name}: {text}", 120, initial_indent=" " * 8, subsequent_indent=" " * 12, break_on_hyphens=False
            ) + "\n"
            for name, text in texts.items()
        )  # fmt: skip
        render.__doc__ = render.__doc__.replace("        options: see below.\n", told)


def _text(one: Described) -> str:
    """An option's help, in Python's terms, and its default."""
    default = one.shown or ("none" if one.default in (None, ()) else repr(one.default))
    takes = "" if one.given is None else f" {inspect.getdoc(one.given)}"
    return f"{one.help}{takes} Default: {default}.".replace("`", "``")


_document()
