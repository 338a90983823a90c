"""Tile services and packed tiles as layers: a server on 127.0.0.1 whose tiles say which they are."""

from __future__ import annotations

import io
import re
import sqlite3
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from PIL import Image
from pyproj import CRS, Transformer

import orograph
from orograph.dem.raster import Dem
from orograph.errors import ReadError, UsageError
from orograph.geo import Grid
from orograph.geovis.basemaps import Basemap
from orograph.geovis.layers import Layer

SIZE = (160, 120)
EAST, NORTH = 1_113_000.0, 6_446_000.0  # Web Mercator, by the Matterhorn


def colour(z: int, x: int, y: int) -> tuple[int, int, int]:
    """A colour that says which tile it is of."""
    return 40 + 12 * z, 60 + 37 * x % 180, 60 + 53 * y % 180


def encoded(z: int, x: int, y: int, side: int = 256) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (side, side), colour(z, x, y)).save(out, "png")
    return out.getvalue()


class Tiles(ThreadingHTTPServer):
    """Serves ``encoded``. Attributes: asked: paths and agents. mood: a status to answer with, 200 if all is well."""

    daemon_threads = True

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.mood = 200
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/{{z}}/{{x}}/{{y}}.png"


class Handler(BaseHTTPRequestHandler):
    server: Tiles

    def do_GET(self) -> None:
        self.server.asked.append((self.path, self.headers.get("User-Agent", "")))
        if self.server.mood != 200:
            self.send_error(self.server.mood)
            return
        z, x, y = (int(v) for v in re.findall(r"\d+", self.path))
        body = encoded(z, x, y, 512 if "wide" in self.path else 256)
        self.send_response(200)
        self.send_header("Content-Type", "image/png")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[Tiles]:
    made = Tiles()
    threading.Thread(target=made.serve_forever, args=(0.05,), daemon=True).start()
    yield made
    made.shutdown()
    made.server_close()


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    """A level plain of 12.8 by 9.6 km in UTM."""
    x, y = Transformer.from_crs(3857, 32632, always_xy=True).transform(EAST, NORTH)
    grid = Grid((97, 129), Affine(100, 0, x - 6450, 0, -100, y + 4850), CRS.from_epsg(32632))
    return orograph.terrain(Dem(np.zeros(grid.shape, np.float32), grid, name="plain"), False)


def plan(ground: orograph.Terrain, layer: object, backend: str = "cpu") -> np.ndarray:
    view = orograph.camera.plan(ground, SIZE)
    return orograph.render(ground, view, layers=[layer], light="none", water=None, samples=1, backend=backend,
                           progress=False).pixels  # fmt: skip


def expected(ground: orograph.Terrain, zoom: int) -> tuple[np.ndarray, np.ndarray]:
    """The colour of the tile in the middle of each pixel of the plan, and whether the pixel is well inside the tile."""
    view = orograph.camera.plan(ground, SIZE)
    cols, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    metres = view.pixel_metres
    x = view.target[0] + (cols + 0.5 - SIZE[0] / 2) * metres
    y = view.target[1] - (rows + 0.5 - SIZE[1] / 2) * metres
    east, north = Transformer.from_crs(32632, 3857, always_xy=True).transform(x, y)
    tile = 2 * 20037508.342789244 / 2**zoom
    col, row = (east + 20037508.342789244) / tile, (20037508.342789244 - north) / tile
    colours = np.array([[colour(zoom, int(a), int(b)) for a, b in zip(*line)] for line in zip(col, row)])
    inner = (np.abs(col % 1 - 0.5) < 0.45) & (np.abs(row % 1 - 0.5) < 0.45)
    return colours, inner & (np.abs(x - view.target[0]) < 6000) & (np.abs(y - view.target[1]) < 4500)


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_a_picture_shows_the_tiles_of_the_zoom_that_it_needs(server, ground, backend) -> None:
    if backend == "gpu":
        pytest.importorskip("wgpu")
    layer = orograph.basemap(server.url)
    pixels = plan(ground, layer, backend)
    zooms = {int(path.split("/")[1]) for path, _ in server.asked}
    right = [np.abs(pixels.astype(int) - colours).max(-1)[inner].mean()
             for colours, inner in (expected(ground, zoom) for zoom in sorted(zooms))]  # fmt: skip
    assert min(right) < 3 and max(zooms) <= (11 if backend == "cpu" else 13) and len(server.asked) < 30
    assert all(agent.startswith("orograph/") for _, agent in server.asked)
    before = len(server.asked)
    assert np.array_equal(plan(ground, layer, backend), pixels) and len(server.asked) == before  # out of the cache


