"""Chunks that the GPU decodes: bytes per triangle, triangles per second, and a comparison with *compact* heights.

    python bench/chunk_code.py [PATH …] [--synthetic 4097] [--cells 32] [--times 5] [--batch 4] [--tolerance 1]
        [--size 1280x720] [--no-views]

Some evenly spaced chunks of each terrain are encoded; the terrain is a raster, or a synthetic one made on the spot. The
table gives bytes per triangle, compared with indexed triangles (12 bytes each, and 12 per vertex), and the same with
the rest of the words included (skirts, and 4 bytes per vertex for morphs). Then come triangles per second: of the GPU's
decoder by its own clock, as the mean of many runs in one submission, for the chunks of a frame (about 300,000
triangles) and for a batch of ``--batch`` million (chunks are repeated if there are too few); of a whole call, with
uploads and Python, also per second of processor time, which is what matters on a software adapter; of uploading the
same vertices and triangles decoded; and of decoding on one thread of the CPU. Each is the fastest of ``--times``.

Unless ``--no-views`` is given, three stores of each raster are built: with compressed chunks, with uncompressed chunks,
and with *compact* heights. Two views of each are drawn, with only the system's file cache warm: MB read, and ms to read
and decode on the CPU, to upload (and decode on the GPU), and to draw.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import orograph
from orograph.dem import Dem
from orograph.gpu.clock import Clock
from orograph.gpu.device import Device, open_device
from orograph.gpu.recording import write
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.parallel import map_ordered
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.chunks import Chunks, Decoder
from orograph.rendering.gpu.surface.meshes import packed
from orograph.rendering.gpu.targets import Targets
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.chunk_code import HEADER, decoded
from orograph.store.chunked import MISSING, Kind, Layout, Words
from orograph.store.chunked_build import MemoryChunks
from orograph.viewpoint import Camera
from view import FLIGHTS

DATA = Path(__file__).parents[2] / "shared" / "data"
PATHS = [
    DATA / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif",
    DATA / "nrw-dom1-1m" / "dom1_32_356_5699_1_nw_2020.tif",
]
SOME, TILE, FRAME, SHARE = 400, 256, 3e5, 0.2
"""Chunks of a level; samples of a tile; triangles of a frame; seconds of a measurement of the GPU."""
VERTICES, TRIANGLES, HUNG, RUNS = (HEADER.index(name) for name in ("vertices", "triangles", "hung", "runs"))
Name = tuple[int, int, int]


def some_chunks(chunks: Any, most: int) -> tuple[list[Name], list[Words]]:
    """Evenly spaced chunks of all levels, at most so many of each level, and their words."""
    names: list[Name] = []
    for level in range(chunks.layout.top + 1):
        every = [(level, i, j) for i, j in np.ndindex(chunks.layout.chunks(level))]
        names += every[:: -(-len(every) // most)]
    return names, list(map_ordered(lambda name: chunks.words(*name), names))


def sizes(layout: Layout, names: list[Name], words: list[Words]) -> None:
    """Bytes per triangle, with levels weighted by their number of chunks."""
    rows: dict[int, list[Any]] = {}
    for name, coded in zip(names, words, strict=True):
        mesh = decoded(coded, layout, *name)
        _, first = np.unique(mesh.places, axis=0, return_index=True)
        t, e, v, s = len(mesh.triangles), int(coded[HUNG]), len(first), int((mesh.low[first] != MISSING).sum())
        bare, whole = 12 * t + 12 * v, 12 * (t + 2 * e) + 16 * v + 12 * s
        share = np.prod(layout.chunks(name[0])) / sum(n[0] == name[0] for n in names)
        numbers = t, 4 * len(coded), bare, whole, v, len(mesh.places), int(coded[RUNS])
        rows.setdefault(name[0], []).append(np.array(numbers) * share)
    t, coded_, bare, whole, v, there, runs = np.sum([np.sum(each, 0) for each in rows.values()], 0)
    print(
        f"  {t:,.0f} triangles, {coded_ / t:.3f} bytes each; indexed {bare / t:.2f} ({bare / coded_:.1f} ×), "
        f"with morphs and skirts {whole / t:.2f} ({whole / coded_:.1f} ×); {t / runs:.0f} triangles a run, "
        f"{there / v:.2f} vertices in place of one"
    )


class Batch:
    """Chunks to decode, repeated up to a number of triangles, and the buffers for them."""

    def __init__(self, device: Device, layout: Layout, names: list[Name], words: list[Words], most: float) -> None:
        self.device, self.layout, self.decoder = device, layout, Decoder(device)
        ends = np.cumsum([int(one[TRIANGLES]) for one in words])
        count = int(np.searchsorted(ends, most)) + 1
        times = max(round(most / int(ends[-1])), 1)
        self.names, self.words = names[:count] * times, words[:count] * times
        counts = np.array([(int(w[VERTICES]), int(w[TRIANGLES]) + 2 * int(w[HUNG])) for w in self.words])
        ends = np.cumsum(counts, 0)
        self.places = [(v, t) for v, t in (ends - counts).tolist()]
        self.triangles, self.bytes = int(ends[-1, 1]), 4 * sum(map(len, self.words))
        self.buffers = [
            device.buffer(size * int(end), "STORAGE|COPY_SRC") for size, end in zip((20, 12), ends[-1], strict=True)
        ]

    def call(self) -> None:
        """Decode all chunks, as a frame does."""
        self.decoder.decode(self.layout, self.names, self.words, self.places, *self.buffers)
        self.device.wait()

    def by_clock(self, times: int) -> float:
        """Seconds of the GPU for one decoding, by its own clock if it has one."""
        clock = Clock(self.device)
        group, count = self.decoder.prepare(self.layout, self.names, self.words, self.places, *self.buffers)

        def some(repeats: int) -> float:
            self.device.wait()
            begun = time.perf_counter()
            clock.begin()
            encoder = self.device.handle.create_command_encoder()
            self.decoder.record(encoder, group, count, repeats)
            self.device.queue.submit([encoder.finish()])
            clock.end()
            self.device.wait()
            wall = time.perf_counter() - begun
            return (clock.seconds() or wall) / repeats

        some(1)
        repeats = int(min(max(SHARE / some(1), 1), 500))
        return min(some(repeats) for _ in range(times))

    def upload(self, plain: list[Any]) -> None:
        """Upload the decoded chunks."""
        for buffer, data in zip(self.buffers, plain, strict=True):
            write(self.device, buffer, data)
        self.device.wait()


def rates(device: Device, layout: Layout, names: list[Name], words: list[Words], options: argparse.Namespace) -> None:
    """Triangles per second: decoded by the GPU, uploaded as they are, and decoded by the CPU."""
    order = np.random.default_rng(1).permutation(len(names)).tolist()
    names, words = [names[k] for k in order], [words[k] for k in order]
    for what, most in (("a frame", FRAME), ("a batch", options.batch * 1e6)):
        batch = Batch(device, layout, names, words, most)
        own = batch.by_clock(options.times)
        batch.call()
        plain = [device.read_buffer(buffer).copy() for buffer in batch.buffers]
        call = min(timed(batch.call)[1] for _ in range(options.times)) / 1e3
        begun = time.process_time()
        batch.call()
        worked = time.process_time() - begun
        upload = min(timed(partial(batch.upload, plain))[1] for _ in range(options.times)) / 1e3
        size, million = sum(data.nbytes for data in plain), batch.triangles / 1e6
        print(
            f"  {what}: {batch.triangles:,} triangles, {batch.bytes / 1e6:.2f} MB → {size / 1e6:.1f} MB; GPU "
            f"{own * 1e3:.3f} ms, {million / own:.1f} M triangles/s; with uploading and Python "
            f"{call * 1e3:.2f} ms, {million / call:.1f} ({million / worked:.2f} for a second of the processors); "
            f"uploading what is decoded {upload * 1e3:.2f} ms, "
            f"{million / upload:.1f}"
        )
    begun, few = time.process_time(), range(min(len(names), 100))
    made = sum(len(decoded(words[k], layout, *names[k]).triangles) for k in few)
    print(f"  CPU, one thread: {made / (time.process_time() - begun) / 1e6:.2f} M triangles/s")


def timed(what: Callable[[], Any]) -> tuple[Any, float]:
    """A function's result, and its milliseconds."""
    begun = time.perf_counter()
    found = what()
    return found, (time.perf_counter() - begun) * 1e3


