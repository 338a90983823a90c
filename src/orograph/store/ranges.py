"""Fetch ranges of objects over a network: adjacent ranges as one request, cut apart afterwards."""

from __future__ import annotations

from collections.abc import Sequence

Range = tuple[str, int, int]
"""(key, first byte, end)."""

GAP = 32 << 10  # bytes that may be fetched needlessly to save a request
REQUEST = 4 << 20  # maximum bytes per request


def merged(wanted: Sequence[Range]) -> list[Range]:
    """Merge adjacent ranges of one object into one request, as long as little is fetched needlessly."""
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
    """The part of a range in the merged piece that contains it."""
    first, data = max((piece for piece in pieces if piece[0] <= start), key=lambda piece: piece[0])
    return data[start - first : stop - first]
