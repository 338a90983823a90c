"""Ambient occlusion by one shadow map per direction: the GPU rasterises the terrain along N directions.

    A = Σ wᵢ ρ(L(p, ωᵢ)) / Σ wᵢ,   wᵢ = ⟨ωᵢ, n⟩₊ / p(ωᵢ)

Zhukov, Iones & Kronin 1998 for A (``orograph.light.occlusion`` has the definition); shadow mapping finds L for all
samples of a tile in one pass per direction. All samples share the directions, whose normals differ, so these cover the
whole sphere with density p(ω) = (1 + ω_z) / 4π, which is most where the normals of terrain look: a Fibonacci lattice.
Where no sample of a tile looks towards a direction it is passed over.

*The map* lies square to ω; its texels are 1/``texels`` of a sample wide, anchored to the terrain and not to the tile.
Seen from the light only the outermost face would be in it, but L ends at the first face that a ray enters, so every
texel keeps the depths of all faces that look away from the light, sorted (``layers`` of them; where there are more, the
tile is done again with twice as many). Such faces are the backs of what the light sees: none lies under a lit sample,
so there is no acne, and no bias is needed: what counts is any such face more than ``NEAR`` cells in front. The facets
that meet in the sample itself, on which a texel's width would matter most, are tested exactly instead. Left is an error
of half a texel in where occluders stand: samples come out a little too light, by 0.001 on average with 4 texels.

*Tiles* of ``tile``² samples have their own maps; terrain within R of them, on the light's side and no farther than its
relief can shade, is drawn into them. The result does not depend on the tiles beyond float32 rounding (1e-4 at single
samples). Heights and lengths in metres. Missing samples do not occlude; ground behind a hole counts as a wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.gpu.binding import bind, compute, layout
from orograph.gpu.device import Device, DeviceLimitError, open_device
from orograph.light.occlusion import Neighbourhood, check_reach, flat_only
from orograph.light.products import Blocks, Context, Values
from orograph.light.raster import rectangles
from orograph.light.rho import Transmission, transmission

Array = NDArray[np.float64]

GOLDEN = 0.6180339887498949
NEAR = 1e-3
"""Cells within which a face is the sample's own."""
HOLE = 2.0
"""Cells beyond which a face seen from below is ground behind a hole."""
MISSING = np.float32(-1e30)
_RECORD = 256  # bytes between records of a uniform buffer with dynamic offsets
_SMALL = 16  # samples along the side of a tile that is not divided further
_BATCH = 16  # directions per submission: enough to keep a GPU busy, and Ctrl-C is heard in between


@dataclass(frozen=True, slots=True)
class Settings:
    """How maps are made.

    Attributes:
        texels: per distance between samples. tile: samples along a tile's side, even. layers: faces that a texel
            keeps to begin with.
    """

    texels: float = 4.0
    tile: int = 128
    layers: int = 4


SETTINGS = Settings()
"""What ``run`` uses."""


def directions(n: int, seed: int = 0) -> Array:
    """N directions (n, 3), east, north, up, of density (1 + up) / 4π; ``seed`` turns them about the vertical."""
    i = np.arange(n) + 0.5
    up = 2.0 * np.sqrt(i / n) - 1.0
    turn = 2.0 * math.pi * (i * GOLDEN + (seed * GOLDEN) % 1.0)
    level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
    return np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=-1)