def test_folders_mbtiles_and_pmtiles_show_the_same(server, ground, tmp_path) -> None:
    """Packed are the zooms 9 to 11 over the ground."""
    from pmtiles.tile import Compression, TileType, zxy_to_tileid
    from pmtiles.writer import Writer

    lon, lat = Transformer.from_crs(3857, 4326, always_xy=True).transform(EAST, NORTH)
    tiles = []
    for zoom in (9, 10, 11):
        size = 2 * 20037508.342789244 / 2**zoom
        col, row = int((EAST + 20037508.34) / size), int((20037508.34 - NORTH) / size)
        tiles += [(zoom, col + a, row + b) for a in (-2, -1, 0, 1, 2) for b in (-2, -1, 0, 1, 2)]
    for z, x, y in tiles:
        path = tmp_path / "tiles" / str(z) / str(x) / f"{y}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded(z, x, y))
    with (tmp_path / "a.pmtiles").open("wb") as file:
        writer = Writer(file)
        for z, x, y in sorted(tiles, key=lambda one: zxy_to_tileid(*one)):
            writer.write_tile(zxy_to_tileid(z, x, y), encoded(z, x, y))
        corner = {"min_lon_e7": int((lon - 1) * 1e7), "min_lat_e7": int((lat - 1) * 1e7),
                  "max_lon_e7": int((lon + 1) * 1e7), "max_lat_e7": int((lat + 1) * 1e7)}  # fmt: skip
        writer.finalize({"tile_type": TileType.PNG, "tile_compression": Compression.NONE, "center_zoom": 9,
                         "center_lon_e7": int(lon * 1e7), "center_lat_e7": int(lat * 1e7), **corner}, {})  # fmt: skip
    folder = plan(ground, f"xyz:{tmp_path}/tiles/{{z}}/{{x}}/{{y}}.png")
    colours, inner = expected(ground, 11)
    assert np.abs(folder.astype(int) - colours).max(-1)[inner].mean() < 3
    made = next((tmp_path / "cache" / "images").glob("*/tiles.mbtiles"))
    base = sqlite3.connect(made)
    assert base.execute("SELECT count(*) FROM tiles").fetchone() == (75,)
    base.close()
    np.testing.assert_array_equal(plan(ground, made), folder)
    np.testing.assert_array_equal(plan(ground, tmp_path / "a.pmtiles"), folder)


def test_whoever_made_it_is_named(ground, tmp_path) -> None:
    layer = orograph.basemap("OpenTopoMap", opacity=0.5)
    assert layer.label == "OpenTopoMap" and "OpenTopoMap (CC-BY-SA)" in layer.attribution[0]
    from orograph.scene.scene import Scene

    scene = Scene.of(ground, orograph.camera.plan(ground, SIZE), layers=[layer])
    assert scene.attribution == layer.attribution
    assert Scene.of(ground, scene.view, layers=[Layer("xyz:OpenTopoMap", visible=False)]).attribution == ()
    assert Layer.parse("xyz:OpenTopoMap,opacity=0.5") == layer and Layer.from_dict(layer.to_dict()) == layer


def test_a_server_that_fails_is_told(server, ground) -> None:
    server.mood = 404  # it has no tiles here
    with pytest.raises(ReadError, match="no valid pixel over the terrain"):
        plan(ground, orograph.basemap(server.url))
    server.mood = 500
    with pytest.raises(ReadError, match=r"^xyz:.*: The server did not give a tile: status 500"):
        plan(ground, orograph.basemap(server.url.replace("{y}.png", "{y}.jpg")))


def test_wide_tiles(server, ground) -> None:
    wide = server.url.replace("{y}.png", "{y}.png?wide")
    with pytest.raises(ReadError, match="as wide as expected") as error:
        plan(ground, orograph.basemap(wide))
    assert "#512" in error.value.remedy
    assert Basemap.of("xyz:http://a.b/{z}/{x}/{y}@2x.png").side == 512
    seen = np.unique(np.asarray(plan(ground, orograph.basemap(f"{wide}#512"))).reshape(-1, 3), axis=0)
    assert len(seen) > 1
    for path in ("tiles/{z}/{x}/{y}.png", "http://a.b/{z}/{x}/{y}.png"):
        with pytest.raises(UsageError, match="pattern") as told:
            plan(ground, Layer(path))
        assert told.value.remedy == f"Write xyz:{path}."


def test_names_of_the_catalogue() -> None:
    found = Basemap.of("xyz:Esri.WorldImagery")
    assert "{z}" in found.url and "{y}/{x}" in found.url and "Esri" in found.attribution
    assert Basemap.of("xyz:openstreetmap mapnik").name == "OpenStreetMap.Mapnik"
    assert "apikey=abc" in Basemap.of("xyz:Thunderforest.Outdoors?apikey=abc").url
    for name, words in (("Thunderforest.Outdoors", "needs a token"), ("OpenTopMap", "Did you mean OpenTopoMap"),
                        (str(Path(__file__).parent), "/{z}/{x}/{y}.png"), ("http://a.b/{z}/{x}/{y}#x", "such as #512"),
                        ("http://a.b/{z}/{x}.png", "have {z}, {x} and {y}"),
                        ("OpenTopoMap?key=1", "has no parameter 'key'")):  # fmt: skip
        with pytest.raises(UsageError, match=re.escape(words)):
            orograph.basemap(name)
