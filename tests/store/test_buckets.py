"""Stores in buckets: an S3 server (moto) that is busy, slow, cuts answers off and lists what is no more."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from datetime import datetime, timedelta

import numpy as np
import pytest
from breaking import broken_off
from buckets import ENVIRONMENT, bucket_server
from surfaces import rough, source
from webserver import until

from orograph import store
from orograph.errors import DamagedChunkError, StoreError, UsageError, public
from orograph.lighting.bake import bake
from orograph.processes import host
from orograph.store import bucket as buckets
from orograph.store import bucket_lock, storage
from orograph.store.addresses import storage_at
from orograph.store.bucket import BucketStorage
from orograph.store.lock import alone
from orograph.store.publishing import publish
from orograph.store.repair import repair
from orograph.store.storage import FolderStorage

pytest.importorskip("obstore")
pytest.importorskip("moto.server")

HEIGHTS = rough((270, 120), 21, hole=True)
SIZES = {"shard": 128, "chunk": 32}


@pytest.fixture(scope="module")
def server():
    with bucket_server() as running:
        yield running


@pytest.fixture
def s3(server, monkeypatch):
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(storage, "AGAIN", (0.01, 0.02))
    monkeypatch.setattr(storage, "LONGER", (0.02,) * 6)
    server.well()
    yield server
    server.well()


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    path = tmp_path_factory.mktemp("local") / "area.oro"
    store.build(source(HEIGHTS), path, **SIZES).close()
    return path


def check(terrain):
    np.testing.assert_array_equal(terrain.read(0, 0, 270, 0, 120), HEIGHTS)
    np.testing.assert_array_equal(terrain.read(0, 30, 90, 20, 101), HEIGHTS[30:90, 20:101])
    assert terrain.check() == []


def contents(url):
    """All objects at a URL, by listing."""
    place = storage_at(url)
    return {
        name: place.get(name)
        for name in sorted(each["path"].removeprefix(f"{place.prefix}/") for each in place._below(""))
    }


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.stress
def test_a_store_in_a_bucket_has_the_bytes_of_one_in_a_folder_and_no_request_lists(s3, local):
    url = "s3://terrain/same/area.oro"
    with store.build(source(HEIGHTS), url, **SIZES) as terrain:
        assert s3.asked["LIST"] <= 1  # what is below parts/, when they are removed
        before = s3.asked["LIST"]
        check(terrain)
        assert s3.asked["LIST"] == before
        assert contents(url) == files(local)
        assert terrain.size_bytes == FolderStorage(local).size()
    assert not storage_at("s3://terrain/same").exists(".area.oro.lock")
    conditional = [path for kind, path, condition in s3.log if kind == "PUT" and condition]
    assert "/terrain/same/area.oro/zarr.json" in conditional and "/terrain/same/.area.oro.lock" in conditional
    puts = [path for kind, path, _ in s3.log if kind == "PUT" and "/same/area.oro/" in path]
    assert puts[-1].endswith("area.oro/zarr.json")
    with pytest.raises(StoreError, match="there already"):
        store.build(source(HEIGHTS), url, **SIZES)
    with store.build(source(HEIGHTS + 1), url, overwrite=True, **SIZES) as other:
        np.testing.assert_array_equal(other.read(0, 0, 5, 0, 5), HEIGHTS[:5, :5] + 1)


@pytest.mark.stress
@pytest.mark.parametrize("fault", [{"refuse": 0.2, "cut": 0.05, "slow": 0.002}])
def test_faults_change_nothing(s3, local, fault):
    url = f"s3://terrain/faults/{'-'.join(fault)}.oro"
    for name, share in fault.items():
        setattr(s3, name, share)
    with store.build(source(HEIGHTS), url, **SIZES) as terrain:
        check(terrain)
    s3.well()
    assert contents(url) == files(local)


def test_a_bucket_that_stays_busy_is_an_error_that_says_so(s3):
    s3.refuse = 1.0
    with pytest.raises(StoreError, match=r"s3://terrain/busy.*503"):
        store.open("s3://terrain/busy")
    assert s3.asked["GET"] == 9


@pytest.mark.stress
def test_a_stale_listing_does_not_bring_back_what_an_earlier_build_has_left(s3):
    """The parts of a build that was interrupted are not listed when they are to be removed."""
    url = "s3://terrain/stale.oro"
    interrupted(source(HEIGHTS + 7), url, 40)
    s3.stale = True
    interrupted(source(HEIGHTS), url, 5, overwrite=True)
    with store.build(source(HEIGHTS), url, resume=True, **SIZES) as terrain:
        np.testing.assert_array_equal(terrain.read(0, 0, 270, 0, 120), HEIGHTS)
        assert terrain.check() == []


def interrupted(heights, url, puts, **options):
    """A build that is broken off after so many puts."""
    with broken_off(BucketStorage, puts):
        store.build(heights, url, jobs=1, **SIZES, **options)


@pytest.mark.stress
def test_an_interrupted_build_is_resumed_to_the_same_bytes(s3, local):
    url = "s3://terrain/resumed.oro"
    interrupted(source(HEIGHTS), url, 30)
    with pytest.raises(StoreError, match=r"incomplete.*resume=True"):
        store.open(url)
    with pytest.raises(StoreError, match="interrupted build"):
        store.build(source(HEIGHTS), url, **SIZES)
    with store.build(source(HEIGHTS), url, resume=True, **SIZES) as terrain:
        check(terrain)
    assert contents(url) == files(local)


def test_one_of_two_builds_at_once_is_refused_and_told_which_is_at_work(s3, local):
    url = "s3://terrain/two.oro"
    with alone(storage_at(url), "building this store"):
        with pytest.raises(
            StoreError, match=rf"building this store \(process {os.getpid()} on .*last heartbeat was \d+ s"
        ):
            store.build(source(HEIGHTS), url, **SIZES)
        with pytest.raises(StoreError, match="Another process is building"), alone(storage_at(url), "x", shared="a"):
            pass
    told = []

    def build():
        try:
            store.build(source(HEIGHTS), url, **SIZES).close()
            told.append("")
        except StoreError as error:
            told.append(str(error))

    threads = [threading.Thread(target=build) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(not each for each in told) == [False, False, True]
    assert all("Another process is building" in each or "there already" in each for each in told if each)
    assert contents(url) == files(local)


def test_those_of_one_plan_share_the_lock_and_the_last_removes_it(s3):
    url, place = "s3://terrain/shared.oro", storage_at("s3://terrain")
    with alone(storage_at(url), "building parts", shared="plan"):
        with alone(storage_at(url), "building parts", shared="plan"):
            assert len(json.loads(place.get(".shared.oro.lock"))["holders"]) == 2
            with pytest.raises(StoreError, match="Its plan is different"), alone(storage_at(url), "x", shared="other"):
                pass
        assert len(json.loads(place.get(".shared.oro.lock"))["holders"]) == 1
        with pytest.raises(StoreError, match="building parts"), alone(storage_at(url), "x"):
            pass
    assert place.get(".shared.oro.lock") is None


def left_behind(key, **holder):
    """A lock of a process that said nothing more since."""
    place = storage_at("s3://terrain")
    said = {
        "doing": "baking",
        "shared": None,
        "lease": bucket_lock.LEASE,
        "holders": [{"token": "t", "since": "then", **holder}],
    }
    place.put(key, [json.dumps(said).encode()])
    return place


def test_a_lock_whose_process_has_ended_here_is_taken_over_at_once(s3):
    child = subprocess.Popen(["true"])
    child.wait()
    place = left_behind(".ended.oro.lock", host=host(), pid=child.pid)
    with alone(storage_at("s3://terrain/ended.oro"), "building"):
        assert json.loads(place.get(".ended.oro.lock"))["holders"][0]["pid"] == os.getpid()


def test_another_machine_s_lock_is_taken_over_when_its_lease_is_over(s3, monkeypatch):
    monkeypatch.setattr(bucket_lock, "LEASE", 1.5)
    left_behind(".away.oro.lock", host="elsewhere", pid=1)
    with pytest.raises(StoreError, match="process 1 on elsewhere"), alone(storage_at("s3://terrain/away.oro"), "x"):
        pass
    assert until(lambda: taken("s3://terrain/away.oro"), 10)


def taken(url):
    try:
        with alone(storage_at(url), "x"):
            return True
    except StoreError:
        return False


def test_a_lock_that_beats_is_not_taken_over_however_late_the_clock_of_the_other(s3, monkeypatch):
    monkeypatch.setattr(bucket_lock, "LEASE", 2.0)
    monkeypatch.setattr(bucket_lock, "BEAT", 0.2)

    class Late(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + timedelta(hours=1)

    with alone(storage_at("s3://terrain/beats.oro"), "building"):
        monkeypatch.setattr(bucket_lock, "datetime", Late)
        assert not taken("s3://terrain/beats.oro")


def test_who_has_lost_the_lock_writes_nothing(s3, monkeypatch):
    monkeypatch.setattr(bucket_lock, "BEAT", 0.05)
    place = storage_at("s3://terrain/lost.oro")
    with alone(place, "building"):
        place.put("heights", [b"1"])
        left_behind(".lost.oro.lock", host="elsewhere", pid=1)
        assert until(lambda: place.lease is not None and refused(place), 5)
    assert json.loads(storage_at("s3://terrain").get(".lost.oro.lock"))["holders"][0]["host"] == "elsewhere"


def refused(place):
    try:
        place.put("heights", [b"2"])
    except StoreError as error:
        return "lost" in str(error)
    return False


def test_a_root_that_another_has_put_is_not_replaced(s3):
    first, second = storage_at("s3://terrain/roots.oro"), storage_at("s3://terrain/roots.oro")
    assert first.get("zarr.json") is None and second.get("zarr.json") is None
    first.put("zarr.json", [b"one"])
    with pytest.raises(StoreError, match="Another process has published"):
        second.put("zarr.json", [b"two"])
    first.put("zarr.json", [b"three"])
    assert second.get("zarr.json") == b"three"
    second.put("zarr.json", [b"four"])
    with pytest.raises(StoreError, match="Another process has published"):
        first.put("zarr.json", [b"five"])


def test_storage_that_ignores_conditions_is_not_built_in(s3, monkeypatch):
    monkeypatch.setattr(s3, "ignores", True)
    with pytest.raises(StoreError, match="ignores conditional"):
        store.build(source(HEIGHTS), "s3://terrain/ignoring.oro", **SIZES)


def test_no_secret_is_told(s3, monkeypatch, tmp_path):
    url = "https://user:pass-word@127.0.0.1:9/area.oro"
    with pytest.raises(StoreError, match=r"https://127\.0\.0\.1:9/area\.oro") as told:
        store.open(url)
    assert "pass-word" not in str(told.value) and "pass-word" not in told.value.path
    with pytest.raises(StoreError, match="must not have a query") as told:
        store.open("https://127.0.0.1:9/area.oro?X-Amz-Signature=abc")
    assert "abc" not in str(told.value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3.url.replace("http://", "http://someone:hidden@"))
    s3.refuse = 1.0
    with pytest.raises(StoreError) as told:
        store.open("s3://terrain/secret.oro")
    assert "hidden" not in str(told.value) and ENVIRONMENT["AWS_SECRET_ACCESS_KEY"] not in str(told.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("GET https://a:b@c/d.tif?X-Amz-Signature=1&k=2: 403", "GET https://c/d.tif: 403"),
        ("/vsicurl/https://c/d.tif?sig=1%2F, and more. Why?", "/vsicurl/https://c/d.tif, and more. Why?"),
        ("Is it at s3://b/x.oro?", "Is it at s3://b/x.oro"),
        ("a@b is no URL; what? yes", "a@b is no URL; what? yes"),
        ("'https://c/d?e=f.'", "'https://c/d.'"),
    ],
)
def test_what_may_be_secret_is_left_out_of_urls(text, told):
    assert public(text) == told


def test_damage_is_named(s3):
    url = "s3://terrain/damaged.oro"
    store.build(source(HEIGHTS), url, **SIZES).close()
    place = storage_at(url)
    place.remove("heights/0/height/c/1/0")
    with store.open(url) as terrain, pytest.raises(DamagedChunkError, match="heights/0/height/c/1/0"):
        terrain.read(0, 130, 140, 0, 10)
    whole = place.get("heights/0/height/c/0/0")
    with store.open(url, cache_bytes=0) as terrain:
        terrain.read(0, 0, 5, 0, 5)
        place.put("heights/0/height/c/0/0", [whole[: len(whole) // 3]])
        with pytest.raises(DamagedChunkError, match="heights/0/height/c/0/0"):
            terrain.read(0, 0, 128, 0, 120)
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open("s3://terrain/nothing")
    with pytest.raises(StoreError, match="no such bucket"):
        store.open("s3://nowhere/area.oro")


def test_small_reads_are_put_together(s3, local):
    url = "s3://terrain/reads.oro"
    store.build(source(HEIGHTS), url, **SIZES).close()
    with store.open(url) as terrain:
        terrain.read(0, 0, 1, 0, 1)
        s3.well()
        terrain.read(0, 0, 128, 0, 120)  # sixteen chunks of one shard
        assert s3.asked == {"GET": 1}


@pytest.mark.stress
def test_a_store_is_published_with_all_its_bytes_and_its_root_last(s3, local):
    url = "s3://terrain/published/area.oro"
    with broken_off(BucketStorage, 12):
        publish(local, url, jobs=1)
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open(url)
    s3.well()
    done = publish(local, url)
    assert done.sent == done.objects - 12 and s3.asked["LIST"] == 0
    assert contents(url) == files(local)
    puts = [path for kind, path, _ in s3.log if kind == "PUT" and "area.oro/" in path]
    assert puts[-1].endswith("area.oro/zarr.json")
    assert publish(local, url).sent == 0
    with store.open(url) as terrain:  # from one bucket to another place
        publish(terrain, "s3://terrain/published/again.oro")
    assert contents("s3://terrain/published/again.oro") == files(local)


@pytest.mark.stress
def test_what_is_damaged_or_in_the_way_is_not_published(s3, local, tmp_path):
    other = tmp_path / "other.oro"
    store.build(source(HEIGHTS + 1), other, **SIZES).close()
    url = "s3://terrain/published/other.oro"
    publish(other, url)
    with pytest.raises(StoreError, match="there already"):
        publish(local, url)
    shard = other / "heights" / "1" / "height" / "c" / "0" / "0"
    shard.write_bytes(shard.read_bytes()[:100] + b"!" + shard.read_bytes()[101:])
    with pytest.raises(DamagedChunkError, match="heights/1/height"):
        publish(other, "s3://terrain/published/damaged.oro")
    with pytest.raises(StoreError, match="not an Orograph store"):
        store.open("s3://terrain/published/damaged.oro")
    publish(local, url, overwrite=True)
    assert contents(url) == files(local)
    with pytest.raises(UsageError, match="at URLs"):
        publish(local, str(tmp_path / "copy.oro"))


@pytest.mark.stress
def test_a_store_in_a_bucket_is_mended_and_baked_into(s3, tmp_path):
    url = "s3://terrain/mended.oro"
    with store.build(source(HEIGHTS), url, **SIZES):
        pass
    place = storage_at(url)
    sound = contents(url)
    place.put("mean/1/height/c/0/0", [b"damage"])
    place.remove("tiles/0/minimum/c/0/0")
    assert sorted(repair(url, source(HEIGHTS))) == ["mean/1/height/c/0/0", "tiles/0/minimum/c/0/0"]
    assert contents(url) == sound
    bake(url, "sky-view-factor", azimuths=4, progress=False).close()
    folder = tmp_path / "area.oro"
    store.build(source(HEIGHTS), folder, **SIZES).close()
    bake(folder, "sky-view-factor", azimuths=4, progress=False).close()
    assert contents(url) == files(folder)
    assert not storage_at("s3://terrain").exists(".mended.oro.lock")


def test_large_objects_go_in_parts(s3, monkeypatch):
    place = storage_at("s3://terrain/large")
    data = np.random.default_rng(1).bytes(buckets.PART * 2 + 5)
    place.put("object", [data[:100], data[100:]])
    assert s3.asked["POST"] == 2 and s3.asked["PUT"] == 3
    assert place.get("object") == data and place.tail("object", 7) == data[-7:]
    assert place.ranges([("object", 5, 9), ("none", 0, 3)]) == [data[5:9], b""]
