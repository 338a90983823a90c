"""Layers: images and rasters laid over the ground one above another, the same description for every backend.

A layer names a file in any CRS and says how it is shown. An image (RGB, RGBA, a palette, or one band as grey) shows its
own colours; with a colour map, one band of a raster is coloured from the low to the high end of a range of its values.
Layers are composited bottom to top over the tint of heights, in linear light (Porter & Duff 1984, *over*):

    normal:   c ← c · (1 − a) + image · a         multiply:   c ← c · (1 − a) + c · image · a

where a is the image's own opacity times the layer's. Units: those of the raster for ranges, opacities from 0 to 1.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import InitVar, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from orograph._named import named, remedy
from orograph._numba import kernel
from orograph.dem.handles import locate
from orograph.documents import number
from orograph.errors import UsageError
from orograph.geovis.basemaps import PREFIX, Basemap, location_of
from orograph.geovis.held import Held, held
from orograph.geovis.keys import Legend
from orograph.geovis.tables import Table

Colors = NDArray[np.float32]

Blend = Literal["normal", "multiply"]

IMAGES = 4
"""Of the memory allowed, the part (one of so many) that images may take."""

MOST = 8
"""Layers that a picture shows at once."""


@named("A layer")
@dataclass(frozen=True, slots=True, repr=False)
class Layer:
    """An image or a raster over the ground.

    Attributes:
        path: the file, in any CRS; without any georeference it is stretched over the terrain. Also a tile service or
            tiles (``xyz:NAME``: ``basemaps``); an array of values or colours, a DataArray, or an open rasterio dataset
            (``held``), whose path is then that of a file in memory.
        opacity: 0 to 1, times the image's own.
        visible: whether it is drawn.
        name: what to call it; None: the file's name.
        blend: "normal" covers what is below, "multiply" darkens it (a scanned map over relief).
        colormap: colours one band as values: alpine, mars, grey or any name of the cmap catalogue; a colour map of
            matplotlib's or cmap's; colours by value, {1: "green", 2: "#08f"}. None: the image's own colours.
        range: the values that become the ends of the colour map; None: those of the norm or the classes, else the 2nd
            and 98th percentile over the terrain.
        band: which band is coloured: its number, from 1, or its name.
        nodata: the value that means "nothing here", instead of the one the file declares.
        transform, crs: where an array lies (not kept: they are the file's in memory).
        norm: matplotlib's, of the colour map (not kept: it is folded into it).
        key: what the colours of an image mean, for the legend.

    Raises:
        UsageError: a number is out of its range, a name is unknown.
    """

    path: Any
    opacity: float = 1.0
    visible: bool = True
    name: str | None = None
    blend: Blend = "normal"
    colormap: Any = None
    range: tuple[float, float] | None = None
    band: int | str = 1
    nodata: float | None = None
    held: Held | None = field(default=None, repr=False, compare=False)
    key: Legend | None = field(default=None, repr=False, compare=False)
    transform: InitVar[Any] = None
    crs: InitVar[Any] = None
    norm: InitVar[Any] = None

    def __post_init__(self, transform: Any, crs: Any, norm: Any) -> None:
        if isinstance(self.path, str | os.PathLike):
            object.__setattr__(self, "path", os.fspath(self.path))
            if transform is not None or crs is not None:
                raise self._error("A file has its own transform and CRS; these are for arrays.")
        else:
            path, keep = held(self.path, transform, crs)
            object.__setattr__(self, "path", path)
            object.__setattr__(self, "held", keep)
        if norm is not None or not isinstance(self.colormap, str | Table | None):
            if self.colormap is None:
                raise self._error("A norm needs a colour map.", "Give a colormap, such as viridis.")
            object.__setattr__(self, "colormap", Table.of(self.colormap, norm))
        if not self.path:
            raise UsageError("A layer has no path.", remedy="Name an image or a raster.")
        if not 0 <= self.opacity <= 1:
            raise self._error(f"The opacity must be a number from 0 to 1, not {self.opacity:g}.")
        if self.blend not in get_args(Blend):
            raise self._error(f"Unknown blend {self.blend!r}; the blends are {', '.join(get_args(Blend))}.")
        if isinstance(self.band, int) and self.band < 1:
            raise self._error(f"Bands are counted from 1; there is no band {self.band}.")
        if self.range is not None:
            low, high = (float(v) for v in self.range)
            object.__setattr__(self, "range", (low, high))
            if not (math.isfinite(low) and math.isfinite(high) and low != high):
                raise self._error(f"A range needs two different finite values, not {low:g} and {high:g}.")
        if self.colormap is None and (self.range is not None or self.band != 1):
            raise self._error(
                "A range and a band apply only to a raster with a colour map.",
                remedy="Give a colormap, such as viridis, or omit them.",
            )
        if isinstance(self.colormap, str):
            from orograph.geovis.color import color_table

            try:
                color_table(self.colormap, 2)
            except UsageError as error:
                raise self._error(error.what, error.remedy) from error

    def __repr__(self) -> str:
        said = (f"{f.name}={getattr(self, f.name)!r}" for f in fields(self)[1:]
                if f.repr and getattr(self, f.name) != f.default)  # fmt: skip
        return f"Layer({', '.join([repr(self.path), *said])})"

    def _repr_html_(self) -> str:
        from orograph.geovis.layer_cards import card_of

        return card_of(self)

    @property
    def label(self) -> str:
        """What to call it."""
        if self.path.startswith(PREFIX):
            return self.name or Basemap.of(self.path).name
        file = Path(self.path)
        return self.name or (file.name if self.held is None else file.stem) or str(self.path)

    @property
    def title(self) -> str:
        """What to call it in a picture: its name, or its file's without what comes after the dot."""
        return self.name or Path(self.label).stem.replace("_", " ")

    @property
    def location(self) -> str:
        """What GDAL opens.

        Raises:
            ReadError: there is no such file. UsageError: there is no such tile service.
        """
        return locate(location_of(self.path))

    @property
    def asks(self) -> bool:
        """Whether a server is asked for its tiles."""
        return self.path.startswith(PREFIX) and "://" in Basemap.of(self.path).url

    @property
    def attribution(self) -> tuple[str, ...]:
        """Whom a tile service wants to be named."""
        said = Basemap.of(self.path).attribution if self.path.startswith(PREFIX) else ""
        return (said,) if said else ()

    @property
    def content(self) -> Layer:
        """The layer as far as its colours go: what of it must be read."""
        return Layer(
            self.path, colormap=self.colormap, range=self.range, band=self.band, nodata=self.nodata, held=self.held
        )

    @property
    def drawn(self) -> bool:
        """Whether anything of it can be seen."""
        return self.visible and self.opacity > 0

    @property
    def hides(self) -> bool:
        """Whether what lies below it cannot be told any more by its colour."""
        return self.visible and self.blend == "normal" and self.opacity > 0.5

    @classmethod
    def parse(cls, text: str) -> Layer:
        """A layer from the command line: ``PATH[,KEY=VALUE…]``, as in ``rain.tif,colormap=viridis,range=0:80``.

        Raises:
            UsageError: a key is unknown or its value makes no sense.
        """
        path, keys = keyed(text)
        if "path" in keys:
            raise UsageError("path is given twice.", path=text)
        values: dict[str, Any] = {"path": path, **keys}
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Layer:
        """A layer from its JSON: an object with ``path`` and any other attributes of ``Layer``.

        Raises:
            UsageError: something is missing, unknown or of the wrong kind; the message names it.
        """
        given = {k: v for k, v in values.items() if v is not None}
        path = given.get("path")
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise UsageError('A layer lacks its "path": a file.')
        for key in given:
            if key not in FIELDS:
                raise UsageError(f"A layer has no {key!r}.", path=path, remedy=remedy(key, FIELDS[1:]))
        try:
            for key in ("opacity", "nodata"):
                if key in given:
                    given[key] = _number(given[key], key)
            if "band" in given:
                given["band"] = _band(given["band"])
            if "visible" in given:
                given["visible"] = _truth(given["visible"])
            if "range" in given:
                given["range"] = _range(given["range"])
            for key in ("name", "blend", "colormap"):
                if key in given and not isinstance(given[key], str):
                    raise UsageError(f"The {key} must be a text, not {given[key]!r}.")
        except UsageError as error:
            raise UsageError(error.what, path=path, remedy=error.remedy) from error
        return cls(**given)

    def to_dict(self) -> dict[str, Any]:
        """What ``from_dict`` reads."""
        default = Layer(self.path)
        told = {name: getattr(self, name) for name in FIELDS}
        if told["colormap"] is not None:
            told["colormap"] = str(told["colormap"])
        told["range"] = None if self.range is None else list(self.range)
        return {k: v for k, v in told.items() if k == "path" or v != getattr(default, k)}

    def _error(self, what: str, remedy: str = "") -> UsageError:
        return UsageError(what, path=self.path, remedy=remedy)


FIELDS = tuple(f.name for f in fields(Layer) if f.compare)


def _band(given: Any) -> int | str:
    """A band's number or name, from JSON or the command line."""
    if isinstance(given, str) and not given.strip().lstrip("+-").replace(".", "", 1).isdigit():
        return given
    band = _number(given, "band")
    if band != int(band):
        raise UsageError(f"A band must be an integer or a name, not {band:g}.")
    return int(band)


def keyed(text: str) -> tuple[str, dict[str, str]]:
    """What stands before ``[,KEY=VALUE…]`` on the command line, a path that may hold commas, and the values by key.

    Raises:
        UsageError: a key is said twice.
    """
    path = text
    told: list[str] = []
    while not Path(path).exists() or path.startswith(PREFIX):
        head, comma, last = path.rpartition(",")
        if not comma or "=" not in last or not head:
            break
        path, told = head, [last, *told]
    values: dict[str, str] = {}
    for part in told:
        key, _, value = part.partition("=")
        key = key.strip().lower()
        if key in values:
            raise UsageError(f"{key} is given twice.", path=text)
        values[key] = value.strip()
    return path, values


Given = Any
"""A layer, or what becomes one: the path of an image, an array, a DataArray, an open dataset."""


def basemap(name: str, **options: Any) -> Layer:
    """A layer of a tile service, as ``--drape xyz:NAME`` has it.

    Args:
        name: of the xyzservices catalogue ("OpenTopoMap", "Esri.WorldImagery"), or a URL or a folder with {z}, {x} and
            {y}; "?apikey=…" after a name gives a service what it asks for.
        options: of ``Layer``: ``opacity``, ``blend``, ``name``…

    Returns:
        a ``Layer``, for ``layers=``.

    Raises:
        UsageError: there is no such service, or it asks for a token.
    """
    Basemap.of(name)
    return Layer(name if name.startswith(PREFIX) else PREFIX + name, **options)


def layers_of(given: Given | Iterable[Given] | None) -> tuple[Layer, ...]:
    """Layers, bottom to top, from what a user may give: one or several, each a ``Layer`` or a path.

    Raises:
        UsageError: there are more than ``MOST`` to be drawn.
    """
    if given is None:
        return ()
    several: Iterable[Given] = given if isinstance(given, list | tuple | Iterator) else [given]
    made = tuple(one if isinstance(one, Layer) else Layer(one) for one in several)
    check_count(made)
    return made


def check_count(layers: Iterable[Layer]) -> None:
    """Raise UsageError if more layers are to be drawn than a picture shows."""
    count = sum(layer.drawn for layer in layers)
    if count > MOST:
        raise UsageError(
            f"A picture shows at most {MOST} layers at once, not {count}.",
            remedy="Hide some of them, or merge images first (gdalbuildvrt, gdal_merge.py).",
        )


def drawn(layers: Iterable[Layer]) -> tuple[Layer, ...]:
    """Those that can be seen, bottom to top."""
    return tuple(layer for layer in layers if layer.drawn)


def attributed(own: Iterable[str], layers: Iterable[Layer]) -> tuple[str, ...]:
    """Whom a picture names: the makers of its heights, and of its layers, each once."""
    return tuple(dict.fromkeys([*own, *(one for layer in drawn(layers) for one in layer.attribution)]))


def found_beside(layers: Iterable[Layer], folder: Path) -> tuple[Layer, ...]:
    """Layers whose relative paths, where they name no file as they are, are taken from a folder."""
    return tuple(
        replace(layer, path=str(folder / layer.path))
        if not Path(layer.path).exists() and (folder / layer.path).exists()
        else layer
        for layer in layers
    )


def nothing_over(n: int) -> Colors:
    """What ``composite`` begins with: no layer at all over n places."""
    out = np.ones((n, 7), np.float32)
    out[:, :3] = 0
    return out


@kernel
def composite(image: Colors, opacity: float, multiply: bool, stack: Colors) -> None:
    """Lay an image's colours and opacities (n, 4) over what a stack of layers makes of the ground's own colours.

    That is linear in them: ``stack`` (n, 7) holds what is added (3), by what they are multiplied (3), and how much of
    them is seen between images that cover them (1).
    """
    one = np.float32(1.0)
    for i in range(len(image)):
        a = np.float32(image[i, 3] * opacity)
        for k in range(3):
            factor = one - a + a * image[i, k] if multiply else one - a
            stack[i, k] *= factor
            stack[i, 3 + k] *= factor
            if not multiply:
                stack[i, k] += image[i, k] * a
        if not multiply:
            stack[i, 6] *= one - a


def _number(value: Any, name: str) -> float:
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            raise UsageError(f"The {name} must be a number, not {value!r}.") from None
    return number(value, f"The {name}")


def _truth(value: Any) -> bool:
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    found = value if isinstance(value, bool) else words.get(str(value).lower())
    if found is None:
        raise UsageError(f"visible must be true or false, not {value!r}.")
    return found


def _range(value: Any) -> tuple[float, float]:
    ends = value.split(":") if isinstance(value, str) else list(value) if isinstance(value, list | tuple) else []
    if len(ends) != 2:
        raise UsageError(f"A range must be two values, LOW:HIGH, not {value!r}.")
    return _number(ends[0], "low end of the range"), _number(ends[1], "high end of the range")
