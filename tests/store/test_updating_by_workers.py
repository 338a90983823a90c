"""Updates by the workers of a cluster: the store of one thread to the byte, and what it keeps for the next one, too."""

from __future__ import annotations

import pytest
from buckets import ENVIRONMENT, bucket_server
from test_bucket_versions import equals_a_new_build, there
from test_clusters import client  # noqa: F401 (a fixture)
from test_in_parts import files
from test_updating import OPTIONS, grid_of_tiles, tile

import orograph
from orograph.store.build import build
from orograph.store.digests import crc32c

MORE = {"errors": ("exact", "midpoint"), "tins": 16, "chunked": (32, 0)}


def marked(folder):
    """Files with their checksums, but for times and plans."""
    return {name: crc32c(data) for name, data in files(folder).items()}


@pytest.mark.stress
@pytest.mark.parametrize("more", [{}, pytest.param(MORE, marks=pytest.mark.stress)])
def test_in_a_folder(tmp_path, client, more):  # noqa: F811
    tiles = grid_of_tiles(tmp_path / "tiles", 3)
    one, other = tmp_path / "one.oro", tmp_path / "other.oro"
    for step in range(3):
        if step:
            tile(tmp_path / "tiles", 1, step, step, holes=True)
        chosen = [path for k, path in enumerate(tiles) if (step, k) != (2, 4)]
        build(chosen, one, update=True, jobs=1, **OPTIONS, **more).close()
        build(chosen, other, update=True, dask=client, **OPTIONS, **more).close()
        assert marked(other) == marked(one), step  # (with what tasks found)
    with orograph.open(other) as terrain:
        assert terrain.check() == []


@pytest.mark.stress
def test_only_what_follows_of_a_change_is_made_again(tmp_path, client, monkeypatch):  # noqa: F811
    from orograph.store import clusters

    tiles, done, hear = grid_of_tiles(tmp_path / "tiles", 4), [], clusters._Round._hear

    def heard(self, found):
        done.append((self.stage.name, found.seconds > 0))
        hear(self, found)

    monkeypatch.setattr(clusters._Round, "_hear", heard)
    build(tiles, tmp_path / "s", update=True, dask=client, **OPTIONS).close()
    assert done.count(("heights", True)) == 25
    done.clear()
    tile(tmp_path / "tiles", 0, 0, 3)
    build(tiles, tmp_path / "s", update=True, dask=client, **OPTIONS).close()
    assert 1 <= done.count(("heights", True)) <= 4 and done.count(("heights", False)) >= 21


@pytest.fixture
def s3(monkeypatch):
    pytest.importorskip("obstore")
    pytest.importorskip("moto.server")
    with bucket_server() as server:
        for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}.items():
            monkeypatch.setenv(name, value)
        yield server


@pytest.mark.stress
@pytest.mark.parametrize("more", [{"errors": ("exact",)}, pytest.param(MORE, marks=pytest.mark.stress)])
def test_in_a_bucket(s3, tmp_path, client, more):  # noqa: F811
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": s3.url}.items():
        client.run(_setenv, name, value)
    (tmp_path / "tiles").mkdir()
    tiles = [tile(tmp_path / "tiles", i, j, 0) for i in range(2) for j in range(3)]
    how, urls = {**OPTIONS, "shard": 128, **more}, ("s3://terrain/one/area.oro", "s3://terrain/other/area.oro")
    for step in range(3):
        if step:
            tile(tmp_path / "tiles", step - 1, 2, step)
        for url, by in zip(urls, ({"jobs": 1}, {"dask": client}), strict=True):
            build(tiles, url, update=True, keep=2, **how, **by).close()
        equals_a_new_build(urls[1], tiles, tmp_path / "new", **more)
        one, other = map(there, urls)
        assert other == one, step  # the same objects, what tasks found among them, and nothing else


def _setenv(name, value):
    import os

    os.environ[name] = value
