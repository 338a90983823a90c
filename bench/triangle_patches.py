"""Triangle patches, measured: the time to select them, their triangles and other methods', and a flight over a store.

    python bench/triangle_patches.py [--data FOLDER] [--store STORE.oro] [--frames 200] [--part PART]

*select*: ``TrianglePatches.patches`` alone, with all pages loaded, on views of a 4097² synthetic terrain with various
numbers of patches (medians of 25, and the cost per visited diamond).

*triangles*: the triangles that ``triangle-patches`` draws compared with ``soar`` and ``top-down`` (triangle by
triangle, the same promise), over views of ``bench/promise.py``, with geomorphs and without; and the true error of the
worst sample.

*promise*: the referee on 20 views of each terrain of ``bench/promise.py`` at 1 pixel: patches as they are drawn, with
and without geomorphs, including vertices that are moving (their heights are not samples, which does not count as a
defect).

*flight*: a straight flight over a store (default: built from ``california-3s-tiles`` in a temporary folder), at 60
frames a second, with pages of errors read in the background (``Ready(wait=False)``): ms of Python per frame, patches,
tiles wanted that the frame before did not want, and frames until nothing is missing.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

import promise
from orograph import store, verify
from orograph.lod.method import Goal, Ready, Resources
from orograph.lod.patches.expand import expand
from orograph.lod.registry import chosen
from orograph.lod.triangle_patches import Patches, TrianglePatches
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

PARTS = ("select", "triangles", "promise", "flight")

SPEED = 2000.0
"""Metres a second of the flight (some 7,000 km/h: a frame of 1/60 s is 33 m)."""


def patches_of(method: TrianglePatches, view: View, tolerance: float, wait: bool = True) -> Patches:
    """The patches as a renderer selects them."""
    return method.patches(Camera.over(method.terrain.grid, view), tolerance, Ready(wait=wait), rim=1.0)


def select(data: Path) -> None:
    """Milliseconds per selection, by the number of patches."""
    terrain = promise.terrain_of("synthetic 4097", data)
    assert terrain is not None
    print("\nselect: 4097² synthetic, one thread")
    print(f"{'patches':>8} {'diamonds':>9} {'τ px':>6} {'ms':>7} {'worst':>7} {'ns a diamond':>13}")
    method = TrianglePatches(terrain)
    views = [view for kind, view in promise.views(terrain, 20, 1) if kind in ("grazing", "wide angle", "far away")]
    for wanted in (250, 500, 1000, 2000, 4000, 8000):
        best = None
        for view in views:
            for tolerance in 2.0 ** np.arange(-3, 5, 0.5):
                count = len(patches_of(method, view, float(tolerance)).instances)
                if best is None or abs(count - wanted) < abs(best[0] - wanted):
                    best = count, view, float(tolerance)
        assert best is not None
        _, view, tolerance = best
        times = []
        for _ in range(25):
            begin = time.perf_counter()
            made = patches_of(method, view, tolerance)
            times.append(1e3 * (time.perf_counter() - begin))
        nodes, ms = made.stats["nodes"], statistics.median(times)
        print(
            f"{len(made.instances):8,} {nodes:9,} {tolerance:6.2f} {ms:7.3f} {max(times):7.3f} {1e6 * ms / nodes:13.0f}"
        )


def triangles(data: Path, count: int) -> None:
    """Triangles compared with other methods'."""
    print(f"\ntriangles: mean of {count} views; in brackets the largest error of all over the tolerance")
    labels = ("settled", "morphing", "L = 8", "L = 32", "soar", "top-down")
    print(f"{'':16}{'τ px':>6} " + " ".join(f"{label:>14}" for label in labels))
    for name in ("bigtujunga", "synthetic 4097"):
        terrain = promise.terrain_of(name, data)
        if terrain is None:
            print(f"{name}: not at {data}")
            continue
        views = [view for _, view in promise.views(terrain, count, 1)]
        methods = {
            label: chosen(text).make(terrain)
            for label, text in zip(
                labels,
                ("triangle-patches", "triangle-patches,geomorph=yes", "triangle-patches,legs=8",
                 "triangle-patches,legs=32", "soar", "top-down"),
            )
        }  # fmt: skip
        for tolerance in (0.5, 1.0, 2.0, 4.0, 8.0):
            cells = []
            for label, method in methods.items():
                made, worst = [], 0.0
                for view in views:
                    mesh = method.select(Camera.over(terrain.grid, view), Goal(tolerance)).tessellation()
                    made.append(len(mesh.triangles))
                    if label in ("settled", "morphing"):
                        worst = max(worst, verify.judge_mesh(mesh, terrain, view).largest_at_samples)
                error = f" ({worst / tolerance:.2f})" if worst else ""
                cells.append(f"{statistics.mean(made):,.0f}{error}")
            print(f"{name:16}{tolerance:6.1f} " + " ".join(f"{cell:>14}" for cell in cells), flush=True)


