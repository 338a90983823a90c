"""The interactive view off screen: flights over large terrains, frame by frame, on any GPU.

    python bench/view.py [--terrain california|synthetic-16385|synthetic-65537|PATH…] [--flight orbit|low|jump|steady]…
        [--method auto|all|NAME]… [--tolerance 2]… [--size 1280x720]… [--frames 120] [--judge 3] [--folder FOLDER]
        [--memory 4096] [--rate 60] [--waited] [--no-look-ahead] [--table]

Terrains: the 40 tiles of California (default; 11815 × 5567 samples in metres), the synthetic terrain with so many
samples a side as a store (``bench/synthetic.py``; built first in FOLDER or the cache if it is missing), or any files.

Flights: *orbit*, with the whole terrain in view, half a degree per frame; *low*, a straight flight close above the
ground at 300 m/s and 60 frames a second; *steady*, the same at ten times the height and speed; *jump*, to another place
of the terrain every ten frames (four times in a flight of fewer than 40). Every frame is drawn as the window draws it
(including the first, after ``Renderer.prepare``; tiles stream in meanwhile; shadows and sky are on), and then waited
for. No frame begins before its time on a clock of ``--rate`` frames a second. With a rate of 0, each frame begins when
the last one is done; then all are drawn once more, waiting only for the last, which gives the frame rate.

Every ``--method`` (all: every method) flies each flight at every tolerance and size. Compare their frames on an idle
machine, or by processor time. A method that cannot fly over the terrain says why.

The figures are medians and maxima of: ms until the GPU is done; ms of all threads of the process meanwhile (with a
software adapter this includes the GPU's); ms of the GPU by its own clock (timestamps); ms of Python (*to submit*: until
the frame is submitted, when the GPU can start; *all*: with the work after that); processor time of the thread that
draws, which does not count what it waits for, nor a software adapter's work; ms of the loop (with the driver's work
on submission); ms of selection, patches, triangles, tiles loaded and missing, MB uploaded; and the bound of the largest
error in pixels with the loaded tiles. For ``--judge`` views with all their tiles, there is also the largest error that
the referee finds among all full-resolution samples in view (for other methods, in the picture: among those that its
pixels show).

A tree that lives on the GPU (``cbt``) has more figures: the triangles in its pool and their bytes, ms per update,
updates until nothing changes any more (from two triangles, and from frame to frame), and the error of what was drawn in
flight, read back. Most other methods make their meshes in a background thread: frames show the last one that is ready,
and *late* counts those whose mesh is for another camera. ``--table`` prints a row of a Markdown table for each flight
instead.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import math
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orograph import verify
from orograph.errors import OrographError
from orograph.gpu.clock import Clock
from orograph.gpu.device import Device, open_device
from orograph.lod.patches.expand import expand
from orograph.lod.registry import METHODS
from orograph.rendering.gpu.frame import FrameStats
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.tree import Tree
from orograph.scene.camera import around
from orograph.scene.scene import Scene
from orograph.store.prepare import prepare
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewer.app import SWITCH
from orograph.viewpoint import View
from synthetic import synthetic_store

RATE = 60.0
"""Frames a second of a flight, and of its clock unless ``--rate`` says otherwise."""

SPEED = 300.0
"""Metres a second, flying low."""

STALL = 1000 / 30
"""Milliseconds for which a frame may block the loop."""

Size = tuple[int, int]


@dataclass(frozen=True)
class Frame:
    """The cost of a frame, ms.

    Python until the last submission, the processor time of its thread, wall time until the GPU is done, processor time
    of all threads until then, and the GPU's own clock (or None).
    """

    python: float
    thread: float
    done: float
    worked: float
    gpu: float | None
    stats: FrameStats


def orbit(terrain: Terrain, size: Size, count: int) -> list[View]:
    """Around the middle of the terrain, all of it in view, half a degree per frame."""
    return [around(terrain, size, azimuth=200 + 0.5 * k, pitch=30, distance=None) for k in range(count)]


def straight(terrain: Terrain, size: Size, count: int, above: float, speed: float) -> list[View]:
    """Eastwards through the terrain's middle, looking ahead and down; metres above its coarse heights."""
    spacing = terrain.grid.spacing[0]
    level = max(0, terrain.levels - 3)
    rows, cols = terrain.shape(level)
    row = rows // 2
    line = terrain.read(level, row, row + 1, 0, cols)[0].astype(np.float64)
    line = np.where(np.isfinite(line), line, np.nanmean(line) if np.isfinite(line).any() else 0.0)
    width = max(1, round(40 * above / (spacing * 2**level)))  # the flight is smoother than the ground
    smooth = np.convolve(np.pad(line, width, mode="edge"), np.ones(2 * width + 1) / (2 * width + 1), "valid")
    high = np.maximum.reduce([smooth, *(np.roll(line, k) for k in range(-2, 3))])
    views = []
    begin = 0.2 * terrain.grid.cols
    for k in range(count):
        col = begin + k / RATE * speed / spacing
        x, y = (float(v) for v in terrain.grid.xy(col, 0.5 * terrain.grid.rows))
        ground = float(np.interp(col / 2**level, np.arange(cols), high))
        views.append(
            View((x, y, ground + above), (x + 40 * above, y + 6 * above, ground), width=size[0], height=size[1])
        )
    return views


