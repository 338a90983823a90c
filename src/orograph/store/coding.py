"""Heights as whole numbers of one step, at an error that is stated and measured (``orograph build --max-error``).

A store that is not lossless rounds its heights once, before anything else is made of them: h becomes step · q with
q = round(h / step). The steps are counted from 0 m for the whole terrain, so a sample is the same number in whatever
tile and at whatever level it is stored, and tiles agree along their borders to the bit. From then on the rounded
heights *are* the terrain: levels, extremes, errors, bounds and derived data are computed of them, and a promise in
pixels needs no term for the codec. How far they are from what was read is measured sample by sample (``Coding``).

For a stated error e the step is 2e, rounded down to ten binary digits and to a multiple of 2^-10 m: such heights are
exact in float32 up to 16 km and more, so that every reader finds the same ones whatever arithmetic it uses, and none is
further off than e. ``auto`` takes the steps that the data have by themselves, which are kept as they are: whole metres,
feet, centimetres…

Means are kept in a quarter of that step: those of four samples that are there are exact.

Units: metres, float32, NaN where missing; numbers are int32, ``MISSING`` where missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.store.terrain import Heights

if TYPE_CHECKING:
    from orograph.store.source import HeightSource

Codec = Literal["portable", "compact", "smallest"]
CODECS: tuple[Codec, ...] = ("portable", "compact", "smallest")

MISSING = -(1 << 31)
"""The number of a missing sample."""

FINEST = 2.0**-10
"""The finest step of a stated error, metres."""

OWN_STEPS = (1.0, 0.5, 0.3048, 1200 / 3937, 0.25, 0.1, 0.03048, 120 / 3937, 0.01, 0.003048, 12 / 3937, 0.001)
"""What data's own steps are looked for among: metres, feet, US survey feet, and their parts."""

MEANS = 4
"""Steps of means in a step of heights."""

_MOST = 1 << 29  # (means have numbers four times as large)
_STRIP = 256  # rows that are rounded at once
_WINDOWS, _SIDE = 8, 64  # windows each way in which steps are looked for, and samples along their sides

Numbers = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Packing:
    """How an array holds heights.

    Attributes:
        step: metres.
        codec: what packs the numbers.
    """

    step: float
    codec: Codec

    def numbers(self, heights: Heights) -> Numbers:
        """The numbers of heights."""
        found = np.rint(heights.astype(np.float64) / self.step)
        found[np.isnan(found)] = MISSING
        return found.astype("<i4")

    def heights(self, numbers: Numbers) -> Heights:
        """The heights of numbers."""
        found = np.multiply(numbers, self.step).astype(np.float32)
        found[numbers == MISSING] = np.nan
        return found

    def attributes(self) -> dict[str, Any]:
        """Of the array, after CF."""
        return {"scale_factor": self.step, "add_offset": 0.0, "_FillValue": MISSING}


@dataclass(frozen=True, slots=True)
class Coding:
    """How a store keeps its heights, and how far they are from those it was built from.

    Attributes:
        codec: what packs the numbers.
        step: metres.
        max_error: what was asked for, metres; None: the data's own steps.
        largest, rms: of the distances between what was read and what is kept, metres.
    """

    codec: Codec
    step: float
    max_error: float | None
    largest: float = 0.0
    rms: float = 0.0

    @property
    def heights(self) -> Packing:
        """Of heights."""
        return Packing(self.step, self.codec)

    @property
    def means(self) -> Packing:
        """Of means."""
        return Packing(self.step / MEANS, self.codec)

    def rounded(self, heights: Heights, own: int) -> tuple[Heights, NDArray[np.float64]]:
        """Heights as they are kept, and what that loses of the first ``own`` rows and columns: (the largest distance,
        the sum of the squares of all).

        Raises:
            UsageError: heights are too large for such steps.
        """
        out = np.empty(heights.shape, np.float32)
        largest, squares = 0.0, []
        for row in range(0, len(heights), _STRIP):
            strip = slice(row, row + _STRIP)
            read = heights[strip].astype(np.float64)
            number = np.rint(read / self.step)
            out[strip] = number * self.step
            off = np.abs(out[strip] - read)
            worst = float(np.nanmax(off, initial=0.0))
            highest = float(np.nanmax(np.abs(read), initial=0.0))
            if highest >= _MOST * self.step or (self.max_error is not None and worst > self.max_error):
                raise UsageError(
                    f"Heights of {highest:g} m cannot be kept in steps of {self.step:g} m.",
                    remedy="State a larger error (`max_error`), or build it lossless.",
                )
            off = np.nan_to_num(off[: max(own - row, 0), :own])
            largest = max(largest, float(off.max(initial=0.0)))
            squares.append(float(np.square(off).sum()))
        return out, np.array([largest, math.fsum(squares)])

    def measured(self, found: Sequence[NDArray[np.float64]], samples: int) -> Coding:
        """With what all tasks of a build found.

        Args:
            found: by ``rounded``. samples: that are valid.
        """
        largest = max((float(one[0]) for one in found), default=0.0)
        rms = math.sqrt(math.fsum(float(one[1]) for one in found) / max(samples, 1))
        return replace(self, largest=largest, rms=rms)

    def surprise(self, height_range: tuple[float, float], resampled: bool) -> str | None:
        """What is to be said where data were taken to have steps of their own, and not all have."""
        highest = np.float32(max(map(abs, height_range)))
        if self.max_error is not None or resampled or not self.largest > np.spacing(highest):
            return None
        return (
            f"The heights that were looked at lie in steps of {self.step:g} m, but others do not: they are up to "
            f"{self.largest:.3g} m off. State the error that is allowed (`max_error`), or build it lossless."
        )

    def asked(self) -> dict[str, Any]:
        """What was asked for, without what was found."""
        return {"name": self.codec, "step": self.step, "max_error": self.max_error}

    def __str__(self) -> str:
        step = f"{self.step:.6g} m" if self.step >= 0.01 else f"{1000 * self.step:.4g} mm"
        if self.largest == 0:
            return f"{self.codec}, steps of {step}: every height as it was"
        return f"{self.codec}, steps of {step}: heights at most {self.largest:.3g} m off, {self.rms:.2g} m rms"

    def to_json(self) -> dict[str, Any]:
        return {"name": self.codec, **{k: v for k, v in asdict(self).items() if k != "codec"}}

    @classmethod
    def from_json(cls, told: dict[str, Any]) -> Coding:
        return cls(told["name"], **{k: v for k, v in told.items() if k != "name"})


