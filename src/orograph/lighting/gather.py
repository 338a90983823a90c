"""The common part of products that sum over horizons, and how several of them share one sweep.

A product that is a sum over horizons is described by a ``Sweep``: its azimuths, what to add to a canvas, and how to
finish the sums. Products that sweep the same azimuths in the same way (sky-view factor, visible sky, apertures,
horizons) are swept together: the terrain is read and its hulls are built once for all of them. With ``Context.kept``
the canvases are kept after each pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.context import Blocks, Context, Values
from orograph.lighting.raster import Canvas, rectangles, trim
from orograph.lighting.sweep import Block, fold
from orograph.parallel import for_each, map_ordered

if TYPE_CHECKING:
    from orograph.lighting.products import Product

_AROUND = 1 << 16
"""Bytes that the system maps around an accessed place of a file."""
_TOUCHED = 16 << 20
"""Bytes of a canvas on disk that a thread may have in memory before releasing them."""
_WINDOW = 1 << 20
"""Values of a window that a thread finishes at once."""

Add = Callable[[Values, Block, int, int], None]
"""(canvas (bands, rows, cols), block, first, last): add a block's rows [first, last); from threads, rows apart."""
AddOne = Callable[[Values, Values, Values, Values, int, int, int], None]
"""(canvas (bands, rows, cols), slopes (r, c), gx (r, c), gy (r, c), row0, col0, index of the azimuth): add the horizons
of a window, which begins at (row0, col0) of the canvas."""
Window = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Sweep:
    """A product as sums over horizons.

    Attributes:
        azimuths: (n,) degrees from grid north, in any order; each sample gets them in the same order.
        bands: of the canvas, which begins with zeros.
        add: adds a block's horizons to the canvas.
        finish: (canvas, window) → values (bands of the product, rows, cols) of the window.
        lowest, below: as for ``Context.horizons``.
    """

    azimuths: NDArray[np.float64]
    bands: int
    add: Add
    finish: Callable[[Values, Window], Values]
    lowest: float = 0.0
    below: bool = False

    @property
    def group(self) -> tuple[Any, ...]:
        """The key of sweeps that can be shared."""
        return self.azimuths.tobytes(), self.lowest, self.below


def by_azimuth(context: Context, add: AddOne) -> Add:
    """Make an ``Add`` from a function of one azimuth, with the ground's gradient (NaN where missing)."""

    def strip(canvas: Values, block: Block, first: int, last: int) -> None:
        row, end = block.row0 + first, block.row0 + last
        gx, gy = (np.ascontiguousarray(g) for g in context.gradient(row, end, block.col0, block.col1))
        for k, index in enumerate(block.azimuths):
            add(canvas, block.slopes[k, first:last], gx, gy, row, block.col0, int(index))

    return strip


def produce(context: Context, products: Sequence[Product]) -> Iterator[tuple[int, int, int, Values]]:
    """Make products one after the other: (the product's number, row0, col0, values (bands, rows, cols)).

    Raises:
        UsageError: an option of a product makes no sense (raised before any is made).
    """
    made, canvases = _begun(context, products)
    for k, each in enumerate(made):
        if not isinstance(each, Sweep):
            yield from ((k, row, col, values) for row, col, values in each)
            continue
        canvas = canvases.pop(k)
        windows = list(rectangles(context.shape, 256, max(_WINDOW // 256 // each.bands // 256 * 256, 256)))
        with context.progress.task(f"Writing {products[k].name}", total=len(windows)) as task:
            finished = map_ordered(partial(each.finish, canvas.values), windows, context.jobs)
            for window, values in zip(windows, finished):
                yield k, window[0], window[2], values
                canvas.release()
                task.advance()


def readers(context: Context, products: Sequence[Product]) -> Iterator[Callable[[Window], Values]]:
    """Make products, each as a function that returns any window of it: window → values (bands, rows, cols).

    A function holds its product's data until the last reference to the function is gone.
    """
    made, canvases = _begun(context, products)
    for k, each in enumerate(made):
        if isinstance(each, Sweep):
            yield _finisher(each, canvases.pop(k))
            continue
        canvas = context.canvas(len(products[k].bands(context.options)))
        for row, col, values in each:
            canvas.values[:, row : row + values.shape[1], col : col + values.shape[2]] = values
            canvas.release()
        yield _finisher(None, canvas)


def _finisher(sweep: Sweep | None, canvas: Canvas) -> Callable[[Window], Values]:
    def read(window: Window) -> Values:
        row0, row1, col0, col1 = window
        made = canvas.values[:, row0:row1, col0:col1] if sweep is None else sweep.finish(canvas.values, window)
        canvas.release()
        return np.asarray(made)

    return read


def _begun(context: Context, products: Sequence[Product]) -> tuple[list[Blocks | Sweep], dict[int, Canvas]]:
    """The prepared products, and the canvases of those that are swept, by their number."""
    made = [p.make(context) for p in products]
    canvases: dict[int, Canvas] = {}
    for k, each in enumerate(made):
        if isinstance(each, Sweep) and k not in canvases:
            alike = {i: m for i, m in enumerate(made) if isinstance(m, Sweep) and m.group == each.group}
            canvases.update(_swept(context, alike, [products[i].name for i in alike]))
    return made, canvases


def _swept(context: Context, sweeps: dict[int, Sweep], names: Sequence[str]) -> dict[int, Canvas]:
    """The canvases of sweeps of one group."""
    canvases = {k: context.canvas(sweep.bands) for k, sweep in sweeps.items()}
    all_of_them = list(canvases.values())
    key, kept = "+".join(names), context.kept
    done = [] if kept is None else kept.load(key, all_of_them)

    def add(block: Block, first: int, last: int) -> None:
        for k, sweep in sweeps.items():
            canvas = canvases[k]
            if not canvas.on_disk:
                sweep.add(canvas.values, block, first, last)
                continue
            # Each accessed row of a band of columns brings the pages around it into memory.
            rows = max(8, _TOUCHED // (_AROUND * sweep.bands))
            for row in range(first, last, rows):
                sweep.add(canvas.values, block, row, min(row + rows, last))
                canvas.release()

    def after(block: Block) -> None:
        if kept is not None and block.ends:
            done.extend(int(k) for k in block.azimuths)
            kept.save(key, all_of_them, done)
        for canvas in canvases.values():
            canvas.release()

    one = next(iter(sweeps.values()))
    what = "Sweeping horizons for " + ", ".join(names)
    fold(
        context.horizons(one.azimuths, lowest=one.lowest, below=one.below, what=what, skip=frozenset(done)), add,
        context.jobs, after,
    )  # fmt: skip
    trim()
    return canvases


def collected(context: Context, blocks: Blocks, bands: int) -> Values:
    """Blocks as one array (bands, rows, cols)."""
    out = np.full((bands, *context.shape), np.nan, np.float32)
    for row, col, values in blocks:
        out[:, row : row + values.shape[1], col : col + values.shape[2]] = values
    return out


def whole(context: Context, product: Product) -> Values:
    """A product as one array in memory, (bands, rows, cols) float32."""
    bands = len(product.bands(context.options))
    (made,), canvases = _begun(context, [product])
    if not isinstance(made, Sweep):
        return collected(context, made, bands)
    canvas, sweep = canvases[0], made
    out = np.empty((bands, *context.shape), np.float32)

    def finish(window: Window) -> None:
        out[:, window[0] : window[1], window[2] : window[3]] = sweep.finish(canvas.values, window)
        canvas.release()

    height = max(8, (1 << 16) // context.shape[1])
    for_each(finish, list(rectangles(context.shape, height)), context.jobs)
    return out
