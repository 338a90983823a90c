"""Cameras for a terrain from simple descriptions (from the south-west, at this place, all of it).

Framing is exact: for a given direction the position that sees every given point with the least distance has a closed
form, since each side of the frustum bounds the eye by one half-space (see ``fit``). If that leaves room in one
direction, the points are centred in it.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orograph._named import answering
from orograph.errors import NothingInViewError, UsageError, absent
from orograph.geo.beyond import beyond
from orograph.geo.transform import far_outside, place
from orograph.scene.bearings import Bearing, bearing
from orograph.scene.parts import check_exaggeration
from orograph.scene.sizes import Size, size_of
from orograph.store.opening import takes_terrain
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]

PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
"""File endings of pictures, which are not views."""
MARGIN = 0.93
"""The part of the picture's half-width and half-height that the fitted terrain may fill."""

Insets = tuple[float, float, float, float]
"""Parts of the picture's width (left, right) and height (top, bottom) to leave free, each below 0.5."""

NO_INSETS: Insets = (0.0, 0.0, 0.0, 0.0)


SIZE = (1280, 720)
"""Default size of a picture, pixels."""


def _reach(insets: Insets) -> Insets:
    """How far from the picture's middle the terrain may reach to the left, right, top and bottom; the border is 1."""
    if not all(0 <= part < 0.5 for part in insets):
        raise UsageError(f"Insets must be parts of the picture from 0 to below one half, not {insets}.")
    left, right, top, bottom = (min(MARGIN, 1 - 2 * part) for part in insets)
    return left, right, top, bottom


