"""The files that determine a raster's samples, and their state, for fingerprints and records.

GDAL must open a file to list them, which takes as long as a small read; so the result of opening a file is kept.
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
    """Remember the files that determine a raster's samples, for ``files_of``.

    Only if all of them are on this disk, beside the raster, with its name.
    """
    folder, name = os.path.split(url_of(location) or location)
    stem = f"{folder}/{name.rpartition('.')[0] or name}.".lower()
    inside = (one == location or (url_of(one) or one).lower().startswith(stem) for one in names)
    if is_virtual(location) or not all(inside):
        _known.pop(location, None)
        return
    _known[location] = stamped(location), beside(location), list(dict.fromkeys([location, *sorted(names)]))


def files_of(location: str, known: frozenset[str] = frozenset()) -> list[str]:
    """All files that determine a raster's samples, by GDAL's names.

    They are its own, its companions (headers, masks), and a VRT's sources. Nothing is opened as long as the file and
    the names beside it are unchanged.

    Raises:
        ReadError: it cannot be opened.
    """
    from orograph.dem.whole.files import files_in
    from orograph.dem.whole.virtual import locations

    held = _known.get(location)
    if held is not None and held[0] == stamped(location) and held[1] == beside(location):
        return list(held[2])
    if held is not None:
        HANDLES.close(location)  # an open dataset would not see new companion files
    with HANDLES.borrow(location) as dataset:
        names, virtual = files_in(dataset), dataset.driver == "VRT"
        if virtual:
            names = [name for name in names if not name.lstrip().startswith("<")]  # VRTs nested in its text
            names += locations(dataset, stamped(location))
    found = dict.fromkeys([location, *sorted(names)])
    if virtual:
        for name in names:
            if name not in known and name != location:
                with contextlib.suppress(ReadError):  # a missing source matters only when it is read
                    found.update(dict.fromkeys(files_of(name, known | {location})))
    else:
        know(location, names)
    return list(found)


def states(names: Iterable[str]) -> list[str]:
    """The current state of files, one text for each: absolute name, size and modification time.

    Files not on this disk have only their name and a manifest's entry: requests to servers for all parts of a mosaic
    take longer than reading some of them.
    """
    from orograph.dem.whole.files import absolute, on_disk

    texts = []
    for name in names:
        try:
            found = on_disk(name).stat()
        except (OSError, ValueError):
            state = known(name)  # (a newly signed address means the same file)
            texts.append(public(name) if state is None else f"{public(name)} {state.size} {state.time_ns} {state.etag}")
        else:
            texts.append(f"{absolute(name)} {found.st_size} {found.st_mtime_ns}")
    return texts
