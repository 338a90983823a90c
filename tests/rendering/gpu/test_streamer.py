"""Threads that read tiles: what fails for all of them is not tried for all of them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from numpy.typing import NDArray

from orograph.errors import StoreError
from orograph.rendering.gpu.stream import streamer as module
from orograph.rendering.gpu.stream.streamer import Streamer


class Store:
    """Tiles that can be read or not."""

    def __init__(self) -> None:
        self.bad: set[int] = set()
        self.tried: list[int] = []
        self.lock = threading.Lock()

    def make(self, kind: str, key: int) -> NDArray[np.uint8]:
        with self.lock:
            self.tried.append(key)
        if key in self.bad:
            raise StoreError("it does not answer.", path="store")
        return np.zeros(1, np.uint8)


@pytest.fixture
def store() -> Store:
    return Store()


def run(streamer: Streamer[str, int, np.ndarray], keys: list[int], seconds: float) -> set[int]:
    """Frames that want tiles, the first most; those that came."""
    came: set[int] = set()
    end = time.monotonic() + seconds
    while time.monotonic() < end and len(came) < len(keys):
        streamer.want([(float(-n), "tile", key) for n, key in enumerate(keys) if key not in came])
        time.sleep(0.005)
        came |= {key for _, key, _ in streamer.take(64)}
    return came


def test_a_store_that_is_out_of_order_is_asked_for_a_few_tiles_and_comes_back(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Streamer, "RETRY", 0.4)
    keys = list(range(300))
    store.bad = set(keys)
    streamer: Streamer[str, int, np.ndarray] = Streamer(store.make, 2)
    try:
        assert run(streamer, keys, 0.3) == set()
        assert len(store.tried) < 3 * module.GIVEN_UP
        assert len(streamer.failed) == 300 and streamer.waiting == 0
        store.bad = set()
        assert run(streamer, keys, 20) == set(keys)
        assert not streamer.failed
    finally:
        streamer.close()


@pytest.mark.stress
def test_many_damaged_tiles_do_not_keep_others_from_being_read(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Streamer, "RETRY", 0.2)
    keys = list(range(120))
    store.bad = set(range(60))  # those that are wanted most
    streamer: Streamer[str, int, np.ndarray] = Streamer(store.make, 2)
    try:
        assert run(streamer, keys, 15) >= set(range(60, 120))
    finally:
        streamer.close()
