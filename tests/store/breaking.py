"""Work on a storage that is broken off."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from orograph.store.storage import Storage


@contextmanager
def broken_off(kind: type[Storage], puts: int) -> Iterator[None]:
    """What is done within is broken off, as by Ctrl-C, after so many puts to storages of a kind."""
    left, put = [puts], kind.put

    def stop(self: Storage, key: str, parts: list[bytes]) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        put(self, key, parts)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(kind, "put", stop)
        yield
