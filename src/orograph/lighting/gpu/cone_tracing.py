"""Ambient occlusion by voxel cone tracing: a few cones through prefiltered voxels instead of hundreds of rays.

Crassin, Neyret, Sainz, Green & Eisemann 2011 ("Interactive Indirect Illumination Using Voxel Cone Tracing", sec. 5 and
7), for height fields; the definition of A, ρ and R is that of ``orograph.lighting.occlusion``.

*Voxels* are columns of cells, anchored to the terrain. Each has its share under the ground, and the share of the view
along columns and along rows that the ground in it hides (anisotropic voxels, Crassin et al., sec. 4.2): a cliff in the
middle of a voxel fills half of it and hides everything behind it. They form a clip map: level l has voxels 2^l cells
wide and high, made straight from the heights, and reaches only as far around a tile as cones need it. With trilinear
reads, a voxel blurs as much as an object √3 times as wide, so a cone of half angle a needs voxels of width 2 t tan a /
√3 at distance t. Voxels of level l are made from every 2^(l − 3)-th sample, 64 of them each, so a tile takes a few
megabytes whatever the radius and the raster.

*Cones* fill the hemisphere around the normal in rings of equal height, with as many per ring as make them about square.
Each carries the integral of the cosine over its patch of the sky. It reads voxels of its own width, trilinearly and
between levels. The following makes this accurate for terrain:

- The share of a voxel that the sample's own tangent plane fills or hides is subtracted; otherwise the lowest ring,
  whose patches touch the plane, would be occluded on level ground.
- The share that a voxel hides is too large along a slope that the cone grazes (its highest point is farther away than
  its middle), and the share that it fills is too small at a cliff: the first is used where the share rises along the
  cone (``EDGE`` of the shader).
- Where a cone is narrower than ``FIRST`` cells, the ground itself is the finest level: its elevation above the sample's
  plane, at distances that grow by a factor of 1.3, hides the patch from below. Creases are narrower than any voxel.
- Ground fills a patch from below, and more of the same may be behind it: the hidden share is the largest one along the
  cone, not the product of many transparencies. Where it grows, ρ is taken at that distance.
- The share of a patch becomes a share of light by the integral of the cosine from the patch's lower edge upwards.

The result is smooth and fast, but an approximation: see the manual for the errors. Heights and lengths in metres. Tiles
make no difference beyond the 8 bits of a voxel. Missing samples are empty. Cells should be about square.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Program
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lighting.context import Blocks, Context, Values
from orograph.lighting.gpu.occlusion_maps import by_tiles
from orograph.lighting.gpu.rings import MISSING, Held, Store
from orograph.lighting.occlusion import flat_only
from orograph.lighting.rho import Transmission, transmission

TILE = 128
"""Samples along a tile's side."""
LEVELS = 12
"""Maximum levels of voxels: cells of 1 m see 40 km."""
FIT = 1 / math.sqrt(3)
"""Width of a voxel in widths of its cone: with trilinear reads, it then blurs as much as the cone's width."""
FIRST = 2.0
"""The width of cones, in cells, from which voxels are read; nearer, the ground itself is."""
CONES = 64
"""Default number of cones."""
DENSE = 3
"""Voxels of level l are made from samples of level l − ``DENSE``."""
_FRAME = np.dtype(
    [("linear", "f4", 4), ("inverse", "f4", 4), ("run", "f4", 4), ("tile", "i4", 4), ("counts", "i4", 4),
     ("levels", [("origin", "f4", 4), ("size", "f4", 4), ("place", "f4", 4)], LEVELS)]
)  # fmt: skip


