"""Builds in groups and in parts: the same bytes as in one process, and clear words where parts are missing."""

from __future__ import annotations

import contextlib
from hashlib import blake2b

import numpy as np
import pytest
from surfaces import rough, source

from orograph import store
from orograph.errors import ReadError, StoreError, UsageError
from orograph.store.groups import Groups
from orograph.store.in_parts import levels_of, part_of, share
from orograph.store.lock import alone
from orograph.store.pyramid import tasks
from orograph.store.storage import FolderStorage

SIZES = {"shard": 64, "chunk": 16, "jobs": 1}


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.cases(2)
@pytest.mark.parametrize("shape", [(700, 530), (513, 512), (640, 129), (1200, 66)])
@pytest.mark.parametrize(("count", "kept"), [(1, {}), (3, {}), (3, {"codec": "progressive", "max_error": 0.05})])
def test_parts_make_what_one_process_makes(tmp_path, shape, count, kept):
    given = source(rough(shape, 3, missing=0.01, hole=True))
    how = SIZES | kept
    store.build(given, tmp_path / "whole", **how).close()
    for index in np.random.default_rng(count).permutation(count) + 1:
        assert store.build(given, tmp_path / "s", part=(int(index), count), **how) is None
    store.build(given, tmp_path / "s", finish=True, **how).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")
    assert levels_of((700, 530), 64, 1) > 0  # so some of these are in groups
    assert not [p for p in tmp_path.iterdir() if p.name not in ("s", "whole")]


def test_every_task_has_one_part():
    spots = tasks((1000, 900), 64)
    assert [spot for index in range(1, 8) for spot in share(spots, (index, 7))] == spots


def test_missing_parts_are_named(tmp_path):
    given = source(rough((700, 530), 4))
    for index in (1, 4):
        store.build(given, tmp_path / "s", part=f"{index}/5", **SIZES)
    with pytest.raises(StoreError, match=r"Parts 2-3, 5 of 5 are missing") as caught:
        store.build(given, tmp_path / "s", finish=True, **SIZES)
    assert caught.value.exit_code == 4
    with pytest.raises(StoreError, match="Another build"):
        store.build(given, tmp_path / "s", part="2/6", **SIZES)


@pytest.mark.stress
def test_a_part_that_was_damaged_is_named_and_made_again(tmp_path):
    given = source(rough((700, 530), 4))
    store.build(given, tmp_path / "whole", **SIZES).close()
    for index in (1, 2):
        store.build(given, tmp_path / "s", part=(index, 2), **SIZES)
    (tmp_path / "s.partial/heights/1/height/c/0/0").write_bytes(b"x" * 5000)
    with pytest.raises(StoreError, match=r"Part 1 of 2 is missing"):
        store.build(given, tmp_path / "s", finish=True, **SIZES)
    store.build(given, tmp_path / "s", part=(1, 2), **SIZES)
    store.build(given, tmp_path / "s", finish=True, **SIZES).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.stress
def test_a_part_goes_on_where_it_stopped(tmp_path, monkeypatch):
    given = source(rough((700, 530), 4))
    store.build(given, tmp_path / "whole", **SIZES).close()
    made, make = [], Groups.make
    monkeypatch.setattr(Groups, "make", lambda self, spot: (made.append(spot), make(self, spot))[1])
    for _ in range(2):
        store.build(given, tmp_path / "s", part=(1, 1), **SIZES)
    assert len(made) == len(set(made))
    store.build(given, tmp_path / "s", resume=True, **SIZES).close()  # one process may finish it, too
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_finish_waits_for_no_part_and_has_the_store_alone(tmp_path):
    given = source(rough((200, 200), 4))
    with pytest.raises(StoreError, match="No part of it was built"):
        store.build(given, tmp_path / "s", finish=True, **SIZES)
    with alone(FolderStorage(tmp_path / "s"), "building this store in parts", shared="other"):
        with pytest.raises(StoreError, match="Another process"):
            store.build(given, tmp_path / "s", part=(1, 2), **SIZES)
        with pytest.raises(StoreError, match="Another process"):
            store.build(given, tmp_path / "s", finish=True, **SIZES)


class Damaged(store.ArraySource):
    """Heights whose last rows cannot be read."""

    def read(self, row0, row1, col0, col1):
        if row1 > 650:
            raise ReadError("The block of rows 650–699 cannot be read.", path="a.tif")
        return super().read(row0, row1, col0, col1)


@pytest.mark.parametrize("how", [{}, {"resume": True}, {"part": (1, 1)}, {"part": (2, 2)}])
def test_a_build_whose_first_task_fails_leaves_nothing(tmp_path, how):
    heights = rough((700, 530), 4)
    whole = SIZES | {"shard": 1024}
    damaged = Damaged(heights, source(heights).grid, "rough", None)
    with pytest.raises(ReadError, match="650"):
        store.build(damaged, tmp_path / "s", **whole, **how)
    assert not list(tmp_path.iterdir())
    store.build(source(heights), tmp_path / "s", **whole).close()  # no `resume`, no `overwrite`


def test_a_part_that_fails_leaves_what_other_parts_make(tmp_path):
    heights = rough((700, 530), 4)
    given = Damaged(heights, source(heights).grid, "rough", None)
    store.build(given, tmp_path / "s", part=(1, 2), **SIZES)
    before = files(tmp_path)
    with pytest.raises(ReadError, match="650"):
        store.build(given, tmp_path / "s", part=(2, 2), **SIZES)
    assert before.items() <= files(tmp_path).items()  # and some shards of its own


def test_a_part_that_fails_leaves_the_plan_to_a_part_that_works(tmp_path, monkeypatch):
    heights = rough((200, 200), 4)
    given = Damaged(heights, source(heights).grid, "rough", None)
    grown = store.ArraySource.read
    path = tmp_path / "s"

    def fails_beside_another(self, *window):
        plan = (tmp_path / "s.partial/build.json").read_bytes()
        held.enter_context(alone(FolderStorage(path), "building", shared=blake2b(plan, digest_size=16).hexdigest()))
        raise ReadError("The block cannot be read.", path="a.tif")

    with contextlib.ExitStack() as held:
        monkeypatch.setattr(Damaged, "read", fails_beside_another)
        with pytest.raises(ReadError):
            store.build(given, path, part=(1, 1), **SIZES)
        assert (tmp_path / "s.partial/build.json").is_file()
    monkeypatch.setattr(Damaged, "read", grown)
    store.build(given, path, part=(1, 1), **SIZES)


@pytest.mark.parametrize("said", ["0/4", "5/4", "3", "a/b", (1, 2, 3)])
def test_parts_that_are_none(said):
    with pytest.raises(UsageError, match="I/N"):
        part_of(said)