@takes_terrain
def outline(terrain: Terrain) -> Array:
    """Positions (n, 3) in the terrain's CRS, float64 metres, around which all valid ground lies.

    They are the samples of the coarsest level, raised and lowered by that level's error, and the corners of blocks
    whose sample is missing although there is valid ground between the samples.

    Raises:
        NothingInViewError: no sample is valid.
    """
    level = terrain.levels - 1
    table = terrain.tiles(level)
    rows, cols = terrain.shape(level)
    heights = terrain.read(level, 0, rows, 0, cols).astype(np.float64)
    if not np.isfinite(table.maximum).any():
        raise NothingInViewError(
            "None of the samples is valid, so there is nothing to draw.",
            path=terrain.name,
            remedy="Check what the file holds with orograph info; a wrong `nodata` or `band` hides everything.",
        )
    r, c = np.nonzero(np.isfinite(heights))
    tile = np.minimum(r // TILE, table.error.shape[0] - 1), np.minimum(c // TILE, table.error.shape[1] - 1)
    z, error = heights[r, c], np.nan_to_num(table.error[tile].astype(np.float64))
    up, down = np.fmin(z + error, table.maximum[tile]), np.fmax(z - error, table.minimum[tile])
    scale = 2**level
    col, row, height = [c * scale, c * scale], [r * scale, r * scale], [np.maximum(up, z), np.minimum(down, z)]
    if level:
        means = terrain.read_mean(level, 0, terrain.mean_shape(level)[0], 0, terrain.mean_shape(level)[1])
        i, j = np.nonzero(np.isfinite(means) & np.isnan(heights[: means.shape[0], : means.shape[1]]))
        for di, dj in ((0, 0), (0, 1), (1, 0), (1, 1)):
            col.append((j + dj) * scale - dj)
            row.append((i + di) * scale - di)
            height.append(means[i, j].astype(np.float64))
    x, y = terrain.grid.xy(
        np.minimum(np.concatenate(col), terrain.grid.cols - 1), np.minimum(np.concatenate(row), terrain.grid.rows - 1)
    )
    return np.stack([x, y, np.concatenate(height)], 1)


@answering
def direction(azimuth: float, pitch: float) -> Array:
    """The unit viewing direction (3,) of an eye at ``azimuth`` from its target and ``pitch`` above it.

    Both in degrees; azimuth is clockwise from north.
    """
    a, p = math.radians(azimuth), math.radians(pitch)
    return np.array([-math.sin(a) * math.cos(p), -math.cos(a) * math.cos(p), -math.sin(p)])


NEAREST = 1e-3
"""How near the eye may come to its target, relative to the target's size."""


@answering
def fit(
    points: Array,
    forward: Array,
    fov_y: float,
    size: tuple[int, int],
    exaggeration: float = 1.0,
    insets: Insets = NO_INSETS,
    heading: float = 0.0,
) -> View:
    """The perspective view along ``forward`` that shows all ``points`` (n, 3) from as near as possible, centred.

    In camera axes (right a, up b, forward c) a point lies within the left and right sides seen from eye e if −l·(c −
    e_c) ≤ a − e_a ≤ r·(c − e_c), with the tangents l, r of how far each side reaches: two half-spaces in (e_a, e_c),
    whose nearest common point is the eye; likewise up and down. One direction leaves room at the depth that the other
    demands: there the points are centred on the screen. That is not the middle of the possible eye positions, since
    near points look larger.

    Args:
        forward: the viewing direction (3,), as it looks in the picture. size: (width, height), pixels.
        insets: parts of the picture to leave free. heading: for a view straight down, the direction that is up in the
            picture, degrees clockwise from north.

    Raises:
        UsageError: the exaggeration is not greater than 0, or an inset is not in [0, 0.5).
    """
    check_exaggeration(exaggeration)
    width, height = size
    stretch = np.array([1.0, 1.0, exaggeration])
    drawn = points * stretch
    forward = forward / np.linalg.norm(forward)
    skyward = _skyward(forward, heading)
    right = np.cross(forward, skyward)
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    a, b, c = drawn @ right, drawn @ up, drawn @ forward
    ty = math.tan(math.radians(fov_y) / 2)
    tx = ty * width / height
    left, right_side, top, bottom = _reach(insets)
    bounds = []
    depth = []
    for across, less, more in ((a, left * tx, right_side * tx), (b, bottom * ty, top * ty)):
        # e_a − more·e_c is at least ``least``; e_a + less·e_c is at most ``most``.
        least, most = (across - more * c).max(), (across + less * c).min()
        bounds.append((least, most, less, more))
        depth.append((most - least) / (less + more))
    back = min(depth)
    span = max(float(np.ptp(a)), float(np.ptp(b)), float(np.ptp(c)), 1.0)
    back = min(back, float(c.min()) - NEAREST * span)
    eye = [
        _centred(across, c - back, least + more * back, most - less * back, more - less)
        for across, (least, most, less, more) in zip((a, b), bounds)
    ]
    position = right * eye[0] + up * eye[1] + forward * back
    target = position + forward * (float((c.min() + c.max()) / 2) - back)
    return View(
        tuple(position / stretch),
        tuple(target / stretch),
        tuple(skyward),
        fov_y,
        width,
        height,
    )


def _skyward(forward: Array, heading: float) -> Array:
    """The up direction (3,) of a picture: the zenith; when looking along it, the direction of a heading (degrees)."""
    if np.hypot(forward[0], forward[1]) >= 1e-9 * np.linalg.norm(forward):
        return np.array([0.0, 0.0, 1.0])
    return direction(heading + 180.0, 0.0)


def _centred(across: Array, depth: Array, low: float, high: float, aside: float) -> float:
    """The eye position between ``low`` and ``high`` at which the points' largest and smallest tangent sum to ``aside``.

    Args:
        across, depth: (n,) distances of the points from the axis and from the eye, metres; the tangents are (across -
            eye) / depth, so each is linear in the eye and their sum falls piecewise linearly.
    """
    eye = (low + high) / 2
    for _ in range(60):
        tangent = (across - eye) / depth
        i, j = int(tangent.argmax()), int(tangent.argmin())
        off = tangent[i] + tangent[j] - aside
        low, high = (eye, high) if off > 0 else (low, eye)
        there = eye + off / (1 / depth[i] + 1 / depth[j])  # exact if the same two points decide there
        if abs(there - eye) <= 1e-12 * (high - low) or high - low <= 1e-12 * float(np.ptp(across) + abs(eye)):
            break
        eye = there if low < there < high else (low + high) / 2
    return float(eye)


def view_of(
    given: View | str | os.PathLike[str] | None, terrain: Terrain, size: Size = SIZE, *,
    exaggeration: float = 1.0, insets: Insets = NO_INSETS,
) -> View:  # fmt: skip
    """The camera that a user gives: a ``View``, "plan", the path of a VIEW.json; None: ``whole``.

    Raises:
        UsageError: it is none of these, or the size is not (width, height). ReadError: the file cannot be read.
    """
    size = size_of(size)
    if given is None or (isinstance(given, str) and given == "perspective"):
        return whole(terrain, size, exaggeration=exaggeration, insets=insets)
    if isinstance(given, View):
        return given
    if isinstance(given, str) and given == "plan":
        return plan(terrain, size, insets=insets)
    if isinstance(given, str) and not given.lower().endswith(".json") and not Path(given).exists():
        remedy = 'A view is "plan" (a map), "perspective", the path of a VIEW.json, or made by orograph.camera.'
        if Path(given).suffix.lower() in PICTURES:
            remedy = f"Save pictures through the result: `picture.save({given!r})`. {remedy}"
        raise UsageError(f"There is no view {given!r}.", remedy=remedy)
    if isinstance(given, str | os.PathLike):
        return View.load(os.fspath(given), crs=terrain.grid.crs)
    raise UsageError(
        f"A view must be an orograph.View, 'plan', or the path of a VIEW.json, not {given!r}.",
        remedy="orograph.camera makes them.",
    )


@takes_terrain
def whole(
    terrain: Terrain,
    size: Size = SIZE,
    *,
    azimuth: Bearing = 180.0,
    pitch: float = 42.0,
    fov_y: float = 30.0,
    exaggeration: float = 1.0,
    insets: Insets = NO_INSETS,
    also: Array | None = None,
) -> View:
    """A view that shows the whole terrain well: obliquely from the south, with a long lens.

    Args:
        azimuth: the side from which it is seen: degrees clockwise from north, or a point of the compass ("NE").
        insets: parts of the picture to leave free, such as ``furniture.insets``.
        also: (n, 3) further positions to show, as ``outline`` (``rendering.standing.extent``).
    """
    azimuth = bearing(azimuth)
    points = joined(outline(terrain), also)
    return fit(points, direction(azimuth, pitch), fov_y, size_of(size), exaggeration, insets, azimuth + 180.0)


def joined(points: Array, also: Array | None) -> Array:
    """All positions (n, 3) of both."""
    return points if also is None else np.concatenate([points, also])


@takes_terrain
def around(
    terrain: Terrain,
    size: Size = SIZE,
    *,
    azimuth: Bearing = 180.0,
    pitch: float = 42.0,
    distance: float | None = None,
    fov_y: float = 30.0,
    exaggeration: float = 1.0,
    insets: Insets = NO_INSETS,
    also: Array | None = None,
) -> View:
    """A view from ``azimuth`` and ``pitch`` at ``distance`` from the terrain's middle (None: all of it in the picture).

    Pitch (degrees) and distance (metres) refer to the stretched ground of the picture. ``insets`` are parts of the
    picture to leave free if no distance is given, ``also`` further positions to show then, as for ``whole``.

    Raises:
        UsageError: a number is out of its range. NothingInViewError: no sample is valid.
    """
    azimuth = bearing(azimuth)
    check_around(azimuth, pitch, distance, exaggeration)
    size = size_of(size)
    if distance is None:
        return whole(terrain, size, azimuth=azimuth, pitch=pitch, fov_y=fov_y, exaggeration=exaggeration,
                     insets=insets, also=also)  # fmt: skip
    points = outline(terrain)
    middle = (points[:, :2].min(0) + points[:, :2].max(0)) / 2
    target = np.array([*middle, ground(terrain, middle[0], middle[1], default=float(np.median(points[:, 2])))])
    forward = direction(azimuth, pitch)
    eye = target - forward * distance / np.array([1.0, 1.0, exaggeration])
    return View(tuple(eye), tuple(target), tuple(_skyward(forward, azimuth + 180.0)), fov_y, size[0], size[1])


def check_around(azimuth: float, pitch: float, distance: float | None, exaggeration: float) -> None:
    """Raise UsageError if a number of ``around`` is out of range."""
    if not math.isfinite(azimuth):
        raise UsageError(f"`azimuth` is a direction in degrees clockwise from north, not {azimuth:g}.")
    if not -90 <= pitch <= 90:
        raise UsageError(f"`pitch`, the angle of looking down, must be −90 to 90 degrees, not {pitch:g}.")
    check_exaggeration(exaggeration)
    if distance is not None and not 0 < distance < math.inf:
        raise UsageError(f"`distance` must be more than 0 metres, not {distance:g}.")


@takes_terrain
def standing(
    terrain: Terrain,
    size: Size,
    eye: tuple[float, float, float],
    look_at: tuple[float, float] | None,
    *,
    fov_y: float = 45.0,
) -> View:
    """A view from (longitude, latitude, height) towards the ground at (longitude, latitude), or the terrain's middle.

    Args:
        size: (width, height) in pixels.
        eye: degrees of longitude and latitude (WGS 84), metres above the zero of the heights.
        look_at: degrees of longitude and latitude; None: the terrain's middle.
        fov_y: vertical field of view, degrees.

    Raises:
        UsageError: the terrain has no CRS, a place cannot be transformed to it, its two numbers seem to be swapped, or
            the target lies outside the terrain by more than the terrain's width or height.
    """
    size = size_of(size)
    x, y = place(terrain.grid, eye[0], eye[1])
    points = outline(terrain)
    if look_at is None:
        tx, ty = (points[:, :2].min(0) + points[:, :2].max(0)) / 2
    else:
        tx, ty = place(terrain.grid, *look_at)
        if far_outside(terrain.grid, tx, ty):
            raise UsageError(
                f"There is no ground to look at near longitude {look_at[0]:g}, latitude {look_at[1]:g}: it lies "
                f"{beyond(terrain.grid, tx, ty)}.", path=terrain.name,
                remedy="Longitude comes first, then latitude; orograph info shows where the terrain lies.",
            )  # fmt: skip
    z = ground(terrain, tx, ty, default=float(np.median(points[:, 2])))
    return View((x, y, eye[2]), (tx, ty, z), fov_y=fov_y, width=size[0], height=size[1])


@takes_terrain
def plan(
    terrain: Terrain, size: Size = SIZE, *, azimuth: Bearing = 180.0, insets: Insets = NO_INSETS,
    also: Array | None = None,
) -> View:  # fmt: skip
    """The map view: straight down, the whole terrain, its outline filling the picture to the margin or the insets.

    Args:
        azimuth: the side at the bottom of the picture, as for ``whole``; 180 has north up.
        also: further positions to show, as for ``whole``.

    Raises:
        UsageError: the azimuth is not an angle, or an inset is not in [0, 0.5). NothingInViewError: no sample is valid.
    """
    azimuth = bearing(azimuth)
    if not math.isfinite(azimuth):
        raise UsageError(f"`azimuth` is a direction in degrees clockwise from north, not {azimuth:g}.")
    size = size_of(size)
    points = joined(outline(terrain), also)
    up = direction(azimuth, 0.0)
    right = np.array([up[1], -up[0], 0.0])
    across, along = points @ right, points @ up
    left, right_side, top, bottom = _reach(insets)
    wide, tall = size[0] * (left + right_side) / 2, size[1] * (top + bottom) / 2
    metres = max(np.ptp(across) / wide, np.ptp(along) / tall, 1e-6) * size[1]
    # The terrain's middle goes to the middle of the free area.
    aside = metres / 2 * size[0] / size[1] * (right_side - left) / 2
    above = metres / 2 * (top - bottom) / 2
    middle = right * ((across.min() + across.max()) / 2 - aside) + up * ((along.min() + along.max()) / 2 - above)
    x, y, _ = middle
    fov_y = 30.0
    distance = metres / 2 / math.tan(math.radians(fov_y) / 2)
    # The eye is above the highest summit; its height above the target gives pixels the wanted size.
    eye = terrain.height_range[1] + max(10.0, 0.1 * distance)
    return View((x, y, eye), (x, y, eye - distance), tuple(up), fov_y, size[0], size[1], projection="plan")


def ground(terrain: Terrain, x: float, y: float, default: float) -> float:
    """Height of the full-resolution surface at a place in the terrain's CRS; ``default`` outside it or in a hole."""
    col, row = (float(v) for v in terrain.grid.index(x, y))
    rows, cols = terrain.grid.shape
    if not (0 <= col <= cols - 1 and 0 <= row <= rows - 1):
        return default
    c, r = min(int(col), max(cols - 2, 0)), min(int(row), max(rows - 2, 0))
    # An even corner preserves the parity of the diagonals in the small window.
    c0, r0 = c & ~1, r & ~1
    patch = terrain.read(0, r0, min(r0 + 3, rows), c0, min(c0 + 3, cols))
    from orograph.raycast.caster import Caster

    if min(patch.shape) < 2:
        return default
    height = Caster.of(np.ascontiguousarray(patch), 1).surface(col - c0, row - r0)
    return height if math.isfinite(height) else default


if not TYPE_CHECKING:  # (type checkers look for names themselves)

    def __getattr__(name: str) -> object:
        raise absent("orograph.camera", name, ("whole", "around", "standing", "plan"))
