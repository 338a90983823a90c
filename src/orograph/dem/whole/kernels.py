"""Compiled passes over the bytes of files: tokens of text, and the decoded length of compressed blocks."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel


@kernel
def run_lengths(data, runs):
    """The sum of the lengths of an Imagine block's runs; -1 if they do not end within the bytes.

    The upper two bits of a length's first byte say how many more bytes it has.
    """
    total, at = 0, 0
    for _ in range(runs):
        if at >= data.size:
            return -1
        more = data[at] >> 6
        length = data[at] & 0x3F
        if at + more >= data.size:
            return -1
        for k in range(more):
            length = length * 256 + data[at + 1 + k]
        total += length
        at += 1 + more
    return total


@kernel
def lzw_length(data, most):
    """How many bytes an LZW stream of TIFF 6.0 (section 13) makes, and whether it ends correctly.

    It ends with its end code or, as some writers do it, with its last byte.

    Args:
        data: bytes of the stream.
        most: maximum bytes to decode; reading stops shortly after that.

    Returns:
        Decoded bytes (-1: there is an impossible code), and whether the stream ends there.
    """
    lengths = np.empty(4096, np.int64)
    for i in range(256):
        lengths[i] = 1
    made = at = held = bits = np.int64(0)
    width, entries, last = 9, 258, np.int64(-1)
    while made <= most:
        while bits < width and at < data.size:
            held, bits, at = (held << 8 | np.int64(data[at])) & 0xFFFFFFFF, bits + 8, at + 1
        if bits < width:
            return made, at == data.size
        code = held >> (bits - width) & ((1 << width) - 1)
        bits -= width
        if code == 257:
            return made, True
        if code == 256:
            width, entries, last = 9, 258, np.int64(-1)
            continue
        if last < 0:
            if code > 255:
                return -1, False
        elif entries < 4096:
            if code > entries:
                return -1, False
            lengths[entries] = lengths[last] + 1
            entries += 1
            if entries >= (1 << width) - 1 and width < 12:
                width += 1
        elif code >= entries:
            return -1, False
        made += lengths[code]
        last = code
    return made, False


@kernel
def packed_length(data, most):
    """How many bytes PackBits (TIFF 6.0, section 9) make; -1 if a run does not end within them.

    After ``most`` bytes, only no-operations or zeros may follow.
    """
    made = at = np.int64(0)
    while at < data.size:
        head = np.int64(data[at])
        if made >= most:
            if head != 0 and head != 128:
                return made + 1
            at += 1
        elif head < 128:
            at += head + 2
            made += head + 1
        elif head > 128:
            at += 2
            made += 257 - head
        else:
            at += 1
    return made if at == data.size else -1


@kernel
def scan(data, parting, comma, state):
    """Go through whitespace-separated tokens up to the first that is not a number, or to the end.

    A number is an optional sign, digits with at most one point, and an optional exponent; or "nan" in any case.

    Args:
        data: bytes of text; a token that reaches their end is taken to end there.
        parting: a byte that separates tokens like white space; 0: none.
        comma: whether numbers may have a decimal comma.
        state: (7,) int64, carried from piece to piece: where to begin; tokens and lines so far; where this line
            began, from ``data``'s start; decimal commas that might part thousands, and those that cannot; the line of
            the first that might.

    Returns:
        Where the first token that is not a number begins and ends; −1 if there is none.
    """
    at, tokens, line, begun, doubtful, certain, doubt_line = state
    size = data.size
    first = end = -1
    while at < size:
        if _parts(data[at], parting):
            if data[at] == 10:
                line, begun = line + 1, at + 1
            at += 1
            continue
        after, good, comma_at = _number(data, at, comma)
        if not good or (after < size and not _parts(data[after], parting)):
            while after < size and not _parts(data[after], parting):
                after += 1
            first, end, at = at, after, after
            break
        if comma_at >= 0:
            whole = comma_at - at - (data[at] == 45 or data[at] == 43)
            if after - comma_at == 4 and 0 < whole <= 3 and data[comma_at - whole] != 48:
                doubt_line = doubt_line if doubtful else line
                doubtful += 1
            else:
                certain += 1
        tokens, at = tokens + 1, after
    for i, value in enumerate((at, tokens, line, begun, doubtful, certain, doubt_line)):
        state[i] = value
    return first, end


@kernel
def _number(data, at, comma):
    """Where the number that begins at ``at`` ends, whether it is one, and where its comma is (-1: none)."""
    size, digits, point, comma_at = data.size, 0, False, -1
    if at + 2 < size and _nan(data, at):
        return at + 3, True, -1
    if data[at] == 45 or data[at] == 43:  # - +
        at += 1
    while at < size:
        c = data[at]
        if 48 <= c <= 57:
            digits += 1
        elif not point and (c == 46 or (c == 44 and comma)):
            point = True
            comma_at = at if c == 44 else -1
        else:
            break
        at += 1
    if digits and at < size and data[at] | 32 == 101:  # e
        at, digits = at + 1, 0
        if at < size and (data[at] == 45 or data[at] == 43):
            at += 1
        while at < size and 48 <= data[at] <= 57:
            digits, at = digits + 1, at + 1
    return at, digits > 0, comma_at


@kernel
def _parts(c, parting):
    """Whether a byte separates tokens: white space, the end mark of DOS, or ``parting``."""
    return c == 32 or 9 <= c <= 13 or c == 26 or (c == parting and parting != 0)


@kernel
def _nan(data, at):
    return data[at] | 32 == 110 and data[at + 1] | 32 == 97 and data[at + 2] | 32 == 110
