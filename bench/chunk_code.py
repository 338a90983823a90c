"""Chunks that the GPU decodes: bytes a triangle, triangles a second, and beside heights in the codec *compact*.

    python bench/chunk_code.py [PATH …] [--cells 32] [--times 5] [--tolerance 1] [--size 1280x720]

Of each terrain, a raster, a store is built with compressed chunks, one with chunks that are not, and one with heights
in *compact*. Told are, of the chunks of each level (some, evenly spaced): bytes a triangle, of indexed triangles (12
bytes each and 12 a vertex), and of the same with what words have besides (skirts, 4 bytes a vertex for morphs). Then,
in turns, the fastest of ``--times``: decoding them on the GPU, uploading the same vertices and triangles as they are
decoded there, and decoding them on the CPU; triangles a second. Then two views, each with nothing in memory but the
system's cache of files: MB read, and ms until it is read and decoded on the CPU, brought to the GPU (and decoded there)
and drawn, by ``triangle-patches`` of *compact*, by compressed chunks, and by chunks that are not.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import orograph
from orograph.dem import Dem
from orograph.gpu.device import Device, open_device
from orograph.gpu.recording import write
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.chunks import Chunks, Decoder
from orograph.rendering.gpu.surface.meshes import packed
from orograph.rendering.gpu.targets import Targets
from orograph.scene.scene import Scene
from orograph.store.chunk_code import HEADER, decoded
from orograph.viewpoint import Camera
from view import FLIGHTS

DATA = Path(__file__).parents[2] / "shared" / "data"
PATHS = [
    DATA / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif",
    DATA / "nrw-dom1-1m" / "dom1_32_356_5699_1_nw_2020.tif",
]
SOME, TILE = 400, 256
VERTICES, TRIANGLES, HUNG = (HEADER.index(name) for name in ("vertices", "triangles", "hung"))


def some_chunks(chunks: Any) -> list[tuple[int, int, int]]:
    """Chunks of all levels, evenly spaced."""
    found = []
    for level in range(chunks.layout.top + 1):
        names = [(level, i, j) for i, j in np.ndindex(chunks.layout.chunks(level))]
        found += names[:: -(-len(names) // SOME)]
    return found


def sizes(chunks: Any, names: list[tuple[int, int, int]]) -> None:
    """Bytes a triangle by level, and of all."""
    rows: dict[int, list[Any]] = {}
    for name in names:
        words = chunks.words(*name)
        v, t, e, s = (int(words[k]) for k in (VERTICES, TRIANGLES, HUNG, HEADER.index("sides")))
        bare, whole = 12 * t + 12 * v, 12 * (t + 2 * e) + 16 * v + 12 * s
        share = np.prod(chunks.layout.chunks(name[0])) / sum(n[0] == name[0] for n in names)
        rows.setdefault(name[0], []).append(np.array([t, 4 * len(words), bare, whole]) * share)
    total = np.zeros(4)
    for level, each in rows.items():
        t, coded, bare, whole = np.sum(each, 0)
        total += (t, coded, bare, whole)
        if level < 3:
            print(f"  level {level}: {t:,.0f} triangles, {coded / t:.2f} bytes each, indexed {bare / t:.1f}")
    t, coded, bare, whole = total
    print(
        f"  all: {t:,.0f} triangles, {coded / t:.3f} bytes each; indexed {bare / t:.2f} ({bare / coded:.1f} ×), "
        f"with morphs and skirts {whole / t:.2f} ({whole / coded:.1f} ×)"
    )


def rates(device: Device, chunks: Any, names: list[tuple[int, int, int]], times: int) -> None:
    """Triangles a second: decoded by the GPU, brought to it as they are, decoded by the CPU."""
    words = [chunks.words(*name) for name in names]
    counts = np.array([(int(w[VERTICES]), int(w[TRIANGLES]) + 2 * int(w[HUNG])) for w in words])
    ends = np.cumsum(counts, 0)
    places = [(v, t) for v, t in (ends - counts).tolist()]
    vertices = device.buffer(20 * int(ends[-1, 0]), "STORAGE|COPY_SRC")
    triangles = device.buffer(12 * int(ends[-1, 1]), "STORAGE|COPY_SRC")
    decoder, layout = Decoder(device), chunks.layout

    def by_gpu() -> None:
        decoder.decode(layout, names, words, places, vertices, triangles)
        device.wait()

    by_gpu()
    plain = [device.read_buffer(buffer).copy() for buffer in (vertices, triangles)]

    def upload() -> None:
        for buffer, data in zip((vertices, triangles), plain, strict=True):
            write(device, buffer, data)
        device.wait()

    def by_cpu() -> None:
        for name, word in zip(names, words, strict=True):
            decoded(word, layout, *name)

    took: dict[str, list[tuple[float, float]]] = {}
    for _ in range(times):
        for what in (by_gpu, upload, by_cpu):
            begun, worked = time.perf_counter(), time.process_time()
            what()
            spent = time.perf_counter() - begun, time.process_time() - worked
            took.setdefault(what.__name__, []).append(spent)
    t = int(ends[-1, 1])
    rate = {name: t / np.min(of, 0) / 1e6 for name, of in took.items()}
    size = sum(map(len, words)) * 4, sum(p.nbytes for p in plain)
    print(
        f"  {t:,} triangles, {size[0] / 1e6:.2f} MB, decoded {size[1] / 1e6:.1f} MB; M triangles/s by the clock (and "
        f"for a second of the processors): GPU {told(rate['by_gpu'])}, uploading {told(rate['upload'])}, "
        f"CPU, one thread, {told(rate['by_cpu'])}"
    )


def told(rate: Any) -> str:
    return f"{rate[0]:.2f} ({rate[1]:.2f})"


def timed(what: Callable[[], Any]) -> tuple[Any, float]:
    """What a function returns, and the milliseconds that it took."""
    begun = time.perf_counter()
    found = what()
    return found, (time.perf_counter() - begun) * 1e3


class Told(NamedTuple):
    """What a view took one way: MB read; ms to read and decode, to bring to the GPU, to draw; triangles."""

    mb: float
    read: float
    bring: float
    draw: float
    triangles: int


class Ways:
    """The ways to a picture of one view."""

    def __init__(self, device: Device, stores: dict[str, Path], options: argparse.Namespace) -> None:
        self.device, self.stores, self.options = device, stores, options
        self.targets = Targets(device, *(int(n) for n in options.size.split("x")))

    def patches(self, view: Any) -> Told:
        """Patches out of tiles of heights in *compact*."""
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
        return Told(share * samples / 1e6, reading, bringing, *found)

    def chunks(self, view: Any, compressed: bool) -> Told:
        """Chunks, decoded on the GPU or by threads."""
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
            pool.ready(selection, lambda _: selection)  # compiles
            pool = Chunks(self.device, 1 << 28)
            pool._decoder._pipeline = pool._decoder._program.compute()
            self.device.wait()
            _, bringing = timed(lambda: (pool.ready(selection, lambda _: selection), self.device.wait()))
        else:
            mesh, reading = timed(lambda: made.select(camera, goal).tessellation())
            _, bringing = timed(lambda: ([self.device.buffer(a, "STORAGE") for a in packed(mesh)], self.device.wait()))
        words = [made.chunks.words(*name) for name in made.chosen(camera, self.options.tolerance).names]
        found = self._drawn(renderer, scene)
        return Told(sum(4 * len(w) for w in words) / 1e6, max(reading - selecting, 0.0), bringing, *found)

    @staticmethod
    def _tile(terrain: Any, level: int, row: int, col: int) -> tuple[int, int, int, int]:
        rows, cols = terrain.shape(level)
        r, c = TILE * row, TILE * col
        return r, min(r + TILE + 1, rows), c, min(c + TILE + 1, cols)

    def _drawn(self, renderer: Renderer, scene: Scene) -> tuple[float, int]:
        """The fastest draw of the ground alone, and its triangles."""
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
    """Some views, each by each way."""
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
    parser.add_argument("paths", nargs="*", type=Path, default=PATHS)
    parser.add_argument("--cells", type=int, default=32)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--size", default="1280x720")
    options = parser.parse_args()
    device = open_device()
    print(device.adapter.name)
    for path in options.paths:
        dem: Dem = orograph.read(path)
        with tempfile.TemporaryDirectory() as folder:
            stores = {name: Path(folder) / name for name in ("compact", "compressed", "chunks")}
            whole = bool((np.nan_to_num(dem.heights) == np.rint(np.nan_to_num(dem.heights))).all())
            orograph.build(
                dem, stores["compact"], codec="compact", max_error=0.5 if whole else 0.01, progress=False
            ).close()
            orograph.build(dem, stores["compressed"], chunked=(options.cells, 0, True), progress=False).close()
            orograph.build(dem, stores["chunks"], chunked=(options.cells, 0), progress=False).close()
            chunks = orograph.open(stores["compressed"]).derived(
                "chunked", cells=options.cells, finest=0.0, compressed=True
            )
            names = some_chunks(chunks)
            print(f"{path.name}, {options.cells} cells, error of level 0 {chunks.error:.3g} m")
            sizes(chunks, names)
            rates(device, chunks, names, options.times)
            views_of(device, stores, options)


if __name__ == "__main__":
    main()
