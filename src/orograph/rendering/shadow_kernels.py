"""How deep places on the ground lie in the shadows of things straight above them. See ``shadows``."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel


@kernel
def deepest(x, y, segments, first, order, origin, cell, across, down, out):
    """The greatest of (radius − distance) / radius to segments near places.

    Args:
        x, y: (n,) places, NaN where no ground is. segments: (m, 5) both ends' x and y, and a radius.
        first: (across · down + 1,) where a cell's segments begin in ``order``: each is in the cell of its middle, and
            reaches no farther than the cells around it. origin: (2,) the cells' corner. cell: their side.
        out: (n,), −inf where no shadow is near.
    """
    for n in range(len(x)):
        if np.isnan(x[n]):
            continue
        i, j = int(np.floor((x[n] - origin[0]) / cell)), int(np.floor((y[n] - origin[1]) / cell))
        for row in range(max(j - 1, 0), min(j + 2, down)):
            for col in range(max(i - 1, 0), min(i + 2, across)):
                for k in range(first[row * across + col], first[row * across + col + 1]):
                    s = segments[order[k]]
                    dx, dy = s[2] - s[0], s[3] - s[1]
                    px, py = x[n] - s[0], y[n] - s[1]
                    size = dx * dx + dy * dy
                    part = min(max((px * dx + py * dy) / size, 0.0), 1.0) if size > 0 else 0.0
                    away = np.hypot(px - part * dx, py - part * dy)
                    out[n] = max(out[n], (s[4] - away) / s[4])
