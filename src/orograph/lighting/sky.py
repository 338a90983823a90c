"""How much sky is visible above the horizon: sky-view factor, visible sky, and the horizon's angle itself.

With h(φ) the elevation of the horizon in azimuth φ (at least 0), over N evenly spread azimuths:

- the *visible sky*, the visible share of the hemisphere's solid angle, unweighted: 1 − mean sin h. Zakšek, Oštir &
  Kokalj 2011 ("Sky-View Factor as a Relief Visualization Technique", Remote Sensing 3(2), eq. 4) and GRASS's r.skyview
  call it the sky-view factor;
- the *sky-view factor of a horizontal surface*, the share of a uniform sky's light that falls on it, with each
  direction weighted by its cosine: 1 − mean sin² h;
- the *sky-view factor of the inclined surface itself* (Dozier & Frew 1990, "Rapid Calculation of Terrain Parameters for
  Radiation Modeling from Digital Elevation Data", IEEE TGRS 28(5), eq. 7b), where the sky is above both its horizon and
  its own plane. With slope S, aspect A and H the zenith angle of the higher of the two: mean [cos S sin² H + sin S
  cos(φ − A) (H − sin H cos H)]; (1 + cos S) / 2 on an endless plane.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._numba import inlined, kernel
from orograph.errors import UsageError
from orograph.lighting.context import Context, Options
from orograph.lighting.gather import Sweep, Window, whole
from orograph.lighting.products import Product
from orograph.lighting.sweep import Block
from orograph.lighting.sweep_lines import direction
from orograph.progress import SILENT, Progress

Values = NDArray[np.float32]
Measure = Literal["sky-view", "sky-view-slope", "visible-sky"]


@inlined
def arctangent(t: np.float32) -> np.float32:
    """arctan t, radians, for t ≥ 0: a polynomial, which a compiler can vectorise.

    Abramowitz & Stegun 4.4.49, error below 2e-8 before rounding.
    """
    one = np.float32(1.0)
    q = min(t, one / t)
    s = q * q
    p = np.float32(0.0028662257)
    p = p * s - np.float32(0.0161657367)
    p = p * s + np.float32(0.0429096138)
    p = p * s - np.float32(0.0752896400)
    p = p * s + np.float32(0.1065626393)
    p = p * s - np.float32(0.1420889944)
    p = p * s + np.float32(0.1999355085)
    p = p * s - np.float32(0.3333314528)
    a = q + q * s * p
    return np.float32(0.5 * np.pi) - a if t > one else a


# Kernels on rows: a compiler cannot exclude negative indices into whole arrays, and then does not vectorise.


@kernel
def _sine(slopes: Values, total: Values) -> None:
    """Add sin h."""
    one = np.float32(1.0)
    for j in range(len(total)):
        total[j] += slopes[j] / np.sqrt(one + slopes[j] * slopes[j])


@kernel
def _square(slopes: Values, total: Values) -> None:
    """Add sin² h."""
    one = np.float32(1.0)
    for j in range(len(total)):
        t2 = slopes[j] * slopes[j]
        total[j] += t2 / (one + t2)


@kernel
def _inclined(slopes: Values, gx: Values, gy: Values, east: np.float32, north: np.float32, total: Values) -> None:
    """Add an azimuth's contribution to inclined samples, without their factor cos S."""
    one, right = np.float32(1.0), np.float32(0.5 * np.pi)
    for j in range(len(total)):
        rise = gx[j] * east + gy[j] * north
        t = max(slopes[j], rise)  # a slope hides the sky behind it
        square = one / (one + t * t)
        total[j] += square - rise * (right - arctangent(t) - t * square)


@kernel
def _add_sine(
    slopes: Values, cols: int, first: int, last: int, square: bool, row0: int, col0: int, total: Values
) -> None:
    """Add sin h, or sin² h, of all azimuths to the rows [first, last) of a window of ``total``, ``cols`` wide."""
    for i in range(first, last):
        for k in range(slopes.shape[0]):
            if square:
                _square(slopes[k, i, :cols], total[row0 + i, col0 : col0 + cols])
            else:
                _sine(slopes[k, i, :cols], total[row0 + i, col0 : col0 + cols])


@kernel
def _add_inclined(
    slopes: Values, cols: int, first: int, last: int, gx: Values, gy: Values, toward: Values, row0: int, col0: int,
    total: Values,
) -> None:  # fmt: skip
    """Add the sky in each azimuth ``toward`` (k, 2) (east, north) for inclined samples, without their factor cos S.

    ``gx``, ``gy``: (last − first, cols) rise per metre east and north.
    """
    for i in range(first, last):
        for k in range(slopes.shape[0]):
            _inclined(slopes[k, i, :cols], gx[i - first], gy[i - first], toward[k, 0], toward[k, 1],
                      total[row0 + i, col0 : col0 + cols])  # fmt: skip


