"""What a build leaves that is killed at its very end: complete folders, and words that say which is which."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from surfaces import rough, source

import orograph
from orograph import store
from orograph.cli import cli
from orograph.errors import StoreError
from orograph.store.detect import is_store

OLD, NEW, OTHER = (rough((90, 80), seed) for seed in (1, 2, 3))


class Cut(BaseException):
    """The end of the process."""


@pytest.fixture
def cut(monkeypatch):
    """Builds that end before their n-th rename of the store's folders."""

    def build(heights, path, at, **how):
        rename, count = Path.rename, [0]

        def stop(self, target):
            count[0] += 1
            if count[0] == at:
                raise Cut
            return rename(self, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", stop)
            with pytest.raises(Cut):
                store.build(source(heights), path, **how)

    return build


def heights_of(path):
    with store.open(path) as terrain:
        assert terrain.check() == []
        return terrain.read(0, 0, 90, 0, 80)


def folders(tmp_path):
    return sorted(p.name for p in tmp_path.iterdir())


def test_a_build_cut_off_before_its_last_rename_is_not_taken_for_another(tmp_path, cut):
    cut(OLD, tmp_path / "s", 1)
    assert folders(tmp_path) == ["s.partial"]
    with pytest.raises(StoreError, match=r"cannot be resumed: its sources or options"):
        store.build(source(NEW), tmp_path / "s", resume=True)
    with pytest.raises(StoreError, match="kinds of errors"):
        store.build(source(OLD), tmp_path / "s", resume=True, errors=("exact", "wedgie"))
    store.build(source(OLD), tmp_path / "s", resume=True).close()
    np.testing.assert_array_equal(heights_of(tmp_path / "s"), OLD)
    assert folders(tmp_path) == ["s"]


def test_a_store_of_the_same_samples_under_another_name_is_not_the_same_build(tmp_path):
    store.build(source(OLD), tmp_path / "s").close()
    named = store.ArraySource(OLD, source(OLD).grid, "another", "EGM96 height")
    with pytest.raises(StoreError, match="sources or options"):
        store.build(named, tmp_path / "s", resume=True)


def between(tmp_path, cut):
    store.build(source(OLD), tmp_path / "s.oro").close()
    cut(NEW, tmp_path / "s.oro", 2, overwrite=True)
    assert folders(tmp_path) == ["s.oro.partial", "s.oro.replaced"]
    return tmp_path / "s.oro"


SAID = r"s\.oro\.partial holds the new store, complete; s\.oro\.replaced holds the store that was there before"


def test_between_the_two_renames_everything_is_named(tmp_path, cut):
    path = between(tmp_path, cut)
    assert is_store(path)
    for verb in (lambda: store.open(path), lambda: store.build(source(NEW), path)):
        with pytest.raises(StoreError, match=SAID + r".*resume=True.*rename the folder that you want to s\.oro"):
            verb()
    with pytest.raises(StoreError, match="sources or options"):
        store.build(source(OTHER), path, resume=True)
    assert folders(tmp_path) == ["s.oro.partial", "s.oro.replaced"]
    store.build(source(NEW), path, resume=True).close()
    np.testing.assert_array_equal(heights_of(path), NEW)
    assert folders(tmp_path) == ["s.oro"]


def test_either_folder_may_be_renamed(tmp_path, cut):
    path = between(tmp_path, cut)
    shutil.copytree(tmp_path, tmp_path.parent / "copy")
    (tmp_path / "s.oro.replaced").rename(path)
    np.testing.assert_array_equal(heights_of(path), OLD)
    copy = tmp_path.parent / "copy/s.oro"
    Path(f"{copy}.partial").rename(copy)
    np.testing.assert_array_equal(heights_of(copy), NEW)
    store.build(source(OTHER), copy, overwrite=True).close()  # what was left beside it goes with the next build
    np.testing.assert_array_equal(heights_of(copy), OTHER)
    assert folders(copy.parent) == ["s.oro"]


def test_the_old_store_is_kept_until_a_new_one_is_complete(tmp_path, cut):
    path = between(tmp_path, cut)
    cut(OTHER, path, 1, overwrite=True)
    np.testing.assert_array_equal(heights_of(f"{path}.replaced"), OLD)
    shutil.rmtree(f"{path}.partial")
    for resume in (False, True):
        with pytest.raises(StoreError, match=r"s\.oro\.replaced holds the store that was there before.*Rename"):
            store.build(source(OTHER), path, resume=resume)
    with pytest.raises(StoreError, match=r"s\.oro\.replaced holds.*Rename the folder"):
        store.open(path)
    store.build(source(OTHER), path, overwrite=True).close()
    np.testing.assert_array_equal(heights_of(path), OTHER)
    assert folders(tmp_path) == ["s.oro"]


@pytest.mark.parametrize(
    "words", [["info"], ["render", "-o", "p.png"], ["light", "--product", "slope", "-o", "m.tif"], ["check"],
              ["measure"], ["bake", "--products", "visible-sky"], ["tessellate", "-o", "m.obj"]],
    ids=lambda words: words[0],
)  # fmt: skip
def test_every_verb_names_the_folders(tmp_path, cut, words, monkeypatch):
    path = between(tmp_path, cut)
    monkeypatch.chdir(tmp_path)
    if words[0] == "measure":
        line = ["measure", "pick", str(path), "500000,4000000"]
    else:
        line = [words[0], str(path), *words[1:]]
    told = CliRunner().invoke(cli, ["-q", *line])
    assert isinstance(told.exception, StoreError) and told.exception.exit_code == 4, told.output
    assert "s.oro.partial holds the new store" in str(told.exception)
    assert folders(tmp_path) == ["s.oro.partial", "s.oro.replaced"]


def test_an_unfinished_build_is_said_to_be_one(tmp_path, monkeypatch):
    from orograph.store.storage import FolderStorage

    put, left = FolderStorage.put, [5]

    def stop(self, key, parts):
        left[0] -= 1
        if left[0] < 0:
            raise Cut
        put(self, key, parts)

    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", stop)
        with pytest.raises(Cut):
            store.build(source(NEW), tmp_path / "s")
    with pytest.raises(StoreError, match=r"incomplete.*interrupted. It is made in s\.partial.*resume=True"):
        store.open(tmp_path / "s")


@pytest.mark.parametrize("how", ["update", "resume", "bake"])
def test_an_old_store_that_was_to_be_removed_goes_with_the_next_writer(tmp_path, how):
    """Killed after its last rename: the new store is there, and the old one still lies beside it."""
    given = source(NEW)
    store.build(given, tmp_path / "s", update=how == "update").close()
    store.build(source(OLD), tmp_path / "s.replaced").close()
    if how == "bake":
        orograph.bake(tmp_path / "s", "visible-sky", azimuths=4, progress=False).close()
    else:
        store.build(given, tmp_path / "s", **{how: True}).close()
    assert folders(tmp_path) == ["s"]
    np.testing.assert_array_equal(heights_of(tmp_path / "s"), NEW)
