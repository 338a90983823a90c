"""The codecs in a store: its size, seconds of the build, random tiles per second, and tiles from a slow server.

    python bench/codec_stores.py DEM... [--max-error auto] [--delay 0.03] [--rate 4e6]
    python bench/codec_stores.py --pyramid [--data ../shared/data] [--size 2049]

The first command builds a store of the files with every codec. *Not cached* keeps no decoded tiles; *cached* has read
every tile before. The server answers each request after a delay, at a limited rate; a store is opened there afresh, and
random tiles are read one by one with the reader's cache.

``--pyramid`` compares rate and distortion of nested stores (*smallest*) and *progressive* ones: the ratio to 16 bits
for each full-resolution sample, counting heights of all levels but no means; and the rms error, largest error and PSNR
of the full resolution. Losasso and Hoppe 2004 report 114:1 at 1.8 m rms (the United States) and 63:1 at 1.0 m (Puget
Sound) on *filtered* levels.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import resource
import tempfile
import threading
import time
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from orograph import store
from orograph.dem.synth import Synth
from orograph.store.coding import CODECS

TILE = 257
PYRAMIDS = {
    "SRTM 3″, White Mountains": "n44w072-hgt/N44W072.hgt",
    "NRW surface model, 1 m": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
    "Gabilan lidar, 1 m": "lsd-topo/gabilan.tif",
}


class Slow(SimpleHTTPRequestHandler):
    """A server that answers range requests after a delay and slowly."""

    protocol_version = "HTTP/1.1"
    delay, rate = 0.03, 4e6

    def do_GET(self) -> None:
        time.sleep(self.delay)
        path = Path(self.translate_path(self.path))
        if not path.is_file():
            self.send_error(404)
            return
        data, span = path.read_bytes(), self.headers.get("Range", "")
        size = len(data)
        if span:
            first, _, last = span.removeprefix("bytes=").partition("-")
            start, stop = (int(first), int(last or size - 1) + 1) if first else (size - int(last), size)
            data = data[start:stop]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{start + len(data) - 1}/{size}")
        else:
            self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        time.sleep(len(data) / self.rate)
        self.wfile.write(data)

    def do_HEAD(self) -> None:
        path = Path(self.translate_path(self.path))
        self.send_response(200 if path.is_file() else 404)
        self.send_header("Content-Length", str(path.stat().st_size if path.is_file() else 0))
        self.send_header("Accept-Ranges", "bytes")
        self.end_headers()

    def log_message(self, *what: object) -> None:
        """Log nothing."""


@contextlib.contextmanager
def served(folder: Path, delay: float, rate: float) -> Iterator[str]:
    handler = type("Handler", (Slow,), {"delay": delay, "rate": rate})
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


def bytes_of(folder: Path, kind: str) -> int:
    """Bytes of all shards of heights or means, without coordinates and metadata."""
    return sum(p.stat().st_size for p in (folder / kind).glob("*/height/c/*/*"))


def tiles(terrain: Any, count: int, seconds: float, cached: bool) -> float:
    """Random full-resolution tiles per second of processor time."""
    rng = np.random.default_rng(1)
    rows, cols = terrain.grid.shape
    corners = [(int(rng.integers(0, rows - TILE)), int(rng.integers(0, cols - TILE))) for _ in range(count)]
    if cached:
        for row, col in corners:
            terrain.read(0, row, row + TILE, col, col + TILE)
    began, done = time.process_time(), 0
    while time.process_time() < began + seconds:
        row, col = corners[done % count]
        terrain.read(0, row, row + TILE, col, col + TILE)
        done += 1
    return done / (time.process_time() - began)


def processor() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def stores(given: argparse.Namespace) -> None:
    print("| codec | heights, MB | means, MB | build, s | of processors | tiles/s, not cached | cached | slow server |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for codec in CODECS:
            place = Path(folder) / codec
            how: dict[str, Any] = {"codec": codec, "max_error": given.max_error, "errors": (), "keep_source": False}
            store.build(given.dem, place, progress=False, overwrite=True, **how)  # (compiles the kernels)
            began, busy = time.perf_counter(), processor()
            store.build(given.dem, place, progress=False, overwrite=True, **how)
            took, busy = time.perf_counter() - began, processor() - busy
            with store.open(place, cache_bytes=0) as terrain:
                bare = tiles(terrain, 400, 2.0, False)
            with store.open(place) as terrain:
                cached = tiles(terrain, 50, 1.0, True)
            with served(Path(folder), given.delay, given.rate) as url, store.open(f"{url}/{codec}") as terrain:
                rng, began = np.random.default_rng(2), time.perf_counter()
                rows, cols = terrain.grid.shape
                for _ in range(20):
                    row, col = int(rng.integers(0, rows - TILE)), int(rng.integers(0, cols - TILE))
                    terrain.read(0, row, row + TILE, col, col + TILE)
                far = 20 / (time.perf_counter() - began)
            sizes = bytes_of(place, "heights") / 1e6, bytes_of(place, "mean") / 1e6
            print(
                f"| {codec} | {sizes[0]:.1f} | {sizes[1]:.1f} | {took:.1f} | {busy:.1f} | {bare:.0f} | {cached:.0f} "
                f"| {far:.1f} |", flush=True,
            )  # fmt: skip


def pyramid(given: argparse.Namespace) -> None:
    print("| heights | error, m | codec | bits a sample | ratio | rms, m | largest, m | PSNR, dB |")
    print("|---|---|---|---|---|---|---|---|")
    formula = Synth((given.size, given.size), 7, spacing=30.0)
    formula.prepare()
    sources: dict[str, Any] = {name: given.data / path for name, path in PYRAMIDS.items()}
    sources[f"synthetic, {given.size}², 30 m"] = formula
    with tempfile.TemporaryDirectory() as folder:
        for name, source in sources.items():
            if isinstance(source, Path) and not source.exists():
                continue
            for error in (0.1, 1.0, 3.0):
                for codec in ("smallest", "progressive"):
                    place = Path(folder) / "s"
                    terrain = store.build(
                        source, place, codec=codec, max_error=error, errors=(), keep_source=False, overwrite=True,
                        progress=False,
                    )  # fmt: skip
                    coding, (low, high) = terrain.record.coding, terrain.height_range
                    assert coding is not None
                    bits = 8 * bytes_of(place, "heights") / math.prod(terrain.grid.shape) / terrain.valid_fraction
                    psnr = 20 * math.log10((high - low) / coding.rms)
                    print(
                        f"| {name} | {error} | {codec} | {bits:.3f} | {16 / bits:.0f} | {coding.rms:.3f} "
                        f"| {coding.largest:.3f} | {psnr:.1f} |", flush=True,
                    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem", nargs="*", type=Path)
    parser.add_argument("--max-error", default="auto")
    parser.add_argument("--delay", type=float, default=0.03, help="seconds before each answer of the server")
    parser.add_argument("--rate", type=float, default=4e6, help="bytes a second of each answer")
    parser.add_argument("--pyramid", action="store_true", help="rate and distortion")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--size", type=int, default=2049, help="of the synthetic terrain")
    given = parser.parse_args()
    pyramid(given) if given.pyramid else stores(given)


if __name__ == "__main__":
    main()