def low(terrain: Terrain, size: Size, count: int) -> list[View]:
    return straight(terrain, size, count, 150.0, SPEED)


def steady(terrain: Terrain, size: Size, count: int) -> list[View]:
    return straight(terrain, size, count, 1500.0, 10 * SPEED)


def jump(terrain: Terrain, size: Size, count: int) -> list[View]:
    """Ten frames (or a quarter) at each of many places, from 600 m and from 6 km above them."""
    rng = np.random.default_rng(4)
    level = terrain.levels - 1
    rows, cols = terrain.shape(level)
    coarse = terrain.read(level, 0, rows, 0, cols)
    views: list[View] = []
    while len(views) < count:
        i, j = int(rng.integers(rows // 8, rows - rows // 8)), int(rng.integers(cols // 8, cols - cols // 8))
        if not np.isfinite(coarse[i, j]):
            continue
        x, y = (float(v) for v in terrain.grid.xy(j << level, i << level))
        high = 600.0 if rng.random() < 0.5 else 6000.0
        ground, turn = float(coarse[i, j]), float(rng.uniform(0, 2 * math.pi))
        target = x + 5 * high * math.cos(turn), y + 5 * high * math.sin(turn), ground
        views += [View((x, y, ground + high), target, width=size[0], height=size[1])] * min(10, -(-count // 4))
    return views[:count]


FLIGHTS = {"orbit": orbit, "low": low, "steady": steady, "jump": jump}


def terrain_of(names: list[str], options: argparse.Namespace) -> Terrain:
    """A terrain by its name, or from files."""
    if names == ["california"]:
        return prepare(sorted(map(str, (options.data / "california-3s-tiles").glob("*.tif"))))
    if len(names) == 1 and names[0].startswith("synthetic-"):
        return synthetic_store(int(names[0].removeprefix("synthetic-")), options.folder)
    return prepare(names)


def fly(
    renderer: Renderer, device: Device, views: list[View], scene: Scene, options: argparse.Namespace
) -> tuple[list[Frame], list[tuple[View, Tessellation]]]:
    """Draw all frames in turn, none before its time; for a tree, return what ``--judge`` of them drew."""
    judge: int = options.judge
    meshes: list[tuple[View, Tessellation]] = []
    clock = Clock(device)
    texture = device.texture((views[0].width, views[0].height), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    renderer.prepare("rgba8unorm", scene.but(view=views[0]))
    device.wait()
    frames = []
    start = time.perf_counter()
    for k, view in enumerate(views):
        if options.rate:
            time.sleep(max(0.0, start + k / options.rate - time.perf_counter()))
        clock.begin()
        begun, before, own = time.perf_counter(), time.process_time(), time.thread_time()
        stats = renderer.draw(target, "rgba8unorm", scene.but(view=view), wait=options.waited)
        python, own = time.perf_counter(), time.thread_time() - own
        device.wait()
        done, worked = time.perf_counter(), time.process_time() - before
        clock.end()
        seconds = clock.seconds()
        if renderer.tree is not None:  # no frame knows how many it has
            stats = replace(stats, triangles=renderer.tree.tree.counts().triangles)
            if (k + 1) * judge // len(views) > k * judge // len(views):
                meshes.append((view, renderer.tree.tessellation()))
        gpu = None if seconds is None else seconds * 1e3
        frames.append(Frame((python - begun) * 1e3, own * 1e3, (done - begun) * 1e3, worked * 1e3, gpu, stats))
    return frames, meshes


def most(renderer: Renderer, device: Device, views: list[View], scene: Scene) -> float:
    """Frames per second when none is waited for."""
    target = device.texture((views[0].width, views[0].height), "rgba8unorm", "RENDER_ATTACHMENT").create_view()
    device.wait()
    start = time.perf_counter()
    for view in views:
        renderer.draw(target, "rgba8unorm", scene.but(view=view))
    device.wait()
    return len(views) / (time.perf_counter() - start)


def grown(renderer: Renderer, device: Device, views: list[View], tolerance: float) -> str:
    """The costs of a renderer's tree, with the pages that it has."""
    tree = renderer.tree.tree

    def settle(of: Tree, view: View) -> tuple[int, list[tuple[float, float]]]:
        count, before, took = 0, of.counts().changes, []
        while True:
            begun = time.perf_counter(), time.process_time()
            of.update(view, tolerance, 1.0, 1)
            device.wait()
            took.append(((time.perf_counter() - begun[0]) * 1e3, (time.process_time() - begun[1]) * 1e3))
            changes = of.counts().changes
            if changes == before:
                return count, took
            count, before = count + 1, changes

    settle(tree, views[0])
    steps = [settle(tree, view) for view in views[1:21]]
    counts = tree.counts()
    new = Tree(device, tree.terrain, renderer.method.field.corners, tree.pages, tree.slots)
    cold, _ = settle(new, views[20 if len(views) > 20 else -1])
    lines = [
        f"  the pool: {counts.triangles:,} of {tree.slots:,} triangles, {tree.bytes / 1e6:.0f} MB; pages: "
        f"{tree.pages.atlas.count} of {tree.pages.atlas.capacity}, {tree.pages.atlas.bytes / 1e6:.0f} MB",
        row("ms of an update", [ms for _, took in steps for ms, _ in took], "{:.2f}"),
        row("… of this process's threads", [ms for _, took in steps for _, ms in took], "{:.2f}"),
        row("updates until nothing changes", [count for count, _ in steps], "{:.0f}") + f"   from two triangles {cold}",
    ]
    return "\n".join(lines)


def judged(renderer: Renderer, terrain: Terrain, views: list[View], tolerance: float) -> list[float]:
    """The largest error of each view, pixels, once all its tiles are loaded."""
    found = []
    for view in views:
        patches = renderer.tiles.choose(view, tolerance, 1.0, wait=True).patches
        keys, heights = expand(terrain, patches.instances, renderer.method.legs)
        mesh = Tessellation.from_triangles(terrain.grid, keys, heights, clockwise=False)
        found.append(verify.judge_mesh(mesh, terrain, view).largest_at_samples)
    return found


def judged_pictures(renderer: Renderer, device: Device, scenes: list[Scene]) -> list[float]:
    """The largest error of the pictures of scenes, pixels, with all their tiles."""
    found = []
    for scene in scenes:
        size = scene.view.width, scene.view.height
        target = device.texture(size, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
        renderer.draw(target, "rgba8unorm", scene.but(light="none"), wait=True, samples=1)
        found.append(verify.judge_depth(renderer.depth(), scene.terrain, scene.view).largest)
    return found


def short(milliseconds: list[float]) -> str:
    """The median, for a table."""
    return f"{np.median(milliseconds):.3g}" if milliseconds else "-"


def row(name: str, values: list[float], form: str = "{:.1f}") -> str:
    middle, worst = float(np.median(values)), max(values)
    return f"  {name:30} median {form.format(middle):>10}   worst {form.format(worst):>10}"


def table(frames: list[Frame]) -> str:
    """The table of a flight."""
    stats = [f.stats for f in frames]
    worst = max(range(len(frames)), key=lambda k: frames[k].done)
    gpu = [f.gpu for f in frames if f.gpu is not None]
    finite = [s.error_px for s in stats if s.error_px is not None and math.isfinite(s.error_px)]
    lines = [
        row("ms a frame", [f.done for f in frames], "{:.2f}") + f"   (frame {worst})",
        row("ms of all threads", [f.worked for f in frames]),
        row("ms of the GPU, by its clock", gpu, "{:.2f}")
        if gpu
        else "  ms of the GPU, by its clock    (it tells none)",
        row("ms of Python, to submit", [s.submit_ms for s in stats], "{:.2f}"),
        row("ms of Python, all", [s.cpu_ms for s in stats], "{:.2f}"),
        row("ms of its thread's processor", [f.thread for f in frames], "{:.2f}"),
        row("ms of the loop, all", [f.python for f in frames], "{:.2f}"),
        f"  frames that held the loop up for more than {STALL:.0f} ms: {sum(s.submit_ms > STALL for s in stats)} until "
        f"they were handed over, {sum(f.python > STALL for f in frames)} with what the driver does then",
        row("ms of selection", [s.select_ms for s in stats], "{:.2f}"),
        row("patches", [s.patches for s in stats], "{:,.0f}"),
        row("triangles", [s.triangles for s in stats], "{:,.0f}"),
        row("M triangles a second", [s.triangles / f.done / 1e3 for s, f in zip(stats, frames, strict=True)]),
        row("tiles loaded", [s.tiles_loaded for s in stats], "{:.0f}") + f"   all {sum(s.tiles_loaded for s in stats)}",
        row("tiles lacking", [s.tiles_wanted for s in stats], "{:.0f}")
        + f"   in {sum(s.tiles_wanted > 0 for s in stats)} frames, {sum(s.tiles_wanted for s in stats)} in all",
        row("MB uploaded", [s.bytes_uploaded / 1e6 for s in stats], "{:.2f}")
        + f"   all {sum(s.bytes_uploaded for s in stats) / 1e6:.1f}",
        row("px of error, bound", finite or [math.inf], "{:.2f}"),
    ]
    return "\n".join(lines)


COLUMNS = (
    "flight", "method", "ms a frame, median", "worst", "of the GPU", "of all threads", "of Python, to submit",
    "frames a second", "triangles", "late", "MB", "px, by the referee",
)  # fmt: skip


def line(name: str, method: str, frames: list[Frame], errors: list[float], rate: float) -> str:
    """A flight's row in a table."""
    stats = [f.stats for f in frames]
    done, gpu = [f.done for f in frames], [f.gpu for f in frames if f.gpu is not None]
    windows = max(s.windows for s in stats)
    triangles = f"{np.median([s.triangles for s in stats]):,.0f}" if max(s.triangles for s in stats) else "-"
    cells = [
        name, f"`{method}`", short(done), f"{max(done):.3g}", short(gpu), short([f.worked for f in frames]),
        short([s.submit_ms for s in stats]), f"{rate:.0f}" if rate else "-",
        triangles + (f", {windows} windows" if windows else ""),
        f"{sum(not s.current for s in stats)} of {len(stats)}",
        f"{sum(s.bytes_uploaded for s in stats) / 1e6:.1f}", ", ".join(f"{e:.2f}" for e in errors) or "-",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def flight(
    device: Device, terrain: Terrain, name: str, method: str, tolerance: float, size: Size, options: argparse.Namespace
) -> None:
    """Fly once, and print the results."""
    views = FLIGHTS[name](terrain, size, options.frames)
    begun = time.perf_counter()
    renderer = Renderer(device, terrain, gpu_memory=options.gpu_memory << 20)
    opened = time.perf_counter() - begun
    renderer.tiles.look_ahead = not options.no_look_ahead
    scene = Scene.of(terrain, views[0], sky=True, tolerance=tolerance, method=method, max_memory=options.memory << 20)
    try:
        frames, meshes = fly(renderer, device, views, scene, options)
        rate = 0.0 if options.rate else most(renderer, device, views, scene)
        failed = next((f.stats.failed for f in frames if f.stats.failed), "")
        if failed:
            print(f"{name}, {method}: {failed}", flush=True)
        some = views[:: max(1, len(views) // max(options.judge, 1))][: options.judge]
        if method == "auto":
            errors = judged(renderer, terrain, some, tolerance)
        else:
            errors = judged_pictures(renderer, device, [scene.but(view=view) for view in some])
        if options.table:
            print(line(name, method, frames, errors, rate), flush=True)
            return
        print(f"{name}, {method}: {len(frames)} frames; the renderer opened in {opened * 1e3:.0f} ms")
        print(table(frames), flush=True)
        if rate:
            print(f"  frames a second, none waited for    {rate:.0f}")
        if renderer.tree is not None:
            print(grown(renderer, device, views, tolerance), flush=True)
        if meshes:
            flown = [verify.judge_mesh(mesh, terrain, view).largest_at_samples for view, mesh in meshes]
            print("  px of error, in flight          " + ", ".join(f"{e:.2f}" for e in flown), flush=True)
        if errors:
            print("  px of error, by the referee    " + ", ".join(f"{e:.2f}" for e in errors), flush=True)
    finally:
        renderer.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--terrain", nargs="+", default=["california"])
    parser.add_argument("--flight", action="append", choices=list(FLIGHTS), help="default: orbit")
    parser.add_argument("--method", action="append", help="auto (default): streamed patches; all: each")
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--folder", type=Path, help="where synthetic stores are kept; default: the cache")
    parser.add_argument("--tolerance", action="append", type=float, help="pixels; default: 2")
    parser.add_argument("--size", action="append", help="default: 1280x720")
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--judge", type=int, default=0, help="how many frames the referee looks at")
    parser.add_argument("--gpu-memory", type=int, default=512, help="MiB of tiles on the GPU")
    parser.add_argument("--memory", type=int, default=4096, help="MiB for what methods need and stores lack")
    parser.add_argument("--table", action="store_true", help="a row for each flight")
    parser.add_argument("--rate", type=float, default=RATE, help="frames a second at most; 0: unlimited")
    parser.add_argument("--waited", action="store_true", help="wait for all tiles in each frame")
    parser.add_argument("--no-look-ahead", action="store_true", help="read nothing ahead of the camera")
    options = parser.parse_args()
    sizes: list[Size] = [tuple(int(v) for v in size.split("x")) for size in options.size or ["1280x720"]]
    terrain = terrain_of(options.terrain, options)
    sys.setswitchinterval(SWITCH)
    gc.freeze()  # as the window does
    device = open_device()
    rows, cols = terrain.grid.shape
    methods = options.method or ["auto"]
    methods = list(METHODS) if methods == ["all"] else methods
    for (width, height), tolerance in itertools.product(sizes, options.tolerance or [2.0]):
        print(f"{device.adapter.name}: {rows} × {cols} samples, {width} × {height} pixels, {tolerance:g} px")
        if options.table:
            print(f"\n| {' | '.join(COLUMNS)} |\n|---|---{'|--:' * (len(COLUMNS) - 2)}|")
        for name, method in itertools.product(options.flight or ["orbit"], methods):
            try:
                flight(device, terrain, name, method, tolerance, (width, height), options)
            except OrographError as error:
                print(f"{name}, {method}: {error}", flush=True)


if __name__ == "__main__":
    main()