def keeps(data: Path, count: int, names: list[str]) -> None:
    """The largest error and the defects at 1 px, over all views."""
    print(f"\npromise: {count} views each, 1 px: largest error of any sample, px; meshes beyond 1 px; with a defect")
    print(f"{'':16}{'settled':>24}{'morphing':>24}{'triangles, morphing':>22}{'patches on their way':>22}")
    for name in names:
        terrain = promise.terrain_of(name, data)
        if terrain is None:
            print(f"{name}: not at {data}")
            continue
        method = TrianglePatches(terrain, resources=Resources(1 << 33))
        found: dict[bool, list[tuple[float, bool]]] = {False: [], True: []}
        made, moving = [], []
        for _, view in promise.views(terrain, count, 1):
            for geomorph in (False, True):
                patches = method.patches(Camera.over(terrain.grid, view), 1.0, geomorph=geomorph)
                keys, heights = expand(terrain, patches.instances, method.legs)
                mesh = Tessellation.from_triangles(terrain.grid, keys, heights, clockwise=False)
                report = verify.judge_mesh(mesh, terrain, view, heights="free" if geomorph else "samples")
                found[geomorph].append((report.largest_at_samples, bool(report.defects)))
                if geomorph:
                    made.append(len(mesh.triangles))
                    moving.append(float((patches.instances["morph"] < 1).mean()))
        cells = []
        for geomorph in (False, True):
            errors = [e for e, _ in found[geomorph]]
            cells.append(f"{max(errors):.3f}, {sum(e > 1 for e in errors)}, {sum(d for _, d in found[geomorph])}")
        print(
            f"{name:16}{cells[0]:>24}{cells[1]:>24}{statistics.mean(made):22,.0f}{statistics.mean(moving):22.0%}",
            flush=True,
        )


def path_of(terrain: Terrain, seconds: float) -> View:
    """The eye and target of a flight across the middle of a terrain."""
    rows, cols = terrain.grid.shape
    t = terrain.grid.transform
    x0, y0 = (float(v) for v in terrain.grid.xy(0.2 * cols, 0.55 * rows))
    east, north = t.a, t.d
    size = math.hypot(east, north)
    x, y = x0 + SPEED * seconds * east / size, y0 + SPEED * seconds * north / size
    high = terrain.height_range[1] + 1500.0
    return View((x, y, high), (x + 20000 * east / size, y + 20000 * north / size, high - 5000), fov_y=45.0)


def flight(terrain: Terrain, frames: int, tolerance: float) -> None:
    """A flight over a store."""
    method = TrianglePatches(terrain)
    warm = TrianglePatches(terrain)
    for k in range(3):  # compiled, but with cold pages: another method's
        patches_of(warm, path_of(terrain, k), tolerance, wait=False)
    times, counts, fresh, lacking, seen = [], [], [], [], set()
    for frame in range(frames):
        begin = time.perf_counter()
        made = patches_of(method, path_of(terrain, frame / 60), tolerance, wait=False)
        took = time.perf_counter() - begin
        times.append(1e3 * took)
        counts.append(len(made.instances))
        lacking.append(made.stats["absent"])
        wanted = {tuple(w) for w in made.wanted[["level", "row", "col"]].tolist()}
        fresh.append(len(wanted - seen))
        seen = wanted
        time.sleep(max(0.0, 1 / 60 - took))
    whole = next((i for i, absent in enumerate(lacking) if absent == 0), None)
    rows, cols = terrain.grid.shape
    print(f"\nflight: {terrain.name}, {cols} × {rows}, {frames} frames at {tolerance:g} px, {SPEED:.0f} m/s")
    print(f"  select     median {statistics.median(times):.2f} ms, 99 % {np.quantile(times, 0.99):.2f}, worst "
          f"{max(times):.2f}")  # fmt: skip
    print(f"  patches    median {statistics.median(counts):,.0f}, most {max(counts):,}")
    print(f"  tiles      {len(seen)} wanted at the end; new ones a frame: mean {statistics.mean(fresh[1:]):.2f}, "
          f"most {max(fresh[1:])} (first frame {fresh[0]})")  # fmt: skip
    print(f"  pages      all there at frame {whole}; frames that lacked some: {sum(v > 0 for v in lacking)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--store", type=Path, help="the store of the flight")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--views", type=int, default=10)
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--terrain", action="append", choices=list(promise.TERRAINS), help="only these, for promise")
    options = parser.parse_args()
    parts = options.part or list(PARTS)
    if "select" in parts:
        select(options.data)
    if "triangles" in parts:
        triangles(options.data, options.views)
    if "promise" in parts:
        keeps(options.data, 2 * options.views, options.terrain or list(promise.TERRAINS))
    if "flight" in parts:
        if options.store is not None:
            flight(store.open(options.store), options.frames, 1.0)
            return
        files = sorted((options.data / "california-3s-tiles").glob("*.tif"))
        if not files:
            print(f"flight: california-3s-tiles is not at {options.data}")
            return
        with tempfile.TemporaryDirectory() as folder:
            flight(store.build(files, Path(folder) / "california.oro"), options.frames, 1.0)


if __name__ == "__main__":
    main()
