"""Versions of updated stores: readers that have one open, what is kept, and kills while names are exchanged."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_updating import OPTIONS as SIZES
from test_updating import fresh, grid_of_tiles, objects, tile

import orograph
from orograph.cli import cli
from orograph.errors import StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.products import Options
from orograph.store import versions
from orograph.store.build import build
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage

OPTIONS = {**SIZES, "errors": ()}


@pytest.fixture
def area(tmp_path):
    """Something that changes a tile and updates a store of nine, and the store."""
    files = grid_of_tiles(tmp_path / "tiles", 4)
    store = tmp_path / "area.oro"
    build(files, store, update=True, **OPTIONS).close()

    def changed(seed: int, **options):
        tile(tmp_path / "tiles", 1, 1, seed)
        build(files, store, update=True, **{**OPTIONS, **options}).close()

    return changed, store, files


def beside(store: Path) -> list[str]:
    return sorted(path.name for path in store.parent.iterdir() if path.name != "tiles")


def everything(terrain):
    rows, cols = terrain.grid.shape
    return terrain.read(0, 0, rows, 0, cols)


def test_numbers_and_how_many_are_kept(area):
    changed, store, files = area
    states = [objects(store)]
    for seed in range(1, 5):
        changed(seed, keep=3)
        states.append(objects(store))
    assert beside(store) == ["area.oro", "area.oro@3", "area.oro@4"]
    for number in (3, 4, 5):
        with orograph.open(f"{store}@{number}") as terrain:
            assert terrain.version == number and terrain.check() == []
            assert objects(Path(terrain.url)) == states[number - 1]
    assert Path(terrain.url) == store
    assert states[-1] == fresh(files, store.with_name("other.oro"), errors=())
    shutil.rmtree(store.with_name("other.oro"))
    build(files, store, update=True, keep=1, **OPTIONS).close()  # (nothing has changed)
    assert beside(store) == ["area.oro"]
    changed(9)
    assert beside(store) == ["area.oro", "area.oro@5"]


def test_what_versions_share_is_stored_once(area):
    changed, store, _ = area
    changed(1)
    key = "heights/0/height/c/3/3"  # far from the tile that changed
    assert (store / key).samefile(f"{store}@1/{key}")


@pytest.mark.parametrize("exchange", [True, False], ids=["exchanged", "renamed"])
@pytest.mark.parametrize("seen", [True, False], ids=["read before", "first read"])
def test_readers_go_on_with_the_version_they_have_open(area, monkeypatch, seen, exchange):
    if not exchange:
        monkeypatch.setattr(versions, "exchanged", lambda one, other: False)
    changed, store, _ = area
    with orograph.open(store) as terrain, orograph.open(store) as other:
        before = everything(other)
        if seen:
            everything(terrain)
        carried = pickle.dumps(terrain)
        changed(1, keep=3)
        changed(2, keep=3)
        np.testing.assert_array_equal(everything(terrain), before)
        assert terrain.read_mean(1, 0, 50, 0, 50).shape == (50, 50) and terrain.tiles(0).error.size
        assert "area.oro@1, version 1, not the newest" in repr(terrain)
        np.testing.assert_array_equal(everything(pickle.loads(carried)), before)  # a worker that comes late
        with terrain.reopen() as now:
            assert now.version == 3 and Path(now.url) == store and "newest" not in repr(now)
            assert not np.array_equal(everything(now), before)
        changed(3, keep=1)
        for reader in (terrain, other):
            reader.cache.clear()
            with pytest.raises(StoreError, match="replaced"):
                everything(reader)


@pytest.mark.parametrize("held", [True, False], ids=["cached", "decoded anew"])
def test_between_two_looks_nothing_is_mixed(area, monkeypatch, held):
    changed, store, _ = area
    monkeypatch.setattr("orograph.store.watch.EVERY", 1e9)
    with orograph.open(store, cache_bytes=1 << 26 if held else 0) as terrain:
        before = everything(terrain)
        changed(1)
        if not held:
            terrain.storage.close()
        np.testing.assert_array_equal(everything(terrain), before)
        assert terrain.check() == [] and terrain.version == 1


def test_light_stays_with_its_version(area):
    changed, store, _ = area
    bake(store, ["visible-sky"], Options(azimuths=4), progress=False).close()
    changed(1)
    with orograph.open(store) as now, orograph.open(f"{store}@1") as then:
        assert now.layers == () and then.layers == ("visible-sky",)
        assert then.layer("visible-sky").read(0, 0, 9, 0, 9).shape == (1, 9, 9)


def test_a_version_that_is_written_to_is_not_removed(area):
    changed, store, _ = area
    changed(1)
    with alone(FolderStorage(f"{store}@1"), "baking"):
        changed(2, keep=1)
    assert beside(store) == ["area.oro", "area.oro@1"]
    changed(3, keep=2)
    assert beside(store) == ["area.oro", "area.oro@3"]


def test_a_store_that_was_built_without_updates_becomes_version_1(tmp_path):
    files = grid_of_tiles(tmp_path / "tiles", 2)
    store = tmp_path / "area.oro"
    build(files, store, **OPTIONS).close()
    with orograph.open(store) as terrain:
        assert terrain.version is None
    tile(tmp_path / "tiles", 1, 1, 4)
    build(files, store, update=True, **OPTIONS).close()
    assert [orograph.open(f"{store}@{n}").version for n in (1, 2)] == [1, 2]


def test_what_is_told(area):
    changed, store, _ = area
    with pytest.raises(StoreError, match=r"no version 4 of area\.oro.*area\.oro is the only one"):
        orograph.open(f"{store}@4")
    changed(1)
    with pytest.raises(StoreError, match=r"no version 4 of area\.oro.*There are area\.oro, area\.oro@1"):
        orograph.open(f"{store}@4")
    facts = orograph.info(store)
    assert (facts["version"], facts["versions"]) == (2, [1])
    told = CliRunner().invoke(cli, ["info", f"{store}@2"])
    assert "version  2; kept beside it: @1" in told.output and told.exit_code == 0, told.output
    assert "version  1\n" in CliRunner().invoke(cli, ["info", f"{store}@1"]).output
    for verb in (["info", f"{store}@7"], ["render", f"{store}@7", "-o", "x.png"]):
        lost = CliRunner().invoke(cli, verb)
        assert isinstance(lost.exception, StoreError) and "no version 7 of area.oro" in str(lost.exception)


def test_what_makes_no_sense(area):
    changed, store, files = area
    changed(1)
    with pytest.raises(UsageError, match="`update=True`"):
        build(files, store, keep=2, overwrite=True, **OPTIONS)
    with pytest.raises(UsageError, match="at least one"):
        build(files, store, keep=0, update=True, **OPTIONS)
    with pytest.raises(UsageError, match=r"Update area\.oro"):
        build(files, f"{store}@1", update=True, **OPTIONS)


class Cut(BaseException):
    """The end of the process."""


@pytest.mark.cases(3)
@pytest.mark.parametrize("exchange", [True, False], ids=["exchanged", "renamed"])
@pytest.mark.parametrize("at", range(1, 4))
def test_kills_while_names_are_exchanged(area, monkeypatch, at, exchange):
    """Before the n-th rename of an update, which removes a version, too. Something that opens is there each time."""
    changed, store, files = area
    changed(1)
    swapped, rename, count = versions.exchanged, Path.rename, [0]

    def counted(do):
        def stopping(*args):
            count[0] += 1
            if count[0] == at:
                raise Cut
            return do(*args)

        return stopping

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", counted(rename))
        patch.setattr(versions, "exchanged", counted(swapped) if exchange else lambda one, other: False)
        with pytest.raises(Cut):
            changed(2)
    if exchange or store.exists():
        with orograph.open(store) as terrain:
            assert terrain.check() == []
    else:
        with pytest.raises(StoreError, match=r"area\.oro@2 holds version 2, complete"):
            orograph.open(store)
    build(files, store, update=True, **OPTIONS).close()
    assert beside(store) == ["area.oro", "area.oro@2"]
    assert objects(store) == fresh(files, store.with_name("other.oro"), errors=())
    with orograph.open(store) as terrain, orograph.open(f"{store}@2") as older:
        assert terrain.check() == older.check() == [] and (terrain.version, older.version) == (3, 2)
