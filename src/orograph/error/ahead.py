"""The program that compiles the kernels of errors and spheres while those of holes are compiled.

``python -m orograph.error.ahead KIND`` finds the errors of a small hill without holes (see ``compiling``).
"""

from __future__ import annotations

import sys

from orograph._compiler import hasten
from orograph.error import KINDS, ErrorKind

SIDE = 65
"""Samples of the hill along a side: one octave is larger than those that blocks finish themselves."""


def bound_a_hill(kind: ErrorKind) -> None:
    """Find the errors and spheres of a small hill."""
    import numpy as np

    from orograph.error.diamonds import diamonds
    from orograph.error.encode import Encoder
    from orograph.error.parts import Surface
    from orograph.error.quantise import ErrorCode, RadiusCode

    x, octaves, metric = np.linspace(-2, 2, SIDE), 6, np.diag([30.0, -30.0])
    hill = (300 * np.exp(-np.add.outer(x * x, x * x))).astype(np.float32)
    minimum = np.zeros((1, 1), np.float32)
    rounding = Encoder({kind: ErrorCode.of(300.0, kind, octaves)}, RadiusCode.of(300.0, metric, octaves))
    for _ in diamonds(
        lambda row0, row1, col0, col1: hill[row0:row1, col0:col1], hill[::16, ::16],
        Surface(hill.shape, metric, minimum, 0.0), (kind,), rounding=rounding,
    ):  # fmt: skip
        pass


if __name__ == "__main__":
    hasten()
    for known in KINDS:
        if known in sys.argv[1:]:
            bound_a_hill(known)
