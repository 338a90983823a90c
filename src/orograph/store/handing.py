"""How other processes get the source of a build: they open its files, and reuse what took long to compute.

Such arrays (the triangulation of points, an example with its similar places, the headers of many files) are in
``parts/handed/source`` while the store is built. Workers map them, so those of one machine share the memory. Parts of a
build leave them there for later parts and for the final step.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.progress import Progress
from orograph.store.given import files_of
from orograph.store.inputs import LINES, opened, state_of
from orograph.store.places import HANDED, PLAN
from orograph.store.source import HeightSource
from orograph.store.storage import FolderStorage, Storage

PLACE = f"{HANDED}/source"
LEFT = f"{PLACE}/left.json"
"""The arrays that a part has stored, with their files and options."""

SEVERAL = 64
"""Files that workers need not open for their headers."""

Arrays = Mapping[str, NDArray[Any]]
Kinds = dict[str, tuple[str, tuple[int, ...]]]
"""The type and shape of arrays by their names."""


class Again(Protocol):
    """Opens a source in another process; it can be pickled."""

    def open(self, made: Arrays) -> HeightSource:
        """The source. Args: made: the arrays that took long to compute."""


class Files(NamedTuple):
    """Opens rasters or points from their files (``inputs.opened``)."""

    files: list[str]
    options: dict[str, Any]

    def open(self, made: Arrays) -> HeightSource:
        return opened(self.files, self.options, made=made)


def again_of(raster: HeightSource) -> tuple[Again, Arrays] | None:
    """How another process opens a source, and with which arrays; None if its heights are only in this process."""
    if (own := getattr(raster, "again", None)) is not None:
        found: tuple[Again, Arrays] = own()
        return found
    recipe = getattr(raster, "recipe", lambda: None)()
    if recipe is None:
        return None
    files, options = recipe
    if named := getattr(raster, "named", ()):  # a manifest, so that workers need not open every file
        files, options = list(named), {**options, "skip_damaged": bool(getattr(raster, "skipped", ()))}
    here = [str(Path(path).absolute()) if Path(path).exists() else path for path in files]
    made = next((each.made() for each in _parts(raster) if hasattr(each, "made")), None)
    return Files(here, options), _headers(raster, named) if made is None else made


def _headers(raster: Any, named: Sequence[str]) -> Arrays:
    """The lines of a manifest of a mosaic of many files, if it was not opened by one."""
    from orograph.dem.describing import brief
    from orograph.dem.source import Source

    sources = getattr(raster, "sources", ())
    if named or len(sources) < SEVERAL or not all(isinstance(source, Source) for source in sources):
        return {}
    text = "\n".join(brief(source, raster.reading) for source in sources)
    return {LINES: np.frombuffer(text.encode(), np.uint8)}


def _parts(raster: HeightSource) -> list[Any]:
    """A source, and the sources that it is made from."""
    return [raster, *getattr(raster, "sources", ())]


def leave(storage: Storage, made: Arrays) -> Kinds:
    """Write arrays for other processes."""
    for name, array in made.items():
        data: Any = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
        storage.put(f"{PLACE}/{name}", [data])
    return {name: (array.dtype.str, array.shape) for name, array in made.items()}


def take(storage: Storage, kinds: Kinds) -> dict[str, NDArray[Any]]:
    """The arrays that another process has stored."""
    # (Not read-only, for which kernels would be compiled once more.)
    found: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in kinds.items():
        key = f"{PLACE}/{name}"
        if isinstance(storage, FolderStorage) and 0 not in shape:
            found[name] = np.asarray(np.memmap(storage.path / key, dtype, "c", shape=shape))
        else:
            found[name] = np.frombuffer(bytearray(storage.get(key) or b""), dtype).reshape(shape)
    return found


def leave_for_parts(storage: Storage, given: Any, options: Mapping[str, Any], raster: HeightSource) -> None:
    """Store, for other parts of a build, what took long to compute from the given files, if anything did.

    Args:
        given, options: what ``raster`` was made from.
    """
    files, skipped = files_of(given), bool(getattr(raster, "skipped", ""))
    if files is None or skipped:
        return
    state = _state(files, options)
    found = None if _left(storage).get("state") == state else again_of(raster)
    if found is not None and found[1]:
        storage.put(LEFT, [json.dumps({"state": state, "kinds": leave(storage, found[1])}).encode()])


def left_by_parts(
    storage: Storage, given: Any, options: Mapping[str, Any], progress: Progress
) -> HeightSource | None:  # fmt: skip
    """A source from what another part has stored; None if no part has, or files have changed since."""
    begun = storage.get(PLAN) is not None  # so that a bucket knows where in ``parts/`` to read
    left = _left(storage) if begun else {}
    files = files_of(given) if left else None
    if files is None or left["state"] != _state(files, options):
        return None
    kinds = {name: (dtype, tuple(shape)) for name, (dtype, shape) in left["kinds"].items()}
    reading = {name: value for name, value in options.items() if value is not None}
    return opened(files, reading, progress, take(storage, kinds))


def _left(storage: Storage) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(storage.get(LEFT) or b"{}")
    return found


def _state(files: Sequence[str], options: Mapping[str, Any]) -> str:
    """A hash of the states of files on this disk, their names, and the options of reading."""
    state = [state_of(path) for path in files], sorted((k, repr(v)) for k, v in options.items() if v is not None)
    return hashlib.sha256(json.dumps(state).encode()).hexdigest()
