"""The options of reading (``given.READING``) as type checkers and editors know them; a test compares the names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict

from orograph._named import simple

if TYPE_CHECKING:
    from orograph.dem.undulation import Direction


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


KINDS = simple({name: one.__forward_arg__ for name, one in Reading.__annotations__.items()})
"""Those that are a number or a switch."""
