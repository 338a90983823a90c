"""The options of reading (``given.READING``) as type checkers and editors know them; a test compares the names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict

from orograph._named import simple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from orograph.dem.undulation import Direction
    from orograph.error import ErrorKind
    from orograph.folders import Amount
    from orograph.progress import Progress


class Reading(TypedDict, total=False):
    """How heights are read (``orograph.terrain``)."""

    crs: Any
    resolution: float | str | None
    resampling: str | None
    to_vertical: Direction | None
    geoid: Any
    bbox: Any
    clip: Any
    band: int | None
    nodata: float | str | None
    spacing: float | None
    assume_crs: str | None
    encoding: str | None
    vertical_unit: str | None
    assume_vertical: str | None
    max_edge: float | str | None
    height_column: str | None
    point_layer: str | None
    point_classes: Any
    transform: Any
    name: str | None
    skip_damaged: bool | None


class Building(Reading, total=False):
    """How a store is built (``store.build.build``), but for ``part``."""

    overwrite: bool
    resume: bool
    update: bool
    keep: int | None
    max_memory: Amount
    jobs: int | None
    errors: Sequence[ErrorKind] | str
    tins: int | None
    chunked: tuple[int, float] | tuple[int, float, bool] | None
    quadtin: tuple[float, str] | None
    keep_source: bool
    codec: str
    max_error: str | float
    progress: Progress | bool | None
    storage_options: dict[str, Any] | None
    shard: int | None
    chunk: int
    finish: bool
    workers: int | None
    dask: Any


KINDS = simple({name: one.__forward_arg__ for name, one in Reading.__annotations__.items()})
"""Those that are a number or a switch."""
