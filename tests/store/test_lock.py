"""One writer at a time: locks on a name that nobody replaces, and builds that start at once."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from starts import Start, race
from surfaces import rough, source

from orograph import store
from orograph.errors import StoreError
from orograph.processes import host
from orograph.store import lock
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs file locks")


def held_by_another(path, shared="None", seconds=20):
    """A process that holds the lock of a store; it says so, and ends when its input does."""
    code = f"""
import sys
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage
with alone(FolderStorage({str(path)!r}), "building this store", {shared}):
    print("held", flush=True)
    sys.stdin.read()
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    return process


@pytest.fixture(params=["flock", "owner"])
def kind(request, monkeypatch):
    """With the system's locks, and where it has none."""
    if request.param == "owner":
        without_locks(monkeypatch)
    return request.param


def without_locks(monkeypatch):
    import fcntl

    def unsupported(fd, how):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", unsupported)


def test_one_holds_it_and_nothing_is_left(tmp_path, kind):
    place = FolderStorage(tmp_path / "new/s")
    with alone(place, "building this store"):
        who = rf"s: Another process is building this store \(process {os.getpid()} on"
        with pytest.raises(StoreError, match=who), alone(place, "baking"):
            pass
        with alone(FolderStorage(tmp_path / "new/t"), "building"):
            pass
    assert list((tmp_path / "new").iterdir()) == []
    with alone(place, "baking"):
        pass


def test_the_folder_may_be_moved_and_replaced_under_the_lock(tmp_path):
    """What was locked before was a file of the folder; then two could hold it."""
    place = FolderStorage(tmp_path / "s")
    place.put("build.json", [b"{}"])
    with alone(place, "building this store"):
        place.remove()
        place.put("build.json", [b"{}"])
        with pytest.raises(StoreError, match="Another process"), alone(place, "baking"):
            pass


def test_links_and_spellings_are_one_store(tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "d")
    (tmp_path / "s.oro").symlink_to(tmp_path / "d/s.oro")
    with alone(FolderStorage(tmp_path / "d/s.oro"), "building this store"):
        for other in ("link/s.oro", "d/../d/s.oro/", "s.oro"):
            with pytest.raises(StoreError, match="Another process"), alone(FolderStorage(f"{tmp_path}/{other}"), "x"):
                pass


