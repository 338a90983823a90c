"""Patches that stay on the GPU during a flight, compared with uploading all their triangles in every frame.

    python bench/batches.py [--terrain gabilan] [--method bdam] [--frames 30] [--speed 60] [--tolerance 1.0]

The flight is that of ``bench/roam.py`` (300 m above the ground, 60 frames a second, turning) at 1280 × 720. Both ways
draw the same selections. *welded*: all patches are packed into one mesh with shared vertices and uploaded, like the
triangles of any method (``surface.meshes``). *resident*: only new patches are uploaded (of ``seamless-patches``, only
shapes), and the runs to draw (``surface.batches``, ``surface.pieces``).

*kB*: uploaded in the first frame and in the others (mean, largest). *tiles*: kB of tiles of heights and slopes uploaded
besides: those of the terrain's own patches, and those of pieces. *made*: CPU time from the selection to the buffers to
draw, ms. *frame*: time of a whole frame until it is drawn, on the clock and of all threads, ms. All figures are
medians, except those of the first frame.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import promise
from orograph.gpu.device import open_device
from orograph.lod.selection import TriangleMesh
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface import ground
from orograph.rendering.gpu.surface.batches import Batches
from orograph.rendering.gpu.surface.meshes import packed
from orograph.rendering.gpu.surface.pieces import Pieces
from orograph.scene.scene import Scene
from roam import flight

SIZE = 1280, 720


class Resident:
    """The usual ground, which also records what is uploaded and how long that takes."""

    brought: list[int]
    took: list[float]

    def ready(self, selection: Any, again: Any) -> Any:
        began = time.perf_counter()
        made = super().ready(selection, again)  # type: ignore[misc]
        self.took.append(1e3 * (time.perf_counter() - began))
        self.brought.append(self.sent + made.runs.nbytes)  # type: ignore[attr-defined]
        return made


class Welded(Resident):
    """Drawn like the triangles of any other method."""

    def ready(self, selection: Any, again: Any) -> Any:
        began = time.perf_counter()
        mesh = selection.tessellation()
        points, corners = packed(mesh)
        self.took.append(1e3 * (time.perf_counter() - began))
        self.brought.append(points.nbytes + corners.nbytes)
        return TriangleMesh(method=selection.method, bound=selection.bound, stats=mesh.stats, mesh=mesh)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--terrain", default="gabilan")
    parser.add_argument("--method", default="bdam")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--speed", type=float, default=60.0)
    parser.add_argument("--tolerance", type=float, default=1.0)
    given = parser.parse_args()
    terrain = promise.terrain_of(given.terrain, given.data)
    if terrain is None:
        raise SystemExit(f"{given.terrain} is missing.")
    device = open_device()
    views = [view.resized(*SIZE) for view in flight(terrain, given.frames, given.speed)]
    target = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    print(f"{given.terrain}, {given.method}, {device.adapter.name}")
    for name, kind in (("welded", Welded), ("resident", Resident)):
        kind.brought, kind.took = [], []
        for usual in (Batches, Pieces):
            setattr(ground, usual.__name__, type(usual.__name__, (kind, usual), {}))
        renderer = Renderer(device, terrain)
        frames, threads, triangles, tiles = [], [], [], []
        for view in views:
            scene = Scene.of(terrain, view, method=given.method, tolerance=given.tolerance, samples=1)
            began, busy = time.perf_counter(), time.process_time()
            stats = renderer.draw(target.create_view(), "rgba8unorm", scene, wait=True)
            device.wait()
            frames.append(1e3 * (time.perf_counter() - began))
            threads.append(1e3 * (time.process_time() - busy))
            triangles.append(stats.triangles)
            tiles.append(stats.bytes_uploaded / 1e3)
        renderer.close()
        rest = [size / 1e3 for size in kind.brought[1:]]
        print(
            f"  {name:9} {statistics.mean(triangles):9,.0f} triangles  {kind.brought[0] / 1e3:8,.0f} kB first, then "
            f"{statistics.mean(rest):8,.1f} (at most {max(rest):8,.1f})  tiles {tiles[0]:8,.0f} first, then "
            f"{statistics.mean(tiles[1:]):6,.0f}  made {statistics.median(kind.took[1:]):6.2f}  "
            f"frame {statistics.median(frames[1:]):6.1f} ms, of threads {statistics.median(threads[1:]):6.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
