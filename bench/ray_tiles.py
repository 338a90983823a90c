"""Rays on the GPU by one walk over nested windows, and tile by tile, front to back: time to draw the ground, in turns.

    python bench/ray_tiles.py [--terrain california|synthetic-16385|PATH…] [--tolerance 2] [--size 1280x720] [--views 2]
        [--times 8] [--folder FOLDER]

The walk is that of ``raycast`` (``RayPass``): a ray of every pixel runs through all windows. Tile by tile is how Dick,
Krüger & Westermann (2009) draw: here the same windows, cut into tiles of 256 × 256 cells, each drawn as the back faces
of its box by ``bench/ray_tiles.wgsl``, nearest first. A fragment casts its ray within the box, with the same maximum
mipmaps and the same cells; the nearest hit so far of every pixel is kept in a buffer, so that what lies behind casts
nothing. Perspective views only.

Printed are the fastest of ``--times`` draws, ms, by the clock and of the processors (which with a software adapter do
the GPU's work, too), their ratio, the number of tiles in view, and the share of pixels whose depths differ (rays that
pass between two tiles, and edges).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Group, bindings
from orograph.gpu.recording import write
from orograph.gpu.sources import source
from orograph.raycast.select import Boxes, distances, in_frustum
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.readback import depth_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.left import DEPTH_ONLY
from orograph.rendering.gpu.surface.rays import RayPass
from orograph.rendering.gpu.surface.windows import CastWindows
from orograph.rendering.gpu.targets import MARKS, NEARER, Targets, cleared
from orograph.scene.scene import Scene
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import View
from rays import asked, timed
from view import FLIGHTS, terrain_of

TILES = np.dtype(
    [("first", "<i4", 2), ("last", "<i4", 2), ("low", "<f4"), ("high", "<f4"), ("window", "<i4"), ("pad", "<i4")]
)
"""``Tile`` of ``ray_tiles.wgsl``."""


Place = tuple[int, int]
"""Column and row of the raster."""


def tiles_of(terrain: Terrain, view: View, windows: CastWindows) -> NDArray[np.void]:
    """The tiles of windows that are in view, nearest first; where a finer window lies in one, what is around it."""
    found, (rows, cols) = [], terrain.grid.shape
    for number, window in enumerate(windows.windows):
        table, level = terrain.tiles(window.level), window.level
        inner = None
        if number + 1 < len(windows.windows):
            finer = windows.windows[number + 1]
            begins, ends = ((finer.col0, finer.row0), (finer.col1 - 1, finer.row1 - 1))
            inner = tuple(n << finer.level for n in begins), tuple(n << finer.level for n in ends)
        for row in range(window.row0, window.row1 - 1, TILE):
            for col in range(window.col0, window.col1 - 1, TILE):
                first = col << level, row << level
                ends = min(col + TILE, window.col1 - 1) << level, min(row + TILE, window.row1 - 1) << level
                last = min(ends[0], cols - 1), min(ends[1], rows - 1)  # (levels may reach beyond the raster)
                low, high = (float(part[row // TILE, col // TILE]) for part in (table.minimum, table.maximum))
                if np.isfinite(high):
                    found += [(*part, low, high, number, 0) for part in around(first, last, inner)]
    tiles = np.array(found, TILES)
    (west, north), (east, south) = tiles["first"].T.astype(float), tiles["last"].T.astype(float)
    boxes = Boxes(west, east, north, south, tiles["low"].astype(float), tiles["high"].astype(float))
    seen = in_frustum(terrain, view, 1.0, boxes)
    order = np.argsort(distances(terrain, view, 1.0, boxes)[seen], kind="stable")
    return np.ascontiguousarray(tiles[seen][order])


def around(first: Place, last: Place, hole: tuple[Any, Any] | None) -> list[tuple[Place, Place]]:
    """The rectangle between two places without a rectangular hole, as up to four rectangles."""
    (west, north), (east, south) = first, last
    if hole is None:
        return [(first, last)]
    left, right = max(hole[0][0], west), min(hole[1][0], east)
    top, bottom = max(hole[0][1], north), min(hole[1][1], south)
    if left >= right or top >= bottom:
        return [(first, last)]
    parts = [
        ((west, north), (east, top)), ((west, bottom), (east, south)),
        ((west, top), (left, bottom)), ((right, top), (east, bottom)),
    ]  # fmt: skip
    return [(a, b) for a, b in parts if a[0] < b[0] and a[1] < b[1]]


class TilePass:
    """Draws tiles of windows, front to back. Args: stack: the uniform buffer of the windows."""

    def __init__(self, device: Device, camera: Any, stack: Any, size: tuple[int, int]) -> None:
        text = source("window_rays") + Path(__file__).with_name("ray_tiles.wgsl").read_text(encoding="utf-8")
        declared = bindings(text)
        self.device, self.stack = device, stack
        self.groups = [Group(device, tuple(one for one in declared if one.group == k)) for k in (0, 1)]
        self.seen = self.groups[0].bind({"camera": camera})
        self.nearest = device.buffer(4 * size[0] * size[1], "STORAGE|COPY_DST", "nearest hits")
        self.never = device.buffer(np.full(size[0] * size[1], 1e30, np.float32), "COPY_SRC", "no hits")
        handle = device.handle
        if device.record != "uniform":  # as in ``Device.shader``
            text = text.replace("var<uniform>", "var<storage, read>")
        module = handle.create_shader_module(code=text)
        self.pipeline = handle.create_render_pipeline(
            layout=handle.create_pipeline_layout(bind_group_layouts=[group.layout for group in self.groups]),
            vertex={"module": module, "entry_point": "vertex", "buffers": []},
            primitive={"topology": "triangle-list", "cull_mode": "back"}, depth_stencil=NEARER,
            fragment={"module": module, "entry_point": "fragment", "targets": [{"format": MARKS}]},
        )  # fmt: skip

    def bring(self, tiles: NDArray[np.void], pool: Any) -> tuple[Any, int]:
        """Upload tiles; their bind group and number."""
        buffer = self.device.buffer(tiles, "STORAGE", "tiles")
        bound = {"stack": self.stack, "pool": pool, "tiles": buffer, "nearest": self.nearest}
        return self.groups[1].bind(bound), len(tiles)

    def draw(self, encoder: Any, targets: Targets, brought: tuple[Any, int]) -> None:
        encoder.copy_buffer_to_buffer(self.never, 0, self.nearest, 0, self.never.size)
        pass_ = cleared(targets, self.device, False).begin(encoder)
        pass_.set_pipeline(self.pipeline)
        pass_.set_bind_group(0, self.seen)
        pass_.set_bind_group(1, brought[0])
        pass_.draw(36, brought[1])
        pass_.end()


def main() -> None:
    options = asked(__doc__, views=2, times=8)
    width, height = options.size
    terrain, device = terrain_of(options.terrain, options), open_device()
    renderer, targets = Renderer(device, terrain), Targets(device, width, height)
    ground, camera = renderer._ground, renderer._camera
    walk = RayPass(device, camera)
    by_tiles = TilePass(device, camera, walk.stack, (width, height))
    rows, cols = terrain.grid.shape
    print(f"{device.adapter.name}: {rows} × {cols} samples, {width} × {height} pixels, {options.tolerance:g} px")
    for name in ("orbit", "low", "jump"):
        for view in FLIGHTS[name](terrain, (width, height), 20 * options.views)[::20]:
            scene = Scene.of(terrain, view, tolerance=options.tolerance, method="raycast")
            windows = ground.choose(scene, None, options.tolerance, wait=True).rays
            seen = camera_of(view, terrain, 1.0)
            write(device, camera, seen.tobytes())
            tiles = tiles_of(terrain, view, windows)
            if not len(tiles):
                print(f"  {name:5} no ground in view")
                continue
            brought = by_tiles.bring(tiles, windows.pool)
            draws = {
                "walk": lambda encoder, windows=windows: walk.draw(encoder, targets, windows, DEPTH_ONLY),
                "tiles": lambda encoder, brought=brought: by_tiles.draw(encoder, targets, brought),
            }
            took: dict[str, list[tuple[float, float]]] = {way: [] for way in draws}
            depths: dict[str, NDArray[np.float32]] = {}
            for k in range(options.times + 1):
                for way, draw in draws.items():
                    ms = timed(device, draw)
                    took[way] += [ms] if k else []  # (the first compiles)
                    depths[way] = depth_of(device, targets, seen)
            least = {way: np.min(times, 0) for way, times in took.items()}
            one, other = depths["walk"], depths["tiles"]
            same = (np.isnan(one) & np.isnan(other)) | (np.abs(one - other) <= 1e-5 * one)
            print(
                f"  {name:5} {len(windows.windows)} windows, {len(tiles)} tiles: "
                + ", ".join(f"{way} {ms[0]:.1f} ms (cpu {ms[1]:.0f})" for way, ms in least.items())
                + f"; × {least['tiles'][0] / least['walk'][0]:.2f} (cpu × {least['tiles'][1] / least['walk'][1]:.2f}); "
                f"{(~same).mean():.4%} of the pixels differ",
                flush=True,
            )
    renderer.close()


if __name__ == "__main__":
    main()
