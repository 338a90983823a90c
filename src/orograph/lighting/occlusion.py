"""Ambient occlusion in object space: the share A of ambient light that reaches each sample of the terrain.

    A = 1/π ∬ ρ(L(p, ω)) ⟨ω, n⟩ dω   over the hemisphere around the normal n

with L the free path from p in direction ω, clamped to the radius R, and ρ the share that an occluder at that distance
lets through (``rho``; Zhukov, Iones & Kronin 1998). There are two ways to find L here, and two more on the GPU
(``ELSEWHERE``):

- ``rays``: Monte Carlo with directions of density ⟨ω, n⟩/π, so that A is the mean of ρ over N rays (the caster's);
- ``horizon``: in M azimuths, the integral over elevations has a closed form. For a step, only the highest elevation
  within R matters, and the weight's integral is elementary. For any other ρ, the horizon alone does not tell how far
  away lower elevations end; but the rays at those elevations end exactly on the ground that raises the horizon on the
  way out, so a walk that records every rise of the horizon knows L for all of them. Without a radius (step only)
  horizons are swept, at a cost that does not depend on their distance.

Light comes from the whole hemisphere around the normal, including from below the horizon where the ground falls away,
and space beyond the terrain's border is free: an inclined plane has A = 1, where its sky-view factor is (1 + cos) / 2.
Missing samples occlude nothing. Lengths in metres, A between 0 and 1.
"""

from __future__ import annotations

import copy
import importlib
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.lighting.arrays import context_of
from orograph.lighting.context import Blocks, Context, Options, Values
from orograph.lighting.gather import Sweep, Window, by_azimuth
from orograph.lighting.products import Product, compute
from orograph.lighting.raster import rectangles
from orograph.lighting.rho import Rho, Transmission, transmission
from orograph.lighting.sweep_lines import direction
from orograph.parallel import map_ordered
from orograph.raycast.tables import Scene

if TYPE_CHECKING:
    from orograph.lighting.occlusion_kernels import Edges, Samples

Heights = NDArray[np.float32]
Array = NDArray[np.float64]
Method = Literal["horizon", "rays", "shadow-maps", "cone-tracing"]

ELSEWHERE = {
    "shadow-maps": "orograph.lighting.gpu.occlusion_maps",
    "cone-tracing": "orograph.lighting.gpu.cone_tracing",
}
"""Methods of later layers: modules with ``run(context) → blocks``. This layer has only their names, imports them on
demand, and so works without a GPU and its extra."""

LIFT = 1e-4
"""Height in cells at which rays begin: the ε of p + εω, but upward, so that they begin on the lit side."""

_TIE = 1e-9
_BLOCK, _WIDTH = 256, 512
_PER_SAMPLE = 24
"""Bytes that a neighbourhood takes per sample: heights, slopes, result, the caster's pyramids."""


def edges(linear: Array, azimuth: float, radius: float) -> Edges:
    """The edges of the triangulation that a walk crosses, from a sample outward to ``radius`` metres and one beyond.

    Cells are cut along the diagonals that join samples of even (row + column), so all edges lie on the lines x = k, y =
    k, x − y = c and x + y = c, with c of the parity of the walk's first sample.

    Args:
        linear: (2, 2) metres east and north per column and per row. azimuth: degrees from grid north.
    """
    from orograph.lighting.occlusion_kernels import Edges

    du, dv = (float(x) for x in np.linalg.solve(linear, direction(azimuth)))
    radius += float(np.linalg.norm(linear @ [1, 1]) + np.linalg.norm(linear @ [1, -1])) / 2  # to the edge beyond
    tables = []
    for parity in (0, 1):
        found = []
        # (speed across the lines, distance of lines, first line): the lines a·x + b·y = c.
        for a, b, period, offset in ((1, 0, 1, 0), (0, 1, 1, 0), (1, -1, 2, parity), (1, 1, 2, parity)):
            speed = a * du + b * dv
            if abs(speed) * radius < _TIE:
                continue
            count = int(abs(speed) * radius)
            c = np.arange(-count, count + 1)
            c = c[(c % period == offset) & (c * speed > 0)]
            s = c / speed
            x, y = s * du, s * dv
            if a == 0:
                x0 = np.floor(x + _TIE)
                f, y0, step = x - x0, np.rint(y), (1, 0)
            elif b == 0:
                y0 = np.floor(y + _TIE)
                f, x0, step = y - y0, np.rint(x), (0, 1)
            else:
                x0 = np.floor(x + _TIE)
                f, y0, step = x - x0, b * (c - x0), (1, -b)
            f = np.where(f < _TIE, 0.0, f)
            far = f > 0
            found.append(np.stack([s, y0, x0, y0 + step[1] * far, x0 + step[0] * far, f]))
        table = np.concatenate(found, axis=1)
        table = table[:, np.argsort(table[0], kind="stable")]
        # Several lines meet in a sample, which counts once.
        table = table[:, np.concatenate([[True], np.diff(table[0]) > _TIE * radius])] if table.size else table
        tables.append(table)
    starts = np.cumsum([0, tables[0].shape[1], tables[1].shape[1]])
    s, y1, x1, y2, x2, f = np.concatenate(tables, axis=1)
    rows1, cols1, rows2, cols2 = (np.ascontiguousarray(v, np.int64) for v in (y1, x1, y2, x2))
    return Edges(starts, rows1, cols1, rows2, cols2, np.ascontiguousarray(f), np.ascontiguousarray(s))