def cones(about: int) -> tuple[Values, float]:
    """Cones that fill the hemisphere.

    Args:
        about: the approximate number; there are 8 r² / π in r rings, rounded ring by ring.

    Returns:
        (n, 8) float32: axis (two components across, one along the normal), its share of the cosine's integral (they
        add up to 1), elevations of its patch, tangent of its half angle, 0; and that tangent.
    """
    rings = max(round(math.sqrt(about * math.pi / 8)), 1)
    height = math.pi / 2 / rings
    rows = []
    for ring in range(rings):
        low, high = ring * height, (ring + 1) * height
        middle = (low + high) / 2
        n = max(round(2 * math.pi * math.cos(middle) / height), 3)
        weight = (math.sin(high) ** 2 - math.sin(low) ** 2) / n
        for k in range(n):
            turn = 2 * math.pi * (k + 0.5 * (ring % 2)) / n
            across = math.cos(middle)
            axis = (across * math.cos(turn), across * math.sin(turn), math.sin(middle))
            rows.append((*axis, weight, low, high, math.tan(height / 2), 0.0))
    return np.array(rows, np.float32), math.tan(height / 2)


def _packed(sizes: list[NDArray[np.int64]]) -> tuple[list[tuple[int, int, int]], tuple[int, int, int]]:
    """The positions of boxes (columns, rows, layers) in one texture, and its size.

    The first is beside all others, which are stacked.
    """
    first, rest = sizes[0], sizes[1:]
    places, top = [(0, 0, 0)], 0
    for size in rest:
        places.append((int(first[0]), 0, top))
        top += int(size[2])
    wide = int(first[0]) + max((int(s[0]) for s in rest), default=0)
    return places, (wide, max(int(s[1]) for s in sizes), max(int(first[2]), top))


