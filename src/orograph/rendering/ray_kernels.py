"""Rays through pixels: where they end on the ground.

All arrays run over samples of a picture; one that met no ground has NaN in its depth and position.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.viewpoint import RayBasis


class PixelRays(NamedTuple):
    """The rays through the pixels of a picture, in the terrain's CRS.

    Attributes:
        basis: ``View.ray_basis``. exaggeration: of heights.
        pixel: metres that a pixel measures at unit depth, or (``parallel``) anywhere.
    """

    basis: RayBasis
    exaggeration: float
    pixel: float
    parallel: bool


class ToSamples(NamedTuple):
    """From the terrain's CRS to sample coordinates.

    Attributes:
        linear: (3, 3). offset: (3,). spacing: metres from sample to sample.
    """

    linear: NDArray[np.float64]
    offset: NDArray[np.float64]
    spacing: float


@kernel
def ends(px, py, t, pixels, to_samples, points, rays, width):
    """Where ``PixelRays`` at pixel positions (n,) end at depths t (n,).

    Seen at a slant a pixel covers more ground one way; the geometric mean is what an isotropic filter can do.

    Args:
        points: out (n, 3), sample coordinates. rays: out (n, 3), unit directions, stretched. width: out (n,), of a
            pixel on the ground, in samples.
    """
    o0, ou, ov, d0, du, dv = pixels.basis
    linear, offset = to_samples.linear, to_samples.offset
    for i in range(len(px)):
        x = d0[0] + px[i] * du[0] + py[i] * dv[0]
        y = d0[1] + px[i] * du[1] + py[i] * dv[1]
        z = d0[2] + px[i] * du[2] + py[i] * dv[2]
        wx = o0[0] + px[i] * ou[0] + py[i] * ov[0] + t[i] * x
        wy = o0[1] + px[i] * ou[1] + py[i] * ov[1] + t[i] * y
        points[i, 0] = linear[0, 0] * wx + linear[0, 1] * wy + offset[0]
        points[i, 1] = linear[1, 0] * wx + linear[1, 1] * wy + offset[1]
        points[i, 2] = o0[2] + px[i] * ou[2] + py[i] * ov[2] + t[i] * z
        z *= pixels.exaggeration
        k = 1.0 / np.sqrt(x * x + y * y + z * z)
        rays[i, 0], rays[i, 1], rays[i, 2] = x * k, y * k, z * k
        slant = 1.0 / np.sqrt(min(max(abs(z * k), 0.1), 1.0))
        width[i] = (pixels.pixel if pixels.parallel else pixels.pixel * t[i]) * slant / to_samples.spacing
