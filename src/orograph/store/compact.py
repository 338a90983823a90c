"""The codec *compact*: chunks of integers, predicted from their surroundings and entropy-coded.

A sample is predicted from twelve others to the left and above (weights by least squares, one set per chunk). The
difference is coded with range asymmetric numeral systems (rANS, Duda 2013), with one of up to eight tables, chosen by
the size of the differences above it. docs/codec.md has the format, byte by byte.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.store.coding import Numbers

NAME = "orograph.compact"
"""The codec's name in the metadata of arrays and in Zarr's registry of codecs."""

WRONG = {
    1: "it ends too early",
    2: "it is of another version of the codec, or not a chunk of it",
    3: "its tables are invalid",
    4: "its runs of missing samples are invalid",
    5: "its stream ends in the wrong place",
}


def compressed(numbers: Numbers) -> bytes:
    """Return the bytes of a chunk, (rows, cols) int32, -2^31 where missing."""
    from orograph.store.compact_encode import encode

    found: NDArray[np.uint8] = encode(np.ascontiguousarray(numbers, np.int32))
    return found.tobytes()


def decompressed(data: bytes, shape: tuple[int, int]) -> Numbers:
    """Decode a chunk from its bytes.

    Raises:
        ValueError: they are not a valid chunk.
    """
    from orograph.store.compact_decode import decode

    return unpacked(decode, data, shape)


def unpacked(decode: Callable[[NDArray[np.uint8], Numbers], int], data: bytes, shape: tuple[int, int]) -> Numbers:
    """Decode a chunk with a codec's kernel, which fills it and returns 0 or an error code (``WRONG``).

    Raises:
        ValueError: the kernel returned an error.
    """
    found = np.empty(shape, np.int32)
    wrong = decode(np.frombuffer(data, np.uint8), found)
    if wrong:
        raise ValueError(f"A chunk cannot be decoded: {WRONG[wrong]}.")
    return found
