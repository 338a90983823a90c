"""A .prj beside a raster with Arc's keywords from before WKT: the parts that GDAL ignores.

``Projection UTM``, ``Zone 33``, ``Zunits FEET``, ``Units METERS``, ``Xshift 0.0``, then ``Parameters``: GDAL makes a
CRS from it, without the unit of heights and without the shifts.

Source: ArcInfo's PROJECTDEFINE and PROJECT commands, as their manual lists the keywords.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from orograph.dem.whole.files import here, main_file
from orograph.errors import ReadError

_UNITS = {"FEET": "ft", "METERS": "m", "NO": ""}


def notes(dataset: Any) -> Path | None:
    """The .prj beside a raster on this disk; None if there is none."""
    name = main_file(dataset)
    if not here(name):
        return None
    return next((f for e in (".prj", ".PRJ") if (f := Path(name).with_suffix(e)).is_file()), None)


def unit_of_heights(dataset: Any) -> str:
    """The unit that an old .prj gives heights (Zunits); "" if none does, or it is a number.

    Raises:
        ReadError: it shifts coordinates, which GDAL does not do.
    """
    words = _words(dataset)
    for key in ("XSHIFT", "YSHIFT"):
        if re.search(r"[1-9]", words.get(key, "")):
            raise ReadError(
                f"The CRS beside it says that coordinates are shifted ({key.title()} {words[key]}), which is not "
                "supported.",
                path=notes(dataset), remedy="Move the raster (gdal_translate -a_ullr), then set the shifts to 0.",
            )  # fmt: skip
    return _UNITS.get(words.get("ZUNITS", "").upper(), "")


def _words(dataset: Any) -> dict[str, str]:
    file = notes(dataset)
    if file is None:
        return {}
    text = file.read_text("latin-1")
    if not re.match(r"\s*Projection\s", text, re.I):
        return {}
    lines = (line.split(maxsplit=1) for line in text.partition("Parameters")[0].splitlines())
    return {parts[0].upper(): parts[1].strip() for parts in lines if len(parts) == 2}