def sweep_of(context: Context, measure: Measure) -> Sweep:
    """A measure as sums of its integrand over the azimuths in the options."""
    azimuths = context.options.directions()
    toward = np.array([direction(a) for a in azimuths], np.float32)

    def add(canvas: Values, block: Block, first: int, last: int) -> None:
        at, total, cols = (block.row0, block.col0), canvas[0], block.col1 - block.col0
        if measure == "sky-view-slope":
            gx, gy = context.gradient(block.row0 + first, block.row0 + last, block.col0, block.col1)
            gx, gy = np.ascontiguousarray(gx), np.ascontiguousarray(gy)
            _add_inclined(block.padded, cols, first, last, gx, gy, toward[block.azimuths], *at, total)
        else:
            _add_sine(block.padded, cols, first, last, measure == "sky-view", *at, total)

    return Sweep(azimuths, 1, add, lambda canvas, window: finish(context, canvas[0], measure, window))


def finish(context: Context, total: Values, measure: Measure, window: tuple[int, int, int, int]) -> Values:
    """The measure (1, rows, cols) of a window from its sums."""
    row0, row1, col0, col1 = window
    mean = total[row0:row1, col0:col1] / np.float32(context.options.azimuths)
    if measure == "sky-view-slope":
        gx, gy = context.gradient(*window)
        mean /= np.sqrt(np.float32(1.0) + gx * gx + gy * gy)
    else:
        np.subtract(np.float32(1.0), mean, out=mean)
    np.clip(mean, 0.0, 1.0, out=mean)
    return mean[None]


def sky_view(
    heights: ArrayLike,
    linear: ArrayLike,
    azimuths: int = 16,
    *,
    measure: Measure = "sky-view",
    radius: float | None = None,
    jobs: int | None = None,
    progress: Progress = SILENT,
) -> Values:
    """How much sky every sample of an array sees: a mean over ``azimuths`` horizons, the first in the north.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuths: how many, at least 3.
        measure: ``"sky-view"``: the sky-view factor of a horizontal surface; ``"sky-view-slope"``: that of the
            inclined surface itself; ``"visible-sky"``: the visible share of the hemisphere's solid angle.
        radius: metres beyond which nothing occludes; None: unlimited.
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        (rows, cols) float32 in [0, 1]; NaN where heights are.

    Raises:
        UsageError: the shapes are wrong, the cells degenerate, too few azimuths, or an unknown measure.
    """
    from orograph.lighting.arrays import context_of

    if measure not in get_args(Measure):
        raise UsageError(f"There is no measure {measure!r}; there are {', '.join(get_args(Measure))}.")
    context = context_of(heights, linear, Options(azimuths=azimuths, radius=radius), jobs=jobs, progress=progress)
    return np.asarray(whole(context, _sky(measure))[0])


def _sky(measure: Measure) -> Product:
    name = {"sky-view-slope": "sky-view-factor", "sky-view": "sky-view-horizontal", "visible-sky": "visible-sky"}
    doc = {
        "sky-view-slope": "share of a uniform sky's light that falls on the inclined surface (Dozier & Frew 1990)",
        "sky-view": "share of a uniform sky's light that falls on a horizontal surface",
        "visible-sky": "share of the hemisphere's solid angle that is sky (1 - mean sin horizon)",
    }
    return Product(
        name[measure], lambda options: [name[measure]], "1", doc[measure], lambda context: sweep_of(context, measure)
    )


def _horizon(context: Context) -> Sweep:
    azimuths = context.options.directions()

    def keep(canvas: Values, block: Block, first: int, last: int) -> None:
        rows = slice(block.row0 + first, block.row0 + last)
        for k, index in enumerate(block.azimuths):
            angle = np.degrees(np.arctan(block.slopes[k, first:last]))
            canvas[index, rows, block.col0 : block.col1] = angle

    def window(canvas: Values, at: Window) -> Values:
        return canvas[:, at[0] : at[1], at[2] : at[3]]

    return Sweep(azimuths, len(azimuths), keep, window)


def _azimuth_names(options: Options) -> list[str]:
    return [f"horizon {a:g}" for a in options.directions()]


PRODUCTS = (
    _sky("sky-view-slope"),
    _sky("sky-view"),
    _sky("visible-sky"),
    Product(
        "horizon",
        _azimuth_names,
        "degrees",
        "elevation of the horizon above a level one, one band per azimuth",
        _horizon,
        (0.0, 90.0),
    ),
)

__all__ = ["PRODUCTS", "Measure", "finish", "sky_view", "sweep_of"]
