"""The views that show a target best: the result of ``orograph.best_view``, and how it is saved.

The score and its parts are in docs/best-view.md; ``best_target``, ``best_cameras`` and ``best_search`` have the target,
the allowed cameras, and the search.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orograph.documents import write
from orograph.errors import UsageError
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain
from orograph.touring.best_cameras import Cameras
from orograph.touring.best_search import Found, Search
from orograph.touring.best_target import Target
from orograph.touring.keys import Key
from orograph.touring.tour import Tour
from orograph.viewpoint import View

PIECES, AZIMUTHS, APART = 1000, 72, 20.0
"""The defaults of ``orograph.best_view``: pieces of a target, sides, degrees between views."""


@dataclass(frozen=True, slots=True)
class BestView:
    """A view of a target.

    Attributes:
        view: the camera. score: how well it shows the target, 0 to 1; gain: over the views before it.
        visible: the visible share of the target's weight, 0 to 1.
        geometries: the same for each geometry of the target.
    """

    view: View
    score: float
    gain: float
    visible: float
    geometries: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Its view as in VIEW.json, plus its score and what it sees."""
        return {"view": self.view.to_dict(), "score": self.score, "gain": self.gain, "visible": self.visible,
                "geometries": list(self.geometries)}  # fmt: skip


@dataclass(frozen=True, slots=True)
class BestViews:
    """Views of a target, the best first; a sequence.

    Attributes:
        views: the views. together: the score of all of them, 0 to 1.
        cameras: the number of allowed ones. pieces: of the target. looks: the number of tested lines of sight.
        level: the terrain's level on which they were tested, 0 unless the ground is too large for memory.
    """

    views: tuple[BestView, ...]
    together: float
    cameras: int
    pieces: int
    looks: int
    level: int

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, number: int) -> BestView:
        return self.views[number]

    def to_list(self) -> list[dict[str, Any]]:
        """What ``save`` writes."""
        return [one.to_dict() for one in self.views]

    def save(self, path: str | os.PathLike[str]) -> list[str]:
        """Write them as one JSON list, and each as a separate VIEW.json beside it: NAME-1.json, NAME-2.json…

        Returns:
            the names of those. Raises OutputError: one cannot be written.
        """
        files = singles(path, len(self))
        for file, one in zip(files, self.views):
            one.view.save(file)
        write(self.to_list(), Path(path))
        return files

    def tour(self, *, seconds: float = 6.0, hold: float = 2.0) -> Tour:
        """A tour through the views, about the target.

        Args:
            seconds: from one view to the next. hold: seconds for which the camera stays at each.
        """
        if not (seconds > 0 and hold >= 0):
            raise UsageError("The seconds from view to view must be more than 0, and the hold 0 or more.")
        keys = [Key(one.view, i * (seconds + hold), hold=hold, path="orbit") for i, one in enumerate(self.views)]
        return Tour(tuple(keys), above_ground=2.0)


def search(
    ground: Terrain, target: Any, k: int, *, size: tuple[int, int], azimuths: int | Sequence[float] = AZIMUTHS,
    pitches: Sequence[float] | None = None, heights: Sequence[float] = (), distances: Sequence[float] = (),
    fovs: Sequence[float] = (40.0,), clearance: float = 2.0, target_height: float = 0.0, sun: Any = None,
    apart: float = APART, pieces: int = PIECES, jobs: int | None = None, progress: Progress = SILENT,
) -> BestViews:  # fmt: skip
    """The best views of a target on a terrain, none where no camera sees any of it; see ``orograph.best_view``."""
    from orograph.lighting.sun import sun_of
    from orograph.touring.best_cameras import PITCHES, cameras
    from orograph.touring.best_target import read_target

    pieces_of = read_target(ground, target, pieces, progress)
    pitched = pitches if pitches is not None else () if heights else PITCHES
    cams = cameras(
        ground, pieces_of, size, azimuths=azimuths, pitches=pitched, above=heights, distances=distances, fovs=fovs,
        clearance=clearance,
    )  # fmt: skip
    light = None if sun is None else sun_of(sun, ground.grid)
    made = Search(ground, pieces_of, cams, lift=target_height, sun=light, jobs=jobs, progress=progress)
    return gathered(made, made.views(k, apart), cams, pieces_of)


def singles(path: str | os.PathLike[str], count: int) -> list[str]:
    """The files of single views beside the file of all."""
    whole = Path(path)
    return [str(whole.with_name(f"{whole.stem}-{i + 1}{whole.suffix}")) for i in range(count)]


def gathered(search: Search, found: list[Found], cams: Cameras, target: Target) -> BestViews:
    """The result of a search."""
    views = []
    for one in found:
        seen = ~np.isnan(one.quality)
        whole = np.bincount(target.owner, target.weight, target.count)
        part = np.bincount(target.owner, target.weight * seen, target.count)
        geometries = tuple(float(v) for v in np.where(whole > 0, part * target.count, 0.0))
        views.append(
            BestView(cams.view(one.camera), one.score, one.gain, float((target.weight * seen).sum()), geometries)
        )
    return BestViews(tuple(views), sum(one.gain for one in found), len(cams), len(target.points), search.looks,
                     search.ground.level)  # fmt: skip
