"""The way from errors and radii to the bytes of ``quantise``: each to the first of a table's values not below it.

A value's place in a table is guessed from its upper 16 bits as a float32, which leave less than one hundredth open, and
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


def guesses(table: Floats) -> NDArray[np.uint8]:
    """For the upper 16 bits of every float32 ≥ 0 the first value of the table not below the lowest of such floats."""
    lowest = (np.arange(0x7F81, dtype=np.uint32) << 16).view(np.float32)
    return np.searchsorted(table, lowest).astype(np.uint8)


@leaf
def _find(value, tables, which, guess):
    """The first entry of a table not below ``value``; the table's length if there is none."""
    code = np.int64(guess[which, np.float32(value).view(np.uint32) >> np.uint32(16)])
    while code < tables.shape[1] and tables[which, code] < value:
        code += 1
    return code


@kernel
def _encode_errors(errors, tables, guess, codes):
    """Returns whether all were found."""
    for i in range(errors.shape[0]):
        for j in range(errors.shape[1]):
            code = _find(errors[i, j], tables, 0, guess)
            if code >= tables.shape[1]:
                return False
            codes[i, j] = code
    return True


@kernel
def _encode_radii(radii, odd_row, odd_col, tables, guess, codes):
    """Returns whether all were found."""
    for i in range(radii.shape[0]):
        row = (i + odd_row) & 1
        for j in range(0 if row else 1 - odd_col, radii.shape[1], 1 if row else 2):
            code = _find(abs(radii[i, j]), tables, row & (j + odd_col), guess)
            if code >= tables.shape[1]:
                return False
            codes[i, j] = code | (EMPTY if radii[i, j] < 0 else 0)
    return True


@kernel
def _round_up(radii, squares, tables, guess):
    """Round a window's edge diamonds, or its squares; it begins with even entries. Returns as ``_encode_radii``."""
    for i in range(squares, radii.shape[0], 1 + squares):
        for j in range(1 if squares else 1 - (i & 1), radii.shape[1], 2):
            code = _find(radii[i, j], tables, squares, guess)
            if code >= tables.shape[1]:
                return False
            radii[i, j] = tables[squares, code]
    return True


class Encoder:
    """Turns errors and radii into codes.

    Args:
        errors: how each kind of errors is coded.
        radius: how radii are.
    """

    def __init__(self, errors: Mapping[ErrorKind, ErrorCode], radius: RadiusCode) -> None:
        self.radius = radius
        self.tables = {kind: (code.table[None], guesses(code.table)[None]) for kind, code in errors.items()}
        self.guesses = [np.stack([guesses(table) for table in tables]) for tables in radius.tables]

    def errors(self, kind: ErrorKind, errors: Floats) -> Codes:
        """The codes of errors (2D)."""
        codes = np.empty(errors.shape, np.uint8)
        _check(_encode_errors(errors, *self.tables[kind], codes))
        return codes

    def radii(self, radii: Floats, row: int, col: int, octave: int) -> Codes:
        """The codes of the radii in a window of an octave that begins with entry (row, col)."""
        codes = np.zeros(radii.shape, np.uint8)
        _check(_encode_radii(radii, row % 2, col % 2, self.radius.tables[octave], self.guesses[octave], codes))
        return codes

    def round_up(self, radii: Floats, octave: int, squares: bool) -> None:
        """Replace the radii of an octave's edge diamonds, or of its ``squares``, by those that codes can say."""
        _check(_round_up(radii, int(squares), self.radius.tables[octave], self.guesses[octave]))


def _check(found: bool) -> None:
    if not found:
        raise OrographError(
            "An error or a bounding sphere is larger than these heights allow.", remedy="Please report this."
        )
