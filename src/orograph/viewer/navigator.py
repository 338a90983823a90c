"""What the mouse and the keyboard do to the camera: a state machine over ``navigation``, ``glide`` and ``flying``.

    left drag         pan, holding the ground under the cursor      wheel             zoom to the cursor
    right drag        orbit about the point under the cursor        double click      go there
    middle drag       look around                                   w a s d q e       fly (shift: faster, ctrl: slower)
    shift, ctrl+left  orbit, look around (for trackpads)            arrows            turn

The window passes on events and time, and draws ``view``; the module has no GUI, so all of this is tested without one.
``pick`` finds the ground under the cursor, or None (sky). Units: pixels of the view; seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from orograph.viewer.flying import FAST, KEYS, SLOW, Flying
from orograph.viewer.glide import Glide
from orograph.viewer.navigation import (
    FREE,
    GRAZING,
    Grab,
    Limits,
    Pixel,
    dolly,
    heading_pitch,
    kept_above,
    look,
    orbit,
    towards,
    zoom,
)
from orograph.viewer.pose import Pose
from orograph.viewpoint import Point, View

Pick = Callable[[float, float], Point | None]

LEFT, RIGHT, MIDDLE = 1, 2, 3
"""Mouse buttons, as events number them."""

ORBIT_PER_PIXEL = 0.3
LOOK_PER_PIXEL = 0.15
"""Degrees per pixel in a picture of 720 rows; less in higher ones."""
WHEEL = math.log(1.25)
"""Change of the logarithm of the zoom per notch of the wheel."""
SMOOTH = 0.07
"""Seconds in which a zoom comes within 1/e of its goal."""
CLICK = 4.0
"""Pixels that a mouse may move during a click."""
GO_CLOSER = 2.5
"""A double click goes this many times nearer."""
OBLIQUE = -40.0
"""Pitch of the oblique preset, degrees."""


@dataclass(slots=True)
class _Drag:
    button: int
    kind: str
    last: Pixel
    begun: Pixel
    grab: Grab | None = None
    pivot: Point | None = None
    moved: bool = False


@dataclass(slots=True)
class _Zoom:
    pixel: Pixel
    point: Point | None
    rest: float


@dataclass(slots=True)
class Navigator:
    """The camera and its motion.

    Attributes:
        view: the view to draw.
        home: what ``go_home`` returns to.
        pick: pixel → (easting, northing, height) of the ground there, or None.
        limits: the ground to stay above.
        exaggeration: of the picture.
    """

    view: View
    home: View
    pick: Pick
    limits: Limits = FREE
    exaggeration: float = 1.0
    flying: Flying = field(default_factory=Flying)
    keys: set[str] = field(default_factory=set)
    pace: float = 1.0
    _drag: _Drag | None = None
    _zoom: _Zoom | None = None
    _glide: tuple[Glide, float] | None = None

    # ---- events --------------------------------------------------------------------------------------------------

    def press(self, button: int, x: float, y: float, modifiers: Collection[str] = ()) -> None:
        """A button was pressed."""
        self.stop()
        kind = {LEFT: "pan", RIGHT: "orbit", MIDDLE: "look"}.get(button, "")
        if button == LEFT and "Shift" in modifiers:
            kind = "orbit"
        elif button == LEFT and "Control" in modifiers:
            kind = "look"
        if not kind:
            return
        drag = _Drag(button, kind, (x, y), (x, y))
        if kind == "pan":
            point = self.pick(x, y)
            drag.grab = None if point is None else Grab.take(self.view, point, self.exaggeration)
        elif kind == "orbit":
            drag.pivot = self.pick(x, y) or self.centre()
        self._drag = drag

    def move(self, x: float, y: float) -> None:
        """The pointer moved."""
        drag = self._drag
        if drag is None:
            return
        if not drag.moved and math.dist((x, y), drag.begun) < CLICK:
            return
        dx, dy = x - drag.last[0], y - drag.last[1]
        drag.moved, drag.last = True, (x, y)
        scale = 720.0 / max(self.view.height, 1)
        if drag.kind == "pan":
            if drag.grab is not None:
                self.view = drag.grab.to((x, y), self.limits)
            else:  # the sky was grabbed: it turns with the hand
                per_pixel = math.degrees(self.view.pixel_slope)
                self.view = look(self.view, -dx * per_pixel, dy * per_pixel, self.exaggeration)
        elif drag.kind == "orbit" and drag.pivot is not None:
            self.view = orbit(
                self.view, drag.pivot, dx * ORBIT_PER_PIXEL * scale, -dy * ORBIT_PER_PIXEL * scale, self.limits,
                self.exaggeration,
            )  # fmt: skip
        elif drag.kind == "look":
            per_pixel = LOOK_PER_PIXEL * scale
            self.view = look(self.view, dx * per_pixel, -dy * per_pixel, self.exaggeration)

    def release(self, button: int, x: float, y: float) -> bool:
        """A button was released; returns whether that was a click (the pointer has not moved)."""
        drag, self._drag = self._drag, None
        return drag is not None and drag.button == button and not drag.moved

    def wheel(self, x: float, y: float, notches: float) -> None:
        """The wheel turned; positive: towards the point under the cursor."""
        self._glide = None
        self.flying.stop()
        rest = notches * WHEEL
        now = self._zoom
        if now is not None and math.dist(now.pixel, (x, y)) < CLICK:
            now.rest += rest
            return
        if now is not None:
            rest += now.rest
        self._zoom = _Zoom((x, y), self.pick(x, y), rest)

    def double_click(self, x: float, y: float) -> None:
        """Go to the point under the cursor."""
        point = self.pick(x, y)
        if point is not None:
            self.go_to(point, closer=GO_CLOSER)

    def key_down(self, key: str, modifiers: Collection[str] = ()) -> bool:
        """A key was pressed; returns whether it is a flying key."""
        name = key.lower() if len(key) == 1 else key
        self._modifiers(modifiers)
        if name not in KEYS:
            return False
        self._glide = self._zoom = None
        self.keys.add(name)
        return True

    def key_up(self, key: str, modifiers: Collection[str] = ()) -> bool:
        """A key was released; returns whether it was flying."""
        name = key.lower() if len(key) == 1 else key
        self._modifiers(modifiers)
        held = name in self.keys
        self.keys.discard(name)
        return held

    def _modifiers(self, modifiers: Collection[str]) -> None:
        self.pace = (FAST if "Shift" in modifiers else 1.0) * (SLOW if "Control" in modifiers else 1.0)

    # ---- time ----------------------------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether ``advance`` would change the view, so that a frame is due soon."""
        return bool(self.keys or self.flying.moving or self._glide is not None or self._zoom is not None)

    @property
    def dragging(self) -> bool:
        """Whether a button is held."""
        return self._drag is not None

    @property
    def pivot(self) -> Point | None:
        """The point of the current orbit."""
        drag = self._drag
        return drag.pivot if drag is not None and drag.kind == "orbit" and drag.moved else None

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if self._glide is not None:
            glide, time = self._glide
            time += seconds
            assert glide.seconds is not None
            self.view = glide.at(time).resized(self.view.width, self.view.height)
            self._glide = None if time >= glide.seconds else (glide, time)
        if self._zoom is not None:
            self._advance_zoom(self._zoom, seconds)
        if self.keys or self.flying.moving:
            self.view = self.flying.advance(self.view, self.keys, seconds, self.limits, self.exaggeration, self.pace)

    def _advance_zoom(self, state: _Zoom, seconds: float) -> None:
        part = 1.0 - math.exp(-seconds / SMOOTH)
        done = state.rest * part if abs(state.rest) * (1 - part) > 1e-3 else state.rest
        state.rest -= done
        if state.point is not None:
            self.view = zoom(self.view, state.point, math.exp(done), self.limits, self.exaggeration)
        else:
            metres = self.view.distance * (1 - math.exp(-done))
            self.view = dolly(self.view, state.pixel, metres, self.limits, self.exaggeration)
        if state.rest == 0.0:
            self._zoom = None

    def stop(self) -> None:
        """Stop flights and zooms where they are."""
        self._glide = self._zoom = None
        self.flying.stop()

    # ---- going places --------------------------------------------------------------------------------------------

    def centre(self) -> Point:
        """The ground in the middle of the picture; without ground, the view's target."""
        return self.pick(self.view.width / 2, self.view.height / 2) or self.view.target

    def go(self, view: View) -> None:
        """Fly to a view (its direction and place; the picture keeps its size)."""
        end = kept_above(view.resized(self.view.width, self.view.height), self.limits, self.exaggeration)
        self.stop()
        start = self._focused()
        self._glide = Glide(start, end, self.limits, self.exaggeration), 0.0

    def jump(self, view: View) -> None:
        """Jump to a view."""
        self.stop()
        self.view = kept_above(view.resized(self.view.width, self.view.height), self.limits, self.exaggeration)

    def _focused(self) -> View:
        """The view, with its target at the ground in the middle of the picture if there is any: flights zoom by it."""
        pose = Pose.of(self.view, self.exaggeration)
        point = self.pick(self.view.width / 2, self.view.height / 2)
        if point is None:
            return pose.to_view()
        depth = pose.depth(np.array(point) * [1.0, 1.0, self.exaggeration])
        return replace(pose, distance=max(depth, 1.0)).to_view()

    def go_to(self, point: Point, closer: float = 1.0) -> None:
        """Fly to a point, which comes to the middle of the picture, ``nearer`` times as near."""
        pose = Pose.of(self.view, self.exaggeration)
        distance = float(np.linalg.norm(np.array(point) * [1, 1, self.exaggeration] - pose.eye)) / closer
        self.go(towards(self.view, point, self.limits, self.exaggeration, distance=distance))

    def go_home(self) -> None:
        """Fly to the initial view."""
        self.go(self.home)

    def north_up(self) -> None:
        """Turn about the middle until north is up."""
        self._turn(heading=0.0)

    def straight_down(self) -> None:
        """Look straight down at the middle, north up."""
        self._turn(heading=0.0, pitch=-90.0)

    def oblique(self, heading: float | None = None) -> None:
        """Look down at the middle by ``OBLIQUE``, in a direction (degrees), or the current one."""
        self._turn(heading=heading, pitch=OBLIQUE)

    def turn_quarter(self, quarters: int) -> None:
        """Orbit the middle to the next of the four main directions."""
        heading, _ = heading_pitch(self.view, self.exaggeration)
        step = round(heading / 90.0) + quarters
        self._turn(heading=step * 90.0)

    def _turn(self, heading: float | None = None, pitch: float | None = None) -> None:
        self.go(towards(self.view, self.centre(), self.limits, self.exaggeration, heading=heading, pitch=pitch))

    def resize(self, width: int, height: int) -> None:
        """The picture has a new size."""
        self.view = self.view.resized(max(width, 1), max(height, 1))
        if self._drag is not None:  # what is held was grabbed in another picture
            self._drag = None

    def stretch(self, exaggeration: float) -> None:
        """Change the exaggeration while the target stays in place in the picture: the camera keeps
        its direction and its distance from the ground in the middle, or if it looks along the ground, from the ground
        below it."""
        pose = Pose.of(self.view, self.exaggeration)
        held = self.pick(self.view.width / 2, self.view.height / 2) if pose.pitch < -GRAZING else None
        height = self.limits.ground(*self.view.eye[:2]) if held is None else held[2]
        grown = (exaggeration - self.exaggeration) * height if math.isfinite(height) else 0.0
        pose = replace(pose.at(pose.eye + np.array([0.0, 0.0, grown])), exaggeration=exaggeration)
        self.exaggeration = exaggeration
        self.stop()
        self.view = kept_above(pose.to_view(), self.limits, exaggeration)