def coding_of(source: HeightSource, codec: str, max_error: str | float) -> Coding | None:
    """How a store of these heights is to keep them; None: as float32, lossless.

    Args:
        source: the heights, of which some are looked at for ``auto``.
        codec: its name. max_error: metres, "auto" or "lossless".

    Raises:
        UsageError: there is no such codec, or it cannot keep such an error.
    """
    if codec not in CODECS:
        raise UsageError(f"`codec` is one of {', '.join(CODECS)}, not {codec!r}.")
    if max_error == "lossless":
        if codec != CODECS[0]:
            raise UsageError(
                f"The codec {codec} keeps whole numbers of steps, not float32.",
                remedy="State the error that is allowed; `max_error='auto'` keeps data that have steps as they are.",
            )
        return None
    if max_error == "auto":
        return Coding(codec, _step(source), None)
    try:
        error = float(max_error)
    except (TypeError, ValueError):
        raise UsageError(f"`max_error` is lossless, auto or a number of metres, not {max_error!r}.") from None
    if not FINEST / 2 <= error < _MOST:
        raise UsageError(
            f"`max_error` is at least {FINEST / 2:.3g} m, not {error:g}.",
            remedy="For less, keep the heights as they are: `max_error='lossless'`.",
        )
    return Coding(codec, floored(2 * error), error)


def floored(width: float) -> float:
    """The largest step of at most ``width`` metres that has ten binary digits and is a multiple of ``FINEST``."""
    scale = 2.0 ** min(10, 10 - math.frexp(width)[1])
    return max(math.floor(width * scale) / scale, FINEST)


def _step(source: HeightSource) -> float:
    """The step of the data: their own; of what was resampled a tenth of it; ``FINEST`` where they have none."""
    lattices = getattr(source, "resampled_from", ())
    if not lattices:
        return _own(source) or FINEST
    return floored(min(_own(lattice) or FINEST for lattice in lattices) / 10)


def _own(raster: Any) -> float | None:
    """The coarsest of ``OWN_STEPS`` in which all heights that are looked at lie, to a rounding of float32."""
    rows, cols = raster.grid.shape
    steps = list(OWN_STEPS)
    for row in _places(rows):
        for col in _places(cols):
            read = raster.read(row, min(row + _SIDE, rows), col, min(col + _SIDE, cols))
            read = np.asarray(read[np.isfinite(read)], np.float32)
            near, exact = np.spacing(np.abs(read)).astype(np.float64), read.astype(np.float64)
            steps = [step for step in steps if bool((np.abs(np.rint(exact / step) * step - exact) <= near).all())]
            if not steps:
                return None
    return steps[0]


def _places(size: int) -> list[int]:
    """Where windows begin along an axis."""
    return sorted({(size - _SIDE) * at // (_WINDOWS - 1) for at in range(_WINDOWS)}) if size > _SIDE else [0]
