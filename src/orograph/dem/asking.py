"""The state of rasters on servers: size, modification time and entity tag, with one request (HEAD) for each.

Requests for all files of a large mosaic take minutes, so only ``orograph manifest`` makes them (``dem.manifest``).
Every process that reads the manifest knows the results: fingerprints and records then cover files on servers like those
on this disk. A file opened by its own name is not requested, and its state is unknown.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar
from urllib.parse import unquote, urlsplit

from orograph.errors import ReadError, StoreError, public
from orograph.servers import WEB, connected, passing

T = TypeVar("T")

AGAIN = (0.25, 1.0, 2.0, 4.0)
"""Seconds after which a transient failure is retried."""

_GDAL = {"/vsis3/": "s3://", "/vsigs/": "gs://", "/vsiaz/": "az://", "/vsicurl/": ""}


class State(NamedTuple):
    """A file on a server.

    Attributes:
        size: bytes. time_ns: when it was changed, by the server's clock. etag: changes with the bytes.
    """

    size: int
    time_ns: int | None
    etag: str | None


_known: dict[str, State] = {}


def url_of(location: str) -> str | None:
    """The address that GDAL fetches over a network; None for everything else, and for URLs signed for reading only."""
    for prefix, scheme in _GDAL.items():
        if location.startswith(prefix):
            location = scheme + location.removeprefix(prefix)
    cut = urlsplit(location)
    return location if cut.netloc and cut.scheme and not cut.query and not cut.fragment else None


def known(location: str) -> State | None:
    """The manifest's entry for a file on a server."""
    return _known.get(public(url_of(location) or location))


def know(location: str, state: State | None) -> None:
    """Remember a manifest's entry for a file on a server; None: forget it."""
    name = public(url_of(location) or location)
    if state is None:
        _known.pop(name, None)
    else:
        _known[name] = state


def asked(location: str) -> State | None:
    """The current state of a file on a server; None if there is no such file, or its state is unknown.

    It is unknown for a signed address, without obstore, and if the server gives neither an entity tag nor a time.
    """
    url = url_of(location)
    try:
        found = None if url is None else _request(url, lambda client, key: client.head(key))
    except (ReadError, StoreError):
        return None
    if found is None:
        return None
    changed = found["last_modified"].timestamp()
    state = State(found["size"], round(changed * 1e9) if changed > 0 else None, found["e_tag"])
    return state if state.etag or state.time_ns else None


def fetched(url: str) -> bytes:
    """Fetch a whole file from a server.

    Raises:
        ReadError, StoreError: it does not exist, or cannot be fetched.
    """
    found = _request(url, lambda client, key: bytes(client.get(key).bytes()))
    if found is None:
        raise ReadError("There is no such file.", path=public(url), remedy="Check the address.")
    return found


def _request(url: str, ask: Callable[[Any, str], T]) -> T | None:
    """The server's answer; None if there is no such file.

    Raises:
        ReadError: the server refuses, or does not answer.
    """
    cut = urlsplit(url)
    client = _client(f"{cut.scheme}://{cut.netloc}", cut.scheme)
    key = (unquote(cut.path) if cut.scheme in WEB else cut.path).lstrip("/")
    for pause in (*AGAIN, None):
        try:
            return ask(client, key)
        except FileNotFoundError:
            return None
        except Exception as error:
            text = str(error)
            if pause is None or not passing(text, cut.scheme in WEB):
                why = public(" ".join(text.partition("Debug source")[0].split()))[:300]
                raise ReadError(f"It cannot be fetched: {why}.", path=public(url)) from error
        time.sleep(pause * random.uniform(0.7, 1.3))
    raise AssertionError("the last try returns or raises")


@lru_cache(maxsize=16)
def _client(base: str, scheme: str) -> Any:
    return connected(base, scheme, None, public(base))
