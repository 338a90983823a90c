"""``orograph.render``: from a terrain, a DEM or a path to a picture, in one call.

Its keyword arguments are the options of ``scene.parts``, which also provide the signature and the documentation.
"""

from __future__ import annotations

import difflib
import inspect
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, Unpack, cast, overload

from orograph._named import answering
from orograph.errors import UsageError
from orograph.geovis.layers import layers_of
from orograph.lod.options import Described
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.rendering.memory import check_memory
from orograph.rendering.panels import draw_panels
from orograph.rendering.picture import Picture, picture_format
from orograph.rendering.ways import Way
from orograph.reporting import reporting
from orograph.scene.camera import NO_INSETS, plan, view_of, whole
from orograph.scene.methods import check_promise, conservative_method
from orograph.scene.parts import OPTIONS, check_options
from orograph.scene.scene import Scene
from orograph.scene.sizes import Size, dpi_of, size_of
from orograph.scene.typed import SceneOptions
from orograph.scene.wording import MEANT
from orograph.store.given import READING, check_apart
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


class Rendering(SceneOptions, total=False):
    """The options of ``render`` but for ``output``, as type checkers know them."""

    size: Size
    backend: Literal["cpu", "gpu"]
    conservative: bool
    each: str | None
    depth: str | os.PathLike[str] | None
    workers: int | None
    dask: Any
    sort_last: bool
    progress: Progress | bool | None


File = str | os.PathLike[str]

Given = View | str | os.PathLike[str] | None
"""A view as users give it."""


@overload
def render(terrain: Any, view: Given = None, *, output: None = None, **options: Unpack[Rendering]) -> Picture: ...


@overload
def render(
    terrain: Any, view: Given = None, *, output: str | os.PathLike[str], **options: Unpack[Rendering]
) -> Path: ...  # fmt: skip


@overload
def render(
    terrain: Any, view: Given = None, *, output: str | os.PathLike[str] | None, **options: Unpack[Rendering]
) -> Picture | Path: ...  # fmt: skip


@answering
def render(
    terrain: Any,
    view: View | str | os.PathLike[str] | None = None,
    *,
    size: Size = (1280, 720),
    backend: Literal["cpu", "gpu"] = "cpu",
    conservative: bool = False,
    each: str | None = None,
    output: str | os.PathLike[str] | None = None,
    depth: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    dask: Any = None,
    sort_last: bool = False,
    progress: Progress | bool | None = None,
    **options: Unpack[SceneOptions],
) -> Picture | Path:
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
        conservative: keep the tolerance for every sample in view: sets the options with which the ``method`` promises
            it, or refuses the method.
        each: several panels instead of one picture, all with one camera, one scale and one legend: "view" (a map beside
            the relief), "data" (one for each, with scales of their own), or "member", "band" or "time" of the first
            data, all or some: "member=1-6", "time=T12".
        output: draw into this file (.png, .jpg, .webp or .tif) instead, which may be larger than memory: in bands if
            it takes more than half of ``max_memory`` (None: 1 GiB). depth: with it, where to write the depth: a .tif.
        workers: draw in this many processes of ``jobs`` threads each (default: 1), which share ``max_memory`` (Dask).
        dask: draw on the workers of a cluster: a ``distributed.Client``, or its scheduler's address. They need to see
            the folder of ``output``, or without one the cache folder.
        sort_last: each worker draws a part of the terrain, not tiles of the picture (``rendering.sort_last``).
        progress: gets progress reports and warnings. Default: long work has a bar in terminals and notebooks, warnings
            are Python's; False: silent.
        options: see below.

    Returns:
        a ``Picture``: ``save(path)``, ``pixels`` (height, width, 3) uint8, ``depth`` (height, width) float32 metres;
        the path of ``output`` if there is one.

    Raises:
        ReadError, StoreError: the path cannot be read.
        UsageError: an option is unknown or makes no sense, or the picture does not fit into memory.
        OutputError: the file cannot be written. StoreError: workers gave up tiles.
        NothingInViewError: the picture would be empty.
    """
    chosen = cast("dict[str, Any]", options)
    reading = {name: chosen.pop(name) for name in READING if name in chosen}
    heard = reporting(progress)
    check_names(chosen, "render", inspect.signature(render).parameters)
    way = Way(backend, workers, dask, sort_last)
    check_output(output, depth, each, way, (terrain, chosen.get("layers")))
    if conservative:
        chosen["method"] = conservative_method(chosen.get("method", "auto"), backend)
    check_options(chosen)
    max_memory, jobs = OPTIONS["max_memory"].worded(chosen.get("max_memory")), chosen.get("jobs")
    size = size_of(size)
    if output is None or each is not None:
        check_memory((view.width, view.height) if isinstance(view, View) else size, max_memory)
    terrain = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="render", **reading)
    if conservative:
        check_promise(chosen["method"], backend, terrain)
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
        panels = draw_panels(terrain, view, each, chosen, backend=backend, again=again, progress=heard)
        return panels if output is None else panels.save(output, dpi=dpi_of(size))
    scene = Scene.of(terrain, view, **chosen)
    if automatic:
        from orograph.rendering.standing import with_room

        free = insets(size, terrain.attribution, layers, scene.keys) if beside else NO_INSETS
        again = partial(plan, terrain, size) if flat else partial(whole, terrain, size, exaggeration=stretch)
        scene = with_room(scene, partial(again, insets=free))
    if output is None:
        return way.picture(scene, heard)
    way.into(scene, output, heard, depth=depth, dpi=dpi_of(size), max_memory=max_memory)
    return Path(output)


def check_output(output: File | None, depth: File | None, each: str | None, way: Way, made_of: Sequence[Any]) -> None:
    """Raise UsageError or OutputError if the files of a picture cannot be written, or not so.

    Args:
        made_of: what they must not replace.
    """
    if each is not None and (depth is not None or way.together):
        what = "A `depth` is that of a single picture" if depth is not None else "Panels are drawn by this process"
        raise UsageError(f"{what}, but `each` makes several.")
    if depth is not None and output is None:
        raise UsageError("`depth` is a file beside `output`.", remedy="A Picture has its depth: `picture.depth`.")
    if depth is not None and Path(depth).suffix.lower() not in (".tif", ".tiff"):
        raise UsageError("A depth is saved as a TIFF.", path=depth, remedy="Use .tif.")
    if output is not None:
        picture_format(Path(output))
    for file in (output, depth):
        if file is not None:
            check_folder(Path(file))
            check_apart(file, *made_of)


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
            remedy = "Save the result: `picture.save('relief.png')`, or name its file with `output`."
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
