"""``orograph.build``: a store, with what methods need, baked light and color errors.

Its other keyword arguments are those of ``store.build.build``, which also provides their documentation.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack, cast, overload

from orograph._named import answering
from orograph.errors import UsageError
from orograph.folders import bytes_of
from orograph.reporting import reporting
from orograph.several import words
from orograph.store.build import build as build_store
from orograph.store.chunked import checked_kind
from orograph.store.quadtin_kind import checked_quadtin
from orograph.store.stored import StoredTerrain
from orograph.store.typed import Building
from orograph.verbs.needed import Needed, needed_by

if TYPE_CHECKING:
    from orograph.error import ErrorKind


class Completing(Building, total=False):
    """The options of ``build`` but for ``part``, as type checkers know them."""

    methods: Sequence[str] | str
    products: Sequence[str] | str
    color_errors: bool
    drape: str | os.PathLike[str] | None


@overload
def build(source: Any, url: str | os.PathLike[str], *, part: str | tuple[int, int], **options: Any) -> None: ...


@overload
def build(
    source: Any, url: str | os.PathLike[str], *, part: None = None, **options: Unpack[Completing]
) -> StoredTerrain: ...  # fmt: skip


@overload
def build(
    source: Any, url: str | os.PathLike[str], *, part: str | tuple[int, int] | None, **options: Any
) -> StoredTerrain | None: ...  # fmt: skip


@answering
def build(
    source: Any,
    url: str | os.PathLike[str],
    *,
    methods: Sequence[str] | str = (),
    products: Sequence[str] | str = (),
    color_errors: bool = False,
    drape: str | os.PathLike[str] | None = None,
    **options: Any,
) -> StoredTerrain | None:
    """See below.

    Args:
        methods: also store what these methods need: "soar", or several with their options (["roam,error=wedgie",
            "bdam"]); ``orograph.methods()`` lists them.
        products: also bake this light, as ``orograph.bake`` does: ["sky-view-factor", "aperture"], or a text of them.
        color_errors: also store how much coarser triangles change the lit colours, for methods with a
            ``color_tolerance``. drape: the image that gives them; None: the tint of heights does.
    """
    baked = words(products)
    check_completing(baked, color_errors, drape, options.get("part"))
    heard = options["progress"] = reporting(options.get("progress"))
    given = options.get("chunked"), options.get("quadtin")
    asked = Needed(
        cast("tuple[ErrorKind, ...]", words(options.get("errors", ("exact",)))),  # (``build_store`` checks them)
        options.get("tins"),
        None if given[0] is None else checked_kind(given[0]),
        None if given[1] is None else checked_quadtin(given[1]),
    )
    needed = needed_by((methods,) if isinstance(methods, str) else methods, heard, asked)
    terrain: StoredTerrain | None = build_store(source, url, **{**options, **needed._asdict()})
    shared = ("max_memory", "jobs", "storage_options", "workers", "dask", "progress")
    how = {name: options[name] for name in shared if name in options}
    if terrain is not None and baked:
        from orograph.lighting.bake import bake

        terrain.close()
        terrain = bake(terrain.url, baked, **how)
    if terrain is not None and color_errors:
        from orograph.geovis.color_store import store_colors

        terrain.close()
        memory = {} if "max_memory" not in how else {"max_memory": bytes_of(how["max_memory"])}
        terrain = store_colors(terrain.url, drape, **{**how, **memory})
    return terrain


def check_completing(
    products: Sequence[str], color_errors: bool, drape: str | os.PathLike[str] | None, part: Any
) -> None:  # fmt: skip
    """Raise UsageError if what a store is completed with makes no sense."""
    if drape is not None and not color_errors:
        raise UsageError("`drape` is only used with `color_errors`.", remedy="Give `color_errors=True`, too.")
    if part is not None and (products or color_errors):
        raise UsageError("`part` makes heights only.", remedy="Give `products` and `color_errors` with `finish`.")
    if products:
        from orograph.lighting.bake import check

        check(products)


def _document() -> None:
    """Give ``build`` the signature and the documentation of ``store.build.build``, with its own options."""
    own, all_ = inspect.signature(build), inspect.signature(build_store)
    more = [one for one in own.parameters.values() if one.name not in all_.parameters]
    *others, rest = all_.parameters.values()
    setattr(build, "__signature__", own.replace(parameters=[*others, *more, rest]))  # noqa: B010
    if build.__doc__ is not None and build_store.__doc__ is not None:  # (there is none with -OO)
        before, _, after = build_store.__doc__.partition("        options: ")
        own_args = build.__doc__.partition("Args:\n")[2].rstrip()
        build.__doc__ = f"{before}        {own_args.lstrip()}\n        options: {after}"


_document()
