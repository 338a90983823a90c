"""Undeclared values that are not heights: voids filled with a number, and codes of classes.

A *fill* is a value that many samples share, that is far from all others, and at whose borders the ground jumps: a sea
or a lake is as common, but its shores rise from it. 0 and the usual nodata numbers are suspected if the jump is steep
for this ground; any other value only if it is farther from the rest than half of the rest's spread. *Codes* are few
small integers in patches whose neighbours differ by more than one step.

Both are judged by windows spread over the raster. Units: metres.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orograph.dem.source import Source

WINDOWS = 16
_SIDE = 256
_WHOLE = 1 << 20  # samples of a raster that is examined as a whole
_SHARE = 0.005  # minimum part of the valid samples in a fill
_LEAST = 5.0  # minimum metres from a fill to nearly all other heights
_JUMP = 8.0  # times the median step of the ground
_CODES = 30

Heights = NDArray[np.float32]


def suspected_fills(source: Source, usual: tuple[int, ...], windows: int = WINDOWS) -> list[str]:
    """Sentences about values that seem to mean "missing", or to be codes of classes.

    Args:
        usual: numbers, as stored, that often mean "missing".
        windows: how many to examine.
    """
    parts = [p for p in _read(source, windows) if np.isfinite(p).any()]
    if not parts:
        return []
    values = np.concatenate([p[np.isfinite(p)] for p in parts])
    found, counts = np.unique(values, return_counts=True)
    if found.size < 2:
        return []
    if are_codes(found, parts):
        shown = ", ".join(f"{v:g}" for v in found[:6]) + ("…" if found.size > 6 else "")
        return [
            f"Its values are a few whole numbers in patches ({shown}): codes of classes (land cover?), not heights."
        ]
    sentences = []
    ordinary = {_height(source, n) for n in (0, 1, -1, *usual)}
    for i in np.argsort(counts)[::-1][:3]:
        share = counts[i] / values.size
        others = np.delete(found, i), np.delete(counts, i)
        if share < _SHARE or share > 0.995:
            continue
        value = float(found[i])
        gap = float(_quantiles(np.abs(others[0] - value), others[1], 0.005)[0])
        low, middle, high = _quantiles(*others, 0.25, 0.5, 0.75)
        wanted = _LEAST if value in ordinary else max(_LEAST, float(high - low), 0.5 * abs(middle - value))
        if gap < wanted:
            continue
        steps, jumps, within = _steps(parts, value)
        if within < 0.25 or jumps.size == 0:
            continue
        if float(np.quantile(jumps, 0.1)) < max(_LEAST, _JUMP * float(np.quantile(steps, 0.5)) if steps.size else 0.0):
            continue
        number = (value / source.unit_factor - source.offset) / source.scale
        sentences.append(
            f"{share:.1%} of its heights are exactly {value:g} m, in flat patches, with no other within {gap:,.0f} m "
            + ("." if source.encoding else f"(give `nodata={number:g}` if they are missing).")
        )
    return sentences


def _read(source: Source, windows: int) -> Iterator[Heights]:
    """The windows to examine; of a raster that is little more than they are, cut from a single read."""
    rows, cols = source.shape
    boxes = list(_boxes(source.shape, windows))
    if rows * cols > 2 * _WHOLE:
        yield from (source.read(*box) for box in boxes)
        return
    whole = source.read(0, rows, 0, cols)
    yield from (whole[r0:r1, c0:c1] for r0, r1, c0, c1 in boxes)


def _boxes(shape: tuple[int, int], windows: int) -> Iterator[tuple[int, int, int, int]]:
    rows, cols = shape
    if rows * cols <= _WHOLE:
        yield 0, rows, 0, cols
        return
    down = max(1, min(round(windows**0.5), rows // _SIDE))
    across = max(1, min(windows // down, cols // _SIDE))
    for r in _starts(rows, down):
        for c in _starts(cols, across):
            yield r, min(r + _SIDE, rows), c, min(c + _SIDE, cols)


def _starts(length: int, count: int) -> list[int]:
    """Where so many windows begin, spread over a side."""
    return sorted({int(v) for v in np.linspace(0, max(0, length - _SIDE), count + 2)[1:-1]})


def _height(source: Source, number: int) -> float:
    """The height that a stored number means."""
    return float(np.float32((number * source.scale + source.offset) * source.unit_factor))


def _quantiles(values: Heights, counts: NDArray[np.int64], *parts: float) -> list[float]:
    order = np.argsort(values)
    upto = np.cumsum(counts[order])
    return [float(values[order[min(int(np.searchsorted(upto, p * upto[-1])), order.size - 1)]]) for p in parts]


def _steps(parts: list[Heights], value: float) -> tuple[Heights, Heights, float]:
    """Steps between neighbours without ``value``; from it to others; and the share of its pairs that are equal."""
    plain, border, alike, all_pairs = [], [], 0, 0
    for part in parts:
        for a, b in ((part[1:], part[:-1]), (part[:, 1:], part[:, :-1])):
            step = np.abs(a - b)
            here, there = a == value, b == value
            plain.append(step[~here & ~there & np.isfinite(step)])
            border.append(step[(here ^ there) & np.isfinite(step)])
            alike += int(np.count_nonzero(here & there))
            all_pairs += int(np.count_nonzero(here | there))
    return np.concatenate(plain), np.concatenate(border), alike / all_pairs if all_pairs else 0.0


def are_codes(found: Heights, parts: list[Heights]) -> bool:
    """Whether values are few small integers in patches whose neighbours differ more than measured values do.

    Args:
        found: the distinct values, in order.
        parts: 2-D arrays of them; NaN: none.
    """
    if found.size > _CODES or found.size < 3 or found[0] < -1 or found[-1] > 255 or np.any(found != np.round(found)):
        return False
    steps = np.concatenate([np.abs(np.diff(p, axis=axis)).ravel() for p in parts for axis in (0, 1)])
    steps = steps[np.isfinite(steps)]
    other = steps[steps > 0]
    return bool(other.size and other.size < 0.6 * steps.size and np.count_nonzero(other > 1) > 0.5 * other.size)
