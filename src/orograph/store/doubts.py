"""What users are warned of when terrain is made from files: their warnings, and heights that are doubtful."""

from __future__ import annotations

import math
from typing import Any, cast

from orograph.progress import Progress
from orograph.store.source import HeightSource

MANY, WINDOWS = 64, 16
"""Of how many files windows are read to look for fills, and about how many in all."""


def warn_of_files(raster: HeightSource, progress: Progress) -> None:
    """Warn of what reading the files' headers has found."""
    for text in getattr(raster, "warnings", ()):
        progress.warn(text)


def warn_of_heights(raster: HeightSource, extent: tuple[float, float], progress: Progress) -> None:
    """Warn of doubtful heights: values that mark missing data, other units than declared.

    Args:
        extent: the lowest and the highest of the terrain, metres.
    """
    from orograph.dem.area import Cut
    from orograph.dem.inspect import doubtful_heights
    from orograph.dem.source import Source

    sources: list[Any] = getattr(raster, "sources", [])
    if math.isnan(extent[0]) or getattr(raster, "undulation", None) is not None:
        return  # there are none, or they are no longer those of the files
    seen: set[str] = set()
    every = -(-len(sources) // MANY)
    for i, source in enumerate(sources):
        if not isinstance(source.raster if isinstance(source, Cut) else source, Source):
            continue
        windows = max(1, WINDOWS // len(sources)) if i % every == 0 else 0
        for text in doubtful_heights(cast(Source, source), *extent, windows):
            if text not in seen:
                seen.add(text)
                progress.warn(text if len(sources) == 1 else f"{source.name}: {text}")
