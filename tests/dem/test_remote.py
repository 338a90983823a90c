"""Rasters in buckets: found as stores are, read without a listing, and again where the server is busy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph import store
from orograph.dem.remote import network

sys.path.append(str(Path(__file__).parents[1] / "store"))


@pytest.fixture(scope="module")
def server():
    pytest.importorskip("moto.server")
    from buckets import bucket_server

    with bucket_server() as running:
        yield running


@pytest.fixture(scope="module")
def raster(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    heights = np.random.default_rng(3).normal(500, 10, (150, 130)).astype(np.float32)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(
        path, "w", "GTiff", 130, 150, 1, "EPSG:32633", Affine(30, 0, 400000, 0, -30, 5000000), "float32",
        tiled=True, blockxsize=64, blockysize=64, compress="deflate",
    ) as out:  # fmt: skip
        out.write(heights, 1)
        out.write_mask(heights > 490)
    return path


def orograph(server, *args):
    """The command line in a process of its own: rasterio holds Python's lock while it opens what this one serves."""
    from buckets import ENVIRONMENT

    env = {**os.environ, **ENVIRONMENT, "AWS_ENDPOINT_URL": server.url}
    done = subprocess.run(
        [sys.executable, "-m", "orograph", "--quiet", *map(str, args)], env=env, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.mark.stress
def test_a_raster_in_a_bucket_is_built_into_a_store_with_its_mask_from_a_busy_server(server, raster, tmp_path):
    masks = [path for path in raster.parent.iterdir() if path != raster]
    for path in (raster, *masks):
        server.put(f"terrain/{path.name}", path.read_bytes())
    server.well()
    server.refuse = 0.2
    code, said = orograph(server, "build", "s3://terrain/dem.tif", "-o", tmp_path / "far.oro")
    assert code == 0, said
    asked = [path for _, path, _ in server.log]
    assert server.asked["LIST"] == 0 and len(set(asked)) < 12
    server.well()
    with store.build(raster, tmp_path / "near.oro") as near, store.open(tmp_path / "far.oro") as far:
        np.testing.assert_array_equal(near.read(0, 0, 150, 0, 130), far.read(0, 0, 150, 0, 130))
        assert masks and near.valid_fraction < 1
        assert far.record.inputs["files"][0]["path"] == "s3://terrain/dem.tif"


def test_what_is_not_there_is_told(server, tmp_path):
    code, said = orograph(server, "build", "s3://terrain/none.tif", "-o", tmp_path / "none.oro")
    assert code == 3 and "s3://terrain/none.tif" in said and "key does not exist" in said


@pytest.mark.stress
def test_signatures_and_passwords_are_in_no_message_and_no_store(server, raster, tmp_path):
    """A presigned address, and one with a password: as they come from a browser."""
    server.put("terrain/signed.tif", raster.read_bytes())
    place = server.url.replace("http://", "http://someone:hidden-word@")
    code, said = orograph(server, "build", f"{place}/terrain/none.tif?X-Amz-Signature=hidden", "-o", tmp_path / "a.oro")
    assert code == 3 and "hidden" not in said
    address = f"{place}/terrain/signed.tif?X-Amz-Signature=hidden"
    code, said = orograph(server, "build", address, "-o", tmp_path / "b.oro")
    assert code == 0 and "hidden" not in said, said
    for path in (tmp_path / "b.oro").rglob("*"):
        assert path.is_dir() or b"hidden" not in path.read_bytes(), path
    again = address.replace("Signature=hidden", "Signature=hidden2")
    code, said = orograph(server, "build", again, "-o", tmp_path / "b.oro", "--resume")
    assert code == 0, said  # the same file
    code, said = orograph(server, "info", tmp_path / "b.oro")
    assert code == 0 and "hidden" not in said


def test_gdal_finds_buckets_where_stores_are_found(monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9000/s3/")
    found = network("s3://terrain/dem.tif")
    assert (found["AWS_S3_ENDPOINT"], found["AWS_HTTPS"]) == ("127.0.0.1:9000/s3", "NO")
    monkeypatch.setenv("AWS_S3_ENDPOINT", "elsewhere:1")
    assert "AWS_S3_ENDPOINT" not in network("s3://terrain/dem.tif")
    assert "GDAL_DISABLE_READDIR_ON_OPEN" not in network("dem.tif")
    monkeypatch.setenv("AZURE_STORAGE_ACCOUNT_NAME", "name")
    assert network("az://terrain/dem.tif")["AZURE_STORAGE_ACCOUNT"] == "name"
