"""``orograph.best_view``: of all allowed cameras, those that show a target best (``touring.best_view``)."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from orograph._named import answering
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.several import Numbers, numbers
from orograph.store.opening import terrain as opened

if TYPE_CHECKING:
    from orograph.scene.sizes import Size
    from orograph.touring.best_view import BestViews

PIECES = 1000
AZIMUTHS = 72
APART = 20.0


@answering
def best_view(
    terrain: Any,
    target: Any,
    k: int = 3,
    *,
    size: Size = (1280, 720),
    azimuths: int | Sequence[float] = AZIMUTHS,
    pitches: Numbers | None = None,
    heights: Numbers = (),
    distances: Numbers = (),
    fov: Numbers = 40.0,
    clearance: float = 2.0,
    target_height: float = 0.0,
    sun: Any = None,
    apart: float = APART,
    pieces: int = PIECES,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> BestViews:
    """The views that show most of a target: unoccluded, large, little foreshortened, and different from each other.

    The first view has the highest score of all allowed cameras; each further view adds most to those before it. The
    score is the part of the target that a view shows, each piece by its size in the picture (docs/best-view.md). All
    cameras look at the target's middle.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        target: a GeoJSON file or object of points, lines and polygons, or an object with ``__geo_interface__``; or
            places (n, 2), or a pair of arrays (x, y), in the terrain's CRS. Every geometry counts alike.
        k: how many views.
        size: (width, height) of the pictures.
        azimuths: the sides of the target that cameras may stand at, degrees clockwise from north; a number n: n
            directions, evenly spaced. pitches: degrees by which they look down; None: 5 to 50, unless heights are
            given.
        heights: metres above the ground that cameras stand on. distances: metres over the ground, from the target's
            middle; none: 0.75 to 3 times that from which all of the target is in the picture.
        fov: vertical field of view, degrees; or several.
        clearance: metres above the ground that every eye is at least.
        target_height: metres above the ground of the points to see.
        sun: prefer what this sun lights, given as for ``orograph.render``; None: light does not matter.
        apart: degrees between the directions of any two views, seen from the target.
        pieces: about how many pieces the target is divided into for scoring.
        max_memory: bytes that heights may take. jobs: threads; results do not depend on them. progress: gets progress
            reports; False: silent.

    Raises:
        ReadError: the target cannot be read, or is empty. UsageError: it lies outside the terrain, no camera is above
        the ground, or a number is out of its range.
    """
    max_memory = bytes_of(max_memory)
    check_best_view(k, target_height, apart, pieces)
    ground = opened(terrain, progress, max_memory=max_memory, jobs=jobs, called="best_view", **reading)
    from orograph.scene.sizes import size_of
    from orograph.touring.best_view import search

    told = reporting(progress)
    found = search(
        ground, target, k, size=size_of(size), azimuths=sides_of(azimuths),
        pitches=None if pitches is None else numbers(pitches, "pitches"), heights=numbers(heights, "heights"),
        distances=numbers(distances, "distances"), fovs=numbers(fov, "fov"), clearance=clearance,
        target_height=target_height, sun=sun, apart=apart, pieces=pieces, jobs=jobs, progress=told,
    )  # fmt: skip
    if not found.views:
        raise UsageError(
            f"None of the {found.cameras} cameras sees anything of the target.",
            remedy="Allow steeper `pitches`, or other `distances`.",
        )
    if len(found) < k:
        told.warn(f"Only {len(found)} of {k} views: no other camera is {apart:g}° apart from these and sees any of it.")
    return found


def sides_of(azimuths: int | str | Sequence[float]) -> int | tuple[float, ...]:
    """A number of sides, or their directions in degrees.

    Raises:
        UsageError: it is a text (whether "72" is a number of sides or a direction is not clear) or something else.
    """
    if isinstance(azimuths, str):
        raise UsageError(f"`azimuths` must be a whole number, or directions in degrees, not {azimuths!r}.")
    return operator.index(azimuths) if hasattr(azimuths, "__index__") else numbers(azimuths, "azimuths")


def check_best_view(k: int, target_height: float, apart: float, pieces: int) -> None:
    """Raise UsageError for numbers out of their range."""
    if k < 1 or pieces < 1:
        raise UsageError(f"`k` and `pieces` are whole numbers, at least 1, not {k} and {pieces}.")
    if not 0 <= target_height < float("inf"):
        raise UsageError(f"`target_height` is metres above the ground, 0 or more, not {target_height!r}.")
    if not 0 <= apart <= 180:
        raise UsageError(f"`apart` must be an angle of 0 to 180 degrees, not {apart!r}.")
