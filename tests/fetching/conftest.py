from __future__ import annotations

import shutil

import pytest
from sources import copernicus, heights, srtm3
from tileserver import tiles

from orograph.fetching import asking, products, register
from orograph.fetching.products import _registered


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    with tiles(tmp_path_factory.mktemp("tiles")) as one:
        yield one


@pytest.fixture
def web(server, monkeypatch, tmp_path):
    """A server that all products lie at, and an empty cache."""
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(asking, "PAUSES", [0.01, 0.02, 0.05])
    for name in ("GDAL_HTTP_BEARER", "GDAL_HTTP_USERPWD", "GDAL_HTTP_HEADERS", "OROGRAPH_PRODUCTS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    shutil.rmtree(server.files.folder, ignore_errors=True)
    server.set()
    for name in list(products()):
        register(name, base=f"{server.url}/{name}")
    yield server
    _registered.clear()


@pytest.fixture(scope="session")
def cut_tiles(shared_data):
    """Tiles of California: name → (1200, 1200) of GLO-90's cut."""
    return {n: heights(shared_data, n)[:1200, :1200] for n in ("N37W119", "N37W120", "N36W119", "N36W120")}


@pytest.fixture(scope="session")
def files(cut_tiles, shared_data):
    """Four tiles as GLO-90 and as SRTM GL3, whose borders are shared: by product, path → bytes."""
    return {
        "copernicus-90": dict(copernicus(name, values) for name, values in cut_tiles.items()),
        "srtm-3": dict(srtm3(shared_data, name) for name in cut_tiles),
    }


@pytest.fixture
def california(web, files):
    """The server with the tiles of GLO-90."""
    for path, data in files["copernicus-90"].items():
        web.files[f"copernicus-90/{path}"] = data
    return web


@pytest.fixture
def srtm(web, files):
    """The server with the tiles of SRTM GL3."""
    for path, data in files["srtm-3"].items():
        web.files[f"srtm-3/{path}"] = data
    return web