class Tracer:
    """Cones through a terrain's voxels on a device.

    Args:
        about: the approximate number of cones.
    """

    def __init__(self, device: Device, context: Context, ways: Transmission, about: int) -> None:
        self.device, self.context, self.ways = device, context, ways
        self.cell = float(np.sqrt(abs(np.linalg.det(context.linear))))
        self.inverse = np.linalg.inv(context.linear)
        around, self.tangent = cones(about)
        self.count = len(around)
        rows, cols = context.shape
        far = float(np.linalg.norm(context.linear @ [cols, rows])) + float(
            np.linalg.norm(context.linear @ [cols, -rows])
        )
        self.radius = min(ways.radius, far)
        stretch = max(float(np.linalg.norm(v)) for v in self.inverse) * self.cell
        self.border = math.ceil(FIRST / (2 * self.tangent) * stretch) + 1
        self.levels = min(max(math.ceil(math.log2(self.radius * 2 * self.tangent * FIT / self.cell)), 0) + 1, LEVELS)
        table = context.terrain.tiles(context.terrain.levels - 1)
        self.extremes = float(np.nanmin(table.minimum)), float(np.nanmax(table.maximum))
        self._voxelise, self._trace = Program(device, "voxels"), Program(device, "cones")
        self.fill, self.trace = self._voxelise.compute(), self._trace.compute()
        self.store = Store(device, context.terrain)
        self.cones = device.buffer(around, "STORAGE")
        self.table = device.buffer(np.append(ways.table, ways.free).astype(np.float32), "STORAGE")
        self.sampler = device.handle.create_sampler(
            mag_filter="linear", min_filter="linear", address_mode_u="clamp-to-edge", address_mode_v="clamp-to-edge",
            address_mode_w="clamp-to-edge",
        )  # fmt: skip

    def reach(self, level: int) -> float:
        """How far from a tile voxels of a level are read, in cells."""
        far = self.radius / self.cell
        if level < self.levels - 1:
            far = min(far, (1 << (level + 1)) / (2 * self.tangent * FIT))
        return far + (2 << level)

    def tile(self, row0: int, row1: int, col0: int, col1: int) -> Values:
        """A tile of the result, (rows, cols) float32."""
        window = row0, row1, col0, col1
        inner = self.context.heights(*window)
        missing = np.isnan(inner)
        if missing.all():
            return np.full(inner.shape, np.nan, np.float32)
        low, high = float(np.nanmin(inner)), float(np.nanmax(inner))
        thickest = self.cell * (1 << (self.levels - 1))
        base = math.floor(low / thickest) * thickest  # where the layers of all levels begin, independent of the tile
        sizes = [self._size(k, row0, row1, col0, col1, low - base, high - base, base) for k in range(self.levels)]
        places, whole = _packed([size for _, size in sizes])
        if max(whole) > self.device.limit("max-texture-dimension-3d"):
            return self._parts(row0, row1, col0, col1)
        usage = "STORAGE_BINDING|TEXTURE_BINDING"
        voxels = self.device.texture(whole, "rgba8unorm", usage, label="voxels", dimension="3d")
        encoder = self.device.handle.create_command_encoder()
        wanted = [self._samples(level, box) for level, box in enumerate(sizes)]
        held = self.store.load(tuple(wanted))
        for k in range(self.levels):
            self._fill(encoder, voxels, k, sizes[k], places[k], wanted[k], held[k], base)
        frame = np.zeros(1, _FRAME)
        linear = self.context.linear
        frame["linear"] = *linear[:, 0], *linear[:, 1]
        frame["inverse"] = *self.inverse[:, 0], *self.inverse[:, 1]
        frame["run"] = self.cell, self.radius, FIT, FIRST
        frame["tile"] = col0, row0, col1 - col0, row1 - row0
        frame["counts"] = self.count, self.levels, self.ways.step, self.border
        for k, (origin, size) in enumerate(sizes):
            frame["levels"]["origin"][0, k] = *origin, self.cell * (1 << k)
            frame["levels"]["size"][0, k, :3] = size
            frame["levels"]["place"][0, k, :3] = places[k]
        heights = self.device.buffer(self._bordered(window, base), "STORAGE")
        gx, gy = self.context.gradient(*window)
        slopes = self.device.buffer(np.nan_to_num(np.stack([gx, gy], axis=-1)).astype(np.float32), "STORAGE")
        result = self.device.buffer(4 * inner.size, "STORAGE|COPY_SRC")
        group = self._trace.bind({
            "frame": self.device.buffer(frame.view(np.uint8), "UNIFORM"), "heights": heights, "gradient": slopes,
            "cones": self.cones, "table": self.table, "result": result, "linear_sampler": self.sampler,
            "voxels": voxels,
        })  # fmt: skip
        tracing = encoder.begin_compute_pass()
        tracing.set_pipeline(self.trace)
        tracing.set_bind_group(0, group)
        tracing.dispatch_workgroups(-(-inner.shape[1] // 8), -(-inner.shape[0] // 8))
        tracing.end()
        self.device.queue.submit([encoder.finish()])
        out = self.device.read_buffer(result, np.float32).reshape(inner.shape).copy()
        for used in (voxels, heights, slopes, result):
            used.destroy()
        out[missing] = np.nan
        return np.asarray(np.clip(out, 0.0, 1.0))

    def _size(
        self, level: int, row0: int, row1: int, col0: int, col1: int, low: float, high: float, base: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Origin and size of a level's voxels around a tile, in its own units: columns, rows, layers.

        low, high: of the tile's heights, relative to the base of layers.
        """
        wide, reach = 1 << level, self.reach(level)
        # In samples, a distance in cells is stretched where cells are not square.
        over, down = (reach * self.cell * float(np.linalg.norm(v)) for v in self.inverse)
        thick, up = self.cell * wide, reach * self.cell
        first = [(col0 - over) / wide, (row0 - down) / wide, (low - up) / thick]
        last = [(col1 + over) / wide, (row1 + down) / wide, (high + up) / thick]
        # Beyond the terrain, voxels are empty beside and above it; below it they repeat the outermost ones.
        (rows, cols), (lowest, highest) = self.context.shape, self.extremes
        ends = np.array([[0, cols], [0, rows], [(lowest - base) / self.cell, (highest - base) / self.cell]]) / wide
        least, most = np.floor(ends[:, 0]) - 2, np.ceil(ends[:, 1]) + 2
        begin = np.clip(np.floor(first) - 1, least, most - 1).astype(np.int64)
        return begin, np.clip(np.ceil(last) + 1, begin + 1, most).astype(np.int64) - begin

    def _bordered(self, window: tuple[int, int, int, int], base: float) -> Values:
        """Heights of a tile and ``border`` samples around it above ``base``, ``MISSING`` where there are none."""
        (row0, row1, col0, col1), n, (rows, cols) = window, self.border, self.context.shape
        out = np.full((row1 - row0 + 2 * n, col1 - col0 + 2 * n), MISSING, np.float32)
        a, b, c, d = max(row0 - n, 0), min(row1 + n, rows), max(col0 - n, 0), min(col1 + n, cols)
        there = self.context.heights(a, b, c, d)
        inner = out[a - row0 + n : b - row0 + n, c - col0 + n : d - col0 + n]
        inner[...] = np.where(np.isnan(there), MISSING, there - np.float32(base))
        return out

    def _samples(self, level: int, box: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Rectangle:
        """The samples from which a level's voxels are made."""
        terrain = self.context.terrain
        source = min(max(level - DENSE, 0), terrain.levels - 1)
        (col, row, _), (cols, rows, _) = (v << (level - source) for v in box)
        tall, wide = terrain.shape(source)
        row0, col0 = min(max(int(row) - 1, 0), tall - 1), min(max(int(col) - 1, 0), wide - 1)
        row1, col1 = max(min(int(row + rows) + 1, tall), row0 + 1), max(min(int(col + cols) + 1, wide), col0 + 1)
        return Rectangle(source, row0, row1, col0, col1)

    def _fill(
        self, encoder: Any, voxels: Any, level: int, box: tuple[NDArray[np.int64], NDArray[np.int64]],
        place: tuple[int, int, int], source: Rectangle, held: Held, base: float,
    ) -> None:  # fmt: skip
        """The pass that fills a level's voxels. base: what heights are relative to, metres."""
        origin, size = box
        uniform = np.zeros(24, np.int32)
        uniform[:4] = *origin, level
        uniform[4:8] = *size, source.level
        uniform[8:12] = source.col0, source.row0, source.col1 - source.col0, source.row1 - source.row0
        uniform[12:16] = np.array([self.cell, base, 0.0, 0.0], np.float32).view(np.int32)
        rows, cols = self.context.shape
        uniform[16:18] = cols - 1, rows - 1
        uniform[20:23] = place
        filling = encoder.begin_compute_pass()
        filling.set_pipeline(self.fill)
        levels = self.device.buffer(uniform, "UNIFORM")
        group = self._voxelise.bind({"level": levels, "heights": held.buffer, "voxels": voxels})
        filling.set_bind_group(0, group)
        filling.dispatch_workgroups(-(-int(size[0]) // 8), -(-int(size[1]) // 8))
        filling.end()

    def _parts(self, row0: int, row1: int, col0: int, col1: int) -> Values:
        """A tile with more layers than a texture can hold, in two parts."""
        if max(row1 - row0, col1 - col0) < 2:
            raise UsageError(
                "Voxels as tall as this ground do not fit on the GPU.",
                remedy='Use `method="horizon"` or `method="rays"`, which need no voxels.',
            )
        if row1 - row0 >= col1 - col0:
            half = (row0 + row1) // 2
            return np.concatenate([self.tile(row0, half, col0, col1), self.tile(half, row1, col0, col1)], axis=0)
        half = (col0 + col1) // 2
        return np.concatenate([self.tile(row0, row1, col0, half), self.tile(row0, row1, half, col1)], axis=1)


def run(context: Context, device: Device | None = None) -> Blocks:
    """The product ``ambient-occlusion`` with ``method`` "cone-tracing": about ``cones`` of them (64) per sample.

    Raises:
        NoAdapterError: there is no GPU. DeviceLimitError: its memory is too small for a tile.
        UsageError: too few cones, or as for rays.
    """
    options = context.options
    flat_only(context)
    about = int(options.more.get("cones", CONES))
    if about < 3:
        raise UsageError(f"At least three cones are needed, not {about}.")
    ways = transmission(options.more.get("rho", "step"), options.radius)

    def blocks() -> Blocks:  # (the maker opens the device)
        tracer = Tracer(device or open_device(), context, ways, about)
        yield from by_tiles(context, TILE, "Tracing cones", tracer.tile)

    return blocks()