class Figures(NamedTuple):
    """The costs of a view: MB read; ms to read and decode, to upload, to draw; triangles."""

    mb: float
    read: float
    bring: float
    draw: float
    triangles: int


class Ways:
    """The ways to draw one view."""

    def __init__(self, device: Device, stores: dict[str, Path], options: argparse.Namespace) -> None:
        self.device, self.stores, self.options = device, stores, options
        self.targets = Targets(device, *(int(n) for n in options.size.split("x")))

    def patches(self, view: Any) -> Figures:
        """Draw patches from tiles of *compact* heights."""
        terrain = orograph.open(self.stores["compact"])
        renderer = Renderer(self.device, terrain)
        scene = Scene.of(terrain, view, tolerance=self.options.tolerance)
        wanted = renderer.method.patches(Camera.over(terrain.grid, view, 1.0), self.options.tolerance).wanted
        orograph.open(self.stores["compact"]).read(0, 0, 1, 0, 1)  # loads the codec
        fresh = orograph.open(self.stores["compact"])

        def read() -> list[Any]:
            return [fresh.read(k, *self._tile(fresh, k, row, col)) for k, row, col, _ in wanted.tolist()]

        tiles, reading = timed(read)
        samples = sum(tile.size for tile in tiles)
        files = (f for f in (self.stores["compact"] / "heights").rglob("*") if f.is_file())
        share = sum(f.stat().st_size for f in files) / sum(np.prod(terrain.shape(k)) for k in range(terrain.levels))
        data, buffer = np.concatenate([t.reshape(-1) for t in tiles]), self.device.buffer(4 * samples, "STORAGE")
        _, bringing = timed(lambda: (write(self.device, buffer, data), self.device.wait()))
        found = self._drawn(renderer, scene)
        return Figures(share * samples / 1e6, reading, bringing, *found)

    def chunks(self, view: Any, compressed: bool) -> Figures:
        """Draw chunks that the GPU or threads decode."""
        terrain = orograph.open(self.stores["compressed" if compressed else "chunks"])
        method = f"chunked-lod,cells={self.options.cells}" + (",compressed=yes" if compressed else "")
        scene = Scene.of(terrain, view, tolerance=self.options.tolerance, method=method)
        renderer, camera = Renderer(self.device, terrain), Camera.over(terrain.grid, view, 1.0)
        made, goal = chosen(method).make(terrain), Goal(self.options.tolerance)
        made.chosen(camera, self.options.tolerance)
        _, selecting = timed(lambda: made.chosen(camera, self.options.tolerance))
        if compressed:
            selection, reading = timed(lambda: made.select(camera, goal))
            pool = Chunks(self.device, 1 << 28)
            pool.ready(selection, lambda _: selection)  # compiles the kernels
            pool = Chunks(self.device, 1 << 28)
            pool._decoder._pipeline = pool._decoder._program.compute()
            self.device.wait()
            _, bringing = timed(lambda: (pool.ready(selection, lambda _: selection), self.device.wait()))
        else:
            mesh, reading = timed(lambda: made.select(camera, goal).tessellation())
            _, bringing = timed(lambda: ([self.device.buffer(a, "STORAGE") for a in packed(mesh)], self.device.wait()))
        words = [made.chunks.words(*name) for name in made.chosen(camera, self.options.tolerance).names]
        found = self._drawn(renderer, scene)
        return Figures(sum(4 * len(w) for w in words) / 1e6, max(reading - selecting, 0.0), bringing, *found)

    @staticmethod
    def _tile(terrain: Any, level: int, row: int, col: int) -> tuple[int, int, int, int]:
        rows, cols = terrain.shape(level)
        r, c = TILE * row, TILE * col
        return r, min(r + TILE + 1, rows), c, min(c + TILE + 1, cols)

    def _drawn(self, renderer: Renderer, scene: Scene) -> tuple[float, int]:
        """The fastest drawing of the ground alone, and its triangles."""
        ground = renderer._ground
        write(self.device, renderer._camera, camera_of(scene.view, scene.terrain, 1.0))
        what = ground.choose(scene, None, self.options.tolerance, wait=True)

        def draw() -> None:
            encoder = self.device.handle.create_command_encoder()
            ground.draw(encoder, self.targets, what)
            self.device.queue.submit([encoder.finish()])
            self.device.wait()

        took = min(timed(draw)[1] for _ in range(self.options.times))
        mesh = what.mesh if what.resident is None else what.resident.tessellation()
        renderer.close()
        return took, what.patches.triangles if mesh is None else len(mesh.triangles)


