"""Key frames: the camera at a moment of a tour, the light, and the exaggeration.

A key gives the camera in one of three ways, in the terrain's CRS or, with ``crs``, in any (see ``View.from_dict``):

- ``eye`` and ``target``, as VIEW.json has them;
- ``target``, ``azimuth``, ``pitch`` and ``distance``: the eye stands at that azimuth of the target (degrees clockwise
  from grid north), looks down by ``pitch`` degrees, from ``distance`` metres;
- ``eye``, ``heading`` and ``pitch`` (optionally ``distance``, to the point about which the camera turns): it looks
  towards the heading, down by ``pitch`` degrees.

Angles are those of the true ground, not of the stretched one. Units: seconds, metres, degrees.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from orograph.documents import number
from orograph.errors import UsageError
from orograph.geovis.layers import Layer, layers_of
from orograph.lighting.sun import Moment, Placed, parse
from orograph.scene.parts import check_exaggeration
from orograph.viewpoint import Point, View

Path = Literal["spline", "orbit", "zoom"]
"""How the camera moves from one key to the next."""

SETTINGS = ("exaggeration", "tolerance", "relief", "water")
"""Numbers of the scene that a key may set, in addition to its sun."""

CAMERA = ("eye", "target", "up", "fov_y", "width", "height", "near", "far", "projection", "crs")
ANGLES = ("azimuth", "heading", "pitch", "distance")
WAY = ("time", "hold", "stop", "path", "turns")
FIELDS = (*WAY, *CAMERA, *ANGLES, "sun", *SETTINGS, "layers")
INHERITED = ("up", "fov_y", "width", "height", "near", "far", "projection", "crs", "path", "sun", *SETTINGS, "layers")
"""Fields that may be given once for all keys."""

ARM = 1000.0
"""Metres from the eye to the target of a key with a heading and no distance."""


@dataclass(frozen=True, slots=True)
class Key:
    """A key frame.

    Attributes:
        view: the camera, in the terrain's CRS.
        time: seconds from the tour's beginning; None: follows from the tour's speed.
        hold: seconds for which the camera stays. stop: whether it comes to rest here, without staying.
        path: how it continues from here: along a smooth curve through the keys ("spline"), about the target
            ("orbit"), or up, across and down as in a zoomable map ("zoom").
        turns: with "orbit": full turns besides the shorter way round, clockwise from above; negative: anticlockwise.
        sun: a direction or a moment; None: as before and after.
        exaggeration, tolerance, relief, water: see ``picture.Scene``; None: as before and after.
        layers: over the ground, bottom to top; a layer that the next key lacks fades. None: as before and after.
    """

    view: View
    time: float | None = None
    hold: float = 0.0
    stop: bool = False
    path: Path = "spline"
    turns: int = 0
    sun: Placed | Moment | None = None
    exaggeration: float | None = None
    tolerance: float | None = None
    relief: float | None = None
    water: float | None = None
    layers: tuple[Layer, ...] | None = None

    def __post_init__(self) -> None:
        if self.time is not None and not 0 <= self.time < math.inf:
            raise UsageError(f'The "time" must be in seconds from the beginning, 0 or more, not {self.time:g}.')
        if not 0 <= self.hold < math.inf:
            raise UsageError(f'The "hold" must be how many seconds the camera stays, 0 or more, not {self.hold:g}.')
        if self.path not in get_args(Path):
            raise UsageError(f'The "path" must be one of {", ".join(get_args(Path))}, not {self.path!r}.')
        if self.turns and self.path != "orbit":
            raise UsageError(f'"turns" apply to an "orbit" only, but the "path" is {self.path!r}.')
        if self.exaggeration is not None:
            check_exaggeration(self.exaggeration)
        for name in ("tolerance", "relief"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise UsageError(f'The "{name}" must be a number, 0 or more, not {value:g}.')

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], *, crs: Any = None) -> Key:
        """A key from its JSON.

        Args:
            values: see the module's text and ``FIELDS``.
            crs: the terrain's CRS.

        Raises:
            UsageError: something is missing, unknown or of the wrong kind; the message names it.
        """
        unknown = set(values) - set(FIELDS)
        if unknown:
            raise UsageError(f"There is no {sorted(unknown)[0]!r} in a key; its entries are {', '.join(FIELDS)}.")
        given = {k: v for k, v in values.items() if v is not None}
        view = View.from_dict(_camera(given, crs), crs=crs)
        more: dict[str, Any] = {}
        for name in ("time", "hold", *SETTINGS):
            if name in given:
                more[name] = number(given[name], f'The "{name}"')
        if "stop" in given:
            if not isinstance(given["stop"], bool):
                raise UsageError(f'"stop" must be true or false, not {given["stop"]!r}.')
            more["stop"] = given["stop"]
        if "turns" in given:
            turns = number(given["turns"], '"turns"')
            if turns != int(turns):
                raise UsageError(f'"turns" must be an integer, not {turns:g}.')
            more["turns"] = int(turns)
        if "path" in given:
            more["path"] = given["path"]
        if "sun" in given:
            more["sun"] = _sun(given["sun"])
        if "layers" in given:
            more["layers"] = _layers(given["layers"])
        return cls(view, **more)

    def to_dict(self) -> dict[str, Any]:
        """The input of ``from_dict``."""
        values: dict[str, Any] = {} if self.time is None else {"time": self.time}
        default = Key(self.view)
        for name in ("hold", "stop", "path", "turns", *SETTINGS):
            if getattr(self, name) != getattr(default, name):
                values[name] = getattr(self, name)
        if isinstance(self.sun, Placed):
            values["sun"] = [self.sun.azimuth, self.sun.altitude]
        elif self.sun is not None:
            values["sun"] = self.sun.when.isoformat()
        if self.layers is not None:
            values["layers"] = [layer.to_dict() for layer in self.layers]
        return {**values, **self.view.to_dict()}


def _layers(value: Any) -> tuple[Layer, ...]:
    """A list of layers, each an object with a path or a text as for ``--drape``."""
    if not isinstance(value, list | tuple):
        raise UsageError(f'The "layers" must be a list of images, bottom to top, not {value!r}.')
    made = []
    for one in value:
        if not isinstance(one, str | Mapping):
            raise UsageError(f'A layer must be a path or an object with a "path", not {one!r}.')
        made.append(Layer.parse(one) if isinstance(one, str) else Layer.from_dict(one))
    return layers_of(made)


def has_camera(values: Mapping[str, Any]) -> bool:
    """Whether a key's JSON gives its camera."""
    return values.get("eye") is not None or values.get("target") is not None


