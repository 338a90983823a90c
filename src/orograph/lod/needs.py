"""What methods need from a store besides heights: missing data are made in memory, with a message.

``orograph build --for METHOD`` stores it in advance. A new kind of need is a function in ``SUPPLIERS``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from orograph.error import ErrorKind
from orograph.errors import UsageError
from orograph.lod.method import Need, Resources
from orograph.store.chunked import Kind
from orograph.store.stored import StoredTerrain
from orograph.store.terrain import Terrain

BYTES_PER_SAMPLE = 4 + 8 * 4 / 3 + 4
"""Bytes per sample of heights, errors and radii of diamonds, including temporary data."""

TIN_BYTES_PER_SAMPLE = 4.0
"""Bytes per sample of marks, errors and radii of TINs during their making."""

CHUNKED_BYTES_PER_SAMPLE = BYTES_PER_SAMPLE + 4 / 3
"""Bytes per sample of errors of diamonds during the making of chunks, and of vertices' levels."""


def supply(terrain: Terrain, needs: Iterable[Need], resources: Resources) -> None:
    """Make those ``needs`` that a terrain lacks.

    Raises:
        UsageError: nothing makes such data, or it does not fit into memory.
    """
    for need in needs:
        if need.name not in SUPPLIERS:
            raise UsageError(f"Nothing makes {need.name!r}; there are {', '.join(SUPPLIERS)}.")
        SUPPLIERS[need.name](terrain, need.options, resources)


def kinds_of(needs: Iterable[Need]) -> tuple[ErrorKind, ...]:
    """The kinds of errors that a store must have been built with."""
    return tuple(dict.fromkeys(need.options["error"] for need in needs if need.name == "diamonds"))


def _check_room(terrain: Terrain, resources: Resources, each: float, what: str, remedy: str) -> None:
    """Raise UsageError if making what a store lacks takes more memory than allowed.

    Args:
        each: bytes per sample.
    """
    needed = int(terrain.grid.rows * terrain.grid.cols * each)
    if needed > resources.max_memory:
        raise UsageError(
            f"The store has no {what}, and making them in memory takes {needed >> 20} MiB.", path=terrain.name,
            remedy=remedy,
        )  # fmt: skip


def _diamonds(terrain: Terrain, options: Mapping[str, Any], resources: Resources) -> None:
    kind = options["error"]
    if not isinstance(terrain, StoredTerrain) or terrain.has("diamonds", error=kind):
        return
    remedy = f"Build it with them (`orograph.build(..., errors={(*terrain.errors, kind)}, overwrite=True)`)."
    _check_room(terrain, resources, BYTES_PER_SAMPLE, f"{kind} errors", remedy)
    resources.progress.note(
        f"the store has no {kind} errors: they are made in memory "
        f"(`orograph.build(..., errors={(*terrain.errors, kind)})` keeps them)"
    )
    with resources.progress.task(f"Finding {kind} errors"):
        terrain.supply("diamonds", error=kind)


def _patches(terrain: Terrain, options: Mapping[str, Any], resources: Resources) -> None:
    if isinstance(terrain, StoredTerrain) and not terrain.has("patches", **options):
        resources.progress.note("the store has no errors of such patches: they are made in memory")
    # (The method's own table makes them: ``lod.patches.tables``.)


def _tins(terrain: Terrain, options: Mapping[str, Any], resources: Resources) -> None:
    if not isinstance(terrain, StoredTerrain) or terrain.has("tins", **options):
        return
    remedy = f"Allow more memory, or build it with them (`orograph.build(..., tins={options['legs']})`)."
    _check_room(terrain, resources, TIN_BYTES_PER_SAMPLE, "TINs", remedy)
    resources.progress.note(
        f"the store lacks these TINs: made in memory (`orograph.build(..., tins={options['legs']})` keeps them)"
    )
    # (The method itself makes them: ``lod.bdam``.)


def _chunked(terrain: Terrain, options: Mapping[str, Any], resources: Resources) -> None:
    if not isinstance(terrain, StoredTerrain) or terrain.has("chunked", **options):
        return
    pair = Kind(**options)
    remedy = f"Allow more memory, or build it with them (`orograph.build(..., chunked={pair})`)."
    _check_room(terrain, resources, CHUNKED_BYTES_PER_SAMPLE, "meshes of chunks", remedy)
    resources.progress.note(
        f"the store lacks these chunks: made when needed (`orograph.build(..., chunked={pair})` keeps them)"
    )
    with resources.progress.task("Finding midpoint errors"):
        terrain.supply("chunked", **options)


def _quadtin(terrain: Terrain, options: Mapping[str, Any], resources: Resources) -> None:
    if not isinstance(terrain, StoredTerrain) or terrain.has("quadtin", **options):
        return
    asked = f"({options['finest']:g}, {options['split']!r})"
    resources.progress.note(
        f"the store lacks this QuadTIN: made in memory (`orograph.build(..., quadtin={asked})` keeps it)"
    )
    # (The method itself makes it: ``lod.quadtin``.)


SUPPLIERS: dict[str, Callable[[Terrain, Mapping[str, Any], Resources], None]] = {
    "diamonds": _diamonds,
    "patches": _patches,
    "tins": _tins,
    "chunked": _chunked,
    "quadtin": _quadtin,
}
"""Suppliers by name of a need; the options are the need's."""
