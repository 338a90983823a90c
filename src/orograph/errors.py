"""The errors Orograph raises on purpose, each one paragraph: what happened, to which file, what to do about it.

The command line prints them without a traceback (unless ``--debug``) and exits with ``exit_code``:

====  ==================================================================
code  meaning
====  ==================================================================
0     the job is done and its result is where the command said
1     a fault of Orograph itself (please report it, with ``--debug``), or a bound that compare finds broken
2     the command line is wrong
3     an input cannot be read, or does not say what is needed of it
4     an output or a store cannot be written, is damaged or incomplete
5     there is nothing to draw: no valid terrain in view
6     there is no GPU that can be used, and it was asked for
130   interrupted (Ctrl-C); nothing half-written is left behind
====  ==================================================================
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

_SECRETS = re.compile(
    r"""(\b[a-z][a-z0-9+.-]*://)      # of a URL
        (?:[^\s/@'"]*@)?            # user and password,
        ([^\s?'"<>]*)
        (?:\?[^\s'"<>]*?(?=[.,;:]?(?:[\s'"<>]|$)))?  # and the query (but not a sentence's end)
    """,
    re.VERBOSE | re.IGNORECASE,
)


def public(text: str) -> str:
    """A text without what may be secret in its URLs: user, password and query, which signatures are in."""
    return _SECRETS.sub(r"\1\2", text) if "://" in text else text


class OrographError(Exception):
    """An expected failure.

    Args:
        what: what happened, a full sentence.
        path: the file or store it happened to, if any.
        remedy: what the user can do, a full sentence.
    """

    exit_code = 1

    def __init__(self, what: str, *, path: str | os.PathLike[str] | None = None, remedy: str = "") -> None:
        self.what = public(what)
        self.path = None if path is None else public(os.fspath(path))
        self.remedy = public(remedy)
        super().__init__(str(self))

    def __str__(self) -> str:
        head = f"{self.path}: {self.what}" if self.path else self.what
        return f"{head} {self.remedy}".strip()


class UsageError(OrographError):
    """Arguments that contradict each other or cannot be understood."""

    exit_code = 2


class ReadError(OrographError):
    """An input that cannot be read, or lacks something that is needed (a CRS, valid samples…)."""

    exit_code = 3


class StoreError(OrographError):
    """A store that cannot be written, opened or trusted."""

    exit_code = 4


class StoreBusyError(StoreError):
    """Another process is writing to a store."""


class DamagedChunkError(StoreError):
    """A chunk of a store fails its checksum or cannot be decoded; ``chunk`` is its key within the store."""

    def __init__(self, chunk: str, *, path: str | os.PathLike[str] | None = None, cause: str = "") -> None:
        self.chunk = chunk
        self.cause = cause
        if chunk.startswith("layers/"):
            remedy = "Bake that layer again (`orograph.bake(..., overwrite=True)`), or restore that file from a copy."
        else:
            remedy = (
                "Mend the store from its sources (`orograph.store.repair.repair`), or restore that file from a copy."
            )
        super().__init__(f"Chunk {chunk} is damaged{': ' + cause if cause else ''}.", path=path, remedy=remedy)


class StoreReplacedError(StoreError):
    """The store that is read was replaced since it was opened; ``reopen()`` opens the one that is there now."""


class OutputError(OrographError):
    """A result that cannot be written."""

    exit_code = 4


class NothingInViewError(OrographError):
    """The picture would be empty: no valid terrain in view."""

    exit_code = 5


def absent(module: str, name: str, names: Iterable[str]) -> AttributeError:
    """The error about a name that a module does not have, with those that may be meant.

    Args:
        module: what users call it ("orograph.measure"). names: those that it has.
    """
    import difflib

    known = [] if name.startswith("_") else sorted(names)
    close = difflib.get_close_matches(name, known, 2, 0.6)
    functions = [one for one in known if one.islower()]
    meant = f". Did you mean {' or '.join(f'{module}.{one}' for one in close)}?" if close else ""
    there = f". There are {', '.join(functions)}." if functions and not close else ""
    return AttributeError(f"{module} has no attribute {name!r}{meant}{there}")
