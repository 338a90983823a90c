"""What all that write a store shard by shard have in common: they work there alone, and go through the shards.

One task makes one shard, and nobody else writes it; what comes of the tasks does not depend on their number or order.
An error or Ctrl-C cancels what has not begun (``parallel.map_ordered``), and what is done is kept by those who do it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from orograph.errors import StoreError
from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.store.arrays import Spot
from orograph.store.storage import FolderStorage, Storage


def go_through(
    label: str,
    spots: Sequence[Spot],
    run: Callable[[Spot], object],
    jobs: int,
    progress: Progress,
    last: Callable[[], object] | None = None,
) -> None:
    """Do the tasks of all shards.

    Args:
        label: what is done, for the progress line.
        spots: the shards' (row, col).
        run: does one, in one of ``jobs`` threads.
        last: what is left to do when all are done, under the same label.
    """
    with progress.task(label, total=len(spots)) as task:
        for _ in map_ordered(run, spots, jobs):
            task.advance()
        if last is not None:
            last()


@contextmanager
def alone(storage: Storage, at: str, busy: str) -> Iterator[None]:
    """Keep a second process from the same work (in folders, where the system has file locks).

    Args:
        at: what is locked: a file that is there, or a folder, made if it is not. Where neither can be there is no lock.
        busy: the message if another process holds it.

    Raises:
        StoreError: another process is at work, or nothing can be written there.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    if not isinstance(storage, FolderStorage):
        yield
        return
    path = storage.path / at
    try:
        if not path.exists():
            path.mkdir()
        held = os.open(path, os.O_RDONLY)
    except OSError as error:
        raise StoreError(f"Nothing can be written there: {error.strerror}.", path=storage.url) from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise StoreError(busy, path=storage.url, remedy="Wait until it is done.") from error
        yield
    finally:
        os.close(held)
