"""Stores in buckets (``s3://``, ``gs://``, ``az://``), and read-only on web servers (``http(s)://``), through obstore.

A process runs at most ``AT_ONCE`` requests at a time and retries transient failures. It requests objects by name; only
``remove`` (of everything below a key) and ``size`` list them. Credentials come from the environment, where the clouds'
own tools find them, and never appear in a message or a record.

A bucket has neither locks nor renames, but it has conditional puts: ``swap`` writes an object only if the existing one
is still the version that was read. The lock (``bucket_lock``) is built on this, and so is the publication of a store:
its root ``zarr.json`` replaces the version that this object last read, or is created where there was none.
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
"""Concurrent requests of one process."""

PART = 8 << 20
"""Part size of a multipart upload, in bytes; smaller objects go in one request."""

SCHEMES = WEB | {"s3", "s3a", "gs", "az", "azure", "abfs", "abfss"}
KEPT = "parts/"
"""Holds the results of tasks until the store is complete."""
VERSIONS = "versions"
"""Holds the roots of older versions."""

TOGETHER = 1000
"""Objects removed by one request."""

T = TypeVar("T")

_gate = threading.BoundedSemaphore(AT_ONCE)


def scope_of(plan: bytes) -> str:
    """Return the name in ``parts/`` below which the tasks of a build put their results."""
    return hashlib.blake2b(plan, digest_size=8).hexdigest()


def root_key(number: int) -> str:
    """Return the key of an older version's root (``versions``)."""
    return f"{VERSIONS}/{number}.json"


class Version(NamedTuple):
    """Identifies the version of an object that was read."""

    e_tag: str | None
    version: str | None

    def mode(self) -> dict[str, str]:
        """Return the known fields in obstore's form."""
        return {name: value for name, value in self._asdict().items() if value is not None}


class Seen(NamedTuple):
    """An object: its bytes, their version, and when it was written (by the server's clock)."""

    data: bytes
    version: Version
    written: datetime


class BucketStorage(Storage):
    """Objects below a prefix of a bucket, or of a web server.

    Args:
        url: the URL of the store's root.
        options: obstore's configuration of the store (``endpoint``, ``region``, ``skip_signature``…), in addition to
            the environment; ``client_options`` are obstore's, too.

    Attributes:
        lease: the lease of the lock that is held (``bucket_lock``); without one, any process may write.
        scope: the name in ``parts/`` below which tasks put their results (``scope_of``).
        elsewhere: the scope of each key in ``parts/`` whose object lies below another name.
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
        """Return what the store lies in, and the store's name there ("" if it is a whole bucket)."""
        found = self._like()
        found.prefix, _, name = self.prefix.rpartition("/")
        found.lease, found.number = None, None
        return found, name

    def below(self, prefix: str, url: str) -> BucketStorage:
        """Return another prefix of the same bucket."""
        found = self._like()
        found.prefix, found._url, found.url, found.number = prefix, url, public(url), None
        return found

    def older(self, number: int) -> BucketStorage:
        """Return an older version of the store (``versions``): its root is another object, the rest is shared."""
        found = self.below(self.prefix, f"{self._url}@{number}")
        found.number = number
        return found

    def newest(self) -> BucketStorage:
        """Return the newest version of this store."""
        return self if self.number is None else self.below(self.prefix, self._url.rpartition("@")[0])

    def follow(self, other: Storage) -> None:
        assert isinstance(other, BucketStorage)
        self._home = self._like()
        self._url, self.url, self.number = other._url, other.url, other.number

    def uncached(self) -> Storage:
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
        """Derive the scope from a plan, under whose digest the results of an unfinished build lie.

        So leftovers of an earlier build that a stale listing hides are not mistaken for this build's.
        """
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
        """Return an object with the version that ``swap`` needs; None if there is none."""

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
        if self.web:  # (an object's other metadata differs from one web server to the next)
            data = self.get(key)
            return None if data is None else (len(data), zlib.crc32(data))
        found = self._try("read", key, lambda: self._client.head(self._at(key)))
        return None if found is None else (found["e_tag"], found["version"], found["size"])

    def size(self) -> int | None:
        if self.web:
            return None
        return self._try("listed", "", lambda: sum(each["size"] for each in self._below("")))

    def listed(self) -> list[str]:
        """List the names of all objects. The listing may be stale: new objects missing, removed ones still there."""
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
        """Put an object where there is none (``version`` is None), or replace this version of it.

        Returns None if another version is there by now.

        Raises:
            StoreError: it cannot be written, or the server has no conditional puts.
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
            # The first response may have been lost; the retry then found the first write.
            seen = self.look(key)
            return seen.version if seen is not None and seen.data == data else None
        return made

    def copy(self, made: BucketStorage, key: str, to: str) -> None:
        """Copy an object from another prefix of this bucket, on the server."""
        self.may_write()
        self._try("written", to, lambda: self._client.copy(made._at(key), self._at(to)), written=True)

    def _publish(self, data: bytes) -> None:
        """Replace the version of the root that was read last."""
        if ROOT not in self._roots:
            self.get(ROOT)
        made = self.swap(ROOT, data, self._roots[ROOT])
        if made is None:
            raise StoreError(
                "Another process has published or removed the store meanwhile: its root has changed.",
                path=self.url, remedy="Check what is there, and run it again.",
            )  # fmt: skip
        self._roots[ROOT] = made

    def remove(self, key: str = "") -> None:
        self.may_write()
        if key == ROOT or not key:
            self._roots[ROOT] = None
        if not key.endswith((".json", ".lock")):  # (those are single objects)
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
                for path in some:  # (one was already gone, and some clouds then remove none of the others)
                    self._try("removed", "", lambda: self._client.delete(path))  # noqa: B023

    def may_write(self) -> None:
        """Raise StoreError if this is a web server, or the lock was lost."""
        if self.web:
            raise StoreError(
                "It could not be written: web servers are read only.", path=self.url,
                remedy="Write into the bucket or folder that the server serves.",
            )  # fmt: skip
        if self.lease is not None:
            self.lease.must_hold()

    # Requests

    def _try(self, what: str, key: str, ask: Callable[[], T], written: bool = False) -> T | None:
        """Perform a request and retry transient failures; return None if there is no such object."""
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
    """Return the threads for concurrent requests."""
    if not _made:
        _made.append(ThreadPoolExecutor(AT_ONCE, thread_name_prefix="orograph-bucket"))
    return _made[0]