def staying(before: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """A key's JSON with the camera of the key before, in its CRS, except for the camera fields of its own."""
    return {**{k: before[k] for k in (*CAMERA, *ANGLES) if k in before}, **values, "crs": before.get("crs")}


def looking(heading: float, pitch: float) -> Point:
    """The unit vector towards ``heading`` (degrees clockwise from north), down by ``pitch`` degrees."""
    a, p = math.radians(heading), math.radians(pitch)
    return math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), -math.sin(p)


def _camera(given: Mapping[str, Any], crs: Any) -> dict[str, Any]:
    """VIEW.json's keys, from any form of camera."""
    plain = {k: given[k] for k in CAMERA if k in given}
    angles = [name for name in ANGLES if name in given]
    if not angles:
        for name, other in (("eye", "target"), ("target", "eye")):
            if name not in given:
                raise UsageError(
                    f"The camera lacks {name!r}: three numbers.",
                    remedy='Or give "target", "azimuth", "pitch" and "distance", or "eye", "heading" and "pitch".'
                    if other in given
                    else "",
                )
        return plain
    about = "target" in given
    if about == ("eye" in given):
        raise UsageError(f'Beside "{angles[0]}" there is either an "eye" or a "target".')
    wanted = ("azimuth", "pitch", "distance") if about else ("heading", "pitch")
    for name in wanted:
        if name not in given:
            raise UsageError(f'The camera lacks "{name}": with {" and ".join(angles)} there are {", ".join(wanted)}.')
    wrong = "heading" if about else "azimuth"
    if wrong in given:
        raise UsageError(f'"{wrong}" goes with {"an eye" if about else "a target"} only.')
    pitch = number(given["pitch"], 'The "pitch"')
    if not -90 <= pitch <= 90:
        raise UsageError(f'The "pitch" must be the downward angle, −90 to 90 degrees, not {pitch:g}.')
    distance = number(given.get("distance", ARM), 'The "distance"')
    if not distance > 0:
        raise UsageError(f'The "distance" must be in metres, more than 0, not {distance:g}.')
    name = "target" if about else "eye"
    place = _place(given, name, crs)
    if about:
        forward = looking(number(given["azimuth"], 'The "azimuth"') + 180.0, pitch)
    else:
        forward = looking(number(given["heading"], 'The "heading"'), pitch)
    sign = -1.0 if about else 1.0
    plain[name] = place
    plain["eye" if about else "target"] = tuple(p + sign * distance * f for p, f in zip(place, forward))
    plain.pop("crs", None)
    return plain


def _place(given: Mapping[str, Any], name: str, crs: Any) -> Point:
    """A place in the terrain's CRS, by the rules of ``View.from_dict``."""
    value = given[name]
    try:
        x, y, z = (float(v) for v in value)
    except (TypeError, ValueError) as error:
        raise UsageError(f"The {name} is not three numbers: {value!r}.") from error
    apart = {"crs": given["crs"]} if "crs" in given else {}
    view = View.from_dict({"eye": (x, y, z), "target": (x, y, z - 1.0), **apart}, crs=crs)
    return view.eye


def _sun(value: Any) -> Placed | Moment:
    """[azimuth, altitude], "azimuth,altitude" or a time with its zone."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        if len(value) != 2:
            raise UsageError(f'The "sun" is [azimuth, altitude] in degrees, or a time with its zone, not {value!r}.')
        value = ",".join(repr(number(v, 'The "sun"')) for v in value)
    if not isinstance(value, str):
        raise UsageError(f'The "sun" is [azimuth, altitude] in degrees, or a time with its zone, not {value!r}.')
    try:
        return parse(value)
    except UsageError as error:
        raise UsageError(f'The "sun": {error.what}', remedy=error.remedy) from error
