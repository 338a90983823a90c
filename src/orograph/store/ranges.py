"""Ranges of objects that are fetched over a network: neighbours as one request, cut apart again afterwards."""

from __future__ import annotations

from collections.abc import Sequence

Range = tuple[str, int, int]
"""(key, first byte, byte behind the last)."""

GAP = 32 << 10  # bytes fetched in vain rather than asking twice
REQUEST = 4 << 20  # bytes asked for at once


def merged(wanted: Sequence[Range]) -> list[Range]:
    """Neighbouring ranges of one object as one request, as long as little is fetched in vain."""
    together: list[Range] = []
    for key, start, stop in sorted(wanted):
        if together and together[-1][0] == key:
            first, last = together[-1][1:]
            if start - last <= GAP and stop - first <= REQUEST:
                together[-1] = (key, first, max(last, stop))
                continue
        together.append((key, start, stop))
    return together


def cut(pieces: list[tuple[int, bytes]], start: int, stop: int) -> bytes:
    """What of a range lies in the one piece that begins last before it."""
    first, data = max((piece for piece in pieces if piece[0] <= start), key=lambda piece: piece[0])
    return data[start - first : stop - first]