def test_a_process_that_was_killed_holds_nothing(tmp_path):
    process = held_by_another(tmp_path / "s")
    with pytest.raises(StoreError, match=rf"Another process is building this store \(process {process.pid} on"):
        store.build(source(rough((20, 20))), tmp_path / "s")
    process.kill()
    process.wait()
    store.build(source(rough((20, 20))), tmp_path / "s").close()
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_parts_of_one_build_share_it(tmp_path):
    place = FolderStorage(tmp_path / "s")
    with alone(place, "building a part", "plan A of 2"):
        other = held_by_another(tmp_path / "s", repr("plan A of 2"))
        with pytest.raises(StoreError, match=r"building.*plan is different"), alone(place, "building", "plan B of 2"):
            pass
        with pytest.raises(StoreError, match="Another process"), alone(place, "building"):
            pass
    with pytest.raises(StoreError, match="Another process"), alone(place, "building"):
        pass
    with alone(place, "building a part", "plan A of 2"):  # joins those that are left
        pass
    other.communicate()
    with alone(place, "building"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_parts_that_begin_and_end_at_once_never_refuse_each_other(tmp_path):
    place, failed = FolderStorage(tmp_path / "s"), []

    def part():
        for _ in range(30):
            try:
                with alone(place, "building a part", "plan"):
                    time.sleep(0.001)
            except StoreError as error:
                failed.append(error)

    threads = [threading.Thread(target=part) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed and list(tmp_path.iterdir()) == []


def test_without_locks_an_owner_that_has_ended_is_replaced(tmp_path, monkeypatch):
    without_locks(monkeypatch)
    place, owner = FolderStorage(tmp_path / "s"), tmp_path / ".s.owner"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    for where, pid, taken in ((host(), ended.pid, True), ("elsewhere", ended.pid, False), (host(), os.getpid(), False)):
        owner.write_text(json.dumps({"doing": "building this store", "host": where, "pid": pid}))
        if taken:
            with alone(place, "baking"):
                assert json.loads(owner.read_text())["pid"] == os.getpid()
            assert not owner.exists()
        else:
            with pytest.raises(StoreError, match=r"process \d+ on .*has ended, remove \.s\.owner"), alone(place, "x"):
                pass
    with pytest.raises(StoreError, match="no locks, which the parts"), alone(place, "x", "plan"):
        pass


def test_a_place_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match=r"Nothing can be written beside it.*\.s\.lock"):
        store.build(source(rough((20, 20))), tmp_path / "file/s")


def test_a_link_to_a_store_stays_a_link(tmp_path):
    store.build(source(rough((20, 20), 1)), tmp_path / "real.oro").close()
    (tmp_path / "link.oro").symlink_to("real.oro")
    store.build(source(rough((20, 20), 2)), tmp_path / "link.oro", overwrite=True).close()
    assert (tmp_path / "link.oro").is_symlink() and not (tmp_path / "real.oro").is_symlink()
    with store.open(tmp_path / "real.oro") as terrain:
        np.testing.assert_array_equal(terrain.read(0, 0, 20, 0, 20), rough((20, 20), 2))


@pytest.mark.stress
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("kills", [False, True])
def test_builds_that_start_at_once(tmp_path, kills):
    """One of them makes the store, and it is one of theirs, whole; the others say why not."""
    race(tmp_path, starts=6, rounds=4 if kills else 3, kills=kills, seed=7)


@pytest.mark.stress
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("locks", [True, False])
def test_two_hundred_starts(tmp_path, locks):
    seed = int(time.time())
    done = race(tmp_path, starts=5, rounds=50, kills=True, seed=seed, locks=locks)
    assert sum(done.values()) == 250, (seed, done)
    assert min(done[Start.DONE], done[Start.REFUSED], done[Start.KILLED]) >= 10, (seed, done)  # each was tried


@pytest.mark.stress
def test_pairs_of_commands(tmp_path):
    """The command line itself, as in ``orograph build A -o s & orograph build B -o s; wait``."""
    import rasterio

    for name in "ab":
        heights = rough((600, 600), ord(name))
        with rasterio.open(
            tmp_path / f"{name}.tif", "w", driver="GTiff", width=600, height=600, count=1, dtype="float32",
            crs="EPSG:32611", transform=source(heights).grid.transform,
        ) as file:  # fmt: skip
            file.write(heights, 1)
    rng = np.random.default_rng(3)
    for number in range(24):
        out = tmp_path / f"{number}.oro"
        names = ("a", "a") if number % 2 else ("a", "b")
        running = []
        for name in names:
            running.append(
                subprocess.Popen(
                    [sys.executable, "-m", "orograph", "-q", "build", str(tmp_path / f"{name}.tif"), "-o", str(out)],
                    stderr=subprocess.PIPE, text=True,
                )
            )  # fmt: skip
            time.sleep(float(rng.uniform(0, 0.2)))
        told = [process.communicate()[1] for process in running]
        codes = [process.returncode for process in running]
        assert sorted(codes) == [0, 4], (codes, told)
        winner = names[codes.index(0)]
        assert "Another process" in told[codes.index(4)] or "there already" in told[codes.index(4)]
        with store.open(out) as terrain:
            assert terrain.name == str(number) and terrain.check() == []
            np.testing.assert_array_equal(terrain.read(0, 0, 600, 0, 600), rough((600, 600), ord(winner)))


def test_the_lock_file_is_beside_the_store(tmp_path):
    with alone(FolderStorage(tmp_path / "area.oro"), "building this store"):
        assert [p.name for p in tmp_path.iterdir()] == [".area.oro.lock"]
    assert lock.TRIES * lock.PAUSE >= 1  # parts wait for each other that long


def test_storage_without_folders_has_no_lock():
    from orograph.store.fsspec_storage import FsspecStorage

    with alone(FsspecStorage("memory://lock/s"), "x"), alone(FsspecStorage("memory://lock/s"), "x"):
        pass


def test_all_who_write_take_the_same_lock(tmp_path):
    from orograph.geovis.color_store import store_colors
    from orograph.lighting.bake import bake
    from orograph.store.repair import repair

    path = tmp_path / "s"
    store.build(source(rough((60, 60))), path).close()
    before = {p: p.stat().st_mtime_ns for p in path.rglob("*")}
    writers = [
        lambda: bake(path, ["visible-sky"]),
        lambda: store_colors(path),
        lambda: repair(path),
        lambda: store.build(source(rough((60, 60))), path),
        lambda: store.build(source(rough((60, 60))), path, resume=True),
        lambda: store.build(source(rough((60, 60))), path, overwrite=True),
    ]
    with alone(FolderStorage(path), "baking into this store"):
        for write in writers:
            with pytest.raises(StoreError, match="Another process is baking into this store"):
                write()
        with store.open(path) as terrain:  # readers are not kept out
            assert terrain.check() == []
    assert {p: p.stat().st_mtime_ns for p in path.rglob("*")} == before


def test_a_bake_keeps_what_another_put_in_while_it_waited(tmp_path, monkeypatch):
    """The record is read under the lock: read before, it would put back what the other had replaced."""
    from orograph.lighting import bake as module
    from orograph.lighting.products import Options

    path = tmp_path / "s"
    store.build(source(rough((60, 60))), path, errors=()).close()
    taken, few = [], Options(azimuths=4)

    def after_another(storage, doing, shared=None):
        if not taken:
            taken.append(doing)
            module.bake(path, ["openness"], few).close()
        return alone(storage, doing, shared)

    monkeypatch.setattr(module, "alone", after_another)
    module.bake(path, ["visible-sky"], few).close()
    with store.open(path) as terrain:
        assert terrain.layers == ("openness", "visible-sky") and terrain.check() == []
