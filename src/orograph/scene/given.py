"""Convert what users give for a scene's options: texts of the command line, and Python values of various types.

A text is read before there is a terrain (``read`` of ``lod.options.option``; a ValueError explains a fault of the text,
other errors that of a file it names). Its meaning may depend on the terrain (``given``): the sun at a moment, a place
by longitude and latitude. Values of an option's own type stay as they are. Units: degrees, metres; colours are sRGB
from 0 to 1.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from orograph.errors import UsageError
from orograph.lod.registry import METHODS
from orograph.scene.aids import Aids, aids_of
from orograph.scene.contours import Contours
from orograph.scene.detail import Detail, detail_of
from orograph.scene.silhouettes import Silhouettes

if TYPE_CHECKING:
    from orograph.geovis.data.dataset import Dataset
    from orograph.geovis.data.focus import Focus
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.layers import Layer
    from orograph.geovis.tables import Table
    from orograph.lighting.aperture import Lamp
    from orograph.lighting.sun import Moment, Passage, Placed, Sun
    from orograph.scene.flying import Flight
    from orograph.scene.ghosts import Ghost
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

T = TypeVar("T")

Disc = tuple["Sun", tuple[float, float, float]]

WHITE = (1.0, 1.0, 1.0)

LAMP = "LON,LAT,HEIGHT,REACH,RED,GREEN,BLUE"
DISC = "AZ,ALT,DIAMETER,RED,GREEN,BLUE"


def numbers(text: str, names: str, optional: int = 0) -> tuple[float, ...]:
    """Numbers separated by commas, named as in ``names``; the last ``optional`` of them may be missing together.

    Raises:
        ValueError: the text is not that.
    """
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if any(map(math.isnan, found)):
        raise ValueError(f"{text!r} holds nan, which is not a number.")
    count = names.count(",") + 1
    if len(found) not in (count, count - optional):
        but = f" (or without the last {optional})" if optional else ""
        raise ValueError(f"{text!r} is not {names}: numbers separated by commas{but}.")
    return found


def read_span(text: str) -> tuple[float, float]:
    """Two numbers separated by a colon (or a comma).

    Raises:
        ValueError: the text is not that.
    """
    try:
        low, high = map(float, text.replace(",", ":").split(":"))
    except ValueError:
        raise ValueError(f"{text!r} is not LOW:HIGH, two numbers separated by a colon.") from None
    return low, high


def read_numbers(names: str, optional: int = 0) -> Callable[[str], tuple[float, ...]]:
    """A reader for ``numbers``."""
    return lambda text: numbers(text, names, optional)


def read_sun(text: str) -> Placed | Moment:
    from orograph.lighting.sun import parse

    try:
        return parse(text)
    except UsageError as error:
        raise ValueError(str(error)) from None


def read_suns(text: str) -> Placed | Moment | Passage:
    """Read a sun as ``read_sun`` does, or a passage A..B."""
    from orograph.lighting.sun import passage

    try:
        return passage(text) or read_sun(text)
    except UsageError as error:
        raise ValueError(str(error)) from None


def read_layer(text: str) -> Layer:
    """A layer as ``Layer.parse`` reads it; its file must exist."""
    from orograph.geovis.layers import Layer

    layer = Layer.parse(text)
    assert layer.location
    return layer


def read_data(text: str) -> Dataset:
    """Data as ``Dataset.parse`` reads them; their file must exist."""
    from orograph.dem.handles import locate
    from orograph.geovis.data.dataset import Dataset

    found = Dataset.parse(text)
    assert locate(found.source)
    return found


def read_priority(text: str) -> Priority:
    from orograph.geovis.data.priority import Priority

    try:
        return Priority.parse(text)
    except UsageError as error:
        raise ValueError(str(error)) from None


def read_focus(text: str) -> Focus:
    from orograph.geovis.data.focus import LENS, NEAR, Focus

    try:
        found = Focus.parse(text)
    except UsageError as error:
        raise ValueError(str(error)) from None
    if found.source not in (LENS, NEAR):
        from orograph.dem.handles import locate

        assert locate(found.source)
    return found


def read_flight(text: str) -> Flight:
    from orograph.scene.flying import Flight

    try:
        return Flight.parse(text)
    except UsageError as error:
        raise ValueError(str(error)) from None


def read_ghost(text: str) -> Ghost:
    from orograph.dem.handles import locate
    from orograph.scene.ghosts import Ghost

    try:
        found = Ghost.parse(text)
    except UsageError as error:
        raise ValueError(str(error)) from None
    assert locate(found.source)
    return found


def read_water(text: str) -> str | float:
    try:
        return text if text in ("auto", "none") else float(text)
    except ValueError:
        raise ValueError(f"{text!r} is neither auto, none nor a level in metres.") from None


def read_contours(text: str) -> Contours:
    try:
        return Contours() if text == "auto" else Contours(float(text))
    except ValueError:
        raise ValueError(f"{text!r} is neither auto nor a number of metres.") from None


def read_method(text: str) -> str:
    """``NAME[,key=value…]``: the name is checked at once, the options when the method is loaded."""
    name = text.partition(",")[0].strip()
    if name != "auto" and name not in METHODS:
        raise ValueError(f"There is no method {name!r}; the methods are {', '.join(METHODS)}.")
    return text


def default_sun() -> Sun:
    from orograph.lighting.sun import Sun

    return Sun()


def sun(value: Any, terrain: Terrain) -> Sun:
    """Takes (azimuth, altitude), a datetime with its zone, such a text, or a `Sun`."""
    from orograph.lighting.sun import Sun, sun_of

    return Sun() if value is None else sun_of(value, terrain.grid)


def standing(options: Mapping[str, Any]) -> tuple[dict[str, Any], Passage | None]:
    """Options of a scene with one sun, that of the beginning if theirs moves; and the passage of one that does."""
    from orograph.lighting.sun import passage

    moving = passage(options.get("sun"))
    return dict(options) if moving is None else {**options, "sun": moving.begin}, moving


def view(value: View | str | os.PathLike[str] | None, terrain: Terrain) -> View | None:
    """Takes a `View`, or the path of one."""
    from orograph.viewpoint import View

    return View.load(os.fspath(value), crs=terrain.grid.crs) if isinstance(value, (str, os.PathLike)) else value


def lamps(value: Iterable[Lamp | tuple[float, ...]], terrain: Terrain) -> tuple[Lamp, ...]:
    """Takes several: such numbers, or a `Lamp` each."""
    from orograph.geo.transform import place
    from orograph.lighting.aperture import Lamp

    def lamp(lon: float, lat: float, height: float, reach: float, *color: float) -> Lamp:
        x, y = place(terrain.grid, lon, lat)
        return Lamp.at(terrain.grid, x, y, height, reach, (color[0], color[1], color[2]) if color else WHITE)

    return tuple(one if isinstance(one, Lamp) else lamp(*one) for one in value)


def discs(value: Iterable[Disc | tuple[float, ...]], terrain: Terrain) -> tuple[Disc, ...]:
    """Takes several: such numbers, or a `Sun` each with its colour; (1, 1, 1) is about that of the sun at 45°."""
    from orograph.lighting.sun import Sun

    def disc(azimuth: float, altitude: float, diameter: float, *color: float) -> Disc:
        return Sun(azimuth, altitude, diameter), (color[0], color[1], color[2]) if color else WHITE

    return tuple(one if isinstance(one[0], Sun) else disc(*one) for one in value)


def colormap(value: Any, terrain: Terrain) -> str | Table | None:
    """Takes a name, or a colour map of matplotlib's or cmap's."""
    from orograph.geovis.tables import Table

    return value if value is None or isinstance(value, str | Table) else Table.of(value)


def layers(value: Any, terrain: Terrain) -> tuple[Layer, ...]:
    """Takes one or several: paths, arrays (which span the terrain), DataArrays, open rasterio datasets, or a `Layer`
    for each, with the same settings as the keys and the place of an array."""
    from orograph.geovis.layers import layers_of

    return layers_of(value)


def data(value: Any, terrain: Terrain) -> tuple[Dataset, ...]:
    """Takes one or several: paths, DataArrays, arrays (which span the terrain), or an `orograph.Dataset` for each, with
    the same settings as the keys and the uncertainty."""
    from orograph.geovis.data.dataset import datasets_of

    return datasets_of(value)


def priority(value: Priority | str | None, terrain: Terrain) -> Priority | None:
    """Takes such a text."""
    from orograph.geovis.data.priority import Priority

    return _parsed(Priority, value)


def focus(value: Focus | str | None, terrain: Terrain) -> Focus | None:
    """Takes such a text, or an `orograph.Focus`."""
    from orograph.geovis.data.focus import Focus

    return _parsed(Focus, value)


def flight(value: Flight | str | None, terrain: Terrain) -> Flight | None:
    """Takes such a text, or a `Flight`."""
    from orograph.scene.flying import Flight

    return _parsed(Flight, value)


def ghosts(value: Any, terrain: Terrain) -> tuple[Ghost, ...]:
    """Takes one or several: what `orograph.terrain` takes, arrays of the terrain's samples, or an `orograph.Ghost` for
    each, with the same settings as the keys."""
    from orograph.scene.ghosts import Ghost

    several = value if isinstance(value, list | tuple) else (value,)
    return tuple(one if isinstance(one, Ghost) else Ghost(one) for one in several)


def _parsed(kind: type[T], value: Any) -> T | None:
    """A value of a kind, or its text."""
    if value is None or isinstance(value, kind):
        return value
    if not isinstance(value, str):
        raise TypeError(f"give a text, or a {kind.__name__}")
    found: T = kind.parse(value)  # type: ignore[attr-defined]
    return found


def water(value: Literal["auto", "none"] | float | None, terrain: Terrain) -> Literal["auto"] | float | None:
    """None: nothing is drawn."""
    return value if value is None or value == "auto" else float(value)


def contours(value: Contours | float | None, terrain: Terrain) -> Contours | None:
    """Takes "auto", metres between lines, or a `Contours`, whose interval may be automatic."""
    return value if value is None or isinstance(value, Contours) else Contours(float(value))


def aids(value: Aids | str | None, terrain: Terrain) -> Aids | None:
    """Takes a text ("drops,poles=100"), or an `Aids`."""
    return aids_of(value)


def detail(value: Detail | str | bool | None, terrain: Terrain) -> Detail | None:
    """Takes True for fractal detail, a text (`exemplar=lidar.tif`), or a `Detail`."""
    return detail_of(value)


def silhouettes(value: Silhouettes | bool | None, terrain: Terrain) -> Silhouettes | None:
    """Takes True, or a `Silhouettes`."""
    if value is None or isinstance(value, Silhouettes):
        return value
    if not isinstance(value, bool):
        raise TypeError("give True, False or a Silhouettes")
    return Silhouettes() if value else None
