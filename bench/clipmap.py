"""Clipmaps measured: the errors of rings as published, what the promise costs, and what a moving eye reads.

The views and terrains are those of ``promise.py``. For every view, the referee judges the mesh of rings as published,
and of rings with a promise at one of five tolerances in turn. For rings as published it also judges the depths of a
picture, pixel by pixel: mean, 99.9th percentile and largest error (Losasso & Hoppe 2004 claim less than a pixel for
99.9 % of the pixels, at 640 × 480 with n = 255). The flight moves the eye at a steady speed over the synthetic terrain
and jumps once (with the paper's update budget of n² samples per frame).

Run: ``python bench/clipmap.py [--views N] [--terrain NAME] [--flight | --gpu] [--data FOLDER]``.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np

from orograph import verify
from orograph.lod.method import Goal, Resources
from orograph.lod.registry import chosen
from orograph.store import Terrain
from orograph.viewpoint import Camera, View
from promise import TERRAINS, TOLERANCES, terrain_of, views

METHODS = ("clipmap", "clipmap,n=511", "clipmap,rings=promise", "clipmap,rings=promise,blend=no", "triangle-patches")


def errors_in_picture(terrain: Terrain, view: View, method: str) -> np.ndarray:
    """The errors of a picture's pixels, in pixels."""
    from orograph.rendering.cpu.draw import draw as draw_cpu
    from orograph.scene.scene import Scene

    drawn = draw_cpu(Scene.of(terrain, view, method=method, samples=1, tolerance=0.5))
    judged = verify.judge_depth(drawn.depth, terrain, view)
    return np.asarray(judged.errors[np.isfinite(judged.truth) & np.isfinite(drawn.depth)])


