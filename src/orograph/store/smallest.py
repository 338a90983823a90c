"""The codec *smallest*: like *compact*, with tables that also depend on the samples just decoded.

A sample is predicted as in *compact*. Twelve differences and errors above it and five to its left estimate how good the
prediction is (weights by least squares). The table also depends on the fractional part of the prediction, or on its
distance from the sample above, as contexts depend on energy and texture in CALIC (Wu and Memon 1997). Where the ground
is half level and half roofs and trees, three tests choose one of eight sets of weights. docs/codec.md has the format,
byte by byte.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.store.coding import Numbers
from orograph.store.compact import unpacked

NAME = "orograph.smallest"
"""The codec's name in the metadata of arrays and in Zarr's registry of codecs."""

WHOLE, NESTED = 1, 4


def compressed(numbers: Numbers, nested: bool = False) -> bytes:
    """Return the bytes of a chunk, (rows, cols) int32, -2^31 where missing.

    Args:
        nested: samples of even row and column are not stored; they are decoded as 0.
    """
    from orograph.store.smallest_encode import encode

    found: NDArray[np.uint8] = encode(np.ascontiguousarray(numbers, np.int32), NESTED if nested else WHOLE)
    return found.tobytes()


def decompressed(data: bytes, shape: tuple[int, int]) -> Numbers:
    """Decode a chunk from its bytes.

    Raises:
        ValueError: they are not a valid chunk.
    """
    from orograph.store.smallest_decode import decode

    return unpacked(decode, data, shape)
