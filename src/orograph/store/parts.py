"""What a task of a build found, kept as one object until the build is complete: named arrays and a checksum.

Not ``.npz``: NumPy reads its headers with ``ast.literal_eval``, which in CPython 3.11 fails now and then where several
threads do so at once ("AST constructor recursion depth mismatch").
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.store.digests import crc32c


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Arrays as bytes: the length of the table of contents, it, all samples, and a checksum over all of them."""
    contents = json.dumps([(name, array.dtype.str, array.shape) for name, array in arrays.items()]).encode()
    data = b"".join(
        [len(contents).to_bytes(8, "little"), contents, *(np.ascontiguousarray(a).tobytes() for a in arrays.values())]
    )
    return data + crc32c(data).to_bytes(4, "little")


def unpack(data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays that were packed.

    Raises:
        ValueError: the data is damaged or cut off.
    """
    if len(data) < 12 or crc32c(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise ValueError("the part of a build fails its checksum")
    at = 8 + int.from_bytes(data[:8], "little")
    arrays = {}
    for name, dtype, shape in json.loads(data[8:at]):
        count = math.prod(shape)
        arrays[name] = np.frombuffer(data, dtype, count, at).reshape(shape)
        at += count * np.dtype(dtype).itemsize
    return arrays
