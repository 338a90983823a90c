"""What methods need of a store: the ``methods`` of ``orograph.build``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from orograph.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from orograph.error import ErrorKind
    from orograph.progress import Progress
    from orograph.store.chunked import Kind


class Needed(NamedTuple):
    """What to store, as arguments of ``orograph.build``.

    Attributes:
        errors: kinds of errors of diamonds. tins: segments of the patches whose TINs are stored. chunked: the kind of
            chunks. quadtin: error and splitting of a QuadTIN. None: not stored.
    """

    errors: tuple[ErrorKind, ...] = ()
    tins: int | None = None
    chunked: Kind | None = None
    quadtin: tuple[float, str] | None = None


def needed_by(methods: Sequence[str], progress: Progress, asked: Needed) -> Needed:
    """What methods need, with what is ``asked`` for besides.

    Raises:
        UsageError: one of them is not a method, or two need different TINs, chunks or QuadTINs.
    """
    if not methods:
        return asked
    from orograph.lod.needs import kinds_of
    from orograph.lod.registry import chosen
    from orograph.store.chunked import Kind
    from orograph.store.patches import LEGS

    found: dict[ErrorKind, None] = dict.fromkeys(asked.errors)
    tins = {} if asked.tins is None else {asked.tins: None}
    chunked: dict[Kind, None] = {} if asked.chunked is None else {asked.chunked: None}
    quadtin = {} if asked.quadtin is None else {asked.quadtin: None}
    for text in methods:
        choice = chosen(text)
        needs = choice.method.needs(choice.options)
        found.update(dict.fromkeys(kinds_of(needs)))
        tins.update(dict.fromkeys(need.options["legs"] for need in needs if need.name == "tins"))
        chunked.update(dict.fromkeys(Kind(**need.options) for need in needs if need.name == "chunked"))
        quadtin.update(
            dict.fromkeys((need.options["finest"], need.options["split"]) for need in needs if need.name == "quadtin")
        )
        if any(need.name == "patches" and need.options["legs"] != LEGS for need in needs):
            progress.note(f"{choice}: stores have errors of patches with {LEGS} segments; others are made when needed.")
        if getattr(choice.options, "color_tolerance", None) is not None:
            progress.note(f"{choice}: store errors of colours with `color_errors=True`.")
    if len(tins) > 1:
        raise UsageError(
            f"A store has TINs of one kind only, not of {' and '.join(map(str, tins))} segments.",
            remedy="Ask for those of one kind.",
        )  # fmt: skip
    if len(chunked) > 1:
        sizes = " and ".join(
            f"{cells} cells from {finest:g} m on{', compressed' if compressed else ''}"
            for cells, finest, compressed in chunked
        )
        raise UsageError(f"A store has chunks of one kind only, not of {sizes}.", remedy="Ask for those of one kind.")
    if len(quadtin) > 1:
        kinds = " and ".join(f"finest={finest:g},split={split}" for finest, split in quadtin)
        raise UsageError(f"A store has only one QuadTIN, not {kinds}.", remedy="Ask for one.")
    return Needed(tuple(found), next(iter(tins), None), next(iter(chunked), None), next(iter(quadtin), None))