def measure(name: str, options: argparse.Namespace) -> None:
    """Judge the views of a terrain, and print a row for each method."""
    terrain = terrain_of(name, options.data)
    if terrain is None:
        print(f"{name}: not at {options.data}")
        return
    methods = {label: chosen(label).make(terrain, Resources(1 << 33, 1)) for label in METHODS}
    records: dict[str, list[tuple[float, ...]]] = {label: [] for label in METHODS}
    pixels: dict[str, list[np.ndarray]] = {label: [] for label in METHODS}
    for number, (_, view) in enumerate(views(terrain, options.views, options.seed)):
        tolerance = TOLERANCES[(number + number // len(TOLERANCES)) % len(TOLERANCES)]
        camera = Camera.over(terrain.grid, view)
        for label, method in methods.items():
            mesh = method.select(camera, Goal(tolerance)).tessellation()
            report = verify.judge_mesh(mesh, terrain, view)
            records[label].append((len(mesh.triangles), report.largest / tolerance, bool(report.defects)))
            if not method.conservative and number < options.pictures:
                pixels[label].append(errors_in_picture(terrain, view.resized(640, 480), label))
    for label, found in records.items():
        triangles, worst, defects = np.array(found, float).T
        line = (
            f"{name:16}{label:32}{triangles.mean():12,.0f} triangles, error / tolerance {np.median(worst):8.3f} median"
        )
        line += f"{worst.max():10.3f} most, {int((worst > 1 + 1e-7).sum()):3} over, {int(defects.sum())} with defects"
        if pixels[label]:
            e = np.concatenate(pixels[label])
            line += f"; pixels: mean {e.mean():.3f}, 99.9 % {np.quantile(e, 0.999):.2f}, most {e.max():.2f}"
            line += f", {(e < 1).mean():.2%} under a pixel"
        print(line, flush=True)


def fly(options: argparse.Namespace) -> None:
    """A steady flight with a jump: samples read, late levels, milliseconds."""
    terrain = terrain_of("synthetic 4097", options.data)
    assert terrain is not None
    spacing = terrain.grid.spacing[0]
    for update in ("none", "1", "2"):
        method = chosen(f"clipmap,update={update}").make(terrain, Resources())
        for speed in (0.5, 4.0, 32.0):  # samples a frame
            rows = []
            for frame in range(120):
                col = 600 + speed * frame + (1500 if frame >= 60 else 0)
                x, y = (float(v) for v in terrain.grid.xy(min(col, 4000), 2048 + 0.3 * speed * frame))
                z = terrain.height_range[1] + 20 * spacing
                view = View((x, y, z), (x + 3000, y, z - 1500), width=1280, height=720)
                began = time.perf_counter()
                stats = method.select(Camera.over(terrain.grid, view), Goal(0.0)).stats
                rows.append((stats["samples_read"], stats["late"], 1e3 * (time.perf_counter() - began)))
            read, late, ms = np.array(rows[1:]).T
            steady = np.delete(read, 59)
            print(
                f"update {update:5} {speed:5.1f} samples a frame: {steady.mean():9,.0f} samples read "
                f"({math.ceil(steady.max()):,} most), after the leap {read[59]:,.0f}; "
                f"late {int((late > 0).sum())} frames, {np.median(ms):.1f} ms"
            )


def fly_on_gpu(terrain: Terrain) -> None:
    """A flight drawn on the GPU, as a mesh per frame and as rings in toroidal textures: bytes, milliseconds.

    The time of a frame is from the camera to the depths of its pixels. Both ways draw the same frames, in turns.
    """
    from orograph.gpu.device import open_device
    from orograph.lod.selection import TriangleMesh
    from orograph.rendering.gpu.camera import camera_of
    from orograph.rendering.gpu.renderer import Renderer
    from orograph.rendering.gpu.surface.clipmap import HeldRings, ready_of
    from orograph.rendering.gpu.surface.left import DEPTH_ONLY
    from orograph.rendering.gpu.surface.meshes import packed
    from orograph.rendering.gpu.targets import Targets

    device, spacing = open_device(), terrain.grid.spacing[0]
    renderer = Renderer(device, terrain)
    ground, camera_buffer, targets = renderer._ground, renderer._camera, Targets(device, 1280, 720)
    surfaces, ready = ground.surfaces, ready_of(terrain.grid.shape, 1 << 28)
    methods = {label: chosen("clipmap").make(terrain, Resources()) for label in ("mesh", "rings")}
    view = View((0, 0, 0), (1, 1, 0), width=1280, height=720)
    for speed in (0.5, 4.0, 32.0):  # samples a frame
        rows: dict[str, list[tuple[float, ...]]] = {"mesh": [], "rings": []}
        for frame in range(22):
            col = 600 + speed * frame
            x, y = (float(v) for v in terrain.grid.xy(col, 2048 + 0.3 * speed * frame))
            z = terrain.height_range[1] + 20 * spacing
            view = View((x, y, z), (x + 3000, y, z - 1500), width=1280, height=720)
            for label, method in methods.items():
                device.queue.write_buffer(camera_buffer, 0, camera_of(view, terrain, 1.0))
                device.wait()
                began, worked = time.perf_counter(), time.process_time()
                selection = method.select(Camera.over(terrain.grid, view), Goal(0.0))
                if label == "mesh":
                    mesh = selection.tessellation()
                    drawn = TriangleMesh(method="clipmap", bound=None, mesh=mesh)
                else:
                    drawn = ready(selection, None)
                    assert isinstance(drawn, HeldRings)
                encoder = device.handle.create_command_encoder()
                surfaces[type(drawn)].draw(encoder, targets, drawn, DEPTH_ONLY)
                device.queue.submit([encoder.finish()])
                device.wait()
                took = time.perf_counter() - began, time.process_time() - worked
                came = surfaces[HeldRings].sent if label == "rings" else sum(a.nbytes for a in packed(mesh))
                rows[label].append((came, *took))
        for label, found in rows.items():
            came, took, worked = np.median(np.array(found[2:]), 0)
            print(
                f"{label:6} {speed:5.1f} samples a frame: {came:12,.0f} bytes, {took * 1e3:6.1f} ms, "
                f"{worked * 1e3:6.1f} ms of processors",
                flush=True,
            )
    renderer.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--views", type=int, default=40, help="of each terrain")
    parser.add_argument("--pictures", type=int, default=10, help="views whose pictures are judged")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--terrain", action="append", choices=list(TERRAINS), help="only these")
    parser.add_argument("--flight", action="store_true", help="only the flight")
    parser.add_argument("--gpu", action="store_true", help="only a flight drawn on the GPU")
    options = parser.parse_args()
    if options.gpu:
        terrain = terrain_of("synthetic 4097", options.data)
        assert terrain is not None
        fly_on_gpu(terrain)
        return
    if options.flight:
        fly(options)
        return
    for name in options.terrain or TERRAINS:
        measure(name, options)


if __name__ == "__main__":
    main()
