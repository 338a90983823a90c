"""Colours of samples, and how far off they are in a triangle."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates


class Painted:
    """Colours of samples: two fields of stripes and a gradient."""

    def __init__(self, shape):
        i, j = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
        self.lab = np.stack([50 + 30 * np.sin(j / 9), 20 * np.sign(np.sin(i / 13)), 0.1 * (i + j)], -1).astype(
            np.float32
        )

    def colors(self, row0, row1, col0, col1):
        return self.lab[row0:row1, col0:col1]


def off_in(triangle, lab):
    """The largest differences of channels in a triangle (3, 2) of samples, column and row, to what is interpolated."""
    (ax, ay), (bx, by), (cx, cy) = triangle
    i, j = np.mgrid[: lab.shape[0], : lab.shape[1]]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    u = ((j - ax) * (cy - ay) - (i - ay) * (cx - ax)) / area
    v = ((bx - ax) * (i - ay) - (by - ay) * (j - ax)) / area
    inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    at = [map_coordinates(lab[..., k], [[ay, by, cy], [ax, bx, cx]], order=1, mode="nearest") for k in range(3)]
    wanted = np.stack([p + u * (q - p) + v * (r - p) for p, q, r in at], -1)
    return np.nan_to_num(np.abs(wanted - lab))[inside].max(0, initial=0.0)