def check_device(device: Device, context: Context, reach: float, tile: int) -> None:
    """Raise DeviceLimitError if a tile of samples with what is within reach does not fit on the device, and say how far
    reach may go."""
    most = device.largest // 4
    rows, cols = context.shape
    across = [float(np.linalg.norm(v)) for v in np.linalg.inv(context.linear)]  # samples per metre

    def samples(metres: float) -> float:
        tall, wide = (min(n, tile + 2 * (metres * k + 2)) for n, k in zip((rows, cols), reversed(across)))
        return tall * wide

    if samples(min(reach, 1e9)) <= most:
        return
    low, high = 0.0, min(reach, 1e9)
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if samples(middle) <= most else (low, middle)
    spacing = 10.0 ** math.floor(math.log10(max(low, 1.0)) - 1)
    raise DeviceLimitError(
        f"What is within reach of a sample is up to {int(samples(min(reach, 1e9))):,} samples; "
        f"{device.adapter.name} holds at most {most:,} at a time.",
        remedy=f"Give a radius of at most {math.floor(low / spacing) * spacing:g} m (--radius), or leave out --method: "
        "sweeps know no limit of distance.",
    )


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
        words = ("uniform+dynamic", "read", "write", "write", "read", "read", "write")
        self.layout = layout(device, *words, stages="COMPUTE|VERTEX|FRAGMENT")
        self.gather = compute(device, self.layout, "occlusion_map", "gather")
        self.draw = {front: self._pipeline(front) for front in (False, True)}
        table = np.append(ways.table, ways.free).astype(np.float32)
        self.table = device.buffer(table, "STORAGE")
        self._size, self._target = (0, 0), None

    def _pipeline(self, front: bool) -> Any:
        """The pass that fills a map with faces that look away from the light, or with all of them."""
        module = self.device.shader("occlusion_map")
        # Rows of the map run upward, which turns triangles over once, and so do rows of samples that run south.
        winding = "cw" if np.linalg.det(self.context.linear) < 0 else "ccw"
        return self.device.handle.create_render_pipeline(
            label="occlusion_map",
            layout=self.layout.pipeline,
            vertex={"module": module, "entry_point": "vertex", "buffers": []},
            primitive={
                "topology": "triangle-list",
                "front_face": winding,
                "cull_mode": "none" if front else "front",
            },
            fragment={
                "module": module,
                "entry_point": "fragment",
                "targets": [{"format": "r8unorm", "write_mask": 0}],  # the layers are what is drawn
            },
        )

    def tile(self, row0: int, row1: int, col0: int, col1: int, tall: float = 1.0) -> Values:
        """A tile of the result, (rows, cols) float32. ``tall``: texels are this much taller than wide."""
        near = Neighbourhood(self.context, row0, row1, col0, col1, self.ways.radius)
        inner = near.block(near.heights)
        missing = np.isnan(inner)
        if missing.all():
            return np.full(inner.shape, np.nan, np.float32)
        gx, gy = near.block(near.gx).astype(np.float64), near.block(near.gy).astype(np.float64)
        frames = _Frames(self, near, gx, gy, tall)
        layers = self.how.layers
        while True:
            if (
                frames.texels * layers * 4 > self.device.largest
                or max(frames.size) > self.device.limit("max-texture-dimension-2d")
            ):  # fmt: skip
                return self._parts(row0, row1, col0, col1, tall)
            sums, lost = self._pass(near, frames, gx, gy, layers)
            if not lost:
                break
            layers *= 2
        with np.errstate(invalid="ignore", divide="ignore"):
            out = sums[..., 0] / sums[..., 1]
        out[missing] = np.nan
        return np.asarray(np.clip(out, 0.0, 1.0))

    def _parts(self, row0: int, row1: int, col0: int, col1: int, tall: float) -> Values:
        """A tile whose maps are too large: in two parts, or below a cliff of thousands of texels with taller texels."""
        if max(row1 - row0, col1 - col0) <= _SMALL:
            return self.tile(row0, row1, col0, col1, 2.0 * tall)
        if row1 - row0 >= col1 - col0:
            half = (row0 + row1) // 2
            return np.concatenate([self.tile(*w, tall) for w in ((row0, half, col0, col1), (half, row1, col0, col1))])
        half = (col0 + col1) // 2
        parts = [self.tile(*w, tall) for w in ((row0, row1, col0, half), (row0, row1, half, col1))]
        return np.concatenate(parts, axis=1)

    def _pass(self, near: Neighbourhood, frames: _Frames, gx: Array, gy: Array, layers: int) -> tuple[Values, int]:
        """Sums (rows, cols, 2) over all directions, and how many faces found no layer."""
        device, handle = self.device, self.device.handle
        rows, cols = gx.shape
        heights = np.where(np.isnan(near.heights), MISSING, near.heights - np.float32(frames.level))
        records = frames.records(layers)
        width, height = frames.size
        if self._size[0] < width or self._size[1] < height:
            self._size = max(self._size[0], width), max(self._size[1], height)
            self._target = device.texture(self._size, "r8unorm", "RENDER_ATTACHMENT").create_view()
        uniforms = np.zeros((len(records), _RECORD), np.uint8)
        uniforms[:, : records.dtype.itemsize] = records.view(np.uint8).reshape(len(records), -1)
        slopes = np.nan_to_num(np.stack([gx, gy], axis=-1)).astype(np.float32)
        texels = device.buffer(frames.texels * layers * 4, "STORAGE")
        sums = device.buffer(np.zeros((rows, cols, 2), np.float32), "STORAGE|COPY_SRC")
        lost = device.buffer(np.zeros(1, np.uint32), "STORAGE|COPY_SRC")
        group = bind(
            device, self.layout, device.buffer(uniforms, "UNIFORM"), device.buffer(heights, "STORAGE"), texels, sums,
            device.buffer(slopes, "STORAGE"), self.table, lost, sizes={0: _RECORD},
        )  # fmt: skip
        draw = self.draw[frames.holes]
        target = {"view": self._target, "load_op": "clear", "store_op": "discard", "clear_value": (0, 0, 0, 0)}
        for first in range(0, len(records), _BATCH):
            encoder = handle.create_command_encoder()
            for k in range(first, min(first + _BATCH, len(records))):
                w, h = (int(v) for v in records["map"][k, :2])
                encoder.clear_buffer(texels, 0, w * h * layers * 4)
                drawing = encoder.begin_render_pass(color_attachments=[target])
                drawing.set_viewport(0, 0, w, h, 0.0, 1.0)
                drawing.set_scissor_rect(0, 0, w, h)
                drawing.set_pipeline(draw)
                drawing.set_bind_group(0, group, [k * _RECORD])
                drawing.draw(6 * int(records["window"][k, 2]), int(frames.rows[k]))
                drawing.end()
                gathering = encoder.begin_compute_pass()
                gathering.set_pipeline(self.gather)
                gathering.set_bind_group(0, group, [k * _RECORD])
                gathering.dispatch_workgroups(-(-cols // 8), -(-rows // 8))
                gathering.end()
            device.queue.submit([encoder.finish()])
        found = device.read_buffer(sums, np.float32).reshape(rows, cols, 2)
        return found.copy(), int(device.read_buffer(lost, np.uint32)[0])


_DIRECTION = np.dtype(
    [("u", "f4", 4), ("v", "f4", 4), ("s", "f4", 4), ("omega", "f4", 4), ("run", "f4", 4), ("map", "u4", 4),
     ("window", "u4", 4), ("tile", "u4", 4), ("ground", "u4", 4), ("bias", "f4", 4)]
)  # fmt: skip
"""``Direction`` of the shader."""


class _Frames:
    """How the directions that matter to a tile map it: everything in float64, relative to the terrain.

    Attributes:
        level: the height that heights are relative to. size, texels: width and height that hold all maps, and
            the area of the largest. holes: whether samples are missing.
        rows: how many rows of cells are drawn, by direction.
    """

    def __init__(self, maps: Maps, near: Neighbourhood, gx: Array, gy: Array, tall: float) -> None:
        self.maps, self.near = maps, near
        omegas = maps.omegas
        up = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        normals = np.stack([-gx * up, -gy * up, up], axis=-1)[np.isfinite(up)]
        facing = np.concatenate([(normals @ part.T).max(axis=0) for part in np.array_split(omegas, 8) if len(part)])
        self.omegas = omegas[facing > 0]
        inner = near.block(near.heights)
        low, high = float(np.nanmin(inner)), float(np.nanmax(inner))
        self.level = round((low + high) / 2)
        self.holes = bool(np.isnan(near.heights).any())
        relief = max(float(np.nanmax(near.heights)) - low, 0.0)
        a, b, c, d = near.inner
        n = len(self.omegas)
        self.rows = np.zeros(n, np.int64)
        out = np.zeros(n, _DIRECTION)
        linear, cell = maps.context.linear, maps.cell
        texel = cell / maps.how.texels
        level_of = np.hypot(self.omegas[:, 0], self.omegas[:, 1])
        corners = np.array([[x, y, z - self.level] for x in (c, d - 1) for y in (a, b - 1) for z in (low, high)])
        everything = np.array(
            [[x, y, z - self.level] for x in (0, near.heights.shape[1] - 1) for y in (0, near.heights.shape[0] - 1)
             for z in (float(np.nanmin(near.heights)), float(np.nanmax(near.heights)))]
        )  # fmt: skip
        # Where the tile lies in the terrain, so that texels do not depend on the tile.
        origin = np.append(linear @ [near.col0, near.row0], float(self.level))
        for k, (omega, level) in enumerate(zip(self.omegas, level_of)):
            az = omega[:2] / level if level > 1e-12 else np.array([0.0, 1.0])
            u = np.array([-az[1], az[0], 0.0])
            v = np.cross(omega, u)  # u × v = ω: looking against the light u is right and v is up
            rows = []
            for along, scale in ((u, texel), (v, texel * tall), (omega, -1.0)):
                flat = along[:2] @ linear / scale
                rows.append(np.array([*flat, along[2] / scale, float(along @ origin) / scale]))
            for axis, row in enumerate(rows[:2]):
                row[3] -= math.floor(float((corners @ row[:3]).min()) + row[3]) - 1
                out["map"][k, axis] = math.floor(float((corners @ row[:3]).max()) + row[3]) + 2
            rows[2][3] = 1.0 - float((everything @ rows[2][:3]).min())  # the light's plane is before everything
            out["u"][k], out["v"][k], out["s"][k] = rows
            out["omega"][k] = *omega, 1.0 / (1.0 + omega[2])
            run = maps.inverse @ omega[:2]
            out["run"][k] = *run, min(maps.ways.radius, 1e30), 0.0
            # How far occluders can be: within R, and no higher than the terrain is.
            reach = maps.ways.radius * level
            if omega[2] > 1e-9:
                reach = min(reach, relief * level / omega[2])
            reach = min(reach, 1e9)
            shift = maps.inverse @ (az * reach)
            c0, c1 = min(c, c + shift[0]) - 2, max(d, d + shift[0]) + 2
            r0, r1 = min(a, a + shift[1]) - 2, max(b, b + shift[1]) + 2
            c0, c1 = max(int(c0), 0), min(math.ceil(c1), near.heights.shape[1]) - 1
            r0, r1 = max(int(r0), 0), min(math.ceil(r1), near.heights.shape[0]) - 1
            out["window"][k] = c0, r0, max(c1 - c0, 0), maps.ways.step
            self.rows[k] = max(r1 - r0, 0)
        out["map"][:, 3] = self.holes
        out["tile"] = c, a, d - c, b - a
        out["ground"] = near.heights.shape[1], near.heights.shape[0], 0, 0
        out["bias"] = NEAR * cell, HOLE * cell, texel * tall, 0.0
        self._records = out
        self.size = int(out["map"][:, 0].max()), int(out["map"][:, 1].max())
        self.texels = int((out["map"][:, 0].astype(np.int64) * out["map"][:, 1]).max())

    def records(self, layers: int) -> NDArray[Any]:
        """The uniforms (n,) of all directions."""
        self._records["map"][:, 2] = layers
        return self._records


def run(context: Context, device: Device | None = None) -> Blocks:
    """The product ``ambient-occlusion`` with ``method`` "shadow-maps": ``rays`` directions.

    Raises:
        NoAdapterError: there is no GPU to do it. DeviceLimitError: what is within reach does not fit on it.
        UsageError: as for rays.
    """
    options = context.options
    flat_only(context)
    if options.rays < 1:
        raise UsageError(f"At least one direction is needed, not {options.rays}.")
    ways = transmission(options.more.get("rho", "step"), options.radius)
    how = SETTINGS
    check_reach(context, ways.radius, how.tile, how.tile, 1)
    gpu = device or open_device()
    check_device(gpu, context, ways.radius, how.tile)

    def blocks() -> Blocks:
        maps = Maps(gpu, context, ways, options.rays, int(options.more.get("seed", 0)), how)
        windows = list(rectangles(context.shape, how.tile, how.tile))
        with context.progress.task("Drawing shadow maps", total=len(windows)) as task:
            for window in windows:
                yield window[0], window[2], maps.tile(*window)[None]
                task.advance()

    return blocks()
