"""Manifests of files on servers, and at addresses: what entity tags tell, and what is asked for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import orograph
from orograph.dem import asking

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "store"))


@pytest.fixture(scope="module")
def server():
    pytest.importorskip("moto.server")
    from buckets import bucket_server

    with bucket_server() as running:
        yield running


@pytest.fixture
def here(server, monkeypatch):
    """This process asks the server, too."""
    from buckets import ENVIRONMENT

    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url, "AWS_REGION": "us-east-1"}.items():
        monkeypatch.setenv(name, value)
    asking._client.cache_clear()
    yield
    asking._client.cache_clear()
    asking._known.clear()


def run(server, *args):
    """The command line in a process of its own: rasterio holds Python's lock while it opens what this one serves."""
    from buckets import ENVIRONMENT

    env = {**os.environ, **ENVIRONMENT, "AWS_ENDPOINT_URL": server.url, "AWS_REGION": "us-east-1"}
    done = subprocess.run(
        [sys.executable, "-m", "orograph", *map(str, args)], env=env, capture_output=True, text=True, timeout=120
    )
    return done.returncode, done.stdout + done.stderr


def put(server, key, data):
    """Write an object, also where there is one (which takes credentials)."""
    from buckets import ENVIRONMENT
    from obstore.store import S3Store

    access, secret = ENVIRONMENT.values()
    S3Store(
        "terrain", endpoint=server.url, access_key_id=access, secret_access_key=secret, region="us-east-1",
        client_options={"allow_http": True}, virtual_hosted_style_request=False,
    ).put(key, data)  # fmt: skip


def upload(server, tmp_path, number, value):
    from test_manifest import tile

    path = tile(tmp_path / f"u{number}.tif", number, value)
    put(server, f"u{number}.tif", path.read_bytes())
    return f"s3://terrain/u{number}.tif"


@pytest.mark.stress
def test_only_what_changed_on_a_server_is_opened_and_built_again(server, tmp_path):
    urls = [upload(server, tmp_path, number, 10.0 + number) for number in range(4)]
    listed, store = tmp_path / "far.manifest.geojsonl", tmp_path / "far.oro"
    code, told = run(server, "-q", "manifest", *urls, "-o", listed)
    assert code == 0, told
    said = [json.loads(line)["properties"] for line in listed.read_text().splitlines()]
    assert all(one["etag"] for one in said)
    assert [one["size"] for one in said] == [(tmp_path / f"u{k}.tif").stat().st_size for k in range(4)]
    server.well()
    code, told = run(server, "-q", "manifest", listed, "-o", listed)
    assert code == 0 and server.asked == {"HEAD": 4}, (told, server.asked)  # nothing was opened
    build = ("build", listed, "-o", store, "--update", "--errors", "none")
    code, told = run(server, *build)
    assert code == 0, told
    upload(server, tmp_path, 2, 99.0)
    server.well()
    code, told = run(server, "-q", "manifest", listed, "-o", listed)
    opened = {path for kind, path, _ in server.log if kind == "GET"}
    assert (
        code == 0 and "/terrain/u2.tif" in opened and not any(f"/u{k}." in path for path in opened for k in (0, 1, 3))
    )
    code, told = run(server, *build)
    assert code == 0 and "1 of 1 shards of heights" in told, told
    code, told = run(server, *build, "--json")
    with orograph.open(store) as terrain:
        assert terrain.version == 2  # the last had nothing to do
        assert terrain.record.inputs["files"][2]["etag"] not in (None, said[2]["etag"])
        assert terrain.read(0, 3, 4, 18, 19) == 99 and terrain.read(0, 3, 4, 2, 3) == 10


@pytest.mark.stress
def test_a_manifest_at_an_address_with_relative_paths(server, tmp_path, here):
    for number in range(2):
        upload(server, tmp_path, number, 5.0 + number)
    lines = [json.dumps({"path": f"u{number}.tif"}) for number in (0, 1, 7)]
    put(server, "all.manifest.geojsonl", "\n".join(lines).encode())
    at = "s3://terrain/all.manifest.geojsonl"
    code, told = run(server, "build", at, "-o", tmp_path / "a.oro", "--errors", "none")
    assert code == 3 and "s3://terrain/u7.tif" in told
    code, told = run(server, "build", at, "-o", tmp_path / "a.oro", "--errors", "none", "--skip-damaged")
    assert code == 0 and "u7.tif" in told, told
    with orograph.open(tmp_path / "a.oro") as terrain:
        assert terrain.read(0, 3, 4, 10, 11) == 6
    code, told = run(server, "info", "s3://terrain/none.manifest.geojsonl")
    assert code == 3 and "no such file" in told


def test_what_servers_tell(server, tmp_path, here):
    url = upload(server, tmp_path, 0, 5.0)
    first = asking.asked(url)
    assert first is not None and first.etag and first == asking.asked("/vsis3/terrain/u0.tif")
    upload(server, tmp_path, 0, 6.0)
    assert asking.asked(url) != first
    assert asking.asked("s3://terrain/none.tif") is None
    assert asking.asked(f"{server.url}/terrain/u0.tif?X-Amz-Signature=1") is None
    server.refuse = 0.4
    assert asking.asked(url) is not None
    server.well()


def test_states_on_web_servers(tmp_path):
    from test_manifest import tile
    from webserver import serving

    tile(tmp_path / "a.tif")
    with serving(tmp_path) as web:  # which tells neither a tag nor a time
        assert asking.asked(f"{web.url}/a.tif") is None
        assert asking.fetched(f"{web.url}/a.tif") == (tmp_path / "a.tif").read_bytes()
    asking._client.cache_clear()


def test_addresses():
    assert asking.url_of("/vsis3/bucket/a.tif") == "s3://bucket/a.tif"
    assert asking.url_of("/vsicurl/https://host/a.tif") == "https://host/a.tif"
    assert asking.url_of("https://host/a.tif?sig=1") is None and asking.url_of("/data/a.tif") is None
