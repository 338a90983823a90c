"""Rasters of classes (land cover): integers that stand for names, without values in between.

Each texel of an image has the class of the sample nearest to it; where samples are smaller than texels, the class that
most of a lattice of places in it have (the mode). Names and colours are those of a raster attribute table or of
GDAL's categories, else names those of CF's ``flag_values`` and ``flag_meanings``, colours those of a colour table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from affine import Affine

from orograph._named import remedy
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose
from orograph.geovis.data.attribute_table import Named
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.sampling import Positions
from orograph.geovis.tables import DISTINCT

MOST = 64
"""Maximum classes of a picture: more do not fit into a legend."""

FINEST = 4
"""Places along a texel's side whose classes are counted."""


@dataclass(frozen=True, slots=True)
class ClassTable:
    """What the numbers of a raster mean: names and colours (#rrggbb) by number, as far as its source says."""

    names: Mapping[int, str]
    colors: Mapping[int, str]

    @classmethod
    def of_tags(
        cls, tags: Mapping[str, Any], palette: Mapping[int, Any] | None = None, named: Named | None = None
    ) -> ClassTable:  # fmt: skip
        """Of CF attributes, a colour table of numbers from 0 to 255, and what a file beside the raster says."""
        values = [int(float(v)) for v in re.findall(r"-?\d+(?:\.\d+)?", _listed(tags.get("flag_values", "")))]
        words = str(tags.get("flag_meanings", "")).split()
        names = {k: word.replace("_", " ") for k, word in zip(values, words)}
        colors = {k: "#{:02x}{:02x}{:02x}".format(*rgb[:3]) for k, rgb in (palette or {}).items()}
        return cls(names, colors) if named is None else cls(names | {**named.names}, colors | {**named.colors})


def _listed(told: Any) -> str:
    return told if isinstance(told, str) else " ".join(map(str, np.atleast_1d(told)))


def says_classes(field: Field) -> bool:
    """Whether a source says by itself that its numbers are classes: by a colour table, CF's flags, or a table or names
    beside it; or they seem to be codes."""
    return len(field.values) == 1 and field.classified


def classes_over(field: Field, over: Grid) -> Values:
    """The numbers (rows, cols) of classes at the texels of an image; NaN where none is known."""
    corner = Grid((2, 2), over.transform, over.crs)
    at = Positions.of(corner, field)
    fine = float(max(np.hypot(at.c[0, 1] - at.c[0, 0], at.r[0, 1] - at.r[0, 0]),
                     np.hypot(at.c[1, 0] - at.c[0, 0], at.r[1, 0] - at.r[0, 0])))  # fmt: skip
    side = int(np.clip(np.ceil(fine), 1, FINEST))
    layers = []
    for i in range(side):
        for j in range(side):
            shift = Affine.translation((j + 0.5) / side - 0.5, (i + 0.5) / side - 0.5)
            layers.append(Positions.of(Grid(over.shape, compose(over.transform, shift), over.crs), field)
                          .nearest(field.values[0]))  # fmt: skip
    return layers[0] if side == 1 else mode(np.stack(layers))


def mode(votes: Values) -> Values:
    """Of votes (n, rows, cols) the most frequent number of each place, of equally frequent ones the least; NaN too."""
    known = np.unique(votes[np.isfinite(votes)])
    best = np.isnan(votes).sum(0)
    found = np.full(votes.shape[1:], np.nan, np.float32)
    for number in known:
        count = (votes == number).sum(0)
        better = (count > best) | ((count == best) & np.isnan(found) & (count > 0))
        best, found = np.where(better, count, best), np.where(better, number, found).astype(np.float32)
    return found


def numbered(
    values: Values, table: ClassTable, colors: Any, named: Mapping[Any, str], name: str
) -> tuple[Values, tuple[str, ...], dict[str, str]]:
    """Classes numbered from 0, their names, and their colours by name.

    Args:
        colors: the user's own, by name or number, where it is a mapping. named: the user's own names by number.

    Raises:
        ReadError: the values are not classes: not integers, or too many. UsageError: a colour is of no class.
    """
    known = np.unique(values[np.isfinite(values)])
    if (known != np.rint(known)).any() or len(known) > MOST:
        what = "whole numbers" if (known != np.rint(known)).any() else f"at most {MOST}, not {len(known)}"
        raise ReadError(f"Classes must be {what}.", path=name, remedy="Choose another style, such as segmented.")
    codes = [int(v) for v in known]
    table = replace(table, names={**table.names, **{int(code): word for code, word in named.items()}})
    names = [table.names.get(code, str(code)) for code in codes]
    names = [word if names.count(word) == 1 else f"{word} ({code})" for word, code in zip(names, codes)]
    own = own_colors(colors, {**table.names, **dict(zip(codes, names))}, name)
    usual = [table.colors.get(code, DISTINCT[k % len(DISTINCT)]) for k, code in enumerate(codes)]
    found = np.where(np.isfinite(values), np.searchsorted(known, values), np.nan).astype(np.float32)
    return found, tuple(names), {word: own.get(word, color) for word, color in zip(names, usual)}


def own_colors(given: Any, names: Mapping[int, str], source: str) -> dict[str, str]:
    """The user's colours by name, given by name or number; nothing where the colour map is no mapping.

    Args:
        names: of the classes that there are, by number.

    Raises:
        UsageError: one is of no class. (A number may be one that does not occur here.)
    """
    if not isinstance(given, Mapping):
        return {}
    found, known = {}, list(dict.fromkeys(names.values()))
    for key, color in given.items():
        if key in known:
            found[key] = color
        elif re.fullmatch(r"-?\d+", str(key)):
            found[names.get(int(key), str(key))] = color
        else:
            raise UsageError(f"There is no class {key!r} to colour.", path=source, remedy=remedy(str(key), known))
    return found