class Neighbourhood:
    """A block of samples with everything within reach of it, from an even row and column of the terrain.

    Args:
        context: the terrain's. rows, cols: (first, last) of the block. reach: metres; inf: the whole terrain.

    Attributes:
        heights, gx, gy: (rows, cols) of the neighbourhood. row0, col0: where it begins in the terrain.
        inner: the block's rows and columns in it, (first, last, left, right).
    """

    def __init__(self, context: Context, row0: int, row1: int, col0: int, col1: int, reach: float) -> None:
        inverse = np.linalg.inv(context.linear)
        rows, cols = context.shape
        if math.isfinite(reach):
            over, down = (math.ceil(reach * float(np.linalg.norm(v))) + 2 for v in inverse)
        else:
            over, down = cols, rows
        r0, c0 = max(row0 - down, 0) & ~1, max(col0 - over, 0) & ~1
        r1, c1 = min(max(row1 + down, r0 + 2), rows), min(max(col1 + over, c0 + 2), cols)
        self.row0, self.col0 = r0, c0
        self.heights = np.ascontiguousarray(context.heights(r0, r1, c0, c1), np.float32)
        self.inner = row0 - r0, row1 - r0, col0 - c0, col1 - c0
        a, b, c, d = self.inner
        self.gx = np.full(self.heights.shape, np.nan, np.float32)
        self.gy = np.full(self.heights.shape, np.nan, np.float32)
        self.gx[a:b, c:d], self.gy[a:b, c:d] = context.gradient(row0, row1, col0, col1)
        self.inverse = inverse
        self._scene: Scene | None = None

    def part(self, row0: int, row1: int, col0: int, col1: int) -> Neighbourhood:
        """The same neighbourhood around a part of its block (of the terrain's rows and columns)."""
        other = copy.copy(self)
        other.inner = row0 - self.row0, row1 - self.row0, col0 - self.col0, col1 - self.col0
        return other

    def block(self, array: Values) -> Values:
        """The block's part of an array of the neighbourhood."""
        a, b, c, d = self.inner
        return array[..., a:b, c:d]

    def samples(self, lift: float) -> Samples:
        """The block's samples; rays begin ``lift`` metres above the ground."""
        from orograph.lighting.occlusion_kernels import Samples

        z, gx, gy = (np.ascontiguousarray(self.block(a)) for a in (self.heights, self.gx, self.gy))
        return Samples(z, gx, gy, self.row0 + self.inner[0], self.col0 + self.inner[2], self.inverse, lift)

    def scene(self) -> Scene:
        """The caster's scene of these heights."""
        if self._scene is None:
            from orograph.raycast.stack import HeightWindow, Stack

            heights = self.heights
            short = [max(2 - n, 0) for n in heights.shape]
            if any(short):  # a caster needs a cell; a single row or column has no surface
                heights = np.pad(heights, [(0, n) for n in short], constant_values=np.nan)
            shape = (self.row0 + heights.shape[0], self.col0 + heights.shape[1])
            self._scene = Stack.build([HeightWindow(0, self.col0, self.row0, heights)], shape, 1).scene
        return self._scene


