"""The result of a task of a build, stored as one object until the build is complete: named arrays and a checksum.

Not ``.npz``: NumPy reads its headers with ``ast.literal_eval``, which in CPython 3.11 occasionally fails when several
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


def pieces(arrays: Mapping[str, NDArray[Any]]) -> list[bytes]:
    """Arrays as buffers to write one after the other.

    They are the length of the table of contents, the table, all samples, and a checksum over all of them. Contiguous
    samples are not copied.
    """
    contents = json.dumps([(name, array.dtype.str, array.shape) for name, array in arrays.items()]).encode()
    found: list[Any] = [len(contents).to_bytes(8, "little") + contents]
    check = crc32c(found[0])
    for array in arrays.values():
        samples = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        check = crc32c(samples, check)
        found.append(samples)
    return [*found, check.to_bytes(4, "little")]


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The same as bytes."""
    return b"".join(pieces(arrays))


def unpack(data: bytes) -> dict[str, NDArray[Any]]:
    """Unpack the arrays.

    Raises:
        ValueError: the data are damaged or truncated.
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
