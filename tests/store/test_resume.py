"""Killed, interrupted or out of room: a build leaves nothing that opens, and resuming gives the same bytes."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from surfaces import rough, source

from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.store.storage import FolderStorage
from orograph.store.survey import Errors

HEIGHTS = rough((300, 260), 9, missing=0.01)
SIZES = {"shard": 64, "chunk": 16}


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "s"
    store.build(source(HEIGHTS), path, **SIZES)
    found = files(path)
    assert {name.split("/")[0] for name in found} == {"zarr.json", "heights", "mean", "tiles", "diamonds", "patches"}
    assert not [name for name in found if name.endswith(".writing")]
    return found


class Stop(BaseException):
    """Stands for the end of the process: nothing handles it."""


def stopping(monkeypatch, after, error, torn=False):
    """Make the storage fail at its ``after``-th write; ``torn`` leaves half of a temporary file behind."""
    put, done = FolderStorage.put, [0]
    lock = threading.Lock()

    def stop(self, key, parts):
        with lock:
            done[0] += 1
            now = done[0]
        if now >= after:
            if torn:
                path = self.path / key
                path.parent.mkdir(parents=True, exist_ok=True)
                data = b"".join(parts)
                path.with_name(f".{path.name}.writing").write_bytes(data[: len(data) // 2])
            raise error
        put(self, key, parts)

    monkeypatch.setattr(FolderStorage, "put", stop)


@pytest.mark.stress
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_at_random_moments(tmp_path):
    seed = random.SystemRandom().randrange(10**6)
    script = Path(__file__).with_name("killing.py")
    ran = subprocess.run([sys.executable, script, tmp_path, str(seed)], capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, f"seed {seed}: {ran.stderr}"
    kills = sum(int(line.split()[1]) for line in ran.stdout.splitlines())
    assert kills >= 3, ran.stdout
    expected = files(tmp_path / "whole")
    for trial in range(4):
        assert files(tmp_path / f"killed{trial}") == expected, f"seed {seed}, trial {trial}"


@pytest.mark.cases(6)
@pytest.mark.parametrize("seed", range(12))
def test_stopped_at_any_write(tmp_path, monkeypatch, whole, seed):
    rng = random.Random(seed)
    target = tmp_path / "s"
    for attempt in range(4):
        with monkeypatch.context() as patch:
            stopping(patch, rng.randrange(1, len(whole) + 20), Stop(), torn=bool(seed % 2))
            try:
                store.build(source(HEIGHTS), target, resume=attempt > 0, jobs=1 + seed % 3, **SIZES)
                break
            except Stop:
                with pytest.raises(StoreError):
                    store.open(target)
    store.build(source(HEIGHTS), target, resume=True, **SIZES)
    assert files(target) == whole
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s"]


def test_a_full_disk(tmp_path, monkeypatch, whole):
    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", full_disk(FolderStorage.put, 25))
        with pytest.raises(StoreError, match=r"No space left.*Make room.*resume=True"):
            store.build(source(HEIGHTS), tmp_path / "s", **SIZES)
    with pytest.raises(StoreError, match=r"incomplete.*resume=True"):
        store.open(tmp_path / "s")
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)
    assert files(tmp_path / "s") == whole


def full_disk(put, after):
    """The write itself fails, as it does on a full disk, after ``after`` good ones."""
    done = [0]

    def wrapped(self, key, parts):
        done[0] += 1
        if done[0] > after:

            def broken():
                yield parts[0][: len(parts[0]) // 2]
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

            return put(self, key, broken())
        return put(self, key, parts)

    return wrapped


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
def test_a_file_that_may_not_grow(tmp_path, whole):
    """The system itself refuses to write: no shard may be larger than the limit."""
    code = f"""
import resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from surfaces import rough, source
from orograph import store
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))
store.build(source(rough((300, 260), 9, missing=0.01)), sys.argv[1], shard=64, chunk=16)
"""
    ran = subprocess.run([sys.executable, "-c", code, tmp_path / "s"], capture_output=True, text=True)
    assert ran.returncode == 1 and "File too large" in ran.stderr and "`resume=True`" in ran.stderr
    assert not list(tmp_path.iterdir())  # not one shard was complete
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)
    assert files(tmp_path / "s") == whole


def test_work_that_is_done_is_not_done_again(tmp_path, monkeypatch):
    class Counting(store.ArraySource):
        read_windows = 0

        def read(self, *window):
            self.read_windows += 1
            return super().read(*window)

    counting = Counting(HEIGHTS, source(HEIGHTS).grid, "rough", "EGM96 height")
    with monkeypatch.context() as patch:
        stopping(patch, 40, Stop())
        with pytest.raises(Stop):
            store.build(counting, tmp_path / "s", jobs=1, **SIZES)
    first = counting.read_windows
    store.build(counting, tmp_path / "s", resume=True, jobs=1, **SIZES)
    assert counting.read_windows - first <= 25 - first + 1  # 5 × 5 tasks; the one that was stopped is done twice


def test_a_finished_shard_that_was_damaged_meanwhile_is_made_again(tmp_path, monkeypatch, whole):
    with monkeypatch.context() as patch:
        stopping(patch, 40, Stop())
        with pytest.raises(Stop):
            store.build(source(HEIGHTS), tmp_path / "s", jobs=1, **SIZES)
    shard = tmp_path / "s.partial/heights/0/height/c/0/0"
    content = bytearray(shard.read_bytes())
    content[100] ^= 255
    shard.write_bytes(content)
    part = tmp_path / "s.partial/parts/0.1.part"
    part.write_bytes(part.read_bytes()[:50])
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)
    assert files(tmp_path / "s") == whole


def test_errors_are_resumed_and_what_was_damaged_of_them_is_made_again(tmp_path, monkeypatch, whole):
    with monkeypatch.context() as patch:
        put = FolderStorage.put

        def stop(self, key, parts):
            if key == "parts/errors/2.2.part":
                raise Stop
            put(self, key, parts)

        patch.setattr(FolderStorage, "put", stop)
        with pytest.raises(Stop):
            store.build(source(HEIGHTS), tmp_path / "s", jobs=1, **SIZES)
    done = sorted(p.name for p in (tmp_path / "s.partial/parts/errors").iterdir())
    assert "0.0.part" in done and "2.2.part" not in done and len(done) > 5
    shard = tmp_path / "s.partial/diamonds/0/radius/c/0/1"
    shard.write_bytes(shard.read_bytes()[:-9])
    part = tmp_path / "s.partial/parts/errors/1.1.part"
    part.write_bytes(part.read_bytes()[:50])
    made = []
    with monkeypatch.context() as patch:
        make = Errors.make
        patch.setattr(Errors, "make", lambda self, spot: (made.append(spot), make(self, spot))[1])
        store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)
    assert files(tmp_path / "s") == whole
    assert len(made) == 25 - len(done) + 2 and {(0, 1), (1, 1), (2, 2)} <= set(made)


def test_other_sources_are_not_resumed(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        stopping(patch, 20, Stop())
        with pytest.raises(Stop):
            store.build(source(HEIGHTS), tmp_path / "s", jobs=1, **SIZES)
    other = HEIGHTS.copy()
    other[5, 5] += 1
    with pytest.raises(StoreError, match="sources or options differ"):
        store.build(source(other), tmp_path / "s", resume=True, **SIZES)
    with pytest.raises(StoreError, match=r"interrupted build.*resume=True.*overwrite=True"):
        store.build(source(HEIGHTS), tmp_path / "s", **SIZES)
    terrain = store.build(source(other), tmp_path / "s", overwrite=True, **SIZES)
    np.testing.assert_array_equal(terrain.read(0, 0, 9, 0, 9), other[:9, :9])


def test_overwriting_keeps_the_old_store_until_the_new_one_is_complete(tmp_path, monkeypatch, whole):
    old = rough((50, 50))
    store.build(source(old), tmp_path / "s")
    with pytest.raises(StoreError, match=r"there already.*overwrite=True"):
        store.build(source(HEIGHTS), tmp_path / "s", **SIZES)
    with monkeypatch.context() as patch:
        stopping(patch, 60, Stop())
        with pytest.raises(Stop):
            store.build(source(HEIGHTS), tmp_path / "s", overwrite=True, **SIZES)
    np.testing.assert_array_equal(store.open(tmp_path / "s").read(0, 0, 50, 0, 50), old)
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)
    assert files(tmp_path / "s") == whole


def test_resuming_what_is_complete(tmp_path):
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)  # nothing there: begins
    store.build(source(HEIGHTS), tmp_path / "s", resume=True, **SIZES)  # the same: nothing to do
    with pytest.raises(StoreError, match="other sources"):
        store.build(source(HEIGHTS + 1), tmp_path / "s", resume=True, **SIZES)
    with pytest.raises(UsageError, match="not both"):
        store.build(source(HEIGHTS), tmp_path / "s", resume=True, overwrite=True)


def test_what_is_no_store_is_never_overwritten(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos/me.jpg").write_bytes(b"x")
    for overwrite in (False, True):
        with pytest.raises(StoreError, match="not an Orograph store"):
            store.build(source(HEIGHTS), tmp_path / "photos", overwrite=overwrite)
    assert files(tmp_path / "photos") == {"me.jpg": b"x"}


@pytest.mark.skipif(sys.platform == "win32", reason="needs file locks")
def test_two_builds_of_one_store_at_once(tmp_path):
    class Slow(store.ArraySource):
        def read(self, *window):
            begun.set()
            go_on.wait(20)
            return super().read(*window)

    begun, go_on = threading.Event(), threading.Event()
    slow = Slow(HEIGHTS, source(HEIGHTS).grid, "rough", "EGM96 height")
    first = threading.Thread(target=lambda: store.build(slow, tmp_path / "s", **SIZES))
    first.start()
    try:
        assert begun.wait(20)
        for flags in ({"resume": True}, {"overwrite": True}):
            with pytest.raises(StoreError, match="Another process"):
                store.build(source(HEIGHTS), tmp_path / "s", **flags, **SIZES)
    finally:
        go_on.set()
        first.join()
    assert store.open(tmp_path / "s").check() == []
