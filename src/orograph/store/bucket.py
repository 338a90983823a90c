"""Stores in buckets (``s3://``, ``gs://``, ``az://``) and, to be read, on web servers (``http(s)://``): by obstore.

Every request is bounded in number (``AT_ONCE``) and tried again where it failed for the moment only. Objects are asked
for by name; only ``remove`` of what lies below a key, and ``size``, list. Credentials are those of the environment, as
the clouds' own tools find them; no message and no record has them.

A bucket has no locks and no renaming, but it writes under conditions: ``swap`` puts an object only where the one that
is there is still the one that was looked at. The lock is made of that (``bucket_lock``), and so is the publication of
a store: its root ``zarr.json`` takes the place of the one that this object has read last, or of none.
"""

from __future__ import annotations

import hashlib
import random
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from urllib.parse import unquote, urlsplit

from orograph.errors import StoreError, public
from orograph.servers import WEB, beyond, connected, passing, status_of
from orograph.store import storage as waiting
from orograph.store.places import PLAN, ROOT, UPDATE
from orograph.store.ranges import Range, cut, merged
from orograph.store.storage import Storage

if TYPE_CHECKING:
    from orograph.store.bucket_lock import Lease

AT_ONCE = 32
"""Requests of one process under way at once."""

PART = 8 << 20
"""Bytes of an object that is larger which go as one part of a multipart upload."""

SCHEMES = WEB | {"s3", "s3a", "gs", "az", "azure", "abfs", "abfss"}
KEPT = "parts/"
"""What tasks found lies below it until the store is complete."""
VERSIONS = "versions"
"""The roots of older versions lie below it."""

TOGETHER = 1000
"""Objects that are removed by one request."""

T = TypeVar("T")

_gate = threading.BoundedSemaphore(AT_ONCE)


def scope_of(plan: bytes) -> str:
    """Below which name in ``parts/`` lies what the tasks of a build found."""
    return hashlib.blake2b(plan, digest_size=8).hexdigest()


def root_key(number: int) -> str:
    """Where the root of an older version lies (``versions``)."""
    return f"{VERSIONS}/{number}.json"


class Version(NamedTuple):
    """Which state of an object was looked at."""

    e_tag: str | None
    version: str | None

    def mode(self) -> dict[str, str]:
        """As obstore wants it, of what there is."""
        return {name: said for name, said in self._asdict().items() if said is not None}


class Seen(NamedTuple):
    """An object: its bytes, which state of it they are, and when that was written (by the server's clock)."""

    data: bytes
    version: Version
    written: datetime


