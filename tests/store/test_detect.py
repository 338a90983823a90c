"""A store is told from a raster by one look, at URLs too, and where the name says raster without any."""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import fsspec
import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS

from orograph import store
from orograph.cli import cli
from orograph.dem import Dem
from orograph.geo import Grid
from orograph.store import detect
from orograph.store.detect import is_store

HEIGHTS = np.add.outer(np.arange(40, dtype=np.float32), np.arange(50, dtype=np.float32))
DEM = Dem(HEIGHTS, Grid((40, 50), Affine(30, 0, 5e5, 0, -30, 4e6), CRS("EPSG:32611")), "EGM96 height", "slope")


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder and the http address it is served at."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield tmp_path, f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_folders(tmp_path: Path) -> None:
    store.build(DEM, tmp_path / "a.oro").close()
    assert is_store(tmp_path / "a.oro") and is_store(str(tmp_path / "a.oro"))
    assert not is_store(tmp_path) and not is_store(tmp_path / "none.oro") and not is_store(tmp_path / "a.oro/zarr.json")


def test_in_memory() -> None:
    store.build(DEM, "memory://detect/a.oro").close()
    try:
        assert is_store("memory://detect/a.oro") and is_store("memory://detect/a.oro/")
        assert not is_store("memory://detect") and not is_store("memory://detect/b.oro")
        result = CliRunner().invoke(cli, ["--quiet", "info", "--json", "memory://detect/a.oro"], catch_exceptions=False)
        told = json.loads(result.stdout)
        assert told["kind"] == "store" and told["shape"] == [40, 50] and told["vertical_datum"] == "EGM96 height"
    finally:
        fsspec.filesystem("memory").rm("/detect", recursive=True)


def test_over_http_whatever_it_is_called(served: tuple[Path, str]) -> None:
    pytest.importorskip("obstore")
    folder, address = served
    for name in ("a.oro", "a.zarr", "plain"):
        store.build(DEM, folder / name).close()
        assert is_store(f"{address}/{name}"), name
    (folder / "dem").write_bytes(b"no store")
    assert not is_store(f"{address}/dem") and not is_store(f"{address}/none.oro")


@pytest.mark.parametrize("name", ["dem.tif", "dem.xyz", "N44W072.hgt.zip", "dem.tif?token=a.oro", "a.oro/heights.img/"])
def test_a_raster_s_name_is_not_looked_at(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def look(*_: object, **__: object) -> None:
        pytest.fail("a request was made")

    monkeypatch.setattr(detect, "storage_at", look)
    assert not is_store(f"https://example.invalid/{name}")
