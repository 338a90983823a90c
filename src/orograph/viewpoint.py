"""The camera: ``View``, its axes, matrices and frustum, and the rays through its pixels; all in float64.

A view lives in the terrain's projected CRS: x = easting, y = northing, z = height, in metres. Pixel (0, 0) is the upper
left one and its centre lies at (0.5, 0.5). View-space depth is the distance along the viewing direction; ray directions
have unit forward component, so the ray parameter *is* the depth.

A *tile* of a view (``tile``) is a rectangle of its pixels as a view of its own, with an off-axis frustum: pixel (0, 0)
of the tile is pixel (left, top) of the whole. Pictures too large for memory or the graphics card are drawn tile by
tile.

Exaggeration stretches heights on the way to the screen only. The eye and the target are true places and are stretched
with the ground: the picture does not depend on the zero of heights, and an eye above the ground stays above it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._named import named
from orograph.cards import card
from orograph.documents import load_object, naming, write
from orograph.errors import UsageError
from orograph.geo.chart import AffineChart, Chart
from orograph.geo.grid import Grid
from orograph.geo.vectors import Vector, camera_axes, dot

Array = NDArray[np.float64]
Point = tuple[float, float, float]

NUMBERS: dict[str, tuple[type[int] | type[float], int]] = {
    **dict.fromkeys(("eye", "target", "up"), (float, 3)), **dict.fromkeys(("fov_y", "near", "far"), (float, 1)),
    **dict.fromkeys(("width", "height"), (int, 1)), "part": (int, 4),
}  # fmt: skip
"""What the numbers of a VIEW.json are, and how many of each."""


class RayBasis(NamedTuple):
    """The rays through the pixels of a picture: the origin is o0 + px·ou + py·ov, the direction d0 + px·du + py·dv.

    All (3,); (px, py) are pixel *positions*: (0.5, 0.5) is the centre of the first pixel. In perspective ou and ov are
    zero, in a plan du and dv are.
    """

    o0: Array
    ou: Array
    ov: Array
    d0: Array
    du: Array
    dv: Array


@named("A view")
@dataclass(frozen=True, slots=True, repr=False)
class View:
    """A camera.

    Attributes:
        eye, target: (easting, northing, height) in metres, in the terrain's CRS.
        up: the direction that is up in the picture; north replaces it if it is parallel to the view.
        fov_y: vertical field of view, degrees in (0, 180).
        width, height: pixels.
        near, far: the range of visible depths, metres.
        projection: "perspective", or "plan": straight down onto the target, parallel rays; the picture is as high as
            ``fov_y`` spans at the eye's distance from the target, and ``up`` (or the viewing direction) turns it.
        part: None, or for a tile (left, top, width, height): its first pixel in the whole picture, and the whole
            picture's size. ``fov_y`` is the whole picture's; ``width`` and ``height`` are the tile's.
    """

    eye: Point
    target: Point
    up: Point = (0.0, 0.0, 1.0)
    fov_y: float = 40.0
    width: int = 1280
    height: int = 720
    near: float = 0.0
    far: float = math.inf
    projection: Literal["perspective", "plan"] = "perspective"
    part: tuple[int, int, int, int] | None = None

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            value = tuple(float(v) for v in getattr(self, name))
            if len(value) != 3 or not all(map(math.isfinite, value)):
                raise UsageError(f"The view's {name} must be three finite numbers, not {value}.")
            object.__setattr__(self, name, value)
        if self.up == (0.0, 0.0, 0.0):
            raise UsageError("The view's up has no direction: all three numbers are 0.")
        if self.eye == self.target:
            raise UsageError("The view's eye and target are the same point, so it has no direction.")
        if not 0 < self.fov_y < 180:
            raise UsageError(f"fov_y must be an angle between 0 and 180 degrees, not {self.fov_y}.")
        if self.width < 1 or self.height < 1 or self.width != int(self.width) or self.height != int(self.height):
            raise UsageError(
                f"A picture needs whole numbers of pixels, at least 1 × 1, not {self.width} × {self.height}."
            )
        if not 0 <= self.near < self.far:
            raise UsageError(f"near ({self.near}) must not be negative and must be less than far ({self.far}).")
        if self.projection not in ("perspective", "plan"):
            raise UsageError(f"projection must be 'perspective' or 'plan', not {self.projection!r}.")
        if self.part is not None:
            left, top, width, height = self.part
            if left < 0 or top < 0 or left + self.width > width or top + self.height > height:
                raise UsageError(f"The tile of {self.width} × {self.height} pixels at ({left}, {top}) is not inside "
                                 f"the picture of {width} × {height}.")  # fmt: skip

    def __repr__(self) -> str:
        told = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("eye", "target"):
            told[name] = tuple(round(float(v), 3) for v in told[name])
        said = [f"{f.name}={told[f.name]!r}" for f in fields(self)
                if f.name in ("eye", "target", "width", "height") or told[f.name] != f.default]  # fmt: skip
        return f"View({', '.join(said)})"

    def _repr_html_(self) -> str:
        places = [(name, ", ".join(f"{v:,.1f}" for v in getattr(self, name))) for name in ("eye", "target")]
        told = [("pixels", f"{self.width} × {self.height}"), *places, ("distance", f"{self.distance:,.0f} m"),
                ("field of view", f"{self.fov_y:g}°")]  # fmt: skip
        return card(self.projection, "View", told)

    # ---- reading and writing -------------------------------------------------------------------------------------

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], *, crs: Any = None) -> Self:
        """A view from VIEW.json's keys.

        Args:
            values: eye, target; optionally up, fov_y, width, height, near, far, projection, and ``crs``: the CRS of eye
                and target where it is not the terrain's, e.g. "EPSG:4326" for (longitude, latitude, height).
            crs: the terrain's CRS (pyproj); needed if ``values`` names another one.

        Raises:
            UsageError: a key is missing, unknown or of the wrong kind, or the CRS cannot be used.
        """
        known = {f.name for f in fields(cls)}
        unknown = set(values) - known - {"crs"}
        if unknown:
            raise UsageError(
                f"A view has no key {sorted(unknown)[0]!r}; its keys are {', '.join(sorted(known))} and crs."
            )
        given: dict[str, Any] = {k: v for k, v in values.items() if k in known and v is not None}
        for name in ("eye", "target"):
            if name not in given:
                raise UsageError(f"The view lacks {name!r}: three numbers.")
        for name in given.keys() & NUMBERS.keys():
            given[name] = _numbers(name, given[name])
        if values.get("crs") is not None:
            from orograph.geo.transform import transformer

            move = transformer(values["crs"], crs)
            for name in ("eye", "target"):
                x, y = (float(v) for v in move(given[name][0], given[name][1]))
                if not (math.isfinite(x) and math.isfinite(y)):
                    raise UsageError(
                        f"The view's {name}, {values[name]!r} in {values['crs']}, cannot be transformed to the "
                        "terrain's CRS."
                    )
                given[name] = (x, y, given[name][2])
        return cls(**given)

    @classmethod
    def load(cls, path: str | Path, *, crs: Any = None) -> Self:
        """Read a VIEW.json.

        Raises:
            ReadError: the file cannot be read, or is no JSON object. UsageError: as ``from_dict``, naming the file.
        """
        values = load_object(path, "view", "eye, target, fov_y, width and height")
        with naming(path):
            return cls.from_dict(values, crs=crs)

    def save(self, path: str | Path) -> None:
        """Write a VIEW.json; OutputError: it cannot be written."""
        write(self.to_dict(), path)

    def to_dict(self) -> dict[str, Any]:
        """The inverse of ``from_dict``; an unlimited ``far`` is left out (JSON has no infinity)."""
        values = asdict(self)
        if math.isinf(self.far):
            del values["far"]
        if self.part is None:
            del values["part"]
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def resized(self, width: int, height: int) -> Self:
        """The same view (the whole, of a tile) in a picture of another size."""
        return replace(self, width=width, height=height, part=None)

    def tile(self, left: int, top: int, width: int, height: int) -> Self:
        """The pixels [left, left + width) × [top, top + height) of this view, as a view.

        Raises:
            UsageError: they are not all inside the picture.
        """
        x, y, *size = self.frame
        return replace(self, width=width, height=height, part=(x + left, y + top, size[0], size[1]))

    @property
    def frame(self) -> tuple[int, int, int, int]:
        """(left, top, width, height): the first pixel in the whole picture, and that picture's size."""
        return self.part or (0, 0, self.width, self.height)

    @property
    def whole(self) -> Self:
        """The view that this is a tile of; itself if it is not a tile."""
        return self if self.part is None else self.resized(*self.part[2:])

    # ---- geometry ------------------------------------------------------------------------------------------------

    def axes(self, exaggeration: float = 1.0) -> tuple[Array, Array, Array]:
        """Unit vectors (right, up, forward) of the camera, in stretched space."""
        right, up, forward = self.plain_axes(exaggeration)
        return np.array(right), np.array(up), np.array(forward)

    def plain_axes(self, exaggeration: float = 1.0) -> tuple[Vector, Vector, Vector]:
        """``axes`` as plain numbers, five times as fast as NumPy for so few: cameras move at every frame."""
        return camera_axes(self.eye, self.target, self.up, self.projection == "plan", exaggeration)

    @property
    def distance(self) -> float:
        """From the eye to the target, metres."""
        return math.dist(self.target, self.eye)

    @property
    def pixel_slope(self) -> float:
        """The height of a pixel at the picture's centre, at unit depth (perspective)."""
        return 2.0 * math.tan(math.radians(self.fov_y) / 2.0) / self.frame[3]

    @property
    def pixel_metres(self) -> float:
        """The size of a pixel at the target, metres (in a plan: everywhere)."""
        return self.pixel_slope * self.distance

    def view_matrix(self, exaggeration: float = 1.0) -> Array:
        """World (stretched) → camera, (4, 4): x right, y up, z *towards* the eye (right-handed, as OpenGL has it)."""
        right, up, forward = self.axes(exaggeration)
        eye = np.array(self.eye) * [1.0, 1.0, exaggeration]
        if self.projection == "plan":  # seen from straight above the target
            eye[:2] = self.target[:2]
        matrix = np.eye(4)
        for row, axis in enumerate((right, up, -forward)):
            matrix[row, :3] = axis
            matrix[row, 3] = -axis @ eye
        return matrix

    def projection_matrix(self) -> Array:
        """Camera → clip space, (4, 4), reversed depth: 1 at ``near`` (or 1 m, if that is 0), 0 at ``far``."""
        near = self.near or 1.0
        left, top, width, height = self.frame
        # The middle of the whole picture as seen from the tile's, in half tiles: 0 unless this is a tile.
        aside, above = (width / 2 - left) * 2 / self.width - 1, 1 - (height / 2 - top) * 2 / self.height
        matrix = np.zeros((4, 4))
        if self.projection == "plan":
            far = self.far if math.isfinite(self.far) else 1e7
            matrix[0, 0], matrix[0, 3] = 2 / (self.pixel_metres * self.width), aside
            matrix[1, 1], matrix[1, 3] = 2 / (self.pixel_metres * self.height), above
            matrix[2, 2], matrix[2, 3], matrix[3, 3] = 1 / (far - near), far / (far - near), 1.0
            return matrix
        matrix[0, 0], matrix[0, 2] = 2 / (self.pixel_slope * self.width), -aside
        matrix[1, 1], matrix[1, 2] = 2 / (self.pixel_slope * self.height), -above
        matrix[3, 2] = -1.0
        if math.isfinite(self.far):
            matrix[2, 2], matrix[2, 3] = near / (self.far - near), self.far * near / (self.far - near)
        else:
            matrix[2, 3] = near
        return matrix

    def frustum(self, exaggeration: float = 1.0) -> Array:
        """The planes (n, 4) that bound the visible space: a·x + b·y + c·z + d ≥ 0 inside, unit normals, stretched
        space.

        Left, right, bottom, top, near, and far if it is finite.
        """
        right, up, forward = self.plain_axes(exaggeration)
        eye = self.eye[0], self.eye[1], self.eye[2] * exaggeration
        left, top, width, height = self.frame
        plan = self.projection == "plan"
        pixel = self.pixel_metres if plan else self.pixel_slope
        sides = (
            (right, 1.0, left - width / 2), (right, -1.0, width / 2 - left - self.width),
            (up, 1.0, height / 2 - top - self.height), (up, -1.0, top - height / 2),
        )  # fmt: skip
        planes = []
        for axis, sign, pixels in sides:  # at least this many pixels along the axis from the middle
            least = pixels * pixel
            if plan:
                normal = sign * axis[0], sign * axis[1], sign * axis[2]
                middle = self.target[0], self.target[1], self.target[2] * exaggeration
                planes.append((*normal, -dot(normal, middle) - least))
            else:
                size = math.hypot(1.0, least)
                across, along = sign / size, -least / size
                normal = (
                    across * axis[0] + along * forward[0], across * axis[1] + along * forward[1],
                    across * axis[2] + along * forward[2],
                )  # fmt: skip
                planes.append((*normal, -dot(normal, eye)))
        ahead = dot(forward, eye)
        planes.append((*forward, -ahead - self.near))
        if math.isfinite(self.far):
            planes.append((-forward[0], -forward[1], -forward[2], ahead + self.far))
        return np.array(planes)

    def project(self, points: ArrayLike, exaggeration: float = 1.0) -> tuple[Array, Array]:
        """Pixel positions (…, 2) and depths (…) of true positions (…, 3); NaN for points at or behind the eye."""
        right, up, forward = self.axes(exaggeration)
        stretch = np.array([1.0, 1.0, exaggeration])
        delta = (np.asarray(points, np.float64) - np.array(self.eye)) * stretch
        depth = delta @ forward
        if self.projection == "plan":
            delta = (np.asarray(points, np.float64) - np.array(self.target)) * stretch
            scale: Any = self.pixel_metres
        else:
            scale = np.where(depth > 0, depth, np.nan) * self.pixel_slope
        left, top, width, height = self.frame
        x = delta @ right / scale + (width / 2 - left)
        y = (height / 2 - top) - delta @ up / scale
        return np.stack([x, y], -1), depth

    def ray_basis(self, exaggeration: float = 1.0) -> RayBasis:
        """The rays through pixel positions, in true space. Directions have unit forward component."""
        right, up, forward = self.axes(exaggeration)
        unstretch = np.array([1.0, 1.0, 1.0 / exaggeration])
        zero = np.zeros(3)
        left, top, width, height = self.frame
        across, down = width / 2 - left, height / 2 - top
        if self.projection == "plan":
            m = self.pixel_metres
            centre = np.array([self.target[0], self.target[1], self.eye[2]])
            ou, ov = right * m, -up * m
            return RayBasis(centre - ou * across - ov * down, ou, ov, forward * unstretch, zero, zero)
        s = self.pixel_slope
        du, dv = right * s * unstretch, -up * s * unstretch
        d0 = forward * unstretch - du * across - dv * down
        return RayBasis(np.array(self.eye), zero, zero, d0, du, dv)


