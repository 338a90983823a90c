"""Updates of stores: the bytes of a new build, whatever became of the inputs, and little that is made again."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

import orograph
from orograph.errors import StoreError, UsageError
from orograph.progress import Progress
from orograph.store import updating
from orograph.store.build import build
from orograph.store.pyramid import Finest
from orograph.store.survey import Errors

SIDE = 70
"""Samples along the sides of tiles; shards have 64."""


def tile(folder: Path, i: int, j: int, seed: int, holes: bool = False, kind: str = "float32", nodata: float = np.nan):
    """A GeoTIFF of a mosaic of ``SIDE`` × ``SIDE`` samples."""
    rng = np.random.default_rng([seed, i, j])
    heights = (100 + rng.normal(0, 3, (SIDE, SIDE)).cumsum(0)).clip(1, 199).astype(np.float32)
    if holes:
        heights[10:30, 20:40] = nodata
    path = folder / f"{i}_{j}.tif"
    place = Affine(10, 0, 500_000 + 10 * SIDE * j, 0, -10, 4_000_000 - 10 * SIDE * i)
    with rasterio.open(
        path, "w", driver="GTiff", width=SIDE, height=SIDE, count=1, dtype=kind, crs="EPSG:32611",
        transform=place, nodata=nodata,
    ) as file:  # fmt: skip
        file.write(heights.astype(kind), 1)
    changed = path.stat().st_mtime_ns + 1_000_000 * (1 + seed)  # (lest two writes have one time)
    os.utime(path, ns=(changed, changed))
    return path


def objects(store: Path) -> dict[str, str]:
    """Digests of all files of a store, but for those that updates keep."""
    return {
        str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(store.rglob("*"))
        if path.is_file() and "parts" not in path.parts
    }


def grid_of_tiles(folder: Path, count: int = 5) -> list[Path]:
    folder.mkdir()
    return [tile(folder, i, j, 0) for i in range(count) for j in range(count)]


OPTIONS = {"shard": 64, "chunk": 32, "progress": False}


def fresh(files: Any, at: Path, **options) -> dict[str, str]:
    build(files, at, overwrite=True, **{**OPTIONS, **options}).close()
    return objects(at)


@pytest.mark.stress
@pytest.mark.parametrize(
    "options",
    [
        {},
        pytest.param({"codec": "compact", "max_error": 0.5, "errors": ("exact", "wedgie")}, marks=pytest.mark.stress),
        pytest.param({"quadtin": (8.0, "nearest"), "errors": ()}, marks=pytest.mark.stress),
        pytest.param({"codec": "progressive", "max_error": 0.5, "jobs": 1}, marks=pytest.mark.stress),
    ],
)
def test_updates_are_new_builds_to_the_byte(tmp_path, options):
    files = grid_of_tiles(tmp_path / "tiles")
    store, other = tmp_path / "area.oro", tmp_path / "other.oro"
    build(files, store, update=True, **OPTIONS, **options).close()
    assert objects(store) == fresh(files, other, **options)
    rng = np.random.default_rng(7)
    corners = {0, 4, 20, 24}
    there = list(range(25))
    for step in range(1, 4):
        what = ("change", "remove", "add")[step % 3]
        inner = [k for k in there if k not in corners]
        gone = [k for k in range(25) if k not in there]
        if what == "remove" or (what == "add" and not gone):
            there.remove(int(rng.choice(inner)))
        elif what == "add":
            there = sorted([*there, gone[0]])
        else:
            for k in rng.choice(inner, 2, replace=False):
                tile(tmp_path / "tiles", k // 5, k % 5, step, holes=bool(step % 2))
        chosen = [files[k] for k in there]
        build(chosen, store, update=True, **OPTIONS, **options).close()
        assert objects(store) == fresh(chosen, other, **options), (step, what)
    with orograph.open(store) as terrain:
        assert terrain.check() == []


def made(monkeypatch) -> tuple[list, list]:
    """The tasks of heights and of errors that are done from now on."""
    heights, errors = [], []
    of_heights, of_errors = Finest.make, Errors.make
    monkeypatch.setattr(Finest, "make", lambda self, spot: (heights.append(spot), of_heights(self, spot))[1])
    monkeypatch.setattr(Errors, "make", lambda self, spot: (errors.append(spot), of_errors(self, spot))[1])
    return heights, errors


@pytest.mark.stress
def test_only_what_follows_of_a_changed_file_is_made_again(tmp_path, monkeypatch):
    files = grid_of_tiles(tmp_path / "tiles", 8)
    store = tmp_path / "area.oro"
    build(files, store, update=True, **OPTIONS).close()
    heights, errors = made(monkeypatch)
    tile(tmp_path / "tiles", 1, 1, 3)  # samples 70 to 139: shards 1 and 2, and those before them
    build(files, store, update=True, **OPTIONS).close()
    assert set(heights) <= {(i, j) for i in range(3) for j in range(3)} and len(heights) >= 4
    assert errors and (8, 8) not in errors and (0, 8) not in errors
    heights.clear(), errors.clear()
    build(files, store, update=True, **OPTIONS).close()
    assert not heights and not errors


@pytest.mark.stress
def test_another_range_of_heights_makes_all_errors_again(tmp_path, monkeypatch):
    files = grid_of_tiles(tmp_path / "tiles")
    store = tmp_path / "area.oro"
    build(files, store, update=True, **OPTIONS).close()
    with rasterio.open(files[6], "r+") as file:
        values = file.read(1)
        values[5, 5] = 900
        file.write(values, 1)
    heights, errors = made(monkeypatch)
    build(files, store, update=True, **OPTIONS).close()
    assert len(heights) < 36 == len(errors)
    monkeypatch.undo()
    assert objects(store) == fresh(files, tmp_path / "other.oro")


@pytest.mark.stress
@pytest.mark.parametrize("resolution", [None, 17.0, pytest.param(4.0, marks=pytest.mark.stress)])
def test_resampled_sources(tmp_path, resolution, monkeypatch):
    files = grid_of_tiles(tmp_path / "tiles", 4)
    options = {"resolution": resolution} if resolution else {"crs": "EPSG:32612"}
    store, other = tmp_path / "area.oro", tmp_path / "other.oro"
    build(files, store, update=True, **OPTIONS, **options).close()
    with orograph.open(store) as terrain:
        many = -(-terrain.shape(0)[0] // 64) * -(-terrain.shape(0)[1] // 64)
    tile(tmp_path / "tiles", 1, 2, 5)
    heights, _ = made(monkeypatch)
    build(files, store, update=True, **OPTIONS, **options).close()
    assert 0 < len(heights) < many
    assert objects(store) == fresh(files, other, **options)
    del files[5]
    build(files, store, update=True, **OPTIONS, **options).close()
    assert objects(store) == fresh(files, other, **options)


@pytest.mark.cases(1)
@pytest.mark.parametrize("now", [{"kind": "float32"}, {"kind": "int16", "nodata": -9999}])
def test_sources_whose_numbers_are_of_another_kind(tmp_path, now):
    (tmp_path / "tiles").mkdir()
    whole = {"kind": "int16", "nodata": -32768, "holes": True}
    files = [tile(tmp_path / "tiles", i, j, 0, **whole) for i in range(4) for j in range(4)]
    store, other = tmp_path / "area.oro", tmp_path / "other.oro"
    build(files, store, update=True, resolution=17.0, **OPTIONS).close()
    if now["kind"] == "float32":
        tile(tmp_path / "tiles", 0, 0, 3, **now)
    else:
        for k in range(16):
            tile(tmp_path / "tiles", k // 4, k % 4, 0, holes=True, **now)
    build(files, store, update=True, resolution=17.0, **OPTIONS).close()
    assert objects(store) == fresh(files, other, resolution=17.0)


def test_points(tmp_path):
    rng = np.random.default_rng(0)
    table, store = tmp_path / "p.csv", tmp_path / "p.oro"
    for count in (300, 290):
        places = [[0, 0], [900, 0], [0, 900], [900, 900], *rng.uniform(0, 900, (count, 2))]
        points = np.c_[places, rng.uniform(0, 90, count + 4)]
        np.savetxt(table, points, delimiter=",", header="x,y,z", comments="")
        build(table, store, update=True, resolution=20, **OPTIONS).close()
        assert objects(store) == fresh(table, tmp_path / "other.oro", resolution=20)


@pytest.mark.stress
def test_what_cannot_be_updated_is_made_again_and_a_note_says_why(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles", 3)
    store, other = tmp_path / "area.oro", tmp_path / "other.oro"
    notes: list[str] = []

    class Heard(Progress):
        def note(self, text):
            notes.append(text)

        def warn(self, text):
            notes.append(text)

    def again(chosen, **options):
        notes.clear()
        build(chosen, store, update=True, **{**OPTIONS, "progress": Heard(), **options}).close()
        assert objects(store) == fresh(chosen, other, **options)
        return " ".join(notes)

    build(files, store, **OPTIONS).close()
    tile(tmp_path / "tiles", 1, 1, 4)
    assert "keeps no parts" in again(files)
    assert "size" in again(files[:6])
    assert "another order" in again(files[:6][::-1])
    assert "kinds of errors" in again(files[:6][::-1], errors=("midpoint",))
    assert "sources or options" not in again(files[:6][::-1], errors=("midpoint",))


@pytest.mark.stress
def test_an_interrupted_update_goes_on_and_a_later_change_counts(tmp_path, monkeypatch):
    files = grid_of_tiles(tmp_path / "tiles")
    store = tmp_path / "area.oro"
    build(files, store, update=True, **OPTIONS).close()
    before = objects(store)
    tile(tmp_path / "tiles", 2, 2, 6)

    def breaks(self, spot):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Errors, "make", breaks)
        with pytest.raises(KeyboardInterrupt):
            build(files, store, update=True, **OPTIONS)
    assert objects(store) == before and (tmp_path / "area.oro.partial/build.json").exists()
    with pytest.raises(StoreError):
        build(files, store, **OPTIONS)
    tile(tmp_path / "tiles", 0, 1, 7)
    build(files, store, update=True, **OPTIONS).close()
    assert objects(store) == fresh(files, tmp_path / "other.oro")
    assert not (tmp_path / "area.oro.partial").exists()


@pytest.mark.stress
def test_shards_that_were_damaged_meanwhile_are_made_again(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles")
    store = tmp_path / "area.oro"
    build(files, store, update=True, **OPTIONS).close()
    shard = store / "heights/0/height/c/4/4"
    shard.write_bytes(shard.read_bytes()[:-40])
    tile(tmp_path / "tiles", 0, 1, 8)
    build(files, store, update=True, **OPTIONS).close()
    assert objects(store) == fresh(files, tmp_path / "other.oro")


def test_readers_are_told_where_no_older_version_is_kept(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles", 3)
    store = tmp_path / "area.oro"
    with build(files, store, update=True, **OPTIONS) as reader:
        tile(tmp_path / "tiles", 1, 1, 9)
        build(files, store, update=True, keep=1, **OPTIONS).close()
        with pytest.raises(StoreError, match="replaced"):
            reader.read(0, 0, 200, 0, 200)
        with reader.reopen() as now:
            assert np.isfinite(now.read(0, 0, 200, 0, 200)).all()


def test_ways_that_exclude_an_update(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles", 2)
    for name, value in (("overwrite", True), ("resume", True), ("finish", True), ("part", "1/2")):
        with pytest.raises(UsageError, match=f"`update` and `{name}`"):
            build(files, tmp_path / "a.oro", update=True, **{name: value}, progress=False)
    with pytest.raises(UsageError, match="in a folder or a bucket"):
        build(files, "memory://a.oro", update=True, progress=False)


def test_errors_depend_on_samples_at_multiples(monkeypatch):
    found = list(updating._of_errors((1025, 1025), [(65, 90, 300, 320)]))
    assert found == [(65 - 368, 90 + 368, 300 - 368, 320 + 368)]  # no multiple of 32 in both
    wide = list(updating._of_errors((1025, 1025), [(60, 130, 120, 140)]))
    assert [w[1] - w[0] for w in wide[1:]] == [64 + 1 + 128, 64 + 1 + 256, 1 + 512]
    assert updating._multiples(1000, 1025, 512, 1025) == (1024, 1024)
    assert updating._multiples(1000, 1024, 512, 1025) is None


@pytest.mark.stress
def test_updates_that_are_killed_again_and_again(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles", 8)
    store = tmp_path / "area.oro"
    command = [
        sys.executable, "-c",
        "import sys; from orograph.store.build import build\n"
        "build(sys.argv[2:], sys.argv[1], update=True, shard=64, chunk=32, progress=False, jobs=1)",
        str(store), *map(str, files),
    ]  # fmt: skip
    subprocess.run(command, check=True)
    rng = np.random.default_rng(5)
    kills = 0
    for step in range(1, 5):
        for k in rng.choice(64, 3, replace=False):
            tile(tmp_path / "tiles", k // 8, k % 8, 20 + step)
        for _ in range(6):
            process = subprocess.Popen(command)
            try:
                process.wait(rng.uniform(0.8, 4.0))
                break
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                kills += 1
                with orograph.open(store) as terrain:
                    assert terrain.check() == []
    subprocess.run(command, check=True)
    assert kills >= 6
    assert objects(store) == fresh(files, tmp_path / "other.oro")
