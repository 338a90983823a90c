"""``orograph.check``: verify every byte of a store."""

from __future__ import annotations

import os

from orograph._named import answering
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.checking import Damage
from orograph.store.checking import check as check_opened
from orograph.store.stored import StoredTerrain
from orograph.store.stored import open as open_store


@answering
def check(
    store: StoredTerrain | str | os.PathLike[str], *, jobs: int | None = None, progress: Progress | bool | None = None
) -> list[Damage]:
    """Read every byte of a store, and list what is damaged, missing or out of place; an empty list means that it is
    sound.

    Args:
        store: opened, or its path or URL. jobs: threads; None: all processors.
        progress: gets progress reports; False: silent.

    Raises:
        StoreError: it cannot be read, or was replaced meanwhile.
    """
    if isinstance(store, StoredTerrain):
        return check_opened(store, jobs=jobs, progress=reporting(progress))
    with open_store(store, jobs=jobs) as opened:
        return check_opened(opened, jobs=jobs, progress=reporting(progress))