def _numbers(name: str, value: Any) -> Any:
    """A value of a VIEW.json as the numbers that it must be."""
    kind, count = NUMBERS[name]
    try:
        found = tuple(float(v) for v in (value if count > 1 else (value,)))
        if len(found) != count or (kind is int and any(v % 1 for v in found)):
            raise ValueError(name)
        numbers = tuple(kind(v) for v in found)
    except (TypeError, ValueError, OverflowError) as error:
        wanted = {1: "a number", 3: "three numbers", 4: "four whole numbers"}[count]
        raise UsageError(
            f"The view's {name} is not {'a whole number' if kind is int and count == 1 else wanted}: {value!r}."
        ) from error
    return numbers if count > 1 else numbers[0]


@dataclass(frozen=True, slots=True)
class Camera:
    """A view of a terrain: what methods select for and surfaces are drawn with.

    Attributes:
        view: where from.
        chart: how the terrain's samples lie in the view's world.
        exaggeration: heights are stretched by this on the way to the screen.

    Raises:
        UsageError: the exaggeration is not a positive number.
    """

    view: View
    chart: Chart
    exaggeration: float = 1.0

    def __post_init__(self) -> None:
        factor: Any = self.exaggeration
        if not (isinstance(factor, Real) and 0 < float(factor) < math.inf):
            raise UsageError(f"The exaggeration must be greater than 0, not {factor!r}.")

    @classmethod
    def over(cls, grid: Grid, view: View, exaggeration: float = 1.0) -> Self:
        """The camera for a view of flat terrain."""
        return cls(view, AffineChart(grid), exaggeration)

    @property
    def affine(self) -> AffineChart:
        """The chart, for code that draws flat terrain only.

        Raises:
            UsageError: it is curved.
        """
        if not isinstance(self.chart, AffineChart):
            raise UsageError("This method draws flat terrain only.")
        return self.chart