def lift(context: Context) -> float:
    """How far above the ground rays begin, metres."""
    return LIFT * float(np.sqrt(abs(np.linalg.det(context.linear))))


def flat_only(of: Context | Options) -> None:
    """Raise UsageError if curvature is requested: rays and walks are straight over a plane."""
    options = of.options if isinstance(of, Context) else of
    if options.curvature:
        raise UsageError(
            "Rays and walks assume a flat Earth; only swept horizons support its curvature.",
            remedy='Leave out `curvature`, or sweep horizons: `method="horizon"`, without a radius.',
        )


def check_reach(context: Context, reach: float, height: int, width: int, jobs: int) -> None:
    """Raise UsageError if ``jobs`` blocks of height × width samples do not fit in memory with their neighbourhoods."""
    tall, wide = context.shape
    if math.isfinite(reach):
        over, down = (math.ceil(reach * float(np.linalg.norm(v))) + 2 for v in np.linalg.inv(context.linear))
        tall, wide = min(tall, height + 2 * down), min(wide, width + 2 * over)
    need = _PER_SAMPLE * tall * wide * (jobs if math.isfinite(reach) else 1)
    if need > context.budget:
        raise UsageError(
            f"The neighbourhood of a block of samples is {tall} × {wide} samples, which takes {need >> 20} MiB in "
            f"{jobs} threads, more than the {context.budget >> 20} MiB available.",
            remedy="Give a radius or a smaller one, allow more memory (`max_memory`), or use fewer threads (`jobs`).",
        )


