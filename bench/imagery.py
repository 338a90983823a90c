"""Streamed imagery: a flight over a terrain under a large image, frame by frame.

    python bench/imagery.py [TERRAIN] [--side 32768] [--image FILE] [--frames 200] [--size 1280x720] [--gpu-memory 512]
                            [--json]

Without --image, the image is synthetic (RGB, tiled, deflate, with overviews): patches of colour with detail down to one
pixel, over the terrain's extent. It is kept in --folder. The camera flies low along the terrain's diagonal and takes 60
frames for the width of a screen. Printed are the MB read from the file (as the kernel counts the reads of the process,
where it does) and the tiles uploaded to the GPU; milliseconds per frame (median, 95 %, worst) and of Python in it; the
same flight without layers; the share of frames that lacked tiles; and the atlas.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

TILE = Path(__file__).parents[2] / "shared" / "data" / "n44w072-hgt" / "N44W072.hgt"


def make(path: Path, terrain: Any, side: int) -> None:
    """A synthetic image of side × side pixels over a terrain."""
    import rasterio
    from affine import Affine
    from rasterio.enums import Resampling

    grid = terrain.grid
    west, south, east, north = grid.bounds()
    transform = Affine((east - west) / side, 0, west, 0, -(north - south) / side, north)
    profile = {
        "driver": "GTiff", "count": 3, "height": side, "width": side, "dtype": "uint8", "crs": grid.crs.to_wkt(),
        "transform": transform, "tiled": True, "blockxsize": 512, "blockysize": 512, "compress": "deflate",
        "zlevel": 1, "photometric": "rgb", "interleave": "pixel", "BIGTIFF": "IF_SAFER",
    }  # fmt: skip
    rng = np.random.default_rng(0)
    block = 2048
    grain = rng.integers(-24, 24, (block, block, 1))
    with rasterio.Env(GDAL_NUM_THREADS="2"), rasterio.open(path, "w", **profile) as file:
        for r in range(0, side, block):
            for c in range(0, side, block):
                cells = rng.integers(40, 200, (32, 32, 3))
                pixels = np.repeat(np.repeat(cells, block // 32, 0), block // 32, 1) + grain
                piece = np.clip(pixels, 0, 255).astype(np.uint8)[: side - r, : side - c]
                file.write(np.moveaxis(piece, -1, 0), window=((r, r + piece.shape[0]), (c, c + piece.shape[1])))
    with rasterio.Env(GDAL_NUM_THREADS="2", COMPRESS_OVERVIEW="DEFLATE"), rasterio.open(path, "r+") as file:
        file.build_overviews([2**k for k in range(1, max(2, side.bit_length() - 8))], Resampling.average)


def bytes_read() -> int:
    """Bytes that the process has read; 0 where the system does not count them."""
    try:
        lines = Path("/proc/self/io").read_text().splitlines()
    except OSError:
        return 0
    return next(int(line.split()[1]) for line in lines if line.startswith("rchar"))


def flight(terrain: Any, size: tuple[int, int], frames: int) -> list[Any]:
    """Cameras low along the terrain's diagonal."""
    from orograph.viewpoint import View

    west, south, east, north = terrain.grid.bounds()
    low, high = terrain.height_range
    length = math.hypot(east - west, north - south)
    height = high + 0.01 * length
    ahead = np.array([east - west, north - south]) / length
    step = min(0.04 * length / 60, 0.6 * length / frames)
    begin = np.array([west, south]) + 0.2 * length * ahead
    views = []
    for k in range(frames):
        x, y = begin + k * step * ahead
        tx, ty = np.array([x, y]) + 0.06 * length * ahead
        views.append(View((x, y, height), (tx, ty, low), fov_y=50, width=size[0], height=size[1]))
    return views


def fly(renderer: Any, target: Any, scenes: list[Any]) -> dict[str, Any]:
    """Draw scenes one after the other, waiting for the device after each."""
    renderer.draw(target, "rgba8unorm", scenes[0], wait=True)
    took, python, tiles, behind = [], [], 0, 0
    before = bytes_read()
    for scene in scenes:
        begun = time.perf_counter()
        stats = renderer.draw(target, "rgba8unorm", scene)
        renderer.device.wait()
        took.append((time.perf_counter() - begun) * 1e3)
        python.append(stats.cpu_ms)
        tiles += renderer.imagery.loaded
        behind += renderer.imagery.missing > 0
    return {
        "frame_ms": {"median": round(float(np.median(took)), 1), "p95": round(float(np.percentile(took, 95)), 1),
                     "worst": round(max(took), 1)},
        "python_ms": round(float(np.median(python)), 2), "image_tiles": tiles,
        "mb_read": round((bytes_read() - before) / 1e6, 1), "frames_behind": round(behind / len(scenes), 3),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("terrain", nargs="*", default=[str(TILE)], help="default: an SRTM tile of the open data")
    parser.add_argument("--side", type=int, default=32768)
    parser.add_argument("--image", type=Path)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "orograph-bench")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--gpu-memory", type=int, default=512, help="MiB")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    from orograph.geovis.layers import Layer
    from orograph.gpu.device import open_device
    from orograph.rendering.gpu.renderer import Renderer
    from orograph.scene.scene import Scene
    from orograph.store.prepare import prepare

    terrain = prepare(given.terrain)
    image = given.image
    if image is None:
        given.folder.mkdir(parents=True, exist_ok=True)
        image = given.folder / f"imagery-{terrain.name}-{given.side}.tif"
        if not image.exists():
            print(f"making {image} …", file=sys.stderr)
            part = image.with_suffix(".part.tif")
            make(part, terrain, given.side)
            part.rename(image)
    device = open_device()
    width, height = (int(v) for v in given.size.split("x"))
    target = device.texture((width, height), "rgba8unorm", "RENDER_ATTACHMENT").create_view()
    views = flight(terrain, (width, height), given.frames)
    report: dict[str, Any] = {
        "adapter": device.adapter.name, "image": image.name, "image_mb": round(image.stat().st_size / 1e6, 1),
        "size": given.size, "frames": given.frames,
    }  # fmt: skip
    for name, layers in (("bare", ()), ("imagery", (Layer(str(image)),))):
        renderer = Renderer(device, terrain, gpu_memory=given.gpu_memory << 20)
        try:
            scenes = [Scene.of(terrain, view, layers=layers, sky=True, depths=(1e3, 1e5)) for view in views]
            report[name] = fly(renderer, target, scenes)
            if layers and renderer.imagery._atlas is not None:
                atlas = renderer.imagery._atlas
                report["atlas"] = {"mib": round(atlas.bytes / 2**20, 1), "tiles": atlas.capacity, "held": atlas.count}
        finally:
            renderer.close()
    if given.json:
        print(json.dumps(report))
        return
    for key, value in report.items():
        print(f"{key:10} {value}")


if __name__ == "__main__":
    main()
