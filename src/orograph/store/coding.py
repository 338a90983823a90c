"""Heights quantised to one step, with a stated and measured error (``orograph build --max-error``).

A lossy store rounds its heights once, before anything else is made from them: h becomes step · q with q = round(h /
step). Steps are counted from 0 m for the whole terrain, so a sample is the same number in every tile and level that
stores it, and tiles agree along their borders to the bit. From then on the rounded heights *are* the
terrain: levels, extremes, errors, bounds and derived data are computed from them, and a promise in pixels needs no term
for the codec. The difference from the original is measured sample by sample (``Coding``).

For a stated error e the step is 2e, rounded down to ten binary digits and to a multiple of 2^-10 m. Such heights are
exact in float32 up to 16 km and more, so every reader gets the same heights whatever arithmetic it uses, and none
is off by more than e. ``auto`` uses the data's own steps, which are kept exactly: whole metres, feet, centimetres…
If these are coarser than 2e, the step is a whole fraction of them. Heights are then kept exactly, and take no more
space than with ``auto``, for the codecs store the common factor of a chunk's numbers once.

Means are stored in a quarter of that step, so means of four valid samples are exact.

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

Codec = Literal["portable", "compact", "smallest", "progressive"]
CODECS: tuple[Codec, ...] = ("portable", "compact", "smallest", "progressive")

MISSING = -(1 << 31)
"""The number of a missing sample."""

FINEST = 2.0**-10
"""The finest step of a stated error, metres."""

OWN_STEPS = (1.0, 0.5, 0.3048, 1200 / 3937, 0.25, 0.1, 0.03048, 120 / 3937, 0.01, 0.003048, 12 / 3937, 0.001)
"""Candidates for the data's own steps: metres, feet, US survey feet, and their parts."""

MEANS = 4
"""Steps of means per step of heights."""

_MOST = 1 << 29  # (means have numbers four times as large)
_FINER = 16  # steps of *progressive* per twice the error, approximately
_WINDOWS, _SIDE = 8, 64  # windows per axis in which steps are looked for, and samples along their sides