class BucketStorage(Storage):
    """Objects below a prefix of a bucket, or of a web server.

    Args:
        url: of the store's root.
        options: obstore's configuration of the store (``endpoint``, ``region``, ``skip_signature``…), beside what the
            environment says; ``client_options`` are obstore's, too.

    Attributes:
        lease: of the lock that is held (``bucket_lock``); without it any process may write.
        scope: below which of the names in ``parts/`` lies what tasks found (``scope_of``).
        elsewhere: of which keys in ``parts/`` the objects lie below another name, and which.
    """

    remote = True

    def __init__(self, url: str, options: dict[str, Any] | None = None) -> None:
        self._url, self._options = url.rstrip("/"), options
        self.url = public(self._url)
        cut_up = urlsplit(self._url)
        self.web = cut_up.scheme in WEB
        if cut_up.query or cut_up.fragment:
            raise StoreError(
                "The address of a store must not have a query: it would have to follow the name of each object.",
                path=self.url, remedy="Put the credentials into the environment.",
            )  # fmt: skip
        self.prefix = unquote(cut_up.path).strip("/") if self.web else cut_up.path.strip("/")
        self._client = connected(
            f"{cut_up.scheme}://{cut_up.netloc}", cut_up.scheme, options, self.url, waiting.SILENCE
        )
        self._no_suffixes = cut_up.scheme.startswith(("az", "abfs"))
        self._roots: dict[str, Version | None] = {}
        self.scope = ""
        self.elsewhere: dict[str, str] = {}
        self.lease: Lease | None = None
        self._home: BucketStorage | None = None

    def named(self) -> tuple[str, dict[str, Any] | None]:
        return self._url, self._options

    def above(self) -> tuple[BucketStorage, str]:
        """What the store lies in, and the store's name there ("" if it is all of a bucket)."""
        found = self._like()
        found.prefix, _, name = self.prefix.rpartition("/")
        found.lease, found.number = None, None
        return found, name

    def below(self, prefix: str, url: str) -> BucketStorage:
        """Another prefix of the same bucket."""
        found = self._like()
        found.prefix, found._url, found.url, found.number = prefix, url, public(url), None
        return found

    def older(self, number: int) -> BucketStorage:
        """An older version of the store (``versions``): its root is another object, the rest lies here."""
        found = self.below(self.prefix, f"{self._url}@{number}")
        found.number = number
        return found

    def newest(self) -> BucketStorage:
        """The store itself, of an older version."""
        return self if self.number is None else self.below(self.prefix, self._url.rpartition("@")[0])

    def follow(self, other: Storage) -> None:
        assert isinstance(other, BucketStorage)
        self._home = self._like()
        self._url, self.url, self.number = other._url, other.url, other.number

    def anew(self) -> Storage:
        return self._home or self

    def _like(self) -> BucketStorage:
        found = object.__new__(BucketStorage)
        found.__dict__.update(self.__dict__)
        found._roots = {}
        return found

    def _at(self, key: str) -> str:
        if key == ROOT and self.number is not None:
            key = root_key(self.number)
        elif (scope := self.elsewhere.get(key, self.scope)) and key.startswith(KEPT):
            key = f"{KEPT}{scope}/{key.removeprefix(KEPT)}"
        return f"{self.prefix}/{key}".strip("/")

    def _know(self, key: str, data: bytes) -> None:
        """What is kept until the store is complete lies under its plan's digest: were a listing too old to show what an
        earlier build has left, that would not be taken for this one's."""
        if key in (PLAN, UPDATE):
            self.scope = scope_of(data)

    # Reading

    def get(self, key: str) -> bytes | None:
        seen = self.look(key)
        if key == ROOT:
            self._roots[key] = None if seen is None else seen.version
        if seen is None:
            return None
        self._know(key, seen.data)
        return seen.data

    def look(self, key: str) -> Seen | None:
        """An object with what ``swap`` has to know of it; None if there is none."""

        def read() -> Seen:
            found = self._client.get(self._at(key))
            meta = found.meta
            return Seen(bytes(found.bytes()), Version(meta["e_tag"], meta["version"]), meta["last_modified"])

        return self._try("read", key, read)

    def tail(self, key: str, length: int) -> bytes | None:
        def read() -> bytes:
            if self._no_suffixes:
                size = self._client.head(self._at(key))["size"]
                return bytes(self._client.get_range(self._at(key), start=max(0, size - length), end=size))
            return bytes(self._client.get(self._at(key), options={"range": {"suffix": length}}).bytes())

        return self._try("read", key, read)

    def ranges(self, wanted: Sequence[Range]) -> list[bytes]:
        def fetch(one: Range) -> bytes:
            key, start, stop = one
            return (
                self._try("read", key, lambda: bytes(self._client.get_range(self._at(key), start=start, end=stop)))
                or b""
            )

        together = merged(wanted)
        found = list(map(fetch, together)) if len(together) < 2 else list(_pool().map(fetch, together))
        pieces: dict[str, list[tuple[int, bytes]]] = {}
        for (key, start, _), data in zip(together, found, strict=True):
            pieces.setdefault(key, []).append((start, data))
        return [cut(pieces[key], start, stop) for key, start, stop in wanted]

    def exists(self, key: str) -> bool:
        return self._try("read", key, lambda: self._client.head(self._at(key))) is not None

    def stamp(self, key: str) -> tuple[Any, ...] | None:
        if self.web:  # (what web servers say of an object besides differs from one to the next)
            data = self.get(key)
            return None if data is None else (len(data), zlib.crc32(data))
        found = self._try("read", key, lambda: self._client.head(self._at(key)))
        return None if found is None else (found["e_tag"], found["version"], found["size"])

    def size(self) -> int | None:
        if self.web:
            return None
        return self._try("listed", "", lambda: sum(each["size"] for each in self._below("")))

    def listed(self) -> list[str]:
        """The names of all objects, by a listing: what was just written or removed may be missing, or there still."""
        found = self._try("listed", "", lambda: [each["path"] for each in self._below("")]) or []
        return [path.removeprefix(f"{self.prefix}/") for path in found]

    def _below(self, key: str) -> list[Any]:
        return [each for batch in self._client.list(prefix=self._at(key) or None) for each in batch]

    # Writing

    def put(self, key: str, parts: Sequence[bytes]) -> None:
        data = b"".join(parts)
        self.may_write()
        if key == ROOT:
            self._publish(data)
            return
        self._know(key, data)
        self.renewed(key)
        at = self._at(key)
        self._try("written", key, lambda: self._client.put(at, data, chunk_size=PART, max_concurrency=4), written=True)

    def renewed(self, key: str) -> None:
        self.elsewhere.pop(key, None)

    def swap(self, key: str, data: bytes, version: Version | None) -> Version | None:
        """Put an object where there is none (``version`` is None), or in the place of this version of it; None if there
        is something else by now.

        Raises:
            StoreError: it cannot be written, or the server writes nothing under conditions.
        """
        from obstore.exceptions import AlreadyExistsError, NotSupportedError, PreconditionError

        mode = "create" if version is None else version.mode()

        def write() -> Version | None:
            try:
                made = self._client.put(self._at(key), data, mode=mode, use_multipart=False)
            except (AlreadyExistsError, PreconditionError):
                return None
            return Version(made["e_tag"], made["version"])

        try:
            made = self._try("written", key, write, written=True)
        except StoreError as error:
            cause = error.__cause__
            if isinstance(cause, (NotImplementedError, NotSupportedError)) or status_of(str(cause)) == 501:
                raise StoreError(
                    "This storage has no conditional writes (If-None-Match), which locks need.", path=self.url,
                    remedy="Build in a folder, and copy the store there with orograph publish.",
                ) from error  # fmt: skip
            raise
        if made is None:
            # An answer may have been lost, and the second try have met what the first has done.
            seen = self.look(key)
            return seen.version if seen is not None and seen.data == data else None
        return made

    def copy(self, made: BucketStorage, key: str, to: str) -> None:
        """Copy an object of another prefix of this bucket, by the server."""
        self.may_write()
        self._try("written", to, lambda: self._client.copy(made._at(key), self._at(to)), written=True)

    def _publish(self, data: bytes) -> None:
        """Put the root in the place of that which was read last."""
        if ROOT not in self._roots:
            self.get(ROOT)
        made = self.swap(ROOT, data, self._roots[ROOT])
        if made is None:
            raise StoreError(
                "Another process has published the store, or removed it, meanwhile: its root has changed.",
                path=self.url, remedy="Check what is there, and run it again.",
            )  # fmt: skip
        self._roots[ROOT] = made

    def remove(self, key: str = "") -> None:
        self.may_write()
        if key == ROOT or not key:
            self._roots[ROOT] = None
        if not key.endswith((".json", ".lock")):  # (objects by their names)
            self._remove([each["path"] for each in self._try("listed", key, lambda: self._below(key)) or ()])
        if key:
            self._try("removed", key, lambda: self._client.delete(self._at(key)))

    def remove_all(self, keys: Sequence[str]) -> None:
        """Remove objects by their names."""
        self._remove([f"{self.prefix}/{key}".strip("/") for key in keys])

    def _remove(self, paths: Sequence[str]) -> None:
        for first in range(0, len(paths), TOGETHER):
            self.may_write()
            some = list(paths[first : first + TOGETHER])
            if self._try("removed", "", lambda: self._client.delete(some) or True) is None:  # noqa: B023
                for path in some:  # (one of them is gone already, and some clouds remove nothing more then)
                    self._try("removed", "", lambda: self._client.delete(path))  # noqa: B023

    def may_write(self) -> None:
        """Raise StoreError if it is a web server, or the lock was lost."""
        if self.web:
            raise StoreError(
                "It could not be written: web servers are read only.", path=self.url,
                remedy="Write into the bucket or folder that the server serves.",
            )  # fmt: skip
        if self.lease is not None:
            self.lease.must_hold()

    # Requests

    def _try(self, what: str, key: str, ask: Callable[[], T], written: bool = False) -> T | None:
        """What a request brings, tried again where it failed for the moment; None if there is no such object."""
        pauses = iter(waiting.AGAIN if self.web else (*waiting.AGAIN, *waiting.LONGER))
        while True:
            try:
                with _gate:
                    return ask()
            except FileNotFoundError as error:
                if written or "NoSuchBucket" in str(error) or "ContainerNotFound" in str(error):
                    raise StoreError("There is no such bucket.", path=self.url) from error
                return None
            except Exception as error:
                text = str(error)
                if not written and beyond(text):
                    return None
                pause = next(pauses, None)
                if pause is None or not passing(text, self.web):
                    raise self._failed(what, key, text) from error
            time.sleep(pause * random.uniform(0.7, 1.3))

    def _failed(self, what: str, key: str, text: str) -> StoreError:
        remedy = ""
        why = public(" ".join(text.partition("Debug source")[0].split()))[:300]
        if "kind: Timeout" in text:
            why = f"the server does not answer ({waiting.SILENCE:g} s without a byte)"
        elif "kind: Connect" in text:
            why, remedy = "the server cannot be reached", "Check the address and the network."
        elif "RangeNotSupported" in text:
            why = "the server sends whole files when parts are requested"
            remedy = (
                "Use a server that supports range requests (nginx, Apache, Caddy, any object storage; "
                "python -m http.server does not), or copy it to a disk."
            )
        elif status_of(text) in (401, 403):
            remedy = "Check the credentials in the environment."
        return StoreError(f"{key or 'It'} could not be {what}: {why}.", path=self.url, remedy=remedy)


_made: list[ThreadPoolExecutor] = []


def _pool() -> ThreadPoolExecutor:
    """Threads for requests that go together."""
    if not _made:
        _made.append(ThreadPoolExecutor(AT_ONCE, thread_name_prefix="orograph-bucket"))
    return _made[0]
