"""Hours of direct sun on the ground over a day, a month or a year, under a cloudless sky.

A sun counts for the time step around it, in proportion to the part of its disc above the ground's horizon; the horizon
of inclined ground is at least its own plane, so ground that faces away from the sun gets nothing. The suns are those of
``energy``. As there, each azimuth needs one table, here of the hours of all its suns above an altitude; one lookup with
the horizon's angle gives the hours from that azimuth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.lighting.context import Context, Options, Values
from orograph.lighting.energy import FINE, LOWEST, Suns, asked, period
from orograph.lighting.gather import Sweep, Window, by_azimuth
from orograph.lighting.products import Product
from orograph.lighting.sweep_lines import direction


@kernel
def _add(
    slope: Values, gx: Values, gy: Values, toward: tuple[float, float], table: Values, row0: int, col0: int, out: Values
) -> None:
    """Add one azimuth's hours to ``out``.

    slope, gx, gy: (rows, cols) of the window at (row0, col0) of out. toward: the azimuth's unit vector, east and north.
    table: (altitudes,), hours.
    """
    (east, north), count = toward, table.shape[0]
    for i in range(slope.shape[0]):
        for j in range(slope.shape[1]):
            t = max(np.float64(slope[i, j]), np.float64(gx[i, j]) * east + np.float64(gy[i, j]) * north)
            if t != t:
                out[i + row0, j + col0] = np.nan
                continue
            x = (np.degrees(np.arctan(t)) - LOWEST) / FINE
            k = min(max(np.int64(x), 0), count - 2)
            out[i + row0, j + col0] += np.float32(table[k] + (table[k + 1] - table[k]) * min(max(x - k, 0.0), 1.0))


def make(context: Context) -> Sweep:
    """The product: ``date`` (needed) and ``step`` (minutes, 10) among the other options."""
    options = context.options
    date, step, _ = asked(options, "Sunshine")
    table = Suns.over(context.terrain.grid, date, step).hours_above(options.azimuths)
    fan = options.directions()
    shine: NDArray[np.bool_] = np.asarray(table.any(axis=1))

    def add(out: Values, slopes: Values, gx: Values, gy: Values, row0: int, col0: int, index: int) -> None:
        # Without a sun the table is 0, but missing samples are still marked.
        if shine[index] or index == 0:
            _add(slopes, gx, gy, direction(fan[index]), table[index], row0, col0, out[0])

    def finish(canvas: Values, window: Window) -> Values:
        return canvas[:, window[0] : window[1], window[2] : window[3]].copy()

    return Sweep(fan, 1, by_azimuth(context, add), finish)


def _check(options: Options) -> None:
    asked(options, "Sunshine")


def _range(band: str, options: Options) -> dict[str, Any]:
    """The range of 8-bit files and stores: up to a sun that never sets."""
    begin, end = period(str(options.more.get("date", "2026-06-21")))
    return {"byte": (0.0, 24.0 * (end - begin).days)}


PRODUCTS = [
    Product(
        "sunshine",
        lambda options: ["hours"],
        "h",
        "Hours of direct sun on the ground over a day, a month or a year, under a cloudless sky.",
        make,
        about=_range,
        check=_check,
    )
]
