"""Builds into buckets by parts, by workers, and by clients that are killed: the bytes of one process in a folder."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time

import numpy as np
import pytest
import rasterio
from affine import Affine
from buckets import ENVIRONMENT, bucket_server
from surfaces import rough, source
from test_buckets import contents, files
from test_updating import tile

from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.store.addresses import storage_at

pytest.importorskip("obstore")
pytest.importorskip("moto.server")

SIZES = {"shard": 64, "chunk": 16, "jobs": 2}
HEIGHTS = rough((300, 260), 5, missing=0.01, hole=True)


@pytest.fixture(scope="module")
def server():
    with bucket_server() as running:
        yield running


@pytest.fixture
def s3(server, monkeypatch):
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}.items():
        monkeypatch.setenv(name, value)
    server.well()
    yield server
    server.well()


@pytest.mark.stress
def test_parts_and_their_finish_make_what_one_process_makes(s3, tmp_path):
    given, url = source(HEIGHTS), "s3://terrain/parts.oro"
    store.build(given, tmp_path / "whole.oro", errors=(), **SIZES).close()
    store.build(given, url, part=(2, 2), errors=(), **SIZES)
    with pytest.raises(StoreError, match="Part 1 of 2 is missing"):
        store.build(given, url, finish=True, errors=(), **SIZES)
    with pytest.raises(StoreError, match="Another build"):
        store.build(given, url, part=(1, 3), errors=(), **SIZES)
    store.build(given, url, part=(1, 2), errors=(), **SIZES)
    before = s3.asked["LIST"]
    store.build(given, url, finish=True, errors=(), **SIZES).close()
    assert s3.asked["LIST"] - before <= 1
    assert contents(url) == files(tmp_path / "whole.oro")


@pytest.fixture(scope="module")
def raster(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    heights = np.where(np.isnan(HEIGHTS), -9999, HEIGHTS).astype(np.float32)
    with rasterio.open(
        path, "w", "GTiff", heights.shape[1], heights.shape[0], 1, "EPSG:32633",
        Affine(30, 0, 400000, 0, -30, 5000000), "float32", nodata=-9999,
    ) as out:  # fmt: skip
        out.write(heights, 1)
    return path


@pytest.mark.stress
def test_workers_build_into_a_bucket(s3, raster, tmp_path):
    pytest.importorskip("distributed")
    with store.build(raster, tmp_path / "whole.oro", **SIZES):
        pass
    with store.build(raster, "s3://terrain/workers.oro", workers=2, **SIZES | {"jobs": 1}):
        pass
    assert contents("s3://terrain/workers.oro") == files(tmp_path / "whole.oro")


@pytest.mark.stress
def test_workers_bake_into_a_bucket(s3, raster, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    how = {"azimuths": 4, "progress": False}
    for folder in ("whole.oro", "s3://terrain/baked.oro"):
        store.build(raster, folder if "://" in folder else tmp_path / folder, **SIZES).close()
    bake(tmp_path / "whole.oro", "sky-view-factor,aperture", **how).close()
    bake("s3://terrain/baked.oro", "visible-sky", workers=2, jobs=1, **how).close()
    s3.refuse = 0.02
    bake("s3://terrain/baked.oro", "sky-view-factor,aperture", workers=2, jobs=1, **how).close()
    s3.well()
    with store.open("s3://terrain/baked.oro") as terrain:
        assert terrain.layers == ("aperture", "sky-view-factor", "visible-sky") and terrain.check() == []
    made, expected = contents("s3://terrain/baked.oro"), files(tmp_path / "whole.oro")
    layers = {key: data for key, data in expected.items() if key.startswith("layers/") and "zarr.json" not in key}
    assert layers and layers.items() <= made.items()
    assert not list((tmp_path / "cache/bakes").rglob("*.sums"))
    with pytest.raises(UsageError, match="Use `workers`"):
        bake("s3://terrain/baked.oro", "openness", dask="tcp://nowhere:1", **how)


BUILD = """
import sys
from orograph import store
store.build(sys.argv[1], sys.argv[2], resume=True, shard=64, chunk=16, jobs=2).close()
"""


def client(server, raster, url):
    """A build in a process of its own."""
    env = {**os.environ, **ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}
    return subprocess.Popen([sys.executable, "-c", BUILD, str(raster), url], env=env, stderr=subprocess.PIPE)


@pytest.mark.stress
def test_clients_that_are_killed_leave_nothing_that_opens_and_the_last_makes_the_same_bytes(s3, raster, tmp_path):
    with store.build(raster, tmp_path / "whole.oro", **SIZES):
        pass
    chance, kills, trial = random.Random(4), 0, 0
    while kills < 20:
        url, trial = f"s3://terrain/killed{trial}.oro", trial + 1
        s3.refuse, s3.cut, s3.slow = 0.02, 0.02, 0.005
        for _ in range(12):
            s3.log.clear()
            process = client(s3, raster, url)
            while not any(kind == "PUT" for kind, _, _ in list(s3.log)) and process.poll() is None:
                time.sleep(0.02)
            time.sleep(chance.uniform(0, 1.5))
            process.kill()
            said = process.communicate()[1].decode()
            if process.returncode == 0:
                break
            assert process.returncode == -9, said
            kills += 1
            if root_of(url) is None:
                with pytest.raises(StoreError):
                    store.open(url)
        s3.well()
        done = client(s3, raster, url)
        assert done.wait(120) == 0, done.communicate()[1].decode()
        assert contents(url) == files(tmp_path / "whole.oro")
        assert root_of(f"s3://terrain/.killed{trial - 1}.oro.lock", "") is None
    print(f"{kills} kills of {trial} builds")


def root_of(url, key="zarr.json"):
    return storage_at(url).get(key)


@pytest.mark.stress
def test_two_clients_at_once_make_one_store_and_one_of_them_is_told(s3, raster, tmp_path):
    with store.build(raster, tmp_path / "whole.oro", **SIZES):
        pass
    s3.slow = 0.01
    both = [client(s3, raster, "s3://terrain/both.oro") for _ in range(2)]
    said = [each.communicate()[1].decode() for each in both]
    codes = sorted(each.returncode for each in both)
    assert codes[0] == 0 and (codes[1] == 0 or any("Another process is building" in each for each in said))
    assert contents("s3://terrain/both.oro") == files(tmp_path / "whole.oro")


AZURITE = os.environ.get("AZURITE")


@pytest.mark.stress
@pytest.mark.skipif(
    not AZURITE, reason="AZURITE names no azurite (npm install azurite; node_modules/.bin/azurite-blob)"
)
def test_azure(tmp_path, monkeypatch):
    """Azure's own emulator, with its own account and key, which everybody knows."""
    import obstore
    from obstore.store import AzureStore

    account = "devstoreaccount1"
    key = "Eby8vdM02xNOcqFlqUwJPLlmEtlCDXJ1OUzFT50uSRZ6IFsuFq2UVErCz4I6tq/K1SZFPTOtr/KBHBeksoGMGw=="
    port = 10000 + os.getpid() % 20000
    process = subprocess.Popen(
        [
            str(AZURITE),
            "--silent",
            "--skipApiVersionCheck",
            "--blobPort",
            str(port),
            "--location",
            str(tmp_path / "azurite"),
        ]
    )
    try:
        endpoint = f"http://127.0.0.1:{port}/{account}"
        for name, value in {"ACCOUNT_NAME": account, "ACCOUNT_KEY": key, "ENDPOINT": endpoint}.items():
            monkeypatch.setenv(f"AZURE_STORAGE_{name}", value)
        make_container(endpoint, account, key)
        given, url = source(HEIGHTS), "az://terrain/area.oro"
        store.build(given, tmp_path / "whole.oro", errors=(), **SIZES).close()
        with store.build(given, url, errors=(), **SIZES) as terrain:
            assert terrain.check() == []
        assert contents(url) == files(tmp_path / "whole.oro")
        with pytest.raises(StoreError, match="there already"):
            store.build(given, url, errors=(), **SIZES)
        assert isinstance(terrain.storage._client, AzureStore) and obstore
        update = {**SIZES, "errors": (), "update": True}
        tiles = [tile(tmp_path, 0, j, 0) for j in range(2)]
        store.build(tiles, "az://terrain/tiles.oro", **update).close()
        for seed in (1, 2):
            tile(tmp_path, 0, 1, seed)
            store.build(tiles, "az://terrain/tiles.oro", keep=2, **update).close()
        for number in (3, 2):
            with store.open(f"az://terrain/tiles.oro@{number}") as terrain:
                assert terrain.version == number and terrain.check() == []
        store.build(tiles, tmp_path / "tiles.oro", errors=(), **SIZES).close()
        with store.open("az://terrain/tiles.oro") as terrain, store.open(tmp_path / "tiles.oro") as other:
            assert terrain.record.digests.listed == other.record.digests.listed
        left = storage_at("az://terrain/tiles.oro").listed()
        assert len([key for key in left if key.startswith("heights/0/height/c/0/1.")]) == 2
    finally:
        process.terminate()
        process.wait()


def make_container(endpoint, account, key):
    """Create the container ``terrain``: a request signed with the account's key, tried until the server is there."""
    import base64
    import hashlib
    import hmac
    import urllib.error
    import urllib.request
    from email.utils import formatdate

    for _ in range(100):
        date = formatdate(usegmt=True)
        heads = f"x-ms-date:{date}\nx-ms-version:2021-12-02\n"
        text = f"PUT{chr(10) * 12}{heads}/{account}/{account}/terrain\nrestype:container"
        sign = base64.b64encode(hmac.new(base64.b64decode(key), text.encode(), hashlib.sha256).digest()).decode()
        request = urllib.request.Request(f"{endpoint}/terrain?restype=container", method="PUT", headers={
            "x-ms-date": date, "x-ms-version": "2021-12-02", "Authorization": f"SharedKey {account}:{sign}",
        })  # fmt: skip
        try:
            urllib.request.urlopen(request).close()
            return
        except urllib.error.HTTPError:
            raise
        except OSError:
            time.sleep(0.1)
    raise AssertionError("azurite does not answer")
