"""Statistics of several members or times: their mean, a quantile, an extreme, or the probability of exceeding a value.

Quantiles are linear between members (type 7 of Hyndman & Fan 1996); a probability is the part of the members that are
known and above the value.
"""

from __future__ import annotations

import re
import warnings

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError

Values = NDArray[np.float32]

NAMED = {"median": 50.0, "min": 0.0, "max": 100.0}
"""Percent."""

PERCENTILE = re.compile(r"p(\d+(?:\.\d+)?)")


def check_statistic(text: str) -> None:
    """Raise UsageError unless it names a statistic: mean, median, min, max, spread, p0 to p100."""
    if text not in ("mean", "spread") and _percent(text) is None:
        raise UsageError(
            f"There is no statistic {text!r} of several members.",
            remedy="The statistics are mean, median, min, max, spread, and quantiles p0 to p100, such as p90.",
        )


def _percent(text: str) -> float | None:
    found = PERCENTILE.fullmatch(text)
    percent = float(found[1]) if found else NAMED.get(text, -1.0)
    return percent if 0 <= percent <= 100 else None


def words_of(text: str) -> str:
    """A statistic in words: "90 % quantile"."""
    percent = _percent(text)
    if text == "spread":
        return "standard deviation"
    return text if percent is None or text in NAMED else f"{percent:g} % quantile"


def statistic(values: Values, text: str) -> Values:
    """A statistic (rows, cols) of members (members, rows, cols), of those that are known at a sample; NaN where none
    is, of ``spread`` where fewer than two are."""
    known = np.isfinite(values)
    count = known.sum(0)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # of samples where nothing is known
        if text == "mean":
            total = np.where(known, values, 0).sum(0, dtype=np.float64)
            return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
        some = np.where(known, values, np.nan).astype(np.float64)
        if text == "spread":
            return np.where(count > 1, np.nanstd(some, axis=0, ddof=1), np.nan).astype(np.float32)
        return np.asarray(np.nanquantile(some, (_percent(text) or 0.0) / 100, axis=0), np.float32)


def exceedance(values: Values, limit: float) -> Values:
    """How probably members (members, rows, cols) exceed a limit: (rows, cols), NaN where nothing is known."""
    known = np.isfinite(values)
    count = known.sum(0)
    with np.errstate(invalid="ignore"):
        above = (known & (values > limit)).sum(0)
        return np.where(count > 0, above / np.maximum(count, 1), np.nan).astype(np.float32)
