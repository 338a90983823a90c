"""Web servers that are slow, silent, busy or cut short: what readers are told, how soon, and that they recover."""

from __future__ import annotations

import time

import numpy as np
import pytest
from surfaces import rough, source
from webserver import serving

from orograph import store
from orograph.errors import DamagedChunkError, StoreError
from orograph.store import storage

pytest.importorskip("obstore")

HEIGHTS = rough((290, 260), 22)
NEVER = {"cache_bytes": 0}
"""Chunks are asked for again each time."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("unwell")
    store.build(source(HEIGHTS), path / "area.oro", shard=128, chunk=32)
    return path


@pytest.fixture
def web(folder, monkeypatch):
    monkeypatch.setattr(storage, "SILENCE", 0.5)
    monkeypatch.setattr(storage, "AGAIN", (0.02, 0.05))
    with serving(folder) as server:
        yield server


def test_a_server_that_never_answers_is_an_error_after_a_while(web):
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    web.mood = "mute"
    for read in (lambda: terrain.read(0, 0, 100, 0, 100), lambda: store.open(f"{web.url}/area.oro")):
        begun = time.perf_counter()
        with pytest.raises(StoreError, match="server does not answer"):
            read()
        assert 0.4 < time.perf_counter() - begun < 10
    web.mood = "well"
    np.testing.assert_array_equal(terrain.read(0, 0, 100, 0, 100), HEIGHTS[:100, :100])


def test_a_server_that_ignores_ranges_is_named_and_not_the_store_called_damaged(web):
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    web.mood = "whole"
    for read in (  # the end of an object, with its index; a part of one whose index is known
        lambda: store.open(f"{web.url}/area.oro", **NEVER).read(0, 0, 100, 0, 100),
        lambda: terrain.read(0, 0, 100, 0, 100),
    ):
        with pytest.raises(StoreError, match="whole files when parts") as told:
            read()
        assert not isinstance(told.value, DamagedChunkError)
        assert "range requests" in told.value.remedy
    web.mood = "well"
    np.testing.assert_array_equal(terrain.read(0, 0, 100, 0, 100), HEIGHTS[:100, :100])


def test_a_slow_server_is_waited_for(web):
    web.mood, web.seconds = "slow", 0.2  # less than the silence allowed
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    np.testing.assert_array_equal(terrain.read(0, 0, 40, 0, 40), HEIGHTS[:40, :40])


def test_a_busy_server_is_asked_again(web):
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    web.busy = 1
    np.testing.assert_array_equal(terrain.read(0, 0, 30, 0, 30), HEIGHTS[:30, :30])
    web.mood, before = "busy", web.asked
    with pytest.raises(StoreError, match=r"could not be read.*503"):
        terrain.read(0, 200, 230, 200, 230)
    assert web.asked - before >= 3
    web.mood = "well"
    np.testing.assert_array_equal(terrain.read(0, 200, 230, 200, 230), HEIGHTS[200:230, 200:230])


def test_what_is_not_there_is_not_asked_for_again(web):
    before = web.asked
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(f"{web.url}/nothing.oro")
    assert web.asked - before < 10


def test_connections_that_break_off_are_tried_again_and_told(web):
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    web.mood, before = "short", web.asked
    with pytest.raises(StoreError, match="could not be read"):
        terrain.read(0, 0, 30, 0, 30)
    assert web.asked - before >= 3
    web.mood = "well"
    np.testing.assert_array_equal(terrain.read(0, 0, 30, 0, 30), HEIGHTS[:30, :30])


def test_a_chunk_that_is_cut_off_is_named(web):
    terrain = store.open(f"{web.url}/area.oro", **NEVER)
    terrain.read(0, 0, 30, 0, 30)  # the shard's index is known
    web.mood = "cut"
    with pytest.raises(DamagedChunkError, match=r"heights/0/height/c/0/0\[0,0\]"):
        terrain.read(0, 0, 30, 0, 30)


def test_a_port_where_nobody_listens_is_an_error_at_once(folder):
    with serving(folder) as server:
        url = server.url
    begun = time.perf_counter()
    with pytest.raises(StoreError):
        store.open(f"{url}/area.oro")
    assert time.perf_counter() - begun < 10
