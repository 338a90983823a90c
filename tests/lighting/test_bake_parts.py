"""Light baked in parts: the same bytes as by one process, in any order and at once, and clear words otherwise."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from test_bake_cluster import CASES, files, made

import orograph
from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.bake_layers import LayerStage
from orograph.lighting.bake_state import SweepStage
from orograph.lighting.context import Options
from orograph.store.layers import PARTIAL
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage

ALONE = {name: CASES[name] for name in ("radius", "walks", "rays")}
"""What shards are made of without one another."""
NAMES, OPTIONS = CASES["radius"]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A store without light."""
    return files(made(tmp_path_factory.mktemp("plain") / "s"))


@pytest.fixture
def target(tmp_path, plain):
    """A copy of it."""
    for name, data in plain.items():
        (tmp_path / "s" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "s" / name).write_bytes(data)
    return tmp_path / "s"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Case → files of a store baked by one process."""
    found = {}

    def of(case):
        if case not in found:
            folder = made(tmp_path_factory.mktemp(case) / "whole")
            bake(folder, *ALONE[case], jobs=1).close()
            found[case] = files(folder)
        return found[case]

    return of


@pytest.mark.cases(3)
@pytest.mark.parametrize("case", ALONE)
@pytest.mark.parametrize("count", [3, 40])
def test_parts_make_what_one_process_makes(target, whole, case, count):
    names, options = ALONE[case]
    for index in np.random.default_rng(count).permutation(count) + 1:  # there are 24 shards: some of 40 have none
        assert bake(target, names, options, part=(int(index), count), jobs=1) is None
        with store.open(target) as terrain:
            assert terrain.layers == () and terrain.check() == []
    bake(target, names, options, finish=True).close()
    assert files(target) == whole(case)


def test_parts_at_once(target, whole):
    names, options = ALONE["rays"]
    failed = []

    def run(index):
        try:
            bake(target, names, options, part=f"{index}/4", jobs=2)
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=run, args=(index,)) for index in range(1, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    bake(target, names, options, finish=True).close()
    assert files(target) == whole("rays")


def test_missing_parts_are_named_and_not_made(target, whole):
    with pytest.raises(StoreError, match="No part of it was baked"):
        bake(target, NAMES, OPTIONS, finish=True)
    for index in (4, 1):
        bake(target, NAMES, OPTIONS, part=(index, 5))
    before = files(target)
    with pytest.raises(StoreError, match=r"Parts 2-3, 5 of 5 are missing") as caught:
        bake(target, NAMES, OPTIONS, finish=True)
    assert caught.value.exit_code == 4 and files(target) == before
    for index in (2, 3, 5):
        bake(target, NAMES, OPTIONS, part=(index, 5))
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")


@pytest.mark.parametrize("what", ["layers/sky-view-factor/0/sky-view-factor/c/0/0", "parts/visible-sky.0.0.part"])
def test_a_part_that_was_damaged_is_named_and_made_again(target, whole, what):
    for index in (1, 2):
        bake(target, NAMES, OPTIONS, part=(index, 2))
    assert not list((target / PARTIAL).rglob("*.sums"))  # nothing follows from them any more
    damaged = target / PARTIAL / what
    damaged.write_bytes(damaged.read_bytes()[:-30] + bytes(30))
    with pytest.raises(StoreError, match=r"Part 1 of 2 is missing"):
        bake(target, NAMES, OPTIONS, finish=True)
    bake(target, NAMES, OPTIONS, part=(1, 2))
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")


@pytest.mark.parametrize("after", [3, 9, 31, 60])
def test_a_part_that_stops_goes_on(target, whole, monkeypatch, after):
    swept, layers, put, count = [], [], FolderStorage.put, [0]

    class Stop(BaseException):
        """Stands for the end of the process."""

    def stop(self, key, parts):
        count[0] += 1
        if count[0] > after:
            raise Stop
        put(self, key, parts)

    for stage, found in ((SweepStage, swept), (LayerStage, layers)):

        def make(self, spot, old=stage.make, found=found):
            made = old(self, spot)
            found.append((self.number, spot))
            return made

        monkeypatch.setattr(stage, "make", make)
    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", stop)
        with pytest.raises(Stop):
            bake(target, NAMES, OPTIONS, part=(1, 2), jobs=1)
    bake(target, NAMES, OPTIONS, part=(1, 2), jobs=1)
    assert len(layers) == len(set(layers)) == 24 and len(swept) == len(set(swept)) == 12  # nothing is done twice
    bake(target, NAMES, OPTIONS, part=(2, 2), jobs=1)
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")


@pytest.mark.stress
def test_killed_parts_are_run_again(target, tmp_path):
    """Processes that are killed again and again as soon as they have made another shard of their part."""
    names, how = "ambient-occlusion", {"method": "rays", "rays": 512, "radius": 300.0}
    command = [sys.executable, "-m", "orograph", "-q", "bake", target, "--products", names, "--by", "rays", "--rays",
               "512", "--radius", "300", "--jobs", "1"]  # fmt: skip
    kept, kills = target / PARTIAL / "parts", 0
    for index in (2, 1):
        while True:
            before = len(list(kept.glob("*")))
            part = subprocess.Popen([*command, "--part", f"{index}/2"], stderr=subprocess.DEVNULL)
            while part.poll() is None and len(list(kept.glob("*"))) == before:
                time.sleep(0.002)
            part.kill()
            if part.wait() == 0:
                break
            kills += 1
    assert subprocess.run([*command, "--finish"]).returncode == 0
    bake(made(tmp_path / "whole"), names, **how).close()
    assert kills > 10 and files(target) == files(tmp_path / "whole")


def test_all_parts_are_of_one_bake(target):
    bake(target, NAMES, OPTIONS, part=(1, 3))
    with pytest.raises(StoreError, match=r"Another bake.* was begun in 3 parts.*parts of 3.*remove .*partial"):
        bake(target, NAMES, OPTIONS, part=(2, 4))
    for names, options in ((NAMES[:1], OPTIONS), (NAMES, Options(azimuths=7, radius=800.0))):
        for how in ({"part": (2, 3)}, {"finish": True}):
            with pytest.raises(StoreError, match="Another bake"):
                bake(target, names, options, **how)
    with pytest.raises(StoreError, match=r"Another bake.* was begun in 3 parts.*`overwrite=True`"):
        bake(target, NAMES, OPTIONS)
    bake(target, NAMES, OPTIONS, overwrite=True).close()
    assert not (target / PARTIAL).exists()


def test_rays_of_another_seed_are_another_bake(target):
    names, rays = CASES["rays"]
    bake(target, names, rays, part=(1, 2))
    other = Options(rays=rays.rays, radius=rays.radius, more={**rays.more, "seed": 4})
    with pytest.raises(StoreError, match="Another bake"):
        bake(target, names, other, part=(2, 2))


def test_parts_share_the_store_with_each_other_only(target):
    bake(target, NAMES, OPTIONS, part=(1, 2))
    with alone(FolderStorage(target), "baking into this store", shared="other parts"):
        for how in ({"part": (2, 2)}, {"finish": True}, {}):
            with pytest.raises(StoreError, match="Another process is baking into this store"):
                bake(target, NAMES, OPTIONS, **how)
    waiting, go, put = threading.Event(), threading.Event(), FolderStorage.put

    def pausing(self, key, parts):
        if threading.current_thread() is first:
            waiting.set()
            assert go.wait(60)
        put(self, key, parts)

    first = threading.Thread(target=bake, args=(target, NAMES, OPTIONS), kwargs={"part": (2, 2), "jobs": 1})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FolderStorage, "put", pausing)
        first.start()
        try:
            assert waiting.wait(60)
            with pytest.raises(StoreError, match=r"Another process.*Its plan is different"):
                bake(target, NAMES, OPTIONS, part=(1, 3))
            with pytest.raises(StoreError, match="Another process"):
                bake(target, NAMES, OPTIONS, finish=True)
            assert bake(target, NAMES, OPTIONS, part=(1, 2)) is None
        finally:
            go.set()
            first.join()
    bake(target, NAMES, OPTIONS, finish=True).close()


def test_what_is_there_is_left_and_can_be_baked_anew(target, whole):
    bake(target, NAMES[:1], OPTIONS).close()
    for index in (1, 2):  # the other one alone
        bake(target, NAMES, OPTIONS, part=(index, 2))
    assert not (target / PARTIAL / "layers" / NAMES[0]).exists()
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")
    assert bake(target, NAMES, OPTIONS, part=(1, 2)) is None  # all of it is there
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")
    shard = target / "layers/visible-sky/0/visible-sky/c/1/1"
    shard.write_bytes(bytes(len(shard.read_bytes())))
    for index in (1, 2):
        bake(target, NAMES, OPTIONS, part=(index, 2), overwrite=True)
    bake(target, NAMES, OPTIONS, finish=True, overwrite=True).close()
    assert files(target) == whole("radius")


def test_a_finish_that_was_killed_at_its_very_end(target, whole, monkeypatch):
    from orograph.lighting import bake_folder

    bake(target, NAMES, OPTIONS, part=(1, 1))
    with monkeypatch.context() as patch:
        patch.setattr(bake_folder, "discard", lambda storage: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            bake(target, NAMES, OPTIONS, finish=True)
    assert (target / PARTIAL).exists()
    bake(target, NAMES, OPTIONS, finish=True).close()
    assert files(target) == whole("radius")


def test_what_parts_cannot_bake(target):
    for case in ("swept", "round"):
        for how in ({"part": (1, 2)}, {"finish": True}):
            with pytest.raises(UsageError, match=r"Horizons without a radius.*`radius`.*`workers`"):
                bake(target, *CASES[case], **how)
    with pytest.raises(UsageError, match="ambient-occlusion"):  # swept without a radius, by rays never
        bake(target, "ambient-occlusion", part=(1, 2))
    assert bake(target, "ambient-occlusion", method="rays", rays=2, part=(1, 24)) is None
    with store.open(target) as terrain:
        assert terrain.layers == ()


def test_parts_are_said_as_of_builds(target):
    with pytest.raises(UsageError, match="I/N"):
        orograph.bake(target, NAMES, OPTIONS, part="0/2")
    for how in ({"workers": 2}, {"dask": "tcp://127.0.0.1:1"}, {"finish": True}):
        with pytest.raises(UsageError, match="exclude"):
            orograph.bake(target, NAMES, OPTIONS, part="1/2", **how)
    assert not (target / "layers").exists()


def test_parts_bake_into_folders_and_buckets():
    url = made("memory://parts/area.oro")
    with pytest.raises(UsageError, match=r"folders or buckets.*one process"):
        bake(url, NAMES, OPTIONS, part=(1, 2))
