"""Sixteen entropy-coded values side by side, for the decoders of *compact* and *smallest* (docs/codec.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._lanes import least, most, some, where
from orograph._lanes32 import count_of, gather32, marked_before, picked32, shifted_right, spread32
from orograph._numba import inlined, linked
from orograph.store.codec_head import BITS, DIRECT, TOTAL

Flat = NDArray[np.int32]


class Tables(NamedTuple):
    """Both flat, int32.

    Attributes:
        entries: frequencies, offsets and symbols (``read_tables``).
        direct: the number of values of each table.
    """

    entries: Flat
    direct: Flat


@linked
def add_depths(places, depths):
    """Complete the places of tables, (n,) int32, from their offsets in ``Tables.entries``: with the number of bits
    below symbols."""
    for k in range(places.size):
        places[k] += np.int32(depths[places[k] >> BITS])


@inlined
def _refilled(states, p, words):
    """Refill states below ``LEAST`` with a word each: (the states; the next word.)"""
    short = shifted_right(states, 16) == 0
    more = picked32(words, p, marked_before(short))
    return where(short, (states << 16) | more, states), p + count_of(short)


@inlined
def _plain_bits(states, p, words, bits):
    """Read plain bits of each lane, at most 16: (the states; the next word; the bits.)"""
    found = states & ((spread32(1) << bits) - 1)
    states, p = _refilled(shifted_right(states, bits), p, words)
    return states, p, found


@inlined
def next_values(states, p, words, tables, deep, places, coded):
    """Decode a value of each lane that has one: (the states, the next word, the values.)

    Args:
        deep: whether any table has bits below its symbols. places: of the lanes' tables (``add_depths``).
        coded: which lanes have a value.
    """
    entries = gather32(tables.entries, (places & -TOTAL) + (states & (TOTAL - 1)))
    after = (shifted_right(entries, 20) + 1) * shifted_right(states, BITS) + (shifted_right(entries, 8) & (TOTAL - 1))
    states, p = _refilled(where(coded, after, states), p, words)
    values = entries & 255
    ranges = (values >= DIRECT) & coded
    if some(ranges):
        bits = where(ranges, values - DIRECT, 0)
        states, p, found = _plain_bits(states, p, words, least(bits, 16))
        if some(bits > 16):
            states, p, high = _plain_bits(states, p, words, most(bits - 16, 0))
            found = found | (high << 16)
        first = gather32(tables.direct, shifted_right(places, BITS)) - 1
        values = where(ranges, (spread32(1) << bits) + found + first, values)
    if deep:
        depths = where(coded, places & (TOTAL - 1), 0)
        states, p, low = _plain_bits(states, p, words, depths)
        values = (values << depths) | low
    return states, p, values
