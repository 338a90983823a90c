"""The way from errors and radii to the bytes of ``quantise``: each to the first of a table's values not below it.

A value's place in a table is guessed from its upper bits as a float32, which leave less than a thousandth open, and
then corrected upwards: a step or none.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.error import ErrorKind
from orograph.error.quantise import EMPTY, Codes, ErrorCode, Floats, RadiusCode
from orograph.errors import OrographError

OPEN = 13
"""Lower bits of a float32 that a guess does not look at."""

Guess = tuple[np.int64, NDArray[np.uint8]]


def guesses(table: Floats) -> Guess:
    """What ``_find`` begins with: the upper bits of the second value, and from there on the place of each number."""
    finite = table[np.isfinite(table)]
    first, last = (int(v) >> OPEN for v in finite[[1, -1]].view(np.uint32))
    lowest = (np.arange(first, last + 1, dtype=np.uint32) << OPEN).view(np.float32)
    return np.int64(first), np.searchsorted(table, lowest).astype(np.uint8)


@leaf
def _find(value, table, first, guess):
    """The first entry not below ``value``; the table's length if there is none."""
    if value <= table[0]:
        return np.int64(0)
    bits = np.int64(np.float32(value).view(np.uint32) >> np.uint32(OPEN))
    code = np.int64(guess[max(min(bits - first, guess.shape[0] - 1), 0)])
    while code < table.shape[0] and table[code] < value:
        code += 1
    return code


@kernel
def _encode_errors(errors, table, first, guess, codes):
    """Returns whether all were found."""
    for i in range(errors.shape[0]):
        for j in range(errors.shape[1]):
            code = _find(errors[i, j], table, first, guess)
            if code >= table.shape[0]:
                return False
            codes[i, j] = code
    return True


@kernel
def _encode_radii(radii, start_row, start_col, table, first, guess, codes):
    """Every second radius of every second row. Returns whether all were found."""
    for i in range(start_row, radii.shape[0], 2):
        for j in range(start_col, radii.shape[1], 2):
            code = _find(abs(radii[i, j]), table, first, guess)
            if code >= table.shape[0]:
                return False
            codes[i, j] = code | (EMPTY if radii[i, j] < 0 else 0)
    return True


@kernel
def _round_up(radii, squares, table, first, guess):
    """Round a window's edge diamonds, or its squares; it begins with even entries. Returns as ``_encode_radii``."""
    for i in range(squares, radii.shape[0], 1 + squares):
        for j in range(1 if squares else 1 - (i & 1), radii.shape[1], 2):
            code = _find(radii[i, j], table, first, guess)
            if code >= table.shape[0]:
                return False
            radii[i, j] = table[code]
    return True


class Encoder:
    """Turns errors and radii into codes.

    Args:
        errors: how each kind of errors is coded.
        radius: how radii are.
    """

    def __init__(self, errors: Mapping[ErrorKind, ErrorCode], radius: RadiusCode) -> None:
        self.radius = radius
        self.tables = {kind: (code.table, *guesses(code.table)) for kind, code in errors.items()}
        self.edges, self.squares = ([(t, *guesses(t)) for t in radius.tables[:, which]] for which in (0, 1))

    def errors(self, kind: ErrorKind, errors: Floats) -> Codes:
        """The codes of errors (2D)."""
        codes = np.empty(errors.shape, np.uint8)
        _check(_encode_errors(errors, *self.tables[kind], codes))
        return codes

    def radii(self, radii: Floats, row: int, col: int, octave: int) -> Codes:
        """The codes of the radii in a window of an octave that begins with entry (row, col)."""
        codes = np.zeros(radii.shape, np.uint8)
        i, j = 1 - row % 2, 1 - col % 2  # the first odd entries
        _check(_encode_radii(radii, i, j, *self.squares[octave], codes))
        _check(_encode_radii(radii, i, 1 - j, *self.edges[octave], codes))
        _check(_encode_radii(radii, 1 - i, j, *self.edges[octave], codes))
        return codes

    def round_up(self, radii: Floats, octave: int, squares: bool) -> None:
        """Replace the radii of an octave's edge diamonds, or of its ``squares``, by those that codes can say."""
        _check(_round_up(radii, int(squares), *(self.squares if squares else self.edges)[octave]))


def _check(found: bool) -> None:
    if not found:
        raise OrographError(
            "An error or a bounding sphere is larger than these heights allow.", remedy="Please report this."
        )
