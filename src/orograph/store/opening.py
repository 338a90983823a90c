"""Make a terrain from heights in any form; every function that takes a terrain begins with it."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from orograph._named import answering, checking, remedy
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.build import in_memory
from orograph.store.given import OF_AREAS, READING, check_names, files_of, source_of
from orograph.store.prepare import part_of, prepare
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.error import ErrorKind

P = ParamSpec("P")
T = TypeVar("T")


@answering
def terrain(
    source: Any,
    progress: Progress | bool | None = None,
    *,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    errors: Collection[ErrorKind] = (),
    called: str = "terrain",
    **reading: Any,
) -> Terrain:
    """Open heights in any form as a terrain.

    Args:
        source: a path or URL of a DEM or of a store, a pattern (``tiles/*.tif``), a folder (all rasters in it), or a
            list of DEMs; a ``Dem``; a ``Terrain``, which is returned; an ``xarray.DataArray`` or ``Dataset`` (lazy ones
            are computed); an open rasterio dataset, or (dataset, window); an array (rows, cols) of any real type,
            masked or not; or a list of several of these, which are combined (``Mosaic``). Files too large for memory
            are built into a store, which is kept.
        progress: gets progress reports and warnings; None: bars in terminals and notebooks, and Python's warnings;
            False: silent.
        max_memory: bytes that heights may take. jobs: threads; None: all processors.
        errors: kinds of diamond errors that a newly kept store gets, besides exact ones.
        called: the calling function, for errors.
        reading: for arrays ``transform`` (an ``Affine`` or its six numbers) or ``spacing`` (metres), ``nodata``,
            ``vertical_unit``, ``assume_vertical`` and ``name``; for files the options of ``Source.open``: ``band``,
            ``nodata``, ``spacing``, ``assume_crs``, ``encoding``, ``vertical_unit`` and ``assume_vertical``, for many
            files ``skip_damaged``; for all of these the options of ``Mosaic``: ``crs``, ``resolution``, ``resampling``,
            ``to_vertical`` and ``geoid``. ``crs`` is the projected CRS of the terrain; heights in memory without a CRS
            are assumed to be in it. Without a transform the samples of an array are 1 m apart, and a warning says so.
            For anything, including terrains and stores, ``bbox`` (west, south, east, north in degrees) and ``clip``
            (polygons: a GeoJSON file or object, or shapely's, geopandas') select a part.

    Raises:
        ReadError, StoreError: a file cannot be read, or its heights are not real numbers.
        UsageError: it does not hold heights, or an option does not apply.
    """
    max_memory = bytes_of(max_memory)
    progress = reporting(progress)
    check_names(reading, called)
    options = {k: v for k, v in reading.items() if v is not None}
    if isinstance(source, Terrain):
        area = {name: options.pop(name) for name in OF_AREAS if name in options}
        if options:
            names = ", ".join(f"`{name}`" for name in options)
            raise UsageError(f"{names} cannot be used with a Terrain, which has already been read.")
        if not area:
            return source
        return part_of(source, area, max_memory=max_memory, jobs=jobs, progress=progress, errors=errors)
    files = files_of(source)
    if files is not None and not {"transform", "name"} & set(options):
        return prepare(files, max_memory=max_memory, jobs=jobs, progress=progress, errors=errors, **options)
    return in_memory(source_of(source, progress, called=called, **options), progress)


def takes_terrain(function: Callable[Concatenate[Terrain, P], T]) -> Callable[Concatenate[Any, P], T]:
    """Let a function that begins with a terrain take whatever ``terrain`` takes, with its options of reading."""
    own = inspect.signature(function).parameters
    open_ = any(one.kind is one.VAR_KEYWORD for one in own.values())
    signature = f"({', '.join(map(str, (one.name for one in own.values())))})"
    check = checking(function)

    @functools.wraps(function)
    def taking(terrain_: Any, *args: Any, **options: Any) -> T:
        check((terrain_, *args), options)
        reading = {name: options.pop(name) for name in READING if name in options and name not in own}
        more = {k: options[k] for k in ("jobs", "max_memory") if options.get(k) is not None}
        found = terrain(terrain_, called=function.__name__, **more, **reading)
        if odd := next((name for name in options if name not in own and not open_), None):
            raise UsageError(f"{function.__name__} has no option {odd!r}.", remedy=remedy(odd, [*own, *READING]))
        try:
            inspect.signature(function).bind(found, *args, **options)
        except TypeError as error:
            raise UsageError(
                f"{function.__name__}: {error}.", remedy=f"Its signature is {function.__name__}{signature}."
            ) from error
        return function(found, *args, **options)

    @functools.wraps(function)
    def taking_names(*args: Any, **options: Any) -> T:
        first = next(iter(own))
        if not args and first not in options:
            raise UsageError(f"{function.__name__} needs `{first}`: what to read heights from.")
        return taking(*args, **options) if args else taking(options.pop(first), **options)

    return taking_names
