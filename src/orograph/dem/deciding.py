"""Which files decide a raster's samples, and what state they are in: what fingerprints and records are made of.

Asking GDAL takes an opening, as long as a small read; so what was found when a file was opened is kept.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence

from orograph.dem.asking import known, url_of
from orograph.dem.folders import beside
from orograph.dem.handles import HANDLES, Key, stamped
from orograph.dem.pool import is_virtual
from orograph.errors import ReadError, public

_known: dict[str, tuple[Key, list[str], list[str]]] = {}


def know(location: str, names: Sequence[str]) -> None:
    """Keep what files decide a raster's samples, for ``files_of``, if all on this disk lie beside it under its name."""
    folder, name = os.path.split(url_of(location) or location)
    stem = f"{folder}/{name.rpartition('.')[0] or name}.".lower()
    inside = (one == location or (url_of(one) or one).lower().startswith(stem) for one in names)
    if is_virtual(location) or not all(inside):
        _known.pop(location, None)
        return
    _known[location] = stamped(location), beside(location), list(dict.fromkeys([location, *sorted(names)]))


def files_of(location: str, known: frozenset[str] = frozenset()) -> list[str]:
    """All files that decide a raster's samples: its own, those beside it (headers, masks), and of a VRT its sources',
    by GDAL's names of them. Nothing is opened as long as the file, and the names beside it, are what they were.

    Raises:
        ReadError: it cannot be opened.
    """
    from orograph.dem.whole.files import files_in
    from orograph.dem.whole.virtual import locations

    held = _known.get(location)
    if held is not None and held[0] == stamped(location) and held[1] == beside(location):
        return list(held[2])
    if held is not None:
        HANDLES.close(location)  # an open dataset would not see what has come to lie beside it
    with HANDLES.borrow(location) as dataset:
        names, virtual = files_in(dataset), dataset.driver == "VRT"
        if virtual:
            names = [name for name in names if not name.lstrip().startswith("<")]  # VRTs in its text
            names += locations(dataset, stamped(location))
    found = dict.fromkeys([location, *sorted(names)])
    if virtual:
        for name in names:
            if name not in known and name != location:
                with contextlib.suppress(ReadError):  # a source that is not there matters when it is read
                    found.update(dict.fromkeys(files_of(name, known | {location})))
    else:
        know(location, names)
    return list(found)


def states(names: Iterable[str]) -> list[str]:
    """What files are now, a text for each: absolute name, size and time of change. Of what is not on this disk its name
    alone, and what a manifest said of it: to ask servers for all parts of a mosaic takes longer than to read some of
    them."""
    from orograph.dem.whole.files import absolute, on_disk

    said = []
    for name in names:
        try:
            found = on_disk(name).stat()
        except (OSError, ValueError):
            told = known(name)  # (an address that is signed anew means the same file)
            said.append(public(name) if told is None else f"{public(name)} {told.size} {told.time_ns} {told.etag}")
        else:
            said.append(f"{absolute(name)} {found.st_size} {found.st_mtime_ns}")
    return said
