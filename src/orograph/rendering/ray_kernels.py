"""Rays through pixels: where they end on the ground.

All arrays run over samples of a picture; one that met no ground has NaN in its depth and position.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel


@kernel
def ends(
    px, py, t, o0, ou, ov, d0, du, dv, linear, offset, exaggeration, metres, parallel, spacing, points, rays, width
):
    """Ends of rays: ``points`` (n, 3) in sample coordinates, unit ``rays`` (n, 3) stretched, ``width`` (n,) of a pixel
    on the ground in samples. ``metres``: a pixel at unit depth, or (``parallel``) anywhere.

    Seen at a slant a pixel covers more ground one way; the geometric mean is what an isotropic filter can do.
    """
    for i in range(len(px)):
        x = d0[0] + px[i] * du[0] + py[i] * dv[0]
        y = d0[1] + px[i] * du[1] + py[i] * dv[1]
        z = d0[2] + px[i] * du[2] + py[i] * dv[2]
        wx = o0[0] + px[i] * ou[0] + py[i] * ov[0] + t[i] * x
        wy = o0[1] + px[i] * ou[1] + py[i] * ov[1] + t[i] * y
        points[i, 0] = linear[0, 0] * wx + linear[0, 1] * wy + offset[0]
        points[i, 1] = linear[1, 0] * wx + linear[1, 1] * wy + offset[1]
        points[i, 2] = o0[2] + px[i] * ou[2] + py[i] * ov[2] + t[i] * z
        z *= exaggeration
        k = 1.0 / np.sqrt(x * x + y * y + z * z)
        rays[i, 0], rays[i, 1], rays[i, 2] = x * k, y * k, z * k
        slant = 1.0 / np.sqrt(min(max(abs(z * k), 0.1), 1.0))
        width[i] = (metres if parallel else metres * t[i]) * slant / spacing
