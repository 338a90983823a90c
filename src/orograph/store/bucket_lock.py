"""One writer at a time in a bucket: a lock object ``.area.oro.lock`` beside the store, written by conditional puts.

The object names its holder (host, process, start) and is rewritten every ``BEAT`` seconds, each time on condition that
it is unchanged. A holder that could not do so for ``LEASE`` seconds has lost the lock and stops writing.
Another process takes a lock over if its holder was a process on this machine and has ended; or if the lock is older
than ``LEASE`` by the server's clock and does not change for another half of that. So clock skew ends nobody's lease.

The processes of one build share a lock; ``shared`` identifies the build. One heartbeat serves all of them: a holder
that finds a fresh one skips its own. The last to leave removes the object.

The guarantee rests on the server, which must support conditional puts (If-None-Match, If-Match). This is tested when a
lock is taken: the server must refuse to create the lock again.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
import uuid
from datetime import UTC, datetime
from typing import Any

from orograph.errors import StoreError
from orograph.processes import host, running
from orograph.store.bucket import BucketStorage, Seen, Version

LEASE = 60.0
"""Seconds that a lock holds without a heartbeat."""

BEAT = 15.0
"""Seconds between two heartbeats."""

TRIES = 100
PAUSE = 0.1
"""Number of attempts, and seconds between them, while the lock changes hands."""


class Lease:
    """A lock on a store in a bucket.

    Args:
        storage: the store's storage.
        doing: what other processes are told about this one.
        shared: identifies the processes that may work at the same time; None: the lock is exclusive.
    """

    def __init__(self, storage: BucketStorage, doing: str, shared: str | None) -> None:
        self.url, self.doing, self.shared = storage.url, doing, shared
        self.place, name = storage.above()
        self.key = f".{name}.lock"
        self.token = uuid.uuid4().hex
        self._me = {
            "token": self.token, "host": host(), "pid": os.getpid(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
        }  # fmt: skip
        self._version: Version | None = None
        self._renewed = 0.0
        self._beats = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live, name="orograph-lease", daemon=True)

    def must_hold(self) -> None:
        """Raise StoreError if another process may have taken the lock."""
        if time.monotonic() - self._renewed > LEASE:
            raise StoreError(
                f"The lock on this store was lost: the bucket was out of reach for {LEASE:g} s, or another process has "
                "taken it over.", path=self.url, remedy="Run it again, with `resume=True` if it is a build.",
            )  # fmt: skip

    def take(self) -> None:
        """Take the lock.

        Raises:
            StoreError: another process is at work, or the storage has no conditional writes.
        """
        content: dict[str, Any] = {}
        for _ in range(TRIES):
            began = time.monotonic()
            seen = self.place.look(self.key)
            if seen is None:
                if self._put([self._me], None, began):
                    self._must_be_kept()
                    break
                continue
            content = _read(seen)
            if content.get("leaving"):
                time.sleep(PAUSE)
            if self.shared is not None and content.get("shared") == self.shared and not content.get("leaving"):
                others = [each for each in _holders(content) if not _ended(each)]
                if self._put([*others, self._me], seen.version, began):
                    break
            elif self._stale(seen, content):
                if self._put([self._me], seen.version, time.monotonic()):
                    break
            elif not content.get("leaving"):
                raise self._busy(seen, content)
        else:
            raise self._busy(None, content)
        self._thread.start()

    def release(self) -> None:
        """Release the lock; if the bucket does not answer, the lease expires by itself."""
        self._over.set()
        self._thread.join()
        with contextlib.suppress(StoreError):
            while time.monotonic() - self._renewed < LEASE / 2:  # after that, another process may be taking it over
                began = time.monotonic()
                seen = self.place.look(self.key)
                if seen is None or self.token not in [each.get("token") for each in _holders(_read(seen))]:
                    return
                left = [each for each in _holders(_read(seen)) if each.get("token") != self.token and not _ended(each)]
                if not self._put(left or [self._me], seen.version, began, leaving=not left):
                    continue
                if not left:
                    self.place.remove(self.key)
                return

    def _live(self) -> None:
        """Send heartbeats until the lock is released."""
        while not self._over.wait(BEAT):
            with contextlib.suppress(StoreError):
                began = time.monotonic()
                seen = self.place.look(self.key)
                holders = [] if seen is None else _holders(_read(seen))
                if seen is None or self.token not in [each.get("token") for each in holders]:
                    self._renewed = -LEASE  # another process has it
                    return
                if seen.version != self._version:  # another holder has sent a heartbeat, joined or left
                    self._version, self._renewed = seen.version, began
                    continue
                self._put([each for each in holders if not _ended(each)], seen.version, began)

    def _put(self, holders: list[dict[str, Any]], version: Version | None, began: float, leaving: bool = False) -> bool:
        """Write the lock; return whether it was unchanged until then."""
        self._beats += 1
        content = {
            "doing": self.doing, "shared": self.shared, "lease": LEASE, "beat": f"{self.token} {self._beats}",
            "leaving": leaving, "holders": holders,
        }  # fmt: skip
        made = self.place.swap(self.key, json.dumps(content).encode(), version)
        if made is None:
            return False
        self._version, self._renewed = made, began
        return True

    def _must_be_kept(self) -> None:
        """Raise StoreError if the server lets an existing object be created again."""
        if self.place.swap(self.key, b"{}", None) is not None:
            self.place.remove(self.key)
            raise StoreError(
                "This storage ignores conditional writes (If-None-Match), which locks need.", path=self.url,
                remedy="Build in a folder, and copy the store there with orograph publish.",
            )  # fmt: skip

    def _stale(self, seen: Seen, content: dict[str, Any]) -> bool:
        """Return whether nobody holds the lock any more."""
        holders = _holders(content)
        if holders and all(_ended(each) for each in holders):
            return True
        if (datetime.now(UTC) - seen.written).total_seconds() < _lease(content):
            return False
        end = time.monotonic() + _lease(content) / 2
        while time.monotonic() < end:
            time.sleep(min(1.0, _lease(content) / 20))
            now = self.place.look(self.key)
            if now is None or now.version != seen.version:
                return False
        return True

    def _busy(self, seen: Seen | None, content: dict[str, Any]) -> StoreError:
        holders = _holders(content)
        who = ""
        if holders:
            first, more = holders[0], len(holders) - 1
            who = f"process {first.get('pid')} on {first.get('host')}, since {first.get('since')}"
            who = f" ({who}{f', and {more} more' if more else ''})"
        heard = ""
        if seen is not None:
            age = max(0, round((datetime.now(UTC) - seen.written).total_seconds()))
            heard = f" Its last heartbeat was {age} s ago."
        why = (
            " Its plan is different."
            if self.shared is not None and content.get("shared") not in (None, self.shared)
            else ""
        )
        return StoreError(
            f"Another process is {content.get('doing', 'at work on this store')}{who}.{why}{heard}", path=self.url,
            remedy=f"Wait until it is done; if it has ended, its lock expires {1.5 * _lease(content):g} s after its "
            "last heartbeat.",
        )  # fmt: skip


def _read(seen: Seen) -> dict[str, Any]:
    try:
        content = json.loads(seen.data)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def _holders(content: dict[str, Any]) -> list[dict[str, Any]]:
    found = content.get("holders")
    return [each for each in found if isinstance(each, dict)] if isinstance(found, list) else []


def _lease(content: dict[str, Any]) -> float:
    found = content.get("lease")
    return float(found) if isinstance(found, int | float) else LEASE


def _ended(holder: dict[str, Any]) -> bool:
    """Return whether the holder was a process on this machine and has ended."""
    pid = holder.get("pid")
    return holder.get("host") == host() and isinstance(pid, int) and not running(pid)