def views_of(device: Device, stores: dict[str, Path], options: argparse.Namespace) -> None:
    """Draw some views in each way."""
    ways, some = Ways(device, stores, options), orograph.open(stores["chunks"])
    size = ways.targets.width, ways.targets.height
    for name in ("orbit", "low"):
        view = FLIGHTS[name](some, size, 20)[5]
        for way, took in (
            ("compact heights", ways.patches(view)),
            ("compressed chunks", ways.chunks(view, True)),
            ("chunks", ways.chunks(view, False)),
        ):
            print(
                f"  {name}, {way}: {took.mb:.2f} MB, read and decoded {took.read:.0f} ms, to the GPU {took.bring:.0f} "
                f"ms, drawn {took.draw:.0f} ms, {took.triangles:,} triangles"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--synthetic", type=int, metavar="SIDE", help="a synthetic terrain of SIDE × SIDE samples")
    parser.add_argument("--cells", type=int, default=32)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--batch", type=float, default=4.0, help="million triangles")
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--no-views", action="store_true")
    options = parser.parse_args()
    device, kind = open_device(), Kind(options.cells, 0.0, True)
    print(device.adapter.name)
    if options.synthetic:
        terrain: Any = in_memory(orograph.synth(size=options.synthetic, seed=7))
        measure(device, f"synthetic {options.synthetic}²", MemoryChunks(terrain, kind), options)
        return
    for path in options.paths or PATHS:
        dem: Dem = orograph.read(path)
        if options.no_views:
            measure(device, path.name, MemoryChunks(in_memory(dem), kind), options)
            continue
        with tempfile.TemporaryDirectory() as folder:
            stores = built(dem, Path(folder), options.cells)
            measure(
                device, path.name, orograph.open(stores["compressed"]).derived("chunked", **kind._asdict()), options
            )
            views_of(device, stores, options)


def measure(device: Device, what: str, chunks: Any, options: argparse.Namespace) -> None:
    """Bytes and rates of some of a terrain's chunks."""
    (names, words), took = timed(lambda: some_chunks(chunks, SOME // 4 if options.synthetic else SOME))
    print(f"{what}, {options.cells} cells, error of level 0 {chunks.error:.3g} m, made in {took / 1e3:.1f} s")
    sizes(chunks.layout, names, words)
    rates(device, chunks.layout, names, words, options)


def built(dem: Dem, folder: Path, cells: int) -> dict[str, Path]:
    """Build a store of each kind."""
    stores = {name: folder / name for name in ("compact", "compressed", "chunks")}
    whole = bool((np.nan_to_num(dem.heights) == np.rint(np.nan_to_num(dem.heights))).all())
    error = 0.5 if whole else 0.01
    orograph.build(dem, stores["compact"], codec="compact", max_error=error, progress=False).close()
    orograph.build(dem, stores["compressed"], chunked=(cells, 0, True), progress=False).close()
    orograph.build(dem, stores["chunks"], chunked=(cells, 0), progress=False).close()
    return stores


if __name__ == "__main__":
    main()
