"""The cache folder keeps within its size: the longest unused goes, what is in use stays."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rasterio
from affine import Affine
from surfaces import rough

from orograph.errors import UsageError
from orograph.folders import cache_limit
from orograph.progress import Progress
from orograph.store import prepare
from orograph.store.doubts import DOUBTS
from orograph.store.kept import Use, entries, make_room
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage

MB = 1_000_000


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache folder of 2.5 MB at most, with a function that puts something in it: a name, its size, its last use."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("OROGRAPH_CACHE", str(folder))
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", "2.5MB")

    def put(name, size, used):
        path = folder / name
        (path / "heights").mkdir(parents=True)
        (path / "heights" / "0").write_bytes(bytes(size // 2))
        (path / "zarr.json").write_bytes(bytes(size - size // 2))
        os.utime(path, (used, used))
        return path

    return put


def names():
    return [entry.path.name for entry in entries()]


def test_the_longest_unused_goes_first(cache):
    cache("a.oro", MB, 300)
    cache("b.oro", MB, 100)
    cache("images/c", MB, 200)
    cache("d.oro.partial", MB // 4, 50)
    assert names() == ["d.oro", "b.oro", "c", "a.oro"]
    assert [entry.size for entry in entries()] == [MB // 4, MB, MB, MB]
    make_room()
    assert names() == ["c", "a.oro"]
    make_room()
    assert names() == ["c", "a.oro"]


def test_a_store_that_another_process_is_building_is_waited_for(tmp_path, monkeypatch):
    """Two pictures of one large raster at the same time: neither is refused, and one store is built."""
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(prepare, "EXACT_SAMPLES", 100)
    dem = tmp_path / "dem.tif"
    with rasterio.open(dem, "w", driver="GTiff", height=90, width=80, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(rough((90, 80), 3), 1)
    first = prepare.prepare([str(dem)])
    path = entries()[0].path
    first.close()
    shutil.rmtree(path)
    held, done = threading.Event(), threading.Event()

    def other():
        with alone(FolderStorage(path), "building this store"):
            held.set()
            done.wait(60)

    thread = threading.Thread(target=other)
    thread.start()
    held.wait(60)
    threading.Timer(0.5, done.set).start()
    began = time.monotonic()
    with prepare.prepare([str(dem)]) as terrain:
        assert time.monotonic() - began > 0.3
        np.testing.assert_array_equal(terrain.read(0, 0, 90, 0, 80), rough((90, 80), 3))
    thread.join()


def test_doubts_about_heights_are_found_once(tmp_path, monkeypatch):
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(prepare, "EXACT_SAMPLES", 100)
    dem, heights = tmp_path / "dem.tif", rough((90, 80), 3)
    heights[:30, :30] = -9999
    with rasterio.open(dem, "w", driver="GTiff", height=90, width=80, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(heights, 1)

    class Heard(Progress):
        def warn(self, text):
            said.append(text)

    def warnings():
        said.clear()
        prepare.prepare([str(dem)], progress=Heard()).close()
        return [text for text in said if "-9999" in text]

    said = []
    first = warnings()  # of the build
    assert warnings() == first
    assert len(first) == 1
    with monkeypatch.context() as patched:
        patched.setattr("orograph.dem.inspect.doubtful_heights", lambda *_: pytest.fail("looked again"))
        assert warnings() == first
    doubts = entries()[0].path / DOUBTS
    doubts.write_text("[")
    assert warnings() == first and json.loads(doubts.read_text())


def test_what_is_used_again_is_not_the_oldest(cache):
    a, *_ = (cache(f"{name}.oro", MB, used) for used, name in enumerate("abc", 1))
    Use(a).release()
    make_room()
    assert names() == ["c.oro", "a.oro"]


def test_what_is_in_use_or_being_built_stays(cache):
    a, b, c = (cache(f"{name}.oro", 2 * MB, used) for used, name in enumerate("abc", 1))
    held = Use(a)
    os.utime(a, (1, 1))
    with alone(FolderStorage(b), "building this store"):
        make_room()
        assert names() == ["a.oro", "b.oro"] and not c.exists()
    held.release()
    make_room()
    assert names() == ["b.oro"]


def test_another_process_s_use_counts_until_it_ends(cache):
    path = cache("a.oro", 3 * MB, 1)
    code = "import sys; from pathlib import Path; from orograph.store.kept import Use; u = Use(Path(sys.argv[1])); "
    child = subprocess.Popen(
        [sys.executable, "-c", code + "print('held', flush=True); sys.stdin.read()", str(path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert child.stdout.readline() == "held\n"
    make_room()
    assert path.exists()
    child.communicate("")
    make_room()
    assert not path.exists() and names() == []


def test_a_size_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv("OROGRAPH_CACHE_SIZE", "lots")
    with pytest.raises(UsageError, match="OROGRAPH_CACHE_SIZE"):
        cache_limit()
    monkeypatch.delenv("OROGRAPH_CACHE_SIZE")
    assert cache_limit() == 20 * 2**30
