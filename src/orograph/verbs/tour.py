"""``orograph.tour``: make a tour of a terrain from a short description (``touring.make``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from orograph._named import answering
from orograph.folders import Amount, bytes_of
from orograph.progress import Progress
from orograph.scene.bearings import Bearing
from orograph.scene.sizes import Size, size_of
from orograph.several import Numbers
from orograph.store.opening import terrain as opened
from orograph.verbs.ways import parsed_path, settle_tour, tour_of

if TYPE_CHECKING:
    from orograph.touring.tour import Tour


@answering
def tour(
    terrain: Any,
    *,
    size: Size = (1280, 720),
    orbit: bool = False,
    turntable: bool = False,
    still: bool = False,
    plan: bool = False,
    line: Any = None,
    points: Sequence[Sequence[float] | str] = (),
    around: Numbers | None = None,
    azimuth: Bearing | None = None,
    pitch: float | None = None,
    distance: float | None = None,
    fov: float | None = None,
    seconds: float | None = None,
    height: float | None = None,
    speed: float | None = None,
    line_crs: Any = None,
    exaggeration: float = 1.0,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Tour:
    """Make a tour of a terrain: key frames for ``orograph.movie``, to use as they are or to edit.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        size: (width, height) of the pictures.
        orbit: once around the terrain, all of it in view (the default). turntable: the same with the light turning too.
            still: the camera stays, all of the terrain in view, for data that change or a sun that moves. plan: the
            same straight down, as a map.
        line: a GPX or GeoJSON file: fly along its longest line; GeoJSON as an object; or
            places, as ``points``.
        points: (longitude, latitude): fly over them.
        line_crs: the CRS of the line or the points; None: EPSG:4326.
        around: (longitude, latitude[, radius]): orbit this place rather than the terrain, with a radius in metres of
            ground around it in view; by default a quarter of the terrain's shorter side.
        azimuth: the side from which an orbit begins, degrees clockwise from north or "NE"; None: 180. pitch: how far it
            looks down; None: 35. distance: metres from the terrain's middle, or from the place in ``around``; None:
            such that all of it is in view.
        fov: the vertical field of view, degrees; None: 30, along a line 45.
        seconds: how long it takes. height: metres above the ground, along a line. speed: metres per second, along a
        line.
        exaggeration: how heights will be stretched.
        max_memory: bytes that heights may take. jobs: threads. progress: gets progress reports; False: silent.

    Raises:
        UsageError: options contradict each other. ReadError: the line cannot be read.
    """
    max_memory, size = bytes_of(max_memory), size_of(size)
    options = parsed_path({
        "orbit": orbit, "turntable": turntable, "still": still, "plan": plan,
        "line": line, "points": points, "around": around,
        "azimuth": azimuth, "pitch": pitch, "distance": distance, "fov": fov, "seconds": seconds,
        "height": height, "speed": speed,
        "line_crs": line_crs,
    })  # fmt: skip
    settle_tour(options)
    ground = opened(terrain, progress, max_memory=max_memory, jobs=jobs, called="tour", **reading)
    return tour_of(ground, size, options, (315.0, 45.0), exaggeration)