Numbers = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Packing:
    """How an array encodes heights.

    Attributes:
        step: metres.
        codec: the name of the codec for the numbers.
    """

    step: float
    codec: Codec

    def numbers(self, heights: Heights) -> Numbers:
        """The numbers of heights."""
        from orograph._numba import read_only
        from orograph.store.coding_kernels import number

        found = np.empty(heights.shape, np.int32)
        number(read_only(np.ascontiguousarray(heights, np.float32).reshape(-1)), self.step, found.reshape(-1))
        return found

    def heights(self, numbers: Numbers) -> Heights:
        """The heights of numbers."""
        from orograph._numba import read_only
        from orograph.store.coding_kernels import place

        found = np.empty(numbers.shape, np.float32)
        place(read_only(np.ascontiguousarray(numbers, np.int32).reshape(-1)), self.step, found.reshape(-1))
        return found

    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the array, after CF."""
        return {"scale_factor": self.step, "add_offset": 0.0, "_FillValue": MISSING}


@dataclass(frozen=True, slots=True)
class Coding:
    """How a store encodes its heights, and how far they are from the original ones.

    Attributes:
        codec: the name of the codec for the numbers.
        step: metres.
        max_error: the requested error, metres; None: the data's own steps.
        largest, rms: the largest and rms difference between the heights read and stored, metres.
    """

    codec: Codec
    step: float
    max_error: float | None
    largest: float = 0.0
    rms: float = 0.0

    @property
    def heights(self) -> Packing:
        """The packing of heights."""
        return Packing(self.step, self.codec)

    @property
    def means(self) -> Packing:
        """The packing of means."""
        if self.codec == "progressive":
            return Packing(self.step * self.factor / MEANS, "smallest")
        return Packing(self.step / MEANS, self.codec)

    @property
    def factor(self) -> int:
        """Steps of heights per twice the largest error, for the codec *progressive*."""
        return 1 if self.max_error is None else int(2 * self.max_error / self.step)

    def rounded(self, heights: Heights, own: int, kept: Numbers | None = None) -> tuple[Heights, NDArray[np.float64]]:
        """Heights as stored, and the loss in the first ``own`` rows and columns.

        Args:
            heights: C order, of a shard of ``own`` samples a side, with the row and column that follow.
            kept: the numbers to store (with the codec *progressive*); None: the nearest.

        Raises:
            UsageError: heights are too large for such steps.
        """
        from orograph._numba import read_only
        from orograph.store.coding_kernels import quantise

        out, none = np.empty(heights.shape, np.float32), np.empty((0, 0), np.int32)
        kept = read_only(none if kept is None else np.ascontiguousarray(kept))
        highest, worst, largest, squares = quantise(read_only(heights), self.step, kept, own, out)
        self.bounded(highest, worst)
        return out, np.array([largest, squares])

    def bounded(self, highest: float, worst: float = 0.0) -> None:
        """Check that heights can be stored.

        Args:
            highest: the largest of them without its sign, metres. worst: the largest error found, metres.

        Raises:
            UsageError: heights are too large, or off by more than stated.
        """
        if highest >= _MOST * self.step or (self.max_error is not None and worst > self.max_error):
            raise UsageError(
                f"Heights of {highest:g} m cannot be stored in steps of {self.step:g} m.",
                remedy="State a larger error (`max_error`), or build it lossless.",
            )

    def measured(self, found: Sequence[NDArray[np.float64]], samples: int) -> Coding:
        """Return the coding with the losses that all tasks of a build found.

        Args:
            found: results of ``rounded``. samples: the number of valid samples.
        """
        largest = max((float(one[0]) for one in found), default=0.0)
        rms = math.sqrt(math.fsum(float(one[1]) for one in found) / max(samples, 1))
        return replace(self, largest=largest, rms=rms)

    def surprise(self, height_range: tuple[float, float], resampled: bool) -> str | None:
        """Return a warning if data were assumed to have steps of their own, but some of them do not."""
        highest = np.float32(max(map(abs, height_range)))
        if self.max_error is not None or resampled or not self.largest > np.spacing(highest):
            return None
        return (
            f"The sampled heights are in steps of {self.step:g} m, but others are not: they are up to "
            f"{self.largest:.3g} m off. State an allowed error (`max_error`), or build it lossless."
        )

    def asked(self) -> dict[str, Any]:
        """Return the requested coding, without the losses found."""
        return {"name": self.codec, "step": self.step, "max_error": self.max_error}

    def __str__(self) -> str:
        step = f"{self.step:.6g} m" if self.step >= 0.01 else f"{1000 * self.step:.4g} mm"
        if self.largest == 0:
            return f"{self.codec}, steps of {step}: every height as it was"
        return f"{self.codec}, steps of {step}: heights at most {self.largest:.3g} m off, {self.rms:.2g} m rms"

    def to_json(self) -> dict[str, Any]:
        return {"name": self.codec, **{k: v for k, v in asdict(self).items() if k != "codec"}}

    @classmethod
    def from_json(cls, found: dict[str, Any]) -> Coding:
        return cls(found["name"], **{k: v for k, v in found.items() if k != "name"})


def coding_of(source: HeightSource, codec: str, max_error: str | float) -> Coding | None:
    """Return the coding for a store of these heights; None: float32, lossless.

    Args:
        source: the heights, of which some are sampled for ``auto``.
        codec: its name. max_error: metres, "auto" or "lossless".

    Raises:
        UsageError: there is no such codec, or it cannot keep such an error.
    """
    if codec not in CODECS:
        raise UsageError(f"`codec` must be one of {', '.join(CODECS)}, not {codec!r}.")
    if max_error == "lossless":
        if codec != CODECS[0]:
            raise UsageError(
                f"The codec {codec} stores whole numbers of steps, not float32.",
                remedy="State the allowed error; `max_error='auto'` keeps data with steps of their own exactly.",
            )
        return None
    if max_error == "auto":
        return Coding(codec, _step(source), None)
    try:
        error = float(max_error)
    except (TypeError, ValueError):
        raise UsageError(f"`max_error` must be lossless, auto or a number of metres, not {max_error!r}.") from None
    if not FINEST / 2 <= error < _MOST:
        raise UsageError(
            f"`max_error` is at least {FINEST / 2:.3g} m and less than {_MOST:g} m, not {error:g}.",
            remedy="For less, store the heights exactly: `max_error='lossless'`." if error < FINEST / 2 else "",
        )
    if codec == "progressive":
        return Coding(codec, floored(2 * error / _FINER), error)
    own = (None if getattr(source, "resampled_from", ()) else _own(source)) or 0.0
    return Coding(codec, own / math.ceil(own / (2 * error)) if own > 2 * error else floored(2 * error), error)


def floored(width: float) -> float:
    """The largest step of at most ``width`` metres that has ten binary digits and is a multiple of ``FINEST``."""
    scale = 2.0 ** min(10, 10 - math.frexp(width)[1])
    return max(math.floor(width * scale) / scale, FINEST)


def _step(source: HeightSource) -> float:
    """Return the step of the data: their own; for resampled data a tenth of it; ``FINEST`` if they have none."""
    lattices = getattr(source, "resampled_from", ())
    if not lattices:
        return _own(source) or FINEST
    return floored(min(_own(lattice) or FINEST for lattice in lattices) / 10)


def _own(raster: Any) -> float | None:
    """Return the coarsest of ``OWN_STEPS`` that fits all sampled heights, up to float32 rounding."""
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
    """Return the starts of windows along an axis."""
    return sorted({(size - _SIDE) * at // (_WINDOWS - 1) for at in range(_WINDOWS)}) if size > _SIDE else [0]
