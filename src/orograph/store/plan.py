"""The plan of a build, ``build.json``, and what it resumes, replaces or must not touch where it is built."""

from __future__ import annotations

import json
from typing import Any

from orograph.error import ErrorKind
from orograph.errors import StoreError
from orograph.geo.grid import wkt_of
from orograph.store.chunked import Kind
from orograph.store.chunked_kind import CHUNKED
from orograph.store.coding import Coding
from orograph.store.diamond_table import DIAMONDS
from orograph.store.layout import FORMAT, Record
from orograph.store.places import PLAN, ROOT, UPDATE, begun, interrupted, is_store, left_over, missing, occupied
from orograph.store.quadtin_kind import QUADTIN
from orograph.store.source import HeightSource
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import read_record
from orograph.store.tin_kind import TINS


def plan_for(
    raster: HeightSource,
    shard: int,
    chunk: int,
    kinds: tuple[ErrorKind, ...],
    tins: int | None,
    chunked: Kind | None,
    quadtin: tuple[float, str] | None,
    keep_source: bool,
    coding: Coding | None,
) -> dict[str, Any]:
    grid = raster.grid
    return {
        "format": FORMAT,
        "source": raster.fingerprint(),
        "name": raster.name,
        "vertical": raster.vertical,
        "shape": list(grid.shape),
        "transform": list(grid.transform[:6]),
        "crs": wkt_of(grid.crs),
        "shard": shard,
        "chunk": chunk,
        "errors": list(kinds),
        "tins": tins,
        "chunked": None if chunked is None else list(chunked),
        "quadtin": None if quadtin is None else list(quadtin),
        "keep_source": keep_source,
        "codec": None if coding is None else coding.asked(),
    }


def plan_of(record: Record) -> dict[str, Any]:
    """The plan of a complete store."""
    grid = record.grid
    return {
        "format": FORMAT,
        "source": record.source,
        "name": record.name,
        "vertical": record.vertical,
        "shape": list(grid.shape),
        "transform": list(grid.transform[:6]),
        "crs": wkt_of(grid.crs),
        "shard": record.shard,
        "chunk": record.chunk,
        "errors": list(DIAMONDS.of(record).errors),
        "tins": TINS.of(record).get("legs"),
        "chunked": [of[name] for name in Kind._fields] if (of := CHUNKED.of(record)) else None,
        "quadtin": QUADTIN.of(record).get("asked"),
        "keep_source": bool(record.lattices),
        "codec": None if record.coding is None else record.coding.asked(),
    }


def check_replaceable(final: Storage, storage: Storage) -> None:
    """Raise StoreError if something other than a store, or a build of one, is there."""
    known = is_store(final) or begun(storage) or final.exists(f"heights/0/height/{ROOT}")  # its root may be damaged
    if occupied(final) and not known:
        raise StoreError(
            "Something is there that is not an Orograph store, and will not be overwritten.",
            path=final.url,
            remedy="Remove it, or choose another place.",
        )


def compared(final: Storage, storage: Storage, plan: dict[str, Any], resume: bool) -> tuple[dict[str, Any], bool]:
    """Return the plan to resume with, and whether there is nothing left to do.

    Raises:
        StoreError: something is there that this build cannot resume.
    """
    if storage.remote and storage.exists(UPDATE):
        raise interrupted(storage)
    if resume and begun(storage):
        data = storage.get(PLAN)
        if data is None:  # complete, except for its last rename
            before = plan_of(read_record(storage))
        else:
            try:
                before = json.loads(data)
            except ValueError:
                before = {}
        # The shard size depends on --max-memory, which may differ: the build keeps the size it began with.
        plan = {**plan, "shard": before.get("shard"), "chunk": before.get("chunk")}
        unlike = differing(plan, before)
        if unlike:
            raise StoreError(
                f"The interrupted build cannot be resumed: its {unlike} differ.",
                path=storage.url,
                remedy="Run it with the same files and options, or start over with `overwrite=True`.",
            )
        return plan, False
    if is_store(final):
        if not resume:
            if begun(storage) and not final.remote:
                raise _interrupted(final)
            raise StoreError("A store is there already.", path=final.url, remedy="Use `overwrite=True` to replace it.")
        before = plan_of(read_record(final))
        unlike = differing({**plan, "shard": before["shard"], "chunk": before["chunk"]}, before)
        if unlike:
            raise StoreError(
                f"A complete store of other sources or options is there: its {unlike} differ.",
                path=final.url,
                remedy="Use `overwrite=True` to replace it.",
            )
        return plan, True
    if isinstance(final, FolderStorage) and left_over(final.path):
        complete = is_store(storage) or not begun(storage)
        raise missing(final) if complete else _interrupted(final)
    if begun(storage):
        raise _interrupted(final)
    if occupied(final):
        raise StoreError(
            "Something is there that is not an Orograph store.", path=final.url, remedy="Choose another place."
        )
    return plan, False


def differing(plan: dict[str, Any], before: dict[str, Any]) -> str:
    """Name what differs between two plans; empty if nothing does."""
    names = {
        "source": "sources or options", "format": "store format", "errors": "kinds of errors", "tins": "TINs",
        "chunked": "chunks", "quadtin": "QuadTIN", "keep_source": "source samples to keep",
        "codec": "codec or largest error", "crs": "CRS", "vertical": "vertical datum", "shape": "size",
        "transform": "place",
    }  # fmt: skip
    return ", ".join(names.get(key, key) for key in plan if plan[key] != before.get(key))


def _interrupted(final: Storage) -> StoreError:
    return StoreError(
        "An interrupted build of this store is there.",
        path=final.url,
        remedy="Finish it with `resume=True`, or start over with `overwrite=True`.",
    )
