"""Samples of a picture's pixels, one per frame: a picture at rest accumulates them, one that changes starts again.

Positions are pixels from a pixel's middle, those of the CPU's pictures (``rendering.jitter.pattern``).
"""

from __future__ import annotations

from typing import Any

SAMPLES = 16
"""Samples per pixel that a picture at rest gathers."""


class Jitter:
    """The number of samples of the picture on the screen.

    Attributes:
        state: what the picture shows, its scene first; None before there is one. gathered: samples in the mean.
        enough: samples after which it no longer improves. shift: the position of the last sample.
    """

    def __init__(self) -> None:
        self.state: Any = None
        self.gathered, self.enough = 0, SAMPLES
        self.shift = 0.0, 0.0

    @property
    def complete(self) -> bool:
        """Whether there are enough samples."""
        return self.gathered >= self.enough

    def next(self, state: tuple[Any, ...], asked: int | None, busy: bool) -> tuple[int, int]:
        """The first sample of a frame, and their number: one more of a picture at rest, until there are enough.

        Args:
            asked: draw this many, of a new picture. busy: a later frame will show more anyway.
        """
        rests = asked is None and state == self.state and not busy
        self.state = state
        if not rests:
            return 0, asked or 1
        return self.gathered, 0 if self.complete else 1

    def place(self, k: int, asked: int | None, first: tuple[float, float]) -> tuple[float, float]:
        """The position of sample ``k``; ``first``: that of the first one of a picture at rest. −1: the middle."""
        self.shift = 0.0, 0.0
        if k < 0:
            return self.shift
        if k == 0 and asked is None:
            self.shift = first
        elif (n := asked or SAMPLES) > 1:
            from orograph.rendering.jitter import pattern

            x, y = pattern(n)[k % n]
            self.shift = float(x) - 0.5, float(y) - 0.5
        return self.shift
