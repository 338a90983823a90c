"""The promise, measured: the largest error in pixels of every method, and its triangles compared with an oracle's.

Each terrain has 20 random views (grazing, straight down, close by, wide angle, far away), each at five tolerances. The
referee (``orograph.verify``) checks every full-resolution sample in view, and looks for every defect of the mesh. The
oracle (``orograph.lod.oracle``) is the same refinement with the largest true displacement of any sample in view instead
of a bound. It omits every triangle whose own prism is out of view; top-down and roam do so too, while the others cull
by spheres and keep a few more. Methods without a promise are measured for comparison.

``--errors`` omits the oracle and prints, in Markdown, how each method's errors compare with the tolerance in the median
view, in nine of ten, and in the worst. It is for methods without a promise, or with a bound in only some views.

Run: ``python bench/promise.py [--quick] [--errors] [--method NAME[,key=value…]]… [--data FOLDER] [--json OUT.json]``.
FOLDER holds the open DEMs by the names in ``TERRAINS`` (default: ../shared/data beside the checkout); absent ones are
skipped. Processes share the views, and each keeps its methods from view to view. Methods that make the same mesh are
judged together, once.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orograph import verify
from orograph.errors import OrographError
from orograph.lod.field import Field
from orograph.lod.method import Goal, Resources
from orograph.lod.oracle import oracles
from orograph.lod.registry import chosen
from orograph.parallel import cpu_count
from orograph.store import Terrain
from orograph.store.memory import MemoryTerrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

TERRAINS = {
    "bigtujunga": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "nrw-dom1-1m": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
    "gabilan": "lsd-topo/gabilan.tif",
    "mt_rainier_90m": "osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif",
    "synthetic 4097": "",
}
TOLERANCES = (0.5, 1.0, 2.0, 4.0, 8.0)

METHODS = (
    "top-down", "top-down,metric=wedgie", "stateless,queue=fifo", "soar", "soar,metric=anisotropic",
    "threshold-spheres", "threshold-spheres,metric=isotropic", "roam", "roam,metric=wedgie", "soar,error=midpoint",
    "restricted-quadtree", "restricted-quadtree,triangulation=restricted", "smart", "smart,cells=16",
    "seamless-patches",
    "soar,metric=isotropic-published", "top-down,metric=anisotropic-published",
)  # fmt: skip
FEW = 200
"""Views in which the oracle has fewer triangles do not count as the worst: one triangle is half a per cent of them."""


def terrain_of(name: str, data: Path) -> MemoryTerrain | None:
    """A terrain by its name, in memory; None if its files are absent."""
    from orograph.dem.mosaic import Mosaic
    from orograph.dem.synth import Synth
    from orograph.store import terrain

    if not TERRAINS[name]:
        synth = Synth((4097, 4097), 7)
        return MemoryTerrain(synth.read(0, 4097, 0, 4097), synth.grid, name)
    path = data / TERRAINS[name]
    return terrain(Mosaic.open([path])) if path.exists() else None


def views(terrain: Terrain, count: int, seed: int) -> Iterator[tuple[str, View]]:
    """Random views, a fifth of each kind, from above the ground onto the ground."""
    rng = np.random.default_rng(seed)
    rows, cols = terrain.grid.shape
    t = terrain.grid.transform
    extent = min(rows * math.hypot(t.b, t.e), cols * math.hypot(t.a, t.d))
    heights = terrain.read(0, 0, rows, 0, cols)
    kinds = ("grazing", "straight down", "close by", "wide angle", "far away")

    def ground() -> tuple[float, float, float]:
        while True:
            row, col = int(rng.integers(rows)), int(rng.integers(cols))
            if np.isfinite(heights[row, col]):
                x, y = terrain.grid.xy(col, row)
                return float(x), float(y), float(heights[row, col])

    for i in range(count):
        kind = kinds[i % len(kinds)]
        x, y, z = ground()
        target = ground()
        fov = float(rng.uniform(25, 65))
        above = extent * 10 ** rng.uniform(-2, -0.5)
        if kind == "grazing":
            above = extent * 10 ** rng.uniform(-3.3, -2.3)
            target = (target[0], target[1], z + above)
        elif kind == "straight down":
            target = (x, y, z - 1.0)
            above = extent * 10 ** rng.uniform(-1.3, 0.2)
        elif kind == "close by":
            above = extent * 10 ** rng.uniform(-3, -2)
            turn = rng.uniform(0, 2 * math.pi)
            target = (x + 3 * above * math.cos(turn), y + 3 * above * math.sin(turn), z)
        elif kind == "wide angle":
            fov = float(rng.uniform(90, 120))
        else:
            turn = rng.uniform(0, 2 * math.pi)
            x, y, above = x + extent * math.cos(turn), y + extent * math.sin(turn), extent * rng.uniform(0.3, 1.0)
        yield kind, View((x, y, z + above), target, fov_y=fov, width=1280, height=720)


class Bench:
    """A terrain with its methods, in one process."""

    def __init__(self, name: str, terrain: MemoryTerrain, labels: list[str], options: argparse.Namespace) -> None:
        self.name, self.terrain = name, terrain
        self.exact = Field(terrain, max_memory=1 << 40)
        self.views = list(views(terrain, options.views, options.seed))
        self.beside_oracle = not options.errors
        self.methods = {}
        for label in labels:
            choice = chosen(label)
            method: Any = choice.make(terrain, Resources(1 << 33, 1))
            self.methods[label] = method
            # (Patches have pages of their own kind, and ROAM's nodes know theirs.)
            if type(getattr(method, "field", None)) is Field and method.error == "exact" and choice.info.name != "roam":
                method.field = self.exact

    def measure(self, number: int) -> list[dict[str, Any]]:
        """One record for each tolerance and method."""
        kind, view = self.views[number]
        found = []
        fewest = [0] * len(TOLERANCES)
        if self.beside_oracle:
            goals = oracles(self.terrain, view, TOLERANCES, prisms=(True,), field=self.exact, jobs=1)
            fewest = [len(meshes[0].triangles) for meshes in goals]
        for tolerance, least in zip(TOLERANCES, fewest, strict=True):
            judged: dict[bytes, verify.Report] = {}
            camera = Camera.over(self.terrain.grid, view)
            for label, method in self.methods.items():
                start = time.process_time()
                mesh = method.select(camera, Goal(tolerance)).tessellation()
                took = time.process_time() - start
                same = digest(mesh)
                if same not in judged:
                    judged[same] = verify.judge_mesh(mesh, self.terrain, view, jobs=1)
                report = judged[same]
                found.append(
                    {
                        "terrain": self.name, "view": number, "kind": kind, "method": label, "tolerance": tolerance,
                        "conservative": method.conservative, "triangles": len(mesh.triangles),
                        "oracle": least, "largest": report.largest, "rms": report.rms,
                        "defects": report.defects, "ms": 1e3 * took,
                        "kept": bool(report.ok(tolerance) or not method.conservative),
                    }
                )  # fmt: skip
        return found


def digest(mesh: Tessellation) -> bytes:
    """Equal for meshes of the same triangles with the same orientation, in any order."""
    place = np.rint(mesh.vertices[:, 1]).astype(np.int64) << 32 | np.rint(mesh.vertices[:, 0]).astype(np.int64)
    corners = place[mesh.triangles]
    first = corners.argmin(axis=1)
    turned = corners[np.arange(len(corners))[:, None], (first[:, None] + [0, 1, 2]) % 3]
    order = np.lexsort(turned.T)
    return hashlib.blake2b(np.ascontiguousarray(turned[order]).tobytes()).digest()


def tables(found: list[dict[str, Any]], labels: Sequence[str]) -> str:
    """The records as tables: one block for each terrain, and one for all."""
    lines = []
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in found:
        groups[record["terrain"]].append(record)
    if len(groups) > 1:
        groups["all"] = found
    head = "".join(f"{f'τ = {t:g}':>9}" for t in TOLERANCES)
    for terrain, records in groups.items():
        lines += ["", terrain, f"{'':32}{head}{'all':>8}{'worst':>8}   error / τ   broken   defects"]
        for label in labels:
            mine = [r for r in records if r["method"] == label]
            if not mine:
                continue
            cells = []
            for tolerance in (*TOLERANCES, None):
                some = [r for r in mine if tolerance in (None, r["tolerance"])]
                cells.append(sum(r["triangles"] for r in some) / max(1, sum(r["oracle"] for r in some)))
            worst = max((r["triangles"] / r["oracle"] for r in mine if r["oracle"] >= FEW), default=math.nan)
            error = max(r["largest"] / r["tolerance"] for r in mine)
            defects = sum(bool(r["defects"]) for r in mine)
            broken = sum(not r["kept"] for r in mine) if mine[0]["conservative"] else "–"
            ratios = "".join(f"{c:9.3f}" for c in cells[:-1]) + f"{cells[-1]:8.3f}{worst:8.2f}"
            lines.append(f"{label:32}{ratios}{error:12.4f}{broken:>9}{defects:10}")
    lines += [
        "",
        f"Triangles over the oracle's (worst: one view, of {FEW} triangles at least); the largest error in units of",
    ]
    lines += ["the tolerance; meshes of conservative methods that break the promise; meshes with any defect."]
    return "\n".join(lines)


def errors(found: list[dict[str, Any]], labels: Sequence[str]) -> str:
    """How the records' errors compare with the tolerance: Markdown, a row for each terrain and method."""
    lines = [
        "| terrain | method | triangles | error / tolerance: median | in 90 % of views | largest | views over it "
        "| T-junctions | other defects |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for terrain in dict.fromkeys(record["terrain"] for record in found):
        for label in labels:
            mine = [r for r in found if r["terrain"] == terrain and r["method"] == label]
            ratios = np.array([r["largest"] / r["tolerance"] for r in mine])
            triangles = sum(r["triangles"] for r in mine)
            junctions = sum(r["defects"].get("t_junctions", 0) for r in mine)
            defects = sum(sum(r["defects"].values()) for r in mine)
            lines.append(
                f"| {terrain} | `{label}` | {triangles / len(mine):,.0f} | {np.median(ratios):.2f} "
                f"| {np.quantile(ratios, 0.9):.2f} | {ratios.max():.3f} | {(ratios > 1).sum()} of {len(mine)} "
                f"| {junctions:,} | {defects - junctions:,} |"
            )
    return "\n".join(lines)


_bench: dict[str, Bench | None] = {}
"""The terrain of this process."""


def records_of(task: tuple[str, int], options: argparse.Namespace) -> tuple[list[dict[str, Any]], float]:
    """The records of one view of a terrain (none if the terrain cannot be read), and processor seconds."""
    start = time.process_time()
    name, number = task
    if name not in _bench:
        _bench.clear()  # one terrain at a time in memory
        _bench[name] = None
        try:
            terrain = terrain_of(name, options.data)
            if terrain is None:
                print(f"{name}: not at {options.data}", file=sys.stderr)
            else:
                _bench[name] = Bench(name, terrain, options.method or list(METHODS), options)
        except OrographError as error:
            print(f"{name}: {error}", file=sys.stderr)
    bench = _bench[name]
    return bench.measure(number) if bench else [], time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--quick", action="store_true", help="5 views each, and not the synthetic terrain")
    parser.add_argument("--views", type=int, default=20, help="how many of each terrain")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--terrain", action="append", choices=list(TERRAINS), help="only these")
    parser.add_argument("--method", action="append", help="only these: NAME[,key=value…]")
    parser.add_argument("--errors", action="store_true", help="a table of errors, without the oracle")
    parser.add_argument("--jobs", type=int, default=cpu_count(), help="processes")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.views = 5
    names = [name for name in options.terrain or TERRAINS if TERRAINS[name] or not options.quick]
    tasks = [(name, number) for name in names for number in range(options.views)]
    found = []
    spent: dict[str, float] = defaultdict(float)
    began = time.perf_counter()
    with ProcessPoolExecutor(min(options.jobs, len(tasks))) as pool:
        for (name, number), (records, seconds) in zip(tasks, pool.map(partial(records_of, options=options), tasks)):
            found += records
            spent[name] += seconds
            if number == options.views - 1 and records:
                print(f"{name}: {spent[name]:.0f} s of a processor", file=sys.stderr, flush=True)
    print((errors if options.errors else tables)(found, options.method or METHODS))
    print(f"{time.perf_counter() - began:.0f} s in all, {min(options.jobs, len(tasks))} processes.")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1, default=lambda number: number.item()))


if __name__ == "__main__":
    main()
