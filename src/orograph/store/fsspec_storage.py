"""Stores at addresses that only fsspec supports: ``memory://``, ``ftp://``, ``sftp://``…

(``bucket`` has the web and buckets.) There are no conditional writes there, so nothing keeps two writers apart.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from orograph.errors import StoreError, public
from orograph.store.ranges import Range, cut, merged
from orograph.store.storage import Storage


class FsspecStorage(Storage):
    """Anything fsspec reaches.

    Args:
        url: of the store's root.
        options: passed to the fsspec file system.
    """

    remote = True

    def __init__(self, url: str, options: dict[str, Any] | None = None) -> None:
        import fsspec

        self._url, self._options = url.rstrip("/"), options
        self.url = public(self._url)
        try:
            self.fs, self.root = fsspec.core.url_to_fs(self._url, **(options or {}))
        except (ImportError, ValueError) as error:
            raise StoreError(
                f"This kind of address cannot be opened: {error}.", path=self.url,
                remedy="Buckets (s3, gs, az) and the web need pip install 'orograph[remote]'; other protocols need "
                       "their fsspec package.",
            ) from error  # fmt: skip

    def named(self) -> tuple[str, dict[str, Any] | None]:
        return self._url, self._options

    def _at(self, key: str) -> str:
        return f"{self.root.rstrip('/')}/{key}" if key else self.root

    @contextmanager
    def _reporting(self, what: str, key: str) -> Iterator[None]:
        try:
            yield
        except (FileNotFoundError, StoreError):
            raise
        except Exception as error:  # every fsspec backend has its own family of errors
            why = f"{type(error).__name__}: {error}"
            raise StoreError(f"{key or 'It'} could not be {what}: {why}.", path=self.url) from error

    def get(self, key: str) -> bytes | None:
        try:
            with self._reporting("read", key):
                return bytes(self.fs.cat_file(self._at(key)))
        except FileNotFoundError:
            return None

    def tail(self, key: str, length: int) -> bytes | None:
        try:
            with self._reporting("read", key):
                return bytes(self.fs.cat_file(self._at(key), start=-length))
        except FileNotFoundError:
            return None

    def ranges(self, wanted: Sequence[Range]) -> list[bytes]:
        if not wanted:
            return []
        together = merged(wanted)
        keys, starts, stops = zip(*together, strict=True)
        with self._reporting("read", keys[0]):
            found = self.fs.cat_ranges([self._at(k) for k in keys], list(starts), list(stops), on_error="return")
            for part in found:
                if isinstance(part, Exception) and not isinstance(part, FileNotFoundError):
                    raise part
        pieces: dict[str, list[tuple[int, bytes]]] = {}
        for (key, start, _), part in zip(together, found, strict=True):
            pieces.setdefault(key, []).append((start, b"" if isinstance(part, Exception) else bytes(part)))
        return [cut(pieces[key], start, stop) for key, start, stop in wanted]

    def stamp(self, key: str) -> tuple[Any, ...] | None:
        data = self.get(key)  # (other details of an object differ between file systems)
        return None if data is None else (len(data), zlib.crc32(data))

    def put(self, key: str, parts: Sequence[bytes]) -> None:
        with self._reporting("written", key):
            self.fs.pipe_file(self._at(key), b"".join(parts))

    def exists(self, key: str) -> bool:
        with self._reporting("read", key):
            return bool(self.fs.exists(self._at(key)))

    def remove(self, key: str = "") -> None:
        try:
            with self._reporting("removed", key):
                self.fs.rm(self._at(key), recursive=True)
                self.fs.invalidate_cache()
        except FileNotFoundError:
            pass

    def size(self) -> int | None:
        try:
            self.fs.invalidate_cache()
            return int(self.fs.du(self.root))
        except Exception:  # not all file systems can list
            return None
