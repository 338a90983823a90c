"""A terrain in a cell whose camera, light, layers and picks are traits, which cells can read, set, observe and link.

    widget = orograph.view("area.oro")
    widget.exaggeration = 2
    ipywidgets.link((slider, "value"), (widget, "altitude"))
    traitlets.link((widget, "camera"), (other, "camera"))       # both show the same view

Values set here go into the window's session, and the picture follows; changes by mouse, keys and panels come back with
the next frame.
"""

from __future__ import annotations

import base64
import math
import traceback
from collections.abc import Callable, Sequence
from typing import Any, get_args

from traitlets import Any as Anything
from traitlets import Dict, HasTraits, Instance, TraitError, Tuple, Unicode, observe, validate
from traitlets import Float as Number

from orograph.errors import OrographError, UsageError
from orograph.geovis.data.priority import Priority
from orograph.geovis.layers import layers_of
from orograph.lighting.sun import Sun
from orograph.scene.parts import Light, check_exaggeration
from orograph.viewer.results import KINDS
from orograph.viewpoint import View


class Widget(HasTraits):
    """A terrain in a cell.

    Attributes:
        window: the window in it (``viewer.window.Window``): its ``session`` has all settings.
        canvas: the widget itself, to place beside others.

    Traits:
        camera: the ``View``, of the cell's own size; set it to be there at once (``fly`` takes its time).
        exaggeration: how heights are stretched on the screen.
        azimuth, altitude: degrees, where the sun is placed; of a moment, where it is then. Setting one places the sun.
        light: "relief", "ao", "aperture", "raytraced" or "none".
        layers: over the ground, bottom to top, as ``orograph.render`` takes them.
        priority: of terrain, data and uncertainty, "T+D+U-"; "" without data.
        time: of a series, "2019-03-01T12:00", or a moment between two of its times (values are linear); "": as the data
            were given. times: all times of the data.
        selection: of data and ground, {"ranges": {"Height": (500, 900)}, "area": ((easting, northing), …)}: what is
            brushed in the panel Plot; set it to select. {}: all is.
        found: what data say under the pointer, each (name, value, sigma, unit).
        measure: what clicks measure: "pick", "profile"…; "" while they do not.
        picked: the points that were clicked, each (easting, northing, height); set them to have them measured.
        measured: what they measure (``orograph.measure``; of picks, the last), or None.
    """

    camera = Instance(View)
    exaggeration = Number(1.0)
    azimuth = Number(315.0)
    altitude = Number(45.0)
    light = Unicode("relief")
    layers = Anything(())
    priority = Unicode("")
    time = Unicode("")
    times = Tuple(read_only=True)
    selection = Dict()
    found = Tuple(read_only=True)
    measure = Unicode("")
    picked = Tuple()
    measured = Anything(None, allow_none=True, read_only=True)

    def __init__(self, window: Any, canvas: Any, still: bytes) -> None:
        self.window, self.canvas, self._still = window, canvas, still
        self._changes: list[Any] = []
        self._told: Any = None
        self._trouble = ""
        self._updating = True
        super().__init__()
        self._tell()
        self._updating = False
        window.on_frame.append(lambda _: self._update())

    def fly(self, camera: View) -> None:
        """Fly to a view."""
        self.window.session.nav.go(camera)
        self.window.refresh()

    def close(self) -> None:
        """Stop drawing and release the GPU's memory."""
        self.canvas.close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        data = None if self.canvas.get_closed() else self.canvas._repr_mimebundle_(**options)
        rest: tuple[Any, ...] = ()
        if isinstance(data, tuple):
            data, *more = data
            rest = tuple(more)
        data = {**(data or {}), "image/png": base64.b64encode(self._still).decode()}
        return (data, *rest) if rest else data

    def _display_(self) -> Any:
        """What marimo shows."""
        return self.canvas

    # ---- from the window ---------------------------------------------------------------------------------------------

    def _update(self) -> None:
        """Update the traits to what a frame was drawn with, then tell their observers, who may set traits themselves.

        What goes wrong in an observer is printed, and frames go on.
        """
        self._changes, self._updating = [], True
        try:
            self._tell()
        finally:
            self._updating = False
        for change in self._changes:
            self._told = change
            try:
                super().notify_change(change)
            except Exception as error:
                trouble, self._trouble = self._trouble, f"{type(error).__name__}: {error}"
                if self._trouble != trouble:  # not in every frame of a flight
                    traceback.print_exc()

    def notify_change(self, change: Any) -> None:
        """Tell observers of a change; while traits are updated, only when all are."""
        if self._updating:
            self._changes.append(change)
        else:
            super().notify_change(change)

    def _tell(self) -> None:
        session, tools = self.window.session, self.window.tools
        settings = session.settings
        sun = settings.sun.sun(session.terrain)
        self.camera, self.exaggeration, self.light = session.view, settings.exaggeration, settings.light
        self.azimuth, self.altitude = float(sun.azimuth), float(sun.altitude)
        self.layers = tuple(settings.layers)
        shown = settings.shown
        self.priority, self.time = ("", "") if shown is None else (str(shown.priority), shown.time)
        times = () if shown is None else tuple(shown.times)
        if self.times != times:
            self.set_trait("times", times)
        found = tuple((one.name, one.value, one.sigma, one.unit) for one in self.window.found())
        if self.found != found:
            self.set_trait("found", found)
        self.selection = _selected(self.window.brush)
        self.measure = tools.kind if tools.active else ""
        self.picked = tuple(tuple(point) for point in tools.points)
        if self.measured is not tools.result:
            self.set_trait("measured", tools.result)

    # ---- into the window ---------------------------------------------------------------------------------------------

    @validate("camera")
    def _own_size(self, proposal: Any) -> View:
        view: View = proposal["value"]
        own = self.window.session.view
        return view.resized(own.width, own.height)

    @validate("exaggeration", "azimuth", "altitude", "light", "layers", "measure", "picked")
    def _sensible(self, proposal: Any) -> Any:
        name, value = proposal["trait"].name, proposal["value"]
        try:
            return CHECKS[name](value)
        except UsageError as error:
            raise TraitError(str(error)) from error

    @validate("priority", "time")
    def _of_data(self, proposal: Any) -> str:
        """Shown at once, since only then is it known whether there are such data."""
        name, value = proposal["trait"].name, str(proposal["value"])
        session = self.window.session
        shown = session.settings.shown
        if self._updating or (shown is None and not value):
            return value
        try:
            if shown is None:
                raise UsageError("There are no data.")
            session.settings.show(session.terrain, **{name: Priority.parse(value) if name == "priority" else value})
        except OrographError as error:
            raise TraitError(str(error)) from error
        self.window.refresh()
        return str(shown.priority) if name == "priority" else value

    @validate("selection")
    def _of_places(self, proposal: Any) -> dict[str, Any]:
        value = dict(proposal["value"])
        if self._updating:
            return value
        if unknown := set(value) - {"ranges", "area"}:
            raise TraitError(f"A selection may have ranges and area, not {', '.join(sorted(unknown))}.")
        session, brush = self.window.session, self.window.brush
        try:
            brush.choose(value.get("ranges", {}), value.get("area", ()))
            brush.apply(session.terrain, session.settings.shown)
        except OrographError as error:
            raise TraitError(str(error)) from error
        session.settings.veil = brush.veil
        self.window.refresh()
        return _selected(brush)

    @observe("camera", "exaggeration", "azimuth", "altitude", "light", "layers", "measure", "picked")
    def _set(self, change: Any) -> None:
        if change is self._told or self.canvas.get_closed():
            return
        name, value = change["name"], change["new"]
        session, tools = self.window.session, self.window.tools
        if name == "camera":
            session.nav.jump(value)
        elif name == "exaggeration":
            session.stretch(value)
        elif name in ("azimuth", "altitude"):
            sun = session.settings.sun
            sun.mode, sun.azimuth, sun.altitude = "placed", self.azimuth % 360.0, self.altitude
        elif name == "layers":
            session.settings.layers = list(value or ())
        elif name == "light":
            session.settings.light = value
        elif name == "measure":
            tools.leave() if not value else tools.choose(value)
            tools.active = bool(value)
        elif name == "picked":
            tools.active, tools.points = True, list(value)
            tools.measure()
        self.window.refresh()


