"""What users are warned of when terrain is made from files: their warnings, and heights that are doubtful."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import Any, cast

from orograph.progress import Progress
from orograph.store.source import HeightSource

DOUBTS = "doubts.json"
"""The file of them in a kept store."""

MANY, WINDOWS = 64, 16
"""Of how many files windows are read to look for fills, and about how many in all."""


def warn_of_files(raster: HeightSource, progress: Progress) -> None:
    """Warn of what reading the files' headers has found."""
    for text in getattr(raster, "warnings", ()):
        progress.warn(text)


def warn_of_heights(
    raster: HeightSource, extent: tuple[float, float], progress: Progress, kept: Path | None = None
) -> None:
    """Warn of doubtful heights: values that mark missing data, other units than declared.

    Args:
        extent: the lowest and the highest of the terrain, metres.
        kept: the store that is kept of these files. What this version found before is written there.
    """
    import importlib.metadata  # late, for only this needs it

    version, doubts = importlib.metadata.version("orograph"), None
    if kept is not None:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            doubts = json.loads((kept / DOUBTS).read_text(encoding="utf-8")).get(version)
    if doubts is None:
        doubts = _doubts(raster, extent)
        if kept is not None:
            with contextlib.suppress(OSError):
                (kept / DOUBTS).write_text(json.dumps({version: doubts}), encoding="utf-8")
    for text in doubts:
        progress.warn(text)


def _doubts(raster: HeightSource, extent: tuple[float, float]) -> list[str]:
    from orograph.dem.area import Cut
    from orograph.dem.inspect import doubtful_heights
    from orograph.dem.source import Source

    sources: list[Any] = getattr(raster, "sources", [])
    if math.isnan(extent[0]) or getattr(raster, "undulation", None) is not None:
        return []  # there are none, or they are no longer those of the files
    found: dict[str, str] = {}
    every = -(-len(sources) // MANY)
    for i, source in enumerate(sources):
        if not isinstance(source.raster if isinstance(source, Cut) else source, Source):
            continue
        windows = max(1, WINDOWS // len(sources)) if i % every == 0 else 0
        for text in doubtful_heights(cast(Source, source), *extent, windows):
            found.setdefault(text, text if len(sources) == 1 else f"{source.name}: {text}")
    return list(found.values())
