"""The terrain for rays of light on the GPU: nested windows of heights with pyramids of their maxima.

``shaders/ray_field.wgsl`` walks them (Tevs, Ihrke & Seidel 2008), ``shaders/rays.wgsl`` lights pictures by it, as
``rendering.cpu.lighting.Raytraced`` does on the CPU; ``blocked`` asks about any rays.

*Which heights.* A terrain of up to ``EXACT`` samples is held whole at full resolution: then rays meet the surface
itself, whatever the camera. A larger one has nested windows: within the view each is as fine as the tolerance in pixels
requires (``raycast.select``, as for pictures on the CPU), and beyond that every window extends ``margin`` of its own
samples farther than the finer one inside it. So an occluder d metres away from visible ground is drawn from a level
whose samples are at most d / margin apart: if that level is off by e, the edge of a shadow is turned by at most e / d
(``RayField.turn`` says by how much: the largest over all windows).

Heights lie in one array, as ``rendering.gpu.pool`` has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.gpu.device import Device, open_device
from orograph.gpu.program import Group, Program
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.raycast.mips import build_mips
from orograph.raycast.select import load, rectangles
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.pool import NODES, WINDOWS, Pool, Values, samples_in
from orograph.store.terrain import EXACT_SAMPLES, TILE, Terrain
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.rendering.gpu.shade.tracing import Share

EXACT = EXACT_SAMPLES
"""Samples up to which a terrain is held whole."""

MARGIN = 256
"""How many of its own samples a window extends beyond the finer one in it."""

FRAME = np.dtype(
    [
        ("inverse", "<f4", 4), ("last", "<i4", 2), ("exaggeration", "<f4"), ("top", "<f4"), ("count", "<u4"),
        ("first", "<u4"), ("rays", "<u4"), ("total", "<u4"), ("corner", "<f4", 2), ("stride", "<u4"),
        ("spacing", "<f4"), ("windows", "<i4", (WINDOWS, 3, 4)), ("nodes", "<i4", (NODES, 4)),
    ]
)  # fmt: skip
"""The uniform ``RayFrame`` of ``shaders/ray_field.wgsl``."""

_QUERY = np.dtype(
    [("whole", "<i4", 2), ("part", "<f4", 2), ("way", "<f4", 3), ("height", "<f4"), ("skip", "<f4"), ("far", "<f4"),
     ("pad", "<f4", 2)]
)  # fmt: skip
_SHARE = 1 << 18  # rays per submission: does not trigger a driver's watchdog


@dataclass(frozen=True, slots=True)
class RayField:
    """Windows in the shader's form.

    Attributes:
        pool: float32: for each window its heights, then its maxima from level 1 up.
        frame: ``FRAME`` with the constants of all rays.
        turn: maximum angle by which coarse levels turn the edge of a shadow, radians; 0 if everything is exact.
    """

    pool: Values
    frame: NDArray[np.void]
    turn: float = 0.0

    @classmethod
    def of(cls, windows: list[HeightWindow], shape: tuple[int, int], linear: ArrayLike, exaggeration: float = 1.0,
           turn: float = 0.0, jobs: int | None = None) -> RayField:  # fmt: skip
        """Create the field of some windows, outermost first.

        Args:
            shape: (rows, cols) of the raster. linear: (2, 2) metres east and north per column and per row.
        """
        cells = np.asarray(linear, np.float64)
        frame = np.zeros((), FRAME)
        frame["inverse"] = np.linalg.inv(cells).ravel()
        frame["last"] = shape[1] - 1, shape[0] - 1
        frame["exaggeration"], frame["spacing"] = exaggeration, math.sqrt(abs(np.linalg.det(cells)))
        frame["count"], frame["stride"], frame["rays"], frame["total"] = len(windows), 1, 1, 1
        pool = Pool.of(windows, [build_mips(w.heights, jobs) for w in windows], shape)
        for k, w in enumerate(pool.table.windows):
            table = frame["windows"][k]
            table[0] = *w.first, *w.cells
            table[1] = w.offset, w.stride, w.level, w.node
            end = (np.array(w.last) - w.first) * 2.0**-w.level
            table[2] = w.top, *end.astype(np.float32).view(np.int32), 0
        frame["nodes"][: len(pool.table.nodes), :2] = pool.table.nodes[:, :2]
        frame["top"] = pool.table.high
        return cls(pool.values, frame, turn)


NOTHING = RayField(np.zeros(4, np.float32), np.zeros((), FRAME))
"""Empty space, where nothing blocks."""


def field_of(
    terrain: Terrain, view: View, exaggeration: float, tolerance: float, most: int, jobs: int | None = None
) -> tuple[ClipStack, Any]:
    """The terrain that rays meet in a view: the windows, and a function that reads them.

    Args:
        tolerance: pixels. most: bytes available for them.
    """
    chosen = choose(terrain, view, exaggeration, tolerance, samples_in(most))

    def make() -> RayField:
        turn = turned(terrain, chosen)
        windows = load(terrain, chosen, jobs)
        return RayField.of(windows, terrain.grid.shape, terrain.chart.linear, exaggeration, turn, jobs)

    return chosen, make


def choose(terrain: Terrain, view: View, exaggeration: float, tolerance: float, samples: int) -> ClipStack:
    """The windows for a view, outermost first, with at most ``most`` samples, for which the tolerance is coarsened."""
    rows, cols = terrain.grid.shape
    if rows * cols <= min(EXACT, samples):
        return ClipStack([Rectangle.whole(0, (rows, cols))])
    tolerance = max(tolerance, 0.05)
    while True:
        found = rectangles(terrain, view.whole, exaggeration, tolerance).filled(terrain.shape, terrain.levels, MARGIN)
        if found.samples <= samples and len(found) <= WINDOWS:
            return found
        if found[-1].level == terrain.levels - 1:  # there is no coarser level
            return ClipStack(found[-1:])
        tolerance *= 1.25


def turned(terrain: Terrain, chosen: ClipStack) -> float:
    """Maximum angle by which coarse levels turn the edge of a shadow on what the finest window holds, radians: the
    largest error of a level beyond the window inside it, over the distance to it."""
    spacing = min(terrain.grid.spacing)
    worst = 0.0
    for outer, inner in pairwise(chosen):
        error = terrain.tiles(outer.level).error
        k = outer.level - inner.level
        tile = TILE
        beyond = np.ones(error.shape, bool)
        r0, r1 = -(-(inner.row0 >> k) // tile), ((inner.row1 - 1) >> k) // tile
        c0, c1 = -(-(inner.col0 >> k) // tile), ((inner.col1 - 1) >> k) // tile
        beyond[r0:r1, c0:c1] = False
        here = np.zeros_like(beyond)
        here[outer.row0 // tile : -(-outer.row1 // tile), outer.col0 // tile : -(-outer.col1 // tile)] = True
        known = np.where(beyond & here & np.isfinite(error), error, 0.0)
        if known.any():
            worst = max(worst, float(known.max()) / (MARGIN * spacing * 2.0**inner.level))
    return worst


class RayBindings:
    """The bind group of terrain for shaders with ``ray_field.wgsl``.

    Args:
        declared: the group of such a shader.
    """

    def __init__(self, device: Device, declared: Group) -> None:
        self.device, self._declared = device, declared
        self._uniform = device.buffer(FRAME.itemsize, "UNIFORM", "rays")
        self._field: RayField | None = None
        self._pool: Any = None
        self.group: Any = None

    def load(self, field: RayField) -> None:
        """Switch to other terrain."""
        if field is self._field:
            return
        self._pool = self.device.buffer(field.pool, "STORAGE", "heights for rays")
        self.group = self._declared.bind({"ray": self._uniform, "ray_pool": self._pool})
        self._field = field
        self.run()

    def run(self, share: Share | None = None) -> None:
        """Trace a share of the light in what is submitted next."""
        assert self._field is not None
        frame = self._field.frame.copy()
        if share is not None:
            frame["first"], frame["rays"], frame["total"] = share.first, share.rays, share.total
            frame["corner"], frame["stride"] = share.corner, _spread(share.total)
        self.device.queue.write_buffer(self._uniform, 0, frame)


@cache
def _spread(total: int) -> int:
    """A factor that runs through all of ``total`` numbers and spreads consecutive ones evenly over them: of those near
    the golden section, the one that leaves the smallest gaps."""
    near = round(total * 0.6180339887498949)
    some = [k for k in range(max(near - 32, 1), near + 33) if math.gcd(k, total) == 1] or [1]

    def gaps(k: int) -> float:
        worst = 0.0
        for part in (total // 16, total // 8, total // 4, total // 2):
            if part > 1:
                numbers = np.sort(np.arange(part) * k % total)
                worst = max(worst, float(np.diff(np.append(numbers, numbers[0] + total)).max()) * part / total)
        return worst

    return min(some, key=gaps) % max(total, 2)


def blocked(
    field: RayField, points: ArrayLike, ways: ArrayLike, *, skip: float = 0.0, far: float = math.inf,
    device: Device | None = None,
) -> NDArray[np.bool_]:  # fmt: skip
    """Whether terrain blocks rays.

    Args:
        points: (n, 3) columns, rows, metres. ways: (n, 3) unit vectors east, north, up.
        skip, far: range of the rays, metres.

    Returns:
        (n,) bool.

    Raises:
        NoAdapterError: there is no GPU to do it.
    """
    gpu = device or open_device()
    at, way = np.atleast_2d(np.asarray(points, np.float64)), np.atleast_2d(np.asarray(ways, np.float64))
    queries = np.zeros(len(at), _QUERY)
    whole = np.floor(at[:, :2])
    queries["whole"], queries["part"] = whole, at[:, :2] - whole
    queries["way"], queries["height"], queries["skip"] = way, at[:, 2], skip
    queries["far"] = min(far, 1e9)
    program = Program(gpu, "ray_cast", RAY_GROUP=0)
    rays = RayBindings(gpu, program.groups[0])
    rays.load(field)
    pipeline = program.compute()
    out = np.zeros(len(at), bool)
    for a in range(0, len(at), _SHARE):
        some = queries[a : a + _SHARE]
        answers = gpu.buffer(4 * len(some), "STORAGE|COPY_SRC")
        encoder = gpu.handle.create_command_encoder()
        casting = encoder.begin_compute_pass()
        casting.set_pipeline(pipeline)
        casting.set_bind_group(0, rays.group)
        casting.set_bind_group(1, program.bind({"queries": gpu.buffer(some, "STORAGE"), "answers": answers}, 1))
        casting.dispatch_workgroups(-(-len(some) // 64))
        casting.end()
        gpu.queue.submit([encoder.finish()])
        out[a : a + _SHARE] = gpu.read_buffer(answers, np.uint32)[: len(some)] != 0
    return out