def _selected(brush: Any) -> dict[str, Any]:
    """The brush's selection as a trait value."""
    return {} if brush.empty else {"ranges": dict(brush.ranges), "area": brush.area}


def _exaggeration(value: float) -> float:
    check_exaggeration(value)
    return value


def _azimuth(value: float) -> float:
    Sun(azimuth=value)  # refuses it
    return value


def _altitude(value: float) -> float:
    Sun(altitude=value)  # refuses it
    return value


def _light(value: str) -> str:
    if value not in get_args(Light):
        raise UsageError(f"There is no light {value!r}; choose one of {', '.join(get_args(Light))}.")
    return value


def _kind(value: str) -> str:
    if value and value not in KINDS:
        raise UsageError(f"There is no measure {value!r}; choose one of {', '.join(KINDS)}.")
    return value


def _points(value: Sequence[Any]) -> tuple[tuple[float, ...], ...]:
    try:
        points = tuple(tuple(float(v) for v in point) for point in value)
    except (TypeError, ValueError):
        points = ((),)
    if any(len(point) != 3 or not all(map(math.isfinite, point)) for point in points):
        raise UsageError("Each point must be (easting, northing, height), finite numbers.")
    return points


CHECKS: dict[str, Callable[[Any], Any]] = {
    "exaggeration": _exaggeration, "azimuth": _azimuth, "altitude": _altitude, "light": _light, "layers": layers_of,
    "measure": _kind, "picked": _points,
}  # fmt: skip
"""Converts to a trait's value, or raises UsageError."""
