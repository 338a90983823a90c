"""Three ways to draw ``bdam``'s patches: one draw of runs, one indirect draw per patch, and one draw call per patch.

    python bench/multi_draw.py [--terrain gabilan] [--frames 20] [--tolerance 1.0] [--size 1280x720]

All draw the patches of the same view, with the same shader, from the same pool (``surface.batches``). *runs*: as in
pictures, one instance for every 64 triangles of a patch. *indirect*: one instance per patch, all in one multi-draw
indirect call, which needs an adapter with ``indirect-first-instance``. *calls*: the same with one call per patch.
*vertices*: shader invocations, relative to the corners of the triangles. *Python*: processor ms of this thread until a
frame is submitted; *all*: of all threads until it is drawn (software adapters draw on the CPU). Medians.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
from wgpu.backends.wgpu_native._api import libf

import promise
from orograph.gpu import device as devices
from orograph.gpu.recording import write
from orograph.lod.method import Goal
from orograph.lod.registry import chosen
from orograph.rendering.gpu.camera import CAMERA, camera_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.batches import INSTANCE, Batches
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.surface.resident import RUN, ResidentMeshes
from orograph.rendering.gpu.targets import Targets
from orograph.viewpoint import Camera
from roam import flight

NEEDED = "indirect-first-instance"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--terrain", default="gabilan")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--size", default="1280x720")
    given = parser.parse_args()
    terrain = promise.terrain_of(given.terrain, given.data)
    if terrain is None:
        raise SystemExit(f"{given.terrain} is missing.")
    devices.OPTIONAL = (*devices.OPTIONAL, NEEDED)
    device = devices.open_device()
    if NEEDED not in device.features:
        raise SystemExit(f"{device.adapter.name} has no {NEEDED}.")
    width, height = map(int, given.size.split("x"))
    view = flight(terrain, 2, 60.0)[0].resized(width, height)
    method = chosen("bdam").make(terrain)
    camera = Camera.over(terrain.grid, view, 1.0)
    selection: Any = method.select(camera, Goal(given.tolerance))
    resident = Batches(device, 1 << 28).ready(selection, lambda tolerance: selection)
    renderer = Renderer(device, terrain)
    surface: Any = renderer._ground.surfaces[ResidentMeshes]
    write(device, renderer._camera, np.asarray(camera_of(view, terrain, 1.0), CAMERA))
    targets, left = Targets(device, width, height), Left()
    heads = np.flatnonzero(np.r_[True, np.diff(resident.runs["vertex"].astype(np.int64)) != 0])
    whole = resident.runs[heads].copy()
    whole["count"] = np.add.reduceat(resident.runs["count"], heads)
    patches = device.buffer(whole, "VERTEX", "patches")
    records = np.array([(3 * n, 1, 0, k) for k, n in enumerate(whole["count"])], np.uint32)
    indirect = device.buffer(records, "INDIRECT", "draws")
    group = surface.bind(**resident.buffers)

    def runs() -> Any:
        encoder = device.handle.create_command_encoder()
        surface.draw(encoder, targets, resident, left)
        return encoder

    def by_patch(draw: Any) -> Any:
        encoder = device.handle.create_command_encoder()
        pass_ = surface.begin(encoder, targets, left)
        pass_.set_bind_group(0, group)
        pass_.set_vertex_buffer(0, patches)
        draw(pass_)
        pass_.end()
        return encoder

    def calls(pass_: Any) -> None:
        for vertices, _, _, first in records.tolist():
            libf.wgpuRenderPassEncoderDraw(pass_._internal, vertices, 1, 0, first)

    def multi(pass_: Any) -> None:
        libf.wgpuRenderPassEncoderMultiDrawIndirect(pass_._internal, indirect._internal, 0, len(records))

    ways = {
        "runs": runs,
        "indirect": lambda: by_patch(multi),
        "calls": lambda: by_patch(calls),
    }
    corners = 3 * resident.triangles
    shaded = {"runs": 3 * RUN * len(resident.runs), "indirect": corners, "calls": corners}
    took: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    marks = {}
    for _ in range(given.frames):
        for name, way in ways.items():
            busy, own = time.process_time(), time.thread_time()
            device.queue.submit([way().finish()])
            python = time.thread_time() - own
            device.wait()
            took[name].append((1e3 * python, 1e3 * (time.process_time() - busy)))
            marks[name] = device.read_texture(targets.marks, np.uint32, 1) if name not in marks else marks[name]
    same = all(np.array_equal(marks["runs"], one) for one in marks.values())
    print(f"{given.terrain}, {device.adapter.name}: {resident.triangles:,} triangles in {len(whole):,} patches")
    for name, times in took.items():
        python, every = (statistics.median(column) for column in zip(*times[1:], strict=True))
        print(f"  {name:9} vertices {shaded[name] / corners:5.3f}  Python {python:7.3f} ms  all {every:7.1f} ms")
    print("  the same picture" if same else "  the pictures differ", INSTANCE.itemsize * len(resident.runs), "bytes")
    renderer.close()


if __name__ == "__main__":
    main()