def by_blocks(
    context: Context, reach: float, work: Callable[[Neighbourhood], Values], what: str, key: str = ""
) -> Blocks:
    """Windows of the terrain at fixed places, made by ``work(neighbourhood) → (bands, rows, cols)`` in threads.

    Without a limit of reach there is one neighbourhood, the whole terrain. Windows are kept under ``key`` if the
    context keeps partial results.

    Raises:
        UsageError: what lies within reach of a block does not fit in the memory allowed.
    """
    rows, cols = context.shape
    check_reach(context, reach, _BLOCK, _WIDTH, context.jobs)
    whole = None if math.isfinite(reach) else Neighbourhood(context, 0, rows, 0, cols, reach)
    if whole is not None:
        whole.scene()

    def new(row0: int, row1: int, col0: int, col1: int) -> Values:
        window = row0, row1, col0, col1
        return work(whole.part(*window) if whole is not None else Neighbourhood(context, *window, reach))

    def make(row0: int, row1: int, col0: int, col1: int) -> Values:
        if context.kept is None or not key:
            return new(row0, row1, col0, col1)
        return context.kept.window(key, row0, col0, lambda: new(row0, row1, col0, col1))

    with context.progress.task(what, total=-(-rows // _BLOCK) * -(-cols // _WIDTH)) as task:
        windows = (
            w for w in rectangles(context.shape, _BLOCK, _WIDTH) if context.only is None or meet(w, context.only)
        )
        for block in map_ordered(lambda w: (w[0], w[2], make(*w)), windows, context.jobs):
            yield block
            task.advance()


def meet(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    """Whether windows (row0, row1, col0, col1) have samples in common."""
    return max(a[0], b[0]) < min(a[1], b[1]) and max(a[2], b[2]) < min(a[3], b[3])


def _rays(context: Context, ways: Transmission, rays: int, seed: int) -> Blocks:
    from orograph.lighting.occlusion_kernels import ray_occlusion

    def work(near: Neighbourhood) -> Values:
        samples = near.samples(lift(context))
        out = np.empty((1, *samples.heights.shape), np.float32)
        ray_occlusion(near.scene(), samples, ways, rays, seed, out[0])
        return out

    return by_blocks(context, ways.radius, work, "Casting ambient rays", "ambient-occlusion")


def _walks(context: Context, ways: Transmission, azimuths: int) -> Blocks:
    from orograph.lighting.occlusion_kernels import walk_occlusion

    fan = _fan(azimuths)
    tables = [edges(context.linear, a, ways.radius) for a in fan]

    def work(near: Neighbourhood) -> Values:
        out = np.zeros(near.heights.shape, np.float32)
        known = near.heights[np.isfinite(near.heights)]
        highest = float(known.max()) if known.size else 0.0
        for azimuth, table in zip(fan, tables):
            toward = direction(azimuth)
            walk_occlusion(near.heights, near.gx, near.gy, highest, table, toward, ways, near.inner, out)
        out /= np.float32(azimuths)
        out[np.isnan(near.heights)] = np.nan
        return np.clip(near.block(out), 0.0, 1.0)[None]

    return by_blocks(context, ways.radius, work, "Walking to occluders", "ambient-occlusion")


def _sweeps(context: Context) -> Sweep:
    from orograph.lighting.occlusion_kernels import add_sky

    fan = _fan(context.options.azimuths)

    def add(out: Values, slopes: Values, gx: Values, gy: Values, row0: int, col0: int, index: int) -> None:
        add_sky(slopes, gx, gy, *direction(fan[index]), row0, col0, out[0])

    def finish(canvas: Values, window: Window) -> Values:
        mean: Values = canvas[:, window[0] : window[1], window[2] : window[3]] / np.float32(len(fan))
        return np.asarray(np.clip(mean, 0.0, 1.0))

    return Sweep(fan, 1, by_azimuth(context, add), finish, lowest=-math.inf)


def _fan(azimuths: int) -> Array:
    """Azimuths between those of the samples' rows and columns, along which profiles are degenerate."""
    return np.asarray((np.arange(azimuths) + 0.5) * (360.0 / azimuths))


def make(context: Context) -> Blocks | Sweep:
    """The product: ``method``, ``rho`` and ``seed`` among the other options.

    Raises:
        UsageError: there is no such method; and what the method raises.
    """
    options = context.options
    check(options)
    method: Method = options.more.get("method", "horizon")
    if method in ELSEWHERE:
        return cast(Blocks, importlib.import_module(ELSEWHERE[method]).run(context))
    ways = transmission(options.more.get("rho", "step"), options.radius)
    if method == "rays":
        return _rays(context, ways, options.rays, int(options.more.get("seed", 0)))
    return _walks(context, ways, options.azimuths) if math.isfinite(ways.radius) else _sweeps(context)


def check(options: Options) -> None:
    """Raise UsageError if the method, ρ, radius and rays in the options do not fit together."""
    method: Method = options.more.get("method", "horizon")
    if method != "horizon" and method != "rays" and method not in ELSEWHERE:
        raise UsageError(f"There is no method {method!r}; the methods are horizon, rays, {' and '.join(ELSEWHERE)}.")
    ways = transmission(options.more.get("rho", "step"), options.radius)
    if method == "rays" and options.rays < 1:
        raise UsageError(f"At least one ray is needed, not {options.rays}.")
    if method != "horizon" or math.isfinite(ways.radius):
        flat_only(options)


def ambient_occlusion(
    heights: ArrayLike,
    linear: ArrayLike,
    *,
    radius: float | None = None,
    rho: Rho = "step",
    method: Method = "horizon",
    azimuths: int = 32,
    rays: int = 256,
    cones: int = 64,
    seed: int = 0,
    jobs: int | None = None,
) -> Heights:
    """Ambient occlusion of every sample (see the module).

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform: metres east and north per column and per row.
        radius: R, metres; None: unlimited (a step only).
        rho: "step", "linear" or a function of L in metres.
        method: "horizon" (``azimuths`` of them), "rays" (``rays`` per sample, chosen by ``seed``), or on the GPU
            "shadow-maps" (``rays`` directions for all samples) or "cone-tracing" (``cones`` per sample, about).
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        (rows, cols) float32 in [0, 1]: 1 where nothing occludes; NaN where heights are.

    Raises:
        UsageError: wrong shapes, an unknown ρ or method, too few rays or azimuths.
        NoAdapterError: there is no GPU for a method that needs one (``orograph.gpu.device``).
    """
    more = {"rho": rho, "method": method, "seed": seed, "cones": cones}
    context = context_of(heights, linear, Options(azimuths, radius=radius, rays=rays, more=more), jobs=jobs)
    return np.asarray(compute(context, "ambient-occlusion")[0])


PRODUCTS = [
    Product(
        "ambient-occlusion",
        lambda options: ["ambient-occlusion"],
        "1",
        "The share of ambient light that reaches the ground: all around its normal, as far as the radius.",
        make,
        check=check,
    )
]
