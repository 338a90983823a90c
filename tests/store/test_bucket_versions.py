"""Updates of stores in a bucket: what a new build makes, versions, readers, kills, two at once, an unwell server."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from buckets import ENVIRONMENT, bucket_server
from test_updating import OPTIONS, grid_of_tiles, made, tile
from test_versions import everything
from webserver import serving

import orograph
from orograph.errors import StoreError, StoreReplacedError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.products import Options
from orograph.progress import Progress
from orograph.store import storage as waiting
from orograph.store.addresses import storage_at
from orograph.store.build import build
from orograph.store.digests import SIZE
from orograph.store.layout import array_specs
from orograph.store.places import ROOT, UPDATE
from orograph.store.publishing import publish
from orograph.store.repair import repair
from orograph.store.storage import FolderStorage

pytest.importorskip("obstore")
pytest.importorskip("moto.server")

SHORT = {**OPTIONS, "shard": 128, "errors": ()}


@pytest.fixture(scope="module")
def server():
    with bucket_server() as running:
        yield running


@pytest.fixture
def s3(server, monkeypatch):
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(waiting, "AGAIN", (0.01, 0.02))
    monkeypatch.setattr(waiting, "LONGER", (0.02,) * 6)
    server.well()
    yield server
    server.well()


def tiles(folder: Path) -> list[Path]:
    """140 × 280 samples in eight files: two levels, the finest of 2 × 3 shards."""
    folder.mkdir()
    return [tile(folder, i, j, 0) for i in range(2) for j in range(4)]


@pytest.fixture
def area(s3, tmp_path, request):
    """Something that changes a tile and updates a store of eight in a bucket, its address, and the files."""
    files = tiles(tmp_path / "tiles")
    url = f"s3://terrain/{request.node.name}/area.oro"
    build(files, url, update=True, **SHORT).close()

    def changed(seed: int, at: tuple[int, int] = (0, 0), **options):
        tile(tmp_path / "tiles", *at, seed)
        build(files, url, update=True, **{**SHORT, **options}).close()

    return changed, url, files


def objects(url) -> dict[str, bytes | None]:
    """All objects of a store but its root, by their names in a folder."""
    with orograph.open(url) as terrain:
        digests, place = terrain.record.digests, terrain.storage
        specs = {spec.path: spec for spec in array_specs(terrain.record)}
        assert specs.keys() <= digests.listed.keys()
        keys = {}
        for path, listed in digests.listed.items():
            if path in specs:
                for i in range(specs[path].shards[0]):
                    for j in range(specs[path].shards[1]):
                        keys[specs[path].key((i, j))] = specs[path].place((i, j), digests)
            elif path != ROOT:
                assert len(listed) == SIZE
                keys[path] = digests.place(path, bytes(listed))
        return {name: place.get(key) for name, key in keys.items()}


def there(url) -> set[str]:
    """The names of what lies at a URL, by listing."""
    return set(storage_at(url).listed())


def needed(url, *older) -> set[str]:
    """The names that versions need, and what an update keeps."""
    names = {ROOT, *(f"versions/{number}.json" for number in older)}
    for each in (url, *(f"{url}@{number}" for number in older)):
        with orograph.open(each) as terrain:
            digests = terrain.record.digests
            specs = array_specs(terrain.record)
            paths = {spec.path for spec in specs}
            for spec in specs:
                spots = [(i, j) for i in range(spec.shards[0]) for j in range(spec.shards[1])]
                names |= {spec.place(spot, digests) for spot in spots}
            for path, listed in digests.listed.items():
                if path not in paths and path != ROOT:
                    names.add(digests.place(path, bytes(listed)))
    return names


def equals_a_new_build(url, files, folder: Path, **options) -> None:
    build(files, folder, overwrite=True, **{**SHORT, **options}).close()
    expected = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
    del expected[ROOT]
    found = objects(url)
    assert found.keys() == expected.keys()
    assert [key for key in found if found[key] != expected[key]] == []
    with orograph.open(url) as terrain, orograph.open(folder) as other:
        assert terrain.check() == []
        np.testing.assert_array_equal(everything(terrain), everything(other))
        assert terrain.record.height_range == other.record.height_range


@pytest.mark.stress
@pytest.mark.parametrize(
    "options",
    [
        {"errors": ("exact",)},
        pytest.param({"codec": "progressive", "max_error": 0.5, "errors": ("exact",)}, marks=pytest.mark.stress),
        pytest.param({"tins": 16, "quadtin": (8.0, "nearest"), "errors": ("exact",)}, marks=pytest.mark.stress),
        pytest.param({"chunked": (32, 0), "codec": "compact", "max_error": 0.5}, marks=pytest.mark.stress),
    ],
    ids=["lossless", "progressive", "tins and quadtin", "chunks"],
)
def test_an_update_is_a_new_build_though_the_server_is_unwell(s3, tmp_path, options, monkeypatch):
    files, url = tiles(tmp_path / "tiles"), f"s3://terrain/unwell/{'-'.join(options)}.oro"
    s3.refuse, s3.cut = 0.1, 0.03
    given = {**SHORT, **options}
    first = [file for file in files if file != files[5]]
    build(first, url, update=True, **given).close()
    tile(tmp_path / "tiles", 0, 0, 3)
    heights, _ = made(monkeypatch)
    build(files, url, update=True, **given).close()  # one file is another now, and one is new
    assert 0 < len(heights) < 6
    s3.well()
    equals_a_new_build(url, files, tmp_path / "other.oro", **options)
    with orograph.open(url) as terrain:
        assert terrain.version == 2
    with orograph.open(f"{url}@1") as terrain:
        assert terrain.check() == []
    heights.clear()
    s3.well()
    build(files, url, update=True, **given).close()
    assert not heights and s3.asked["LIST"] == 0 and s3.asked["PUT"] < 5


@pytest.mark.stress
def test_where_the_terrain_has_another_size_all_is_made_again(area, tmp_path):
    _, url, files = area
    build(files[:4], url, update=True, **SHORT).close()
    equals_a_new_build(url, files[:4], tmp_path / "other.oro")


@pytest.mark.stress
def test_a_second_update_goes_on_from_what_the_first_took_over(area, tmp_path, monkeypatch):
    changed, url, files = area
    heights, _ = made(monkeypatch)
    changed(1)
    changed(2, at=(1, 3))
    assert len(heights) == 5
    equals_a_new_build(url, files, tmp_path / "other.oro")


@pytest.mark.stress
def test_versions_are_kept_and_what_none_of_them_needs_is_removed(area):
    changed, url, files = area
    states = [objects(url)]
    for seed in range(1, 4):
        changed(seed, keep=3)
        states.append(objects(url))
    for number in (2, 3, 4):
        with orograph.open(f"{url}@{number}") as terrain:
            assert terrain.version == number and terrain.check() == []
            assert terrain.url == (url if number == 4 else f"{url}@{number}")
        assert objects(f"{url}@{number}") == states[number - 1]
    assert orograph.info(url)["versions"] == [3, 2]
    kept = {key for key in there(url) if not key.startswith("parts/")}
    assert kept == needed(url, 3, 2)
    shard = "heights/0/height/c/1/2"  # far from the tile that changed: one object in all versions
    assert len([key for key in kept if key.startswith(f"{shard}.")]) == 1
    assert len([key for key in kept if key.startswith("heights/0/height/c/0/0.")]) == 3
    with pytest.raises(StoreError, match="no version 1"):
        orograph.open(f"{url}@1")
    build(files, url, update=True, keep=1, **SHORT).close()  # (nothing has changed)
    assert {key for key in there(url) if not key.startswith("parts/")} == needed(url)
    changed(9)
    with orograph.open(url) as terrain:
        assert terrain.version == 5 and orograph.info(url)["versions"] == [4]


@pytest.mark.stress
def test_readers_go_on_with_the_version_they_have_open(area, monkeypatch):
    changed, url, _ = area
    monkeypatch.setattr("orograph.store.watch.EVERY_REMOTE", 0.0)
    with orograph.open(url, cache_bytes=0) as terrain, orograph.open(url, cache_bytes=0) as other:
        before = everything(other)
        carried = pickle.dumps(terrain)
        changed(1, keep=3)
        changed(2, keep=3)
        np.testing.assert_array_equal(everything(terrain), before)
        assert terrain.read_mean(1, 0, 50, 0, 50).shape == (50, 50) and terrain.tiles(0).error.size
        assert "area.oro@1, version 1, not the newest" in repr(terrain) and terrain.check() == []
        np.testing.assert_array_equal(everything(pickle.loads(carried)), before)  # a worker that comes late
        np.testing.assert_array_equal(everything(pickle.loads(pickle.dumps(terrain))), before)
        with terrain.reopen() as now:
            assert now.version == 3 and now.url == url and "newest" not in repr(now)
            assert not np.array_equal(everything(now), before)
        changed(3, keep=1)
        for reader in (terrain, other):
            with pytest.raises(StoreReplacedError):
                everything(reader)


@pytest.mark.stress
def test_a_reader_that_does_not_look_reads_its_version_or_is_told(area, monkeypatch):
    changed, url, _ = area
    monkeypatch.setattr("orograph.store.watch.EVERY_REMOTE", 1e9)
    with orograph.open(url, cache_bytes=0) as terrain, orograph.open(url, cache_bytes=0) as other:
        before = everything(other)
        changed(1)
        np.testing.assert_array_equal(everything(terrain), before)
        assert terrain.check() == []
        changed(2, keep=1)
        for reader in (terrain, other):
            with pytest.raises(StoreReplacedError):
                everything(reader)


def test_readers_during_an_update(area):
    """All the while: what they have open, or what is newest, whole."""
    _, url, files = area
    with orograph.open(url) as terrain:
        states = [everything(terrain)]
    seen = []

    class Reads(Progress):
        def note(self, message):
            with orograph.open(url) as now:
                seen.append((now.version, everything(now)))

    tile(Path(files[0]).parent, 0, 0, 7)
    with orograph.open(url, cache_bytes=0) as terrain:
        build(files, url, update=True, **{**SHORT, "progress": Reads()}).close()
        np.testing.assert_array_equal(everything(terrain), states[0])
    assert seen and all(version == 1 and np.array_equal(heights, states[0]) for version, heights in seen)


@pytest.mark.stress
def test_a_store_that_was_built_without_updates_becomes_version_1(s3, tmp_path):
    files, url = grid_of_tiles(tmp_path / "tiles", 2), "s3://terrain/plain/area.oro"
    build(files, url, **SHORT).close()
    plain, before = there(url), objects(url)
    with orograph.open(url) as terrain:
        heights = everything(terrain)
        tile(tmp_path / "tiles", 1, 1, 1)
        build(files, url, update=True, **SHORT).close()
        np.testing.assert_array_equal(everything(terrain), heights)
    equals_a_new_build(url, files, tmp_path / "other.oro")
    assert objects(f"{url}@1") == before
    with orograph.open(f"{url}@1") as terrain:
        assert terrain.version == 1 and terrain.check() == []
    build(files, url, update=True, keep=1, **SHORT).close()
    assert not there(url) & (plain - {ROOT})
    with orograph.open(url) as terrain:
        assert terrain.version == 2 and terrain.check() == []


@pytest.mark.stress
def test_light_stays_with_its_version(area):
    changed, url, _ = area
    bake(url, ["visible-sky"], Options(azimuths=4), progress=False).close()
    changed(1)
    with orograph.open(url) as now, orograph.open(f"{url}@1") as then:
        assert now.layers == () and then.layers == ("visible-sky",)
        assert then.layer("visible-sky").read(0, 0, 9, 0, 9).shape == (1, 9, 9)
    bake(url, ["visible-sky"], Options(azimuths=4), progress=False).close()
    bake(f"{url}@1", ["openness"], Options(azimuths=4), progress=False).close()
    bake(url, ["visible-sky"], Options(azimuths=8), progress=False, overwrite=True).close()
    with orograph.open(url) as now, orograph.open(f"{url}@1") as then:
        assert now.layers == ("visible-sky",) and then.layers == ("openness", "visible-sky")
        assert now.check() == [] == then.check()
    assert {key for key in there(url) if not key.startswith("parts/")} == needed(url, 1)


@pytest.mark.stress
def test_workers_bake_into_a_version(area, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    changed, url, files = area
    changed(1)
    build(files, tmp_path / "whole.oro", **SHORT).close()
    bake(url, ["visible-sky"], azimuths=4, workers=2, jobs=1, progress=False).close()
    bake(tmp_path / "whole.oro", ["visible-sky"], azimuths=4, progress=False).close()
    found = objects(url)
    layer = {key: data for key, data in found.items() if key.startswith("layers/") and "zarr.json" not in key}
    assert layer and all((tmp_path / "whole.oro" / key).read_bytes() == data for key, data in layer.items())
    with orograph.open(url) as terrain, orograph.open(f"{url}@1") as first:
        assert terrain.layers == ("visible-sky",) and terrain.check() == []
        assert first.layers == () and first.check() == []


@pytest.mark.stress
def test_damage_is_found_and_mended(area):
    changed, url, _ = area
    changed(1)
    place = storage_at(url)
    hit = sorted(key for key in there(url) if key.startswith(("heights/0/height/c/0/0.", "tiles/0/valid/zarr.json")))
    for key in hit:
        place.put(key, [b"nonsense"])
    with orograph.open(url) as terrain:
        assert {damage.partition("[")[0] for damage in terrain.check()} == {
            "heights/0/height/c/0/0",
            "tiles/0/valid/zarr.json",
        }
    assert repair(url, progress=Progress())
    with orograph.open(url) as terrain:
        assert terrain.check() == []


@pytest.mark.stress
def test_a_published_version_has_plain_keys(area, tmp_path):
    changed, url, files = area
    changed(1)
    publish(f"{url}@1", "s3://terrain/plain/first.oro")
    publish(url, "s3://terrain/plain/now.oro")
    build(files, tmp_path / "other.oro", **SHORT).close()
    expected = {str(p.relative_to(tmp_path / "other.oro")): p.read_bytes() for p in tmp_path.glob("other.oro/**/*.*")}
    found = {key: storage_at("s3://terrain/plain/now.oro").get(key) for key in there("s3://terrain/plain/now.oro")}
    assert expected.items() <= found.items()
    with orograph.open("s3://terrain/plain/first.oro") as terrain, orograph.open(f"{url}@1") as first:
        assert terrain.version is None and terrain.check() == []
        np.testing.assert_array_equal(everything(terrain), everything(first))


@pytest.mark.stress
def test_versions_are_read_over_http_and_from_a_copy_of_the_bucket(area, tmp_path):
    changed, url, files = area
    changed(1)
    copy = FolderStorage(tmp_path / "web" / "area.oro")
    for key in there(url):
        copy.put(key, [storage_at(url).get(key)])
    with serving(tmp_path / "web") as web:
        for name in ("area.oro", "area.oro@1"):
            with orograph.open(f"{web.url}/{name}") as terrain, orograph.open(url.replace("area.oro", name)) as other:
                assert terrain.version == other.version and terrain.check() == []
                np.testing.assert_array_equal(everything(terrain), everything(other))
        with pytest.raises(StoreError, match="web servers are read only"):
            build(files, f"{web.url}/area.oro", update=True, **SHORT)
    with orograph.open(copy.path) as terrain:
        assert terrain.version == 2 and terrain.check() == []
    build(files, copy.path, overwrite=True, **SHORT).close()


@pytest.mark.stress
def test_refusals(area, tmp_path):
    changed, url, files = area
    changed(1)
    for options in ({"update": True}, {"overwrite": True}, {}):
        with pytest.raises(UsageError, match=r"older version.*\n?.*"):
            build(files, f"{url}@1", **{**SHORT, **options})
    with pytest.raises(UsageError, match="older version"):
        publish(url, f"{url}@1")
    with pytest.raises(UsageError, match="folder or a bucket"):
        build(files, "memory://area.oro", update=True, **SHORT)
    with pytest.raises(UsageError, match=r"`update` and `part` exclude .*`workers`"):
        build(files, url, update=True, part="1/2", **SHORT)
    with orograph.open(f"{url}@1") as terrain:
        assert terrain.check() == []


@pytest.mark.stress
def test_what_others_have_put_there_stays(area):
    changed, url, _ = area
    storage_at(url).put("README.txt", [b"of others"])
    changed(1, keep=1)
    assert storage_at(url).get("README.txt") == b"of others"


@pytest.mark.stress
def test_a_stale_listing_leaves_what_the_next_update_removes(s3, area):
    changed, url, _ = area
    s3.stale = True
    changed(1, keep=1)
    s3.stale = False
    assert {key for key in there(url) if not key.startswith("parts/")} > needed(url)
    changed(2, keep=1)
    assert {key for key in there(url) if not key.startswith("parts/")} == needed(url)


MORE = ("heights/0/", "versions/", "zarr.json", "delete")


class Ended(BaseException):
    """Stands for the end of the process."""


@pytest.mark.stress
@pytest.mark.parametrize("when", ["heights/1/", *MORE])
def test_an_update_that_is_killed_leaves_the_old_version_and_goes_on(area, tmp_path, monkeypatch, when):
    from orograph.store.bucket import BucketStorage

    changed, url, files = area
    before = objects(url)
    put, remove_all = BucketStorage.put, BucketStorage.remove_all

    def killed(self, key, parts):
        if key.startswith(when):
            raise Ended
        put(self, key, parts)

    def killed_too(self, keys):
        if when == "delete":
            raise Ended
        remove_all(self, keys)

    monkeypatch.setattr(BucketStorage, "put", killed)
    monkeypatch.setattr(BucketStorage, "remove_all", killed_too)
    with pytest.raises(Ended):
        changed(1)
    monkeypatch.setattr(BucketStorage, "put", put)
    monkeypatch.setattr(BucketStorage, "remove_all", remove_all)
    done = when == "delete"
    with orograph.open(url) as terrain:
        assert terrain.version == (2 if done else 1) and terrain.check() == []
    assert done or objects(url) == before
    with pytest.raises(StoreError, match=r"update of this store was interrupted|there already"):
        build(files, url, **SHORT)
    if when == "heights/1/":
        tile(tmp_path / "tiles", 1, 1, 5)  # and a file has changed since
    heights, _ = made(monkeypatch)
    build(files, url, update=True, **SHORT).close()
    assert len(heights) < 6 and (heights == []) == (when in ("versions/", "zarr.json", "delete"))
    equals_a_new_build(url, files, tmp_path / "other.oro")
    assert {key for key in there(url) if not key.startswith("parts/")} == needed(url, 1)
    assert not storage_at(url).exists(UPDATE)
    changed(8, at=(1, 3))
    equals_a_new_build(url, files, tmp_path / "other.oro")


@pytest.mark.stress
def test_an_update_that_was_killed_and_is_not_wanted_any_more_leaves_nothing(area, monkeypatch, tmp_path):
    from orograph.store.bucket import BucketStorage

    changed, url, files = area
    path = Path(files[0])
    old, time_ns, state = path.read_bytes(), path.stat().st_mtime_ns, there(url)
    put = BucketStorage.put

    def killed(self, key, parts):
        if key == ROOT:
            raise Ended
        put(self, key, parts)

    monkeypatch.setattr(BucketStorage, "put", killed)
    with pytest.raises(Ended):
        changed(1)
    monkeypatch.setattr(BucketStorage, "put", put)
    path.write_bytes(old)
    os.utime(path, ns=(time_ns, time_ns))
    build(files, url, update=True, **SHORT).close()
    assert there(url) == state
    with orograph.open(url) as terrain:
        assert terrain.version == 1 and terrain.check() == []


UPDATE_OF = """
import sys
from orograph.store.build import build
build(sys.argv[2:], sys.argv[1], update=True, shard=64, chunk=32, errors=(), progress=False).close()
"""


def client(server, url, files):
    env = {**os.environ, **ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}
    command = [sys.executable, "-c", UPDATE_OF, url, *map(str, files)]
    return subprocess.Popen(command, env=env, stderr=subprocess.PIPE)


@pytest.mark.stress
def test_clients_that_are_killed_at_any_time(s3, area, tmp_path):
    _, url, files = area
    rng, kills = np.random.default_rng(3), 0
    for round_ in range(6):
        with orograph.open(url) as terrain:
            version, before = terrain.version, everything(terrain)
        tile(tmp_path / "tiles", *map(int, rng.integers(0, (2, 4))), 10 + round_)
        s3.refuse, s3.cut, s3.slow = 0.02, 0.02, 0.005
        for _ in range(3):
            s3.log.clear()
            process = client(s3, url, files)
            while not any(kind == "PUT" for kind, _, _ in list(s3.log)) and process.poll() is None:
                time.sleep(0.02)
            time.sleep(rng.uniform(0, 2.5))
            process.kill()
            said = process.communicate()[1].decode()
            assert process.returncode in (0, -9), said
            kills += process.returncode == -9
            with orograph.open(url) as terrain:
                assert terrain.version in (version, version + 1)
                assert terrain.version == version + 1 or np.array_equal(everything(terrain), before)
                assert terrain.check() == []
        s3.well()
        done = client(s3, url, files)
        assert done.wait(120) == 0, done.communicate()[1].decode()
        equals_a_new_build(url, files, tmp_path / "other.oro")
        assert {key for key in there(url) if not key.startswith("parts/")} == needed(url, version)
    print(f"{kills} kills of six updates")
    assert kills > 6


@pytest.mark.stress
def test_of_two_updates_at_once_one_wins_and_the_other_is_told(s3, area, tmp_path):
    _, url, files = area
    tile(tmp_path / "tiles", 0, 0, 1)
    s3.slow = 0.02
    told = []

    def update():
        try:
            build(files, url, update=True, **SHORT).close()
        except StoreError as error:
            told.append(str(error))

    with ThreadPoolExecutor(2) as pool:
        for each in [pool.submit(update) for _ in range(2)]:
            each.result()
    s3.well()
    assert len(told) == 1 and "Another process is building this store" in told[0]
    equals_a_new_build(url, files, tmp_path / "other.oro")
    with orograph.open(url) as terrain:
        assert terrain.version == 2


def test_an_update_whose_store_was_replaced_meanwhile_is_told(area, monkeypatch):
    """Its lock was lost, and another has published: the root is put on condition that it is the one that was read."""
    from orograph.store import bucket_updates

    changed, url, _ = area
    publish_ = bucket_updates.publish

    def late(storage, record):
        other = storage_at(url)
        root = other.get(ROOT)
        other.put(ROOT, [root + b" "])
        publish_(storage, record)

    monkeypatch.setattr(bucket_updates, "publish", late)
    with pytest.raises(StoreError, match="Another process has published"):
        changed(1)
    with orograph.open(url) as terrain:
        assert terrain.version == 1 and terrain.check() == []
