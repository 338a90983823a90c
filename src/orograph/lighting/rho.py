"""How much light an occluder at a distance lets through: the function ρ of ambient occlusion.

ρ maps the free path L in [0, R] to [0, 1] (Zhukov, Iones & Kronin 1998, sec. 2, their function of distance):

- ``step``: 0 for L < R, 1 at R: light of the sky, with nothing occluding beyond R;
- ``linear``: L / R: light that fills the volume, so that a near wall hides more than a far one;
- any function of L in metres, tabulated at R's 1,025 equal parts and interpolated between them.

Kernels take it as a table over [0, R) and its value at R, which alone counts for rays that meet nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError

Array = NDArray[np.float64]

Rho = Literal["step", "linear"] | Callable[[Array], Array]
"""ρ by name, or a function of arrays of L (metres) in [0, R]."""

SAMPLES = 1025


class Transmission(NamedTuple):
    """ρ for kernels.

    Attributes:
        table: (n,) float64, ρ at equal parts of [0, R].
        free: ρ(R), for a ray that meets nothing.
        radius: R, metres; inf: unlimited.
        step: whether ρ is 0 for all L < R and 1 at R, so that only rays that meet nothing count.
    """

    table: Array
    free: float
    radius: float
    step: bool


def transmission(rho: Rho, radius: float | None) -> Transmission:
    """Tabulate ρ.

    Args:
        rho: "step", "linear", or a function of L in metres.
        radius: R, metres; None: unlimited, which only a step can be.

    Raises:
        UsageError: no such ρ, an invalid R, values outside [0, 1], or an unlimited ρ that is not a step.
    """
    reach = math.inf if radius is None else float(radius)
    if not reach > 0:
        raise UsageError(f"The radius must be a positive number of metres, not {radius}.")
    if isinstance(rho, str):
        if rho == "step":
            return Transmission(np.zeros(2), 1.0, reach, True)
        if rho != "linear":
            raise UsageError(f"There is no ρ called {rho!r}; use step, linear, or a function.")
    if not math.isfinite(reach):
        raise UsageError("Only a step ρ works without a radius.", remedy="Give the radius in metres.")
    if isinstance(rho, str):
        return Transmission(np.array([0.0, 1.0]), 1.0, reach, False)
    lengths = np.linspace(0.0, reach, SAMPLES)
    values = np.broadcast_to(np.asarray(rho(lengths), np.float64), lengths.shape).copy()
    if not ((values >= 0) & (values <= 1)).all():
        raise UsageError("ρ must map [0, R] to [0, 1].")
    return Transmission(values, float(values[-1]), reach, False)
