"""Shadows of a sun that is a disc: how much of it each sample sees over the horizon, and why no more.

Two bands:

1. ``fraction``: the part of the disc's area above the skyline, 0 to 1; NaN where heights are missing. Direct light on
   the ground is this times the cosine of incidence.
2. ``code``: 0 missing; 1 lit (the whole disc is seen); 2 penumbra (a part of it); 3 self shadow (the ground faces away
   from the disc's centre: no direct light, whatever is seen); 4 cast shadow (it faces the sun, which other ground
   hides).

The skyline is the horizon in the sun's azimuth. With one *strip* it counts as level across the disc, which covers half
a degree of azimuth: exact where the skyline is level there. If it is inclined by 45°, the error is up to a tenth of the
disc; if it is vertical, up to a half. With n strips the disc is cut into n upright strips, each with the horizon of its
own azimuth, placed and weighted by Gauss–Chebyshev quadrature of the second kind (whose weight is the disc's own
chord); n horizons are swept.

Horizons are those of the profiles along swept lines (``sweep``), interpolated between samples; behind the terrain's
border the horizon is level. ``shadow_rays`` instead sends rays over the disc to the surface itself.
Angles in degrees; azimuth from grid north.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.lighting.arrays import context_of
from orograph.lighting.context import Context, Options, Values
from orograph.lighting.gather import Sweep, Window, by_azimuth, collected
from orograph.lighting.products import Product, compute
from orograph.lighting.shade import disc_fraction
from orograph.lighting.sun import Sun

MISSING, LIT, PENUMBRA, SELF, CAST = range(5)
"""The codes of the second band."""
MEANINGS = ("no data", "lit", "penumbra", "self-shadow", "cast shadow")

BANDS = ["fraction", "code"]
_STEEP = 89.0


def strips_of(sun: Sun, strips: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A disc cut into upright strips: their azimuths, half heights (degrees), and weights (of sum 1); each (n,)."""
    i = np.arange(1, strips + 1) * (math.pi / (strips + 1))
    x, weights = np.cos(i), 2.0 / (strips + 1) * np.sin(i) ** 2
    across = sun.diameter / 2 / math.cos(math.radians(min(abs(sun.altitude), _STEEP)))
    return sun.azimuth + across * x, sun.diameter / 2 * np.sin(i), weights


def make(context: Context) -> Sweep:
    """The product, of ``options.sun``; ``strips`` (1) and ``diameter`` (0.53) among the other options."""
    options = context.options
    strips = int(options.more.get("strips", 1))
    if strips < 1:
        raise UsageError(f"The sun's disc must be cut into at least one strip, not {strips}.")
    sun = Sun(*options.sun, *([options.more["diameter"]] if "diameter" in options.more else []))
    azimuths, halves, weights = strips_of(sun, strips)
    east, north, up = sun.direction

    def add(out: Values, slopes: Values, gx: Values, gy: Values, row0: int, col0: int, index: int) -> None:
        window = np.s_[row0 : row0 + slopes.shape[0], col0 : col0 + slopes.shape[1]]
        horizon = np.degrees(np.arctan(slopes.astype(np.float64)))
        if strips == 1:
            seen = disc_fraction(horizon, sun.altitude, sun.diameter)
        elif halves[index] > 0:
            seen = weights[index] * np.clip(0.5 + (sun.altitude - horizon) / (2 * halves[index]), 0.0, 1.0)
        else:
            seen = weights[index] * (sun.altitude > horizon)
        seen[np.isnan(horizon)] = np.nan
        out[0][window] += seen.astype(np.float32)
        if index == 0:
            away = up - gx.astype(np.float64) * east - gy.astype(np.float64) * north <= 0.0
            out[1][window] = np.where(away, SELF, LIT)

    def finish(canvas: Values, window: Window) -> Values:
        total, facing = canvas[:, window[0] : window[1], window[2] : window[3]]
        # Weights add up to 1 except for rounding, which must not put the light of a whole disc into the penumbra.
        fraction = np.where(total < 1e-6, np.float32(0), np.where(total > 1 - 1e-6, np.float32(1), total))
        code = np.where(fraction <= 0, CAST, np.where(fraction < 1, PENUMBRA, LIT))
        code = np.where(np.isnan(fraction), MISSING, np.where(facing == SELF, SELF, code))
        return np.stack([fraction, code.astype(np.float32)])

    return Sweep(azimuths, 2, by_azimuth(context, add), finish)


def shadow(
    heights: ArrayLike, linear: ArrayLike, sun: Sun, *, strips: int = 1, jobs: int | None = None
) -> tuple[Values, Values]:
    """The part of the sun's disc that every sample sees, and its code.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform: metres east and north per column and per row.
        strips: into how many upright strips the disc is cut; as many horizons are swept.
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        fraction, code: (rows, cols) float32, see the module.

    Raises:
        UsageError: wrong shapes, degenerate cells, fewer than one strip.
    """
    options = Options(sun=(sun.azimuth, sun.altitude), more={"strips": strips, "diameter": sun.diameter})
    fraction, code = compute(context_of(heights, linear, options, jobs=jobs), "shadow")
    return fraction, code


def shadow_rays(
    heights: ArrayLike,
    linear: ArrayLike,
    sun: Sun,
    *,
    rays: int = 64,
    cosine: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> Values:
    """The part of the sun's disc that every sample sees, by rays to the surface: the reference for soft shadows.

    Args:
        sun: its disc is a cap of any diameter below 90°.
        rays: per sample, evenly spread over the disc and shifted at random per sample.
        cosine: weigh each ray by its cosine to the normal (below it: 0): the light that arrives, relative to what a
            surface square to the unobstructed disc receives.

    Returns:
        (rows, cols) float32; NaN where heights are.

    Raises:
        UsageError: wrong shapes, degenerate cells, fewer than one ray.
    """
    from orograph.lighting.occlusion import Neighbourhood, by_blocks, lift
    from orograph.lighting.occlusion_kernels import ray_disc

    if rays < 1:
        raise UsageError(f"At least one ray is needed, not {rays}.")
    context = context_of(heights, linear, Options(), jobs=jobs)
    axis, rim = np.array(sun.direction), math.cos(math.radians(sun.diameter / 2))

    def work(near: Neighbourhood) -> Values:
        samples = near.samples(lift(context))
        out = np.empty((1, *samples.heights.shape), np.float32)
        ray_disc(near.scene(), samples, axis, rim, cosine, rays, seed, out[0])
        return out

    seen: Values = collected(context, by_blocks(context, math.inf, work, "Casting rays to the sun"), 1)[0]
    # The rim of a wide disc gives less on a surface that faces its middle: the mean cosine is (1 + cos radius) / 2.
    return np.asarray(seen / np.float32((1 + rim) / 2)) if cosine else seen


PRODUCTS = [
    Product(
        "shadow",
        lambda options: BANDS,
        "1",
        "The part of the sun's disc that is seen, and a code: 0 missing, 1 lit, 2 penumbra, 3 self, 4 cast shadow.",
        make,
        about=lambda band, options: {"codes": MEANINGS} if band == "code" else {},
    )
]
