"""The significant part of a difference, given its uncertainty: the level of detection, and the error of volumes.

Two heights with standard deviations σ₁ and σ₂ differ by chance with σ = sqrt(σ₁² + σ₂²). A difference is *significant*
if it exceeds the level of detection, t σ, with t the two-sided quantile of the normal distribution: 1.96 for 95 %
(Lane, Westaway & Hicks 2003; Wheaton et al. 2010). Volumes are summed over significant samples only.

Errors d metres apart are correlated by exp(−3 (d / R)²), as for ``HeightError``. The variance of a volume over cells of
area a, ΣΣ σᵢ σⱼ ρᵢⱼ aᵢ aⱼ, is computed as c Σ σᵢ² aᵢ with the integral of the correlation over the plane, c = π R² / 3,
or the area of a cell if that is larger; but at most as (Σ σᵢ aᵢ)², its value if all errors are equal (Hugonnet et al.
2022). It is exact for independent errors, and otherwise an upper bound where σ varies slowly, because neighbours beyond
the border count too. It does not include a bias of a whole DEM. Units: metres, metres², metres³.

S. N. Lane, R. M. Westaway, D. M. Hicks, Estimation of erosion and deposition volumes in a large, gravel-bed, braided
river using synoptic remote sensing, Earth Surface Processes and Landforms 28(3), 2003, 249–271. J. M. Wheaton et al.,
Accounting for uncertainty in DEMs from repeat topographic surveys, ESPL 35(2), 2010, 136–156. R. Hugonnet et al.,
Uncertainty analysis of digital elevation models by spatial inference from stable terrain, IEEE JSTARS 15, 2022.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.measuring.height_error import HeightError, deviations_of, sampled

Array = NDArray[np.float64]
Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Detected:
    """The significant part of a difference.

    Attributes:
        confidence: 0 to 1. lowest, highest: the level of detection, metres, at the samples compared.
        count: significant samples; area: of them, metres².
        gain_error, loss_error, net_error: of the volumes, metres³: half the interval of that confidence.
        whole_gain, whole_loss: volumes of all samples, significant or not, metres³.
    """

    confidence: float
    lowest: float
    highest: float
    count: int
    area: float
    gain_error: float
    loss_error: float
    net_error: float
    whole_gain: float
    whole_loss: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "confidence": self.confidence, "detection_m": [self.lowest, self.highest], "significant": self.count,
            "significant_area_m2": self.area, "gain_error_m3": self.gain_error, "loss_error_m3": self.loss_error,
            "net_error_m3": self.net_error, "whole_gain_m3": self.whole_gain, "whole_loss_m3": self.whole_loss,
        }  # fmt: skip


class Doubt:
    """The uncertainty of a difference on its grid.

    Args:
        sigma: of both DEMs, or (of the first, of the second): each metres, or a raster of standard deviations.
        reach: R, metres. confidence: of what counts as significant.

    Raises:
        UsageError: a number makes no sense. ReadError: a raster cannot be read, or is negative.
    """

    def __init__(self, grid: Grid, sigma: Any, reach: float, confidence: float) -> None:
        from scipy.special import ndtri

        self.grid, self.reach, self.confidence = grid, reach, confidence
        self._parts = [
            float(one.sigma) if one.is_number else deviations_of(one.sigma, grid) for one in errors_of(sigma, reach)
        ]
        self.times = float(ndtri(0.5 + confidence / 2))

    def sigma(self, box: Box) -> Array:
        """Standard deviations (rows, cols) of the differences of a block, metres; NaN where unknown."""
        squares = np.zeros((box[1] - box[0], box[3] - box[2]))
        for part in self._parts:
            one = part if isinstance(part, float) else sampled(part, self.grid, *box)
            squares += np.square(one)
        return np.sqrt(squares)

    def error(self, squares: float, sums: float) -> float:
        """The error of a volume. Args: squares, sums: Σ σ² a and Σ σ a over its cells."""
        together = max(math.pi * self.reach**2 / 3, self.grid.cell_area)
        return self.times * min(math.sqrt(squares * together), sums)


def errors_of(sigma: Any, reach: float) -> tuple[HeightError, HeightError]:
    """The errors of both DEMs.

    Raises:
        UsageError: they are not one or two standard deviations, 0 or more, with one above 0.
    """
    pair = tuple(sigma) if isinstance(sigma, tuple | list) else (sigma, sigma)
    if len(pair) == 1:
        pair *= 2
    if len(pair) != 2:
        raise UsageError(f"`sigma` must be one standard deviation for both, or two, not {len(pair)}.")
    first, second = (HeightError(_number(one), reach) for one in pair)
    if first.is_number and second.is_number and not (first.sigma or second.sigma):
        raise UsageError("With `sigma` at least one of the two must be uncertain: give metres above 0, or a raster.")
    return first, second


def check_doubt(sigma: Any, reach: float, confidence: float) -> None:
    """Raise UsageError unless they describe the uncertainty of a difference."""
    if not 0 < confidence < 1:
        raise UsageError(f"`confidence` must be a number between 0 and 1, such as 0.95, not {confidence!r}.")
    if sigma is not None:
        errors_of(sigma, reach)
    elif reach:
        raise UsageError("`range` applies to errors, whose size `sigma` gives.")


def _number(given: Any) -> Any:
    """Convert text that is a number, as the command line gives it."""
    if isinstance(given, str | os.PathLike):
        try:
            return float(given)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            return os.fspath(given)
    return given
