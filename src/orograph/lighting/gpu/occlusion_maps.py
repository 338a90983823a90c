"""Ambient occlusion by one shadow map per direction: the GPU rasterises the terrain along N directions.

    A = Σ wᵢ ρ(L(p, ωᵢ)) / Σ wᵢ,   wᵢ = ⟨ωᵢ, n⟩₊ / p(ωᵢ)

Zhukov, Iones & Kronin 1998 for A (``orograph.lighting.occlusion`` has the definition); shadow mapping finds L for all
samples of a tile in one pass per direction. All samples share the directions, but their normals differ, so the
directions cover the whole sphere with density p(ω) = (1 + ω_z) / 4π, which is highest where the normals of terrain
point: a Fibonacci lattice. A direction that no sample of a tile faces is skipped.

*The map* is perpendicular to ω; its texels are 1/``texels`` of a sample wide, anchored to the terrain and not to the
tile. A usual shadow map holds only the outermost face as seen from the light, but L ends at the first face that a ray
enters. So every texel keeps the sorted depths of all faces that point away from the light (``layers`` of them; if there
are more, the tile is repeated with twice as many). Such faces are the backs of lit ground: none lies under a lit
sample, so there is no acne and no bias is needed. Any such face more than ``NEAR`` cells in front counts. The facets
that meet in the sample itself, for which a texel's width would matter most, are tested exactly instead. The remaining
error is half a texel in the position of occluders: samples come out slightly too light, by 0.001 on average with 4
texels.

*Tiles* of ``tile``² samples have their own maps. Drawn into a map are the blocks of cells that rays from the tile may
meet: those within R, on the light's side and no farther than the tile's relief can shade; at full resolution within 512
samples, and from coarser levels beyond (``rings`` has the bound). So a tile takes some tens of MB whatever the raster
and R. Within 512 samples, the result does not depend on the tiles beyond float32 rounding (1e-4 at single samples).
Heights and lengths in metres. Missing samples do not occlude; ground behind a hole counts as a wall. Faces towards the
light are drawn only for directions that may meet a hole, because they need twice the faces and more layers.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Program
from orograph.hierarchy.clip_stack import Ring
from orograph.lighting.context import Blocks, Context, Values
from orograph.lighting.gpu.occlusion_frames import Frames, corners
from orograph.lighting.gpu.rings import BLOCK, REACH, Held, Store, rings
from orograph.lighting.occlusion import flat_only, meet
from orograph.lighting.raster import rectangles
from orograph.lighting.rho import Transmission, transmission

Array = NDArray[np.float64]

GOLDEN = 0.6180339887498949
_INSTANCE = {
    "array_stride": 16, "step_mode": "instance",
    "attributes": [{"format": "sint32x4", "offset": 0, "shader_location": 0}],
}  # fmt: skip
_RECORD = 256  # bytes between records of a buffer with dynamic offsets
_SMALL = 16  # samples along the side of a tile that is not divided further
_LARGEST = (
    1 << 27
)  # bytes of a map, and texels along its side: any device allows these, so that tiles are divided equally everywhere
_SIDE = 8192


@dataclass(frozen=True, slots=True)
class Settings:
    """How maps are made.

    Attributes:
        texels: per distance between samples. tile: samples along a tile's side, even. layers: the initial number of
            faces that a texel keeps. reach: samples beyond a tile within which the ground is drawn at full resolution.
    """

    texels: float = 4.0
    tile: int = 128
    layers: int = 4
    reach: int = REACH


SETTINGS = Settings()
"""What ``run`` uses."""


def directions(n: int, seed: int = 0) -> Array:
    """N directions (n, 3), east, north, up, of density (1 + up) / 4π; ``seed`` rotates them about the vertical."""
    i = np.arange(n) + 0.5
    up = 2.0 * np.sqrt(i / n) - 1.0
    turn = 2.0 * math.pi * (i * GOLDEN + (seed * GOLDEN) % 1.0)
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    return np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=-1)


class Maps:
    """Shadow maps of a terrain's tiles on a device.

    Args:
        context: the terrain, its radius and ρ. rays: how many directions.
    """

    def __init__(
        self,
        device: Device,
        context: Context,
        ways: Transmission,
        rays: int,
        seed: int = 0,
        how: Settings | None = None,
    ) -> None:
        self.device, self.context, self.ways, self.how = device, context, ways, how or SETTINGS
        self.omegas = directions(rays, seed)
        self.cell = float(np.sqrt(abs(np.linalg.det(context.linear))))
        self.inverse = np.linalg.inv(context.linear)
        self._program = Program(device, "occlusion_map")
        self.gather = self._program.compute("gather")
        self.draw = {front: self._pipeline(front) for front in (False, True)}
        table = np.append(ways.table, ways.free).astype(np.float32)
        self.table = device.buffer(table, "STORAGE")
        self.store = Store(device, context.terrain)
        self.corners = device.buffer(corners(), "INDEX")
        self._size, self._target = (0, 0), None
        self._layers, self._done = self.how.layers, 0
        self._texels: Any = None  # of the largest map so far

    def _pipeline(self, front: bool) -> Any:
        """The pass that fills a map with faces that point away from the light, or with all faces."""
        # Rows of the map run upward, which flips triangles once; so do rows of samples that run south.
        winding = "cw" if np.linalg.det(self.context.linear) < 0 else "ccw"
        return self._program.draw(
            [{"format": "r8unorm", "write_mask": 0}],  # the layers are the output
            buffers=[_INSTANCE],
            primitive={"front_face": winding, "cull_mode": "none" if front else "front"},
        )

    def tile(self, row0: int, row1: int, col0: int, col1: int) -> Values:
        """A tile of the result, (rows, cols) float32."""
        window = row0, row1, col0, col1
        heights = self.context.heights(*window)
        if np.isnan(heights).all():
            return np.full(heights.shape, np.nan, np.float32)
        around = rings(self.context.terrain, window, self.context.linear, self.ways.radius, self.how.reach)
        return self._part(window, (row0, col0), around, 1.0)

    def _part(
        self, window: tuple[int, int, int, int], origin: tuple[int, int], around: tuple[Ring, ...], tall: float
    ) -> Values:
        """A part of the tile that begins at ``origin``. ``tall``: its texels are this much taller than wide."""
        inner = self.context.heights(*window)
        missing = np.isnan(inner)
        if missing.all():
            return np.full(inner.shape, np.nan, np.float32)
        gx, gy = (np.asarray(g, np.float64) for g in self.context.gradient(*window))
        held = self.store.load(tuple(r.where for r in around))
        frames = Frames(self, window, origin, around, held, inner, (gx, gy), tall)
        layers = self._layers
        while True:
            if (
                frames.texels * layers * 4 > min(self.device.largest, _LARGEST)
                or max(frames.size) > min(self.device.limit("max-texture-dimension-2d"), _SIDE)
            ):  # fmt: skip
                return self._parts(window, origin, around, tall)
            sums, lost = self._pass(held, frames, gx, gy, layers)
            if not lost:
                break
            layers *= 2
        # Neighbours usually need as many. Too few are detected, so this affects only the time.
        self._done += 1
        self._layers = layers if self._done % 16 else max(layers // 2, self.how.layers)
        # If no direction faces the ground (with very few directions), nothing is known to hide the sky.
        out = np.divide(sums[..., 0], sums[..., 1], out=np.ones_like(inner), where=sums[..., 1] > 0.0)
        out[missing] = np.nan
        return np.asarray(np.clip(out, 0.0, 1.0))

    def _parts(
        self, window: tuple[int, int, int, int], origin: tuple[int, int], around: tuple[Ring, ...], tall: float
    ) -> Values:
        """A tile whose maps are too large: in two parts or, below a cliff of thousands of texels, with tall texels."""
        row0, row1, col0, col1 = window
        if max(row1 - row0, col1 - col0) <= _SMALL:
            return self._part(window, origin, around, 2.0 * tall)
        axis = 0 if row1 - row0 >= col1 - col0 else 1
        halves = (
            [(row0, (row0 + row1) // 2, col0, col1), ((row0 + row1) // 2, row1, col0, col1)]
            if axis == 0
            else [(row0, row1, col0, (col0 + col1) // 2), (row0, row1, (col0 + col1) // 2, col1)]
        )
        return np.concatenate([self._part(w, origin, around, tall) for w in halves], axis=axis)

    def _pass(self, held: list[Held], frames: Frames, gx: Array, gy: Array, layers: int) -> tuple[Values, int]:
        """Sums (rows, cols, 2) over all directions, and the number of faces that found no layer."""
        device, handle = self.device, self.device.handle
        rows, cols = gx.shape
        records = frames.records(layers)
        if not len(records):
            return np.zeros((rows, cols, 2), np.float32), 0
        width, height = frames.size
        if self._size[0] < width or self._size[1] < height:
            self._size = max(self._size[0], width), max(self._size[1], height)
            self._target = device.texture(self._size, "r8unorm", "RENDER_ATTACHMENT").create_view()
        apart = np.zeros((len(records), _RECORD), np.uint8)
        apart[:, : records.dtype.itemsize] = records.view(np.uint8).reshape(len(records), -1)
        slopes = np.nan_to_num(np.stack([gx, gy], axis=-1)).astype(np.float32)
        if self._texels is None or self._texels.size < frames.texels * layers * 4:
            if self._texels is not None:
                self._texels.destroy()
            self._texels = device.buffer(frames.texels * layers * 4, "STORAGE")
        texels = self._texels
        sums = device.buffer(np.zeros((rows, cols, 2), np.float32), "STORAGE|COPY_SRC")
        lost = device.buffer(np.zeros(1, np.uint32), "STORAGE|COPY_SRC")
        shared = device.buffer(apart, "UNIFORM"), device.buffer(slopes, "STORAGE")
        common = {
            "d": shared[0], "layers": texels, "sums": sums, "gradient": shared[1], "table": self.table, "lost": lost,
        }  # fmt: skip
        groups = [
            self._program.bind(
                {**common, "heights": h.buffer, "ring": device.buffer(ring.view(np.uint8), "UNIFORM")},
                sizes={"d": _RECORD},
            )
            for h, ring in zip(held, frames.rings)
        ]
        blocks = device.buffer(frames.blocks, "VERTEX")
        target = {"view": self._target, "load_op": "clear", "store_op": "discard", "clear_value": (0, 0, 0, 0)}
        for some in frames.batches():
            encoder = handle.create_command_encoder()
            for k in some:
                w, h = (int(v) for v in records["map"][k, :2])
                encoder.clear_buffer(texels, 0, w * h * layers * 4)
                drawing = encoder.begin_render_pass(color_attachments=[target])
                drawing.set_viewport(0, 0, w, h, 0.0, 1.0)
                drawing.set_scissor_rect(0, 0, w, h)
                drawing.set_pipeline(self.draw[bool(frames.holes[k])])
                drawing.set_index_buffer(self.corners, "uint16")
                drawing.set_vertex_buffer(0, blocks)
                for number, first, end in frames.drawn[k]:
                    drawing.set_bind_group(0, groups[number], [k * _RECORD])
                    drawing.draw_indexed(6 * BLOCK * BLOCK, end - first, 0, 0, first)
                drawing.end()
                gathering = encoder.begin_compute_pass()
                gathering.set_pipeline(self.gather)
                gathering.set_bind_group(0, groups[0], [k * _RECORD])
                gathering.dispatch_workgroups(-(-cols // 8), -(-rows // 8))
                gathering.end()
            device.queue.submit([encoder.finish()])
        found = device.read_buffer(sums, np.float32).reshape(rows, cols, 2).copy()
        missed = int(device.read_buffer(lost, np.uint32)[0])
        for buffer in (
            sums,
            lost,
            blocks,
            *shared,
        ):  # now, not at garbage collection: with a software adapter it is the process's memory
            buffer.destroy()
        return found, missed


_ONE = threading.Lock()


def run(context: Context, device: Device | None = None) -> Blocks:
    """The product ``ambient-occlusion`` with ``method`` "shadow-maps": ``rays`` directions.

    Raises:
        NoAdapterError: there is no GPU to do it. DeviceLimitError: its memory does not hold a tile.
        UsageError: as for rays.
    """
    options = context.options
    flat_only(context)
    if options.rays < 1:
        raise UsageError(f"At least one direction is needed, not {options.rays}.")
    ways = transmission(options.more.get("rho", "step"), options.radius)
    how = SETTINGS

    def blocks() -> Blocks:  # (the device is opened by whoever makes them)
        maps = Maps(device or open_device(), context, ways, options.rays, int(options.more.get("seed", 0)), how)
        yield from by_tiles(context, how.tile, "Drawing shadow maps", maps.tile)

    return blocks()


def by_tiles(context: Context, side: int, what: str, make: Callable[[int, int, int, int], Values]) -> Blocks:
    """The product tile by tile, in order, for the tiles in the context's window.

    Tiles are kept if the context keeps partial results. A process makes one at a time.
    """
    windows = [w for w in rectangles(context.shape, side, side) if context.only is None or meet(w, context.only)]

    def one(window: tuple[int, int, int, int]) -> Values:
        def new() -> Values:
            with _ONE:
                return make(*window)[None]

        if context.kept is None:
            return new()
        return context.kept.window("ambient-occlusion", window[0], window[2], new)

    with context.progress.task(what, total=len(windows)) as task:
        for window in windows:
            yield window[0], window[2], one(window)
            task.advance()
