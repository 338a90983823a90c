"""Open elevation products: where their tiles are, how they are named, and what they contain.

The table is ``products.toml``. A file of the same form (TOML or JSON), named by ``$OROGRAPH_PRODUCTS`` or an option,
adds products and changes fields of known ones (``base`` of a mirror, say); ``register`` does so from Python.
"""

from __future__ import annotations

import json
import os
import string
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from orograph.documents import parse
from orograph.errors import ReadError, UsageError

TABLE = "OROGRAPH_PRODUCTS"
"""The environment variable that names a file of products."""

CHOICES = {
    "tiling": ("degrees", "web-mercator", "one"),
    "registration": ("point", "area"),
    "corner": ("sw", "nw"),
    "absent": ("sea", "missing"),
    "model": ("surface", "terrain"),
    "body": ("Earth", "Mars", "Moon"),
    "dtype": ("int16", "float32"),
    "encoding": ("", "terrarium", "mapbox"),
}
"""Fields with a fixed choice of words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Product:
    """An elevation product.

    Attributes:
        name: its identifier. title: for people.
        base, url: where its tiles lie. ``url`` is a format of {base}, {NS}, {EW}, {ns}, {ew} (letters of the
            hemispheres), {lat}, {lon} (whole degrees, without sign), {folder}, {z}, {x}, {y}.
        member: of tiles that are zip archives, the file within, a format like ``url``.
        tiling: "degrees", "web-mercator" (z/x/y), or "one" file.
        spacing: between rows: arc-seconds of degrees, metres of one file.
        registration: "point": samples lie on whole multiples of the spacing; "area": cells do.
        shared: whether a tile's last row and column are also the next tile's first.
        side: degrees of a tile. corner: which corner names it.
        widths: (latitude, factor): the ratio of column to row spacing from this latitude polewards.
        folders: (latitude, name): {folder} of tiles from this latitude northwards.
        extent: west, south, east, north of what it covers, degrees.
        crs: of its samples; of one file its own. body: "Earth", "Mars" or "Moon".
        dtype: of its numbers. nodata: that means "missing", if not what its files declare. scale: metres of one.
        encoding: how colours hold heights, "" if they do not.
        zoom, most_zoom: of web-mercator tiles: usual, and deepest.
        absent: the meaning of an absent tile: "sea" (0 m) or "missing". absent_codes: the status codes of absent tiles.
        witness: a product whose tile at the same place, if it exists, proves that an absent one is not sea.
        vertical: the vertical datum: an EPSG code, a name, "" if it is not one.
        model: "surface" (with trees and houses) or "terrain".
        years: when it was measured. licence, attribution: as its makers require. home: its page.
        account: the account that it needs, "" for none; machine: its name in ~/.netrc.
        sample: longitude and latitude of a place that it covers (``--try-products``).
    """

    name: str
    title: str
    base: str
    url: str
    attribution: str
    licence: str
    member: str = ""
    tiling: str = "degrees"
    spacing: float = 1.0
    registration: str = "point"
    shared: bool = False
    side: int = 1
    corner: str = "sw"
    widths: tuple[tuple[float, float], ...] = ((0, 1),)
    folders: tuple[tuple[float, str], ...] = ()
    extent: tuple[float, float, float, float] = (-180, -90, 180, 90)
    crs: str = "EPSG:4326"
    body: str = "Earth"
    dtype: str = "float32"
    nodata: str | None = None
    scale: float = 1.0
    encoding: str = ""
    zoom: int = 12
    most_zoom: int = 15
    absent: str = "missing"
    absent_codes: tuple[int, ...] = (404,)
    witness: str = ""
    vertical: str = ""
    model: str = "surface"
    years: str = ""
    home: str = ""
    account: str = ""
    machine: str = ""
    sample: tuple[float, float] = (0.5, 0.5)

    @property
    def datum(self) -> str | None:
        """The name of the vertical datum; None if it has none."""
        if not self.vertical.upper().startswith("EPSG:"):
            return self.vertical or None
        from pyproj import CRS

        return str(CRS.from_user_input(self.vertical).name)

    @property
    def by_file(self) -> bool:
        """Whether its tiles can only be read whole: compressed, or pictures."""
        return bool(self.member or self.encoding) or self.url.endswith((".gz", ".zip"))

    def width(self, south: float, north: float) -> float:
        """The ratio of column to row spacing in a tile between two latitudes."""
        nearest = 0.0 if south < 0 < north else min(abs(south), abs(north))
        return max((entry for entry in self.widths if entry[0] <= nearest), key=lambda entry: entry[0])[1]


_FORMAT = {"NS", "EW", "ns", "ew", "lat", "lon", "folder", "z", "x", "y"}
_registered: dict[str, dict[str, Any]] = {}


def register(name: str, **given: Any) -> Product:
    """Add a product, or change fields of a known one, for this process.

    Args:
        name: of the product.
        given: its fields (``Product``), and ``like``, the product that supplies all others.

    Raises:
        UsageError: a field is unknown, missing or wrong.
    """
    before = _registered.get(name, {})
    _registered[name] = {**before, **given}
    try:
        return products()[name]
    except UsageError:
        _registered[name] = before
        if not before:
            del _registered[name]
        raise


def products(table: str | os.PathLike[str] | None = None) -> dict[str, Product]:
    """All products by their names.

    Args:
        table: a file of more of them (TOML or JSON); None: that of ``$OROGRAPH_PRODUCTS``, if it is set.

    Raises:
        ReadError: the file cannot be read. UsageError: it has a field that is unknown, missing or wrong.
    """
    path = table or os.environ.get(TABLE)
    entries = {name: dict(entry) for name, entry in _built_in().items()}
    for more in (_loaded(path) if path else {}, _registered):
        for name, entry in more.items():
            entries[name] = {**entries.get(name, {}), **entry}
    try:
        return {name: _made(name, entries) for name in entries}
    except UsageError as error:
        raise UsageError(error.what, path=path, remedy=error.remedy) from None


def product_named(name: str, table: str | os.PathLike[str] | None = None) -> Product:
    """One product.

    Raises:
        UsageError: there is no such product. Others: as ``products``.
    """
    known = products(table)
    if name not in known:
        raise UsageError(
            f"There is no product {name!r}; the products are {', '.join(known)}.",
            remedy=f"Choose one, or add yours in a file that {TABLE} names.",
        )
    return known[name]


@cache
def _built_in() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name("products.toml").read_text(encoding="utf-8"))


def _loaded(path: str | os.PathLike[str]) -> dict[str, dict[str, Any]]:
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        found = parse(text) if Path(path).suffix.lower() == ".json" else tomllib.loads(text)
    except OSError as error:
        raise ReadError(f"The table of products cannot be read: {error.strerror}.", path=path) from None
    except (ValueError, json.JSONDecodeError) as error:
        raise ReadError(f"The table of products does not match its file ending: {error}.", path=path) from None
    if not isinstance(found, dict) or not all(isinstance(entry, dict) for entry in found.values()):
        raise ReadError("A table of products must have fields under each product's name.", path=path)
    return found


def _made(name: str, entries: Mapping[str, Mapping[str, Any]], below: frozenset[str] = frozenset()) -> Product:
    """A product from its entry and the product that it resembles."""
    values = _values(name, entries, below)
    known = {field.name: field for field in fields(Product)}
    if unknown := sorted(set(values) - set(known)):
        raise UsageError(f"The product {name} has no field {unknown[0]!r}; there are {', '.join(known)}.")
    needed = [key for key, field in known.items() if field.default is MISSING and key != "name"]
    if missing := [key for key in needed if not values.get(key)]:
        raise UsageError(f"The product {name} lacks {', '.join(missing)}.")
    made: dict[str, Any] = {}
    for key, value in values.items():
        like = known[key].default
        if isinstance(like, tuple):
            if not isinstance(value, (list, tuple)):
                raise UsageError(f"{key} of the product {name} must be a list, not {value!r}.")
            made[key] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
        elif isinstance(like, (bool, int, float)):
            if not isinstance(value, (int, float)):
                raise UsageError(f"{key} of the product {name} must be a number, not {value!r}.")
            made[key] = type(like)(value)
        else:
            made[key] = str(value)
        if key in CHOICES and made[key] not in CHOICES[key]:
            raise UsageError(f"{key} of the product {name} must be one of {', '.join(CHOICES[key])}, not {value!r}.")
    _check_rule(name, made)
    return Product(**{**made, "name": name})


def _values(name: str, entries: Mapping[str, Mapping[str, Any]], below: frozenset[str]) -> dict[str, Any]:
    entry = dict(entries[name])
    like = entry.pop("like", None)
    if like is None:
        return entry
    if like not in entries or like in below | {name}:
        raise UsageError(f"The product {name} is like {like!r}, which is not another product.")
    return {**_values(like, entries, below | {name}), **entry}


def _check_rule(name: str, made: Mapping[str, Any]) -> None:
    if not made["base"].startswith(("http://", "https://")):
        raise UsageError(f"base of the product {name} must be an http or https URL, not {made['base']!r}.")
    if made.get("spacing", 1.0) <= 0:
        raise UsageError(f"spacing of the product {name} must be more than 0, not {made['spacing']:g}.")
    for key in ("url", "member"):
        try:
            used = {part for _, part, _, _ in string.Formatter().parse(made.get(key, "")) if part is not None}
        except ValueError as error:
            raise UsageError(f"{key} of the product {name} is not a valid rule: {error}.") from None
        if unknown := sorted(used - _FORMAT - {"base"}):
            raise UsageError(f"{key} of the product {name} has {{{unknown[0]}}}; there are {sorted(_FORMAT)}.")
