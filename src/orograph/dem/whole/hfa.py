"""Erdas Imagine (.img): every block that the file claims to hold lies within it, and runs fill their blocks.

Source: the HFA structure as GDAL documents it (frmts/hfa): a tree of entries. Entries of type ``Edms_State`` list a
layer's blocks; those of type ``ImgExternalRaster`` say where the blocks begin in a companion file (.ige). A compressed
block holds runs: their lengths, each in 1 to 4 bytes, then their values in packed bits.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

_ENTRY = struct.Struct("<IIIIIi64s32s")  # next, previous, parent, child, data, their size, name, type
_STATE = struct.Struct("<iiihII")  # blocks, objects, next object, compression, blocks listed, where
_BLOCK = np.dtype([("file", "<i2"), ("offset", "<u4"), ("size", "<u4"), ("valid", "<i2"), ("packed", "<i2")])
_PACKED = struct.Struct("<iiib")  # smallest value, runs (-1: no runs, all values), offset of the values, bits per value
_MOST_ENTRIES = 1 << 20


def fault(dataset: Any, path: str) -> str | None:
    """The fault of an Imagine file, as a sentence; None if there is none."""
    size = Path(path).stat().st_size
    high, wide = dataset.block_shapes[0]
    count = -(-dataset.height // high) * -(-dataset.width // wide)
    spilled = spills = layers = 0
    with Path(path).open("rb") as file:
        try:
            for kind, at in _nodes(file):
                if kind == b"ImgExternalRaster":
                    wanted = _spilled_end(file, at, count * high * wide * np.dtype(dataset.dtypes[0]).itemsize)
                    spilled = max(spilled, wanted)
                    layers += 1
                    files = [Path(path).with_name(Path(f).name) for f in dataset.files if f.lower().endswith(".ige")]
                    sizes = [f.stat().st_size for f in files if f.exists()]
                    if not sizes:
                        return "The file of its samples (.ige) is missing."
                    spills = sizes[0]
                    if sizes[0] < wanted:
                        return f"Its .ige file ends after {sizes[0]:,} of at least {wanted:,} bytes."
                if kind != b"Edms_State":
                    continue
                blocks = _blocks(file, at)
                end = int((blocks["offset"].astype(np.int64) + blocks["size"])[blocks["valid"] != 0].max(initial=0))
                if end > size:
                    return f"It ends after {size:,} of at least {end:,} bytes that its blocks need."
                if blocks.size == count and any(not _fills(file, b, high * wide) for b in blocks if b["packed"]):
                    return "One of its compressed blocks cannot be decoded."
        except (struct.error, ValueError):
            return "Its list of blocks is truncated or damaged."
    if layers == 1 and spills > spilled:
        return f"Its .ige file has {spills:,} bytes where its header promises {spilled:,}."
    return None


def _nodes(file: BinaryIO) -> Iterator[tuple[bytes, int]]:
    """The type of every entry, and the offset of its data."""
    (header,) = struct.unpack("<I", _at(file, 16, 4))
    (root,) = struct.unpack("<I", _at(file, header + 8, 4))
    waiting, seen = [root], set[int]()
    while waiting:
        place = waiting.pop()
        if not place or place in seen:
            continue
        seen.add(place)
        if len(seen) > _MOST_ENTRIES:
            raise ValueError("too many entries")
        following, _, _, child, data, _, _, kind = _ENTRY.unpack(_at(file, place, _ENTRY.size))
        yield kind.partition(b"\0")[0], data
        waiting += [following, child]


def _spilled_end(file: BinaryIO, at: int, layer: int) -> int:
    """The minimum length of the companion file for one layer of its stack, bytes."""
    (name,) = struct.unpack("<I", _at(file, at, 4))
    _, begin, stack, _ = struct.unpack("<QQII", _at(file, at + 8 + name, 24))
    return int(begin + layer * stack)


def _blocks(file: BinaryIO, at: int) -> Any:
    *_, listed, where = _STATE.unpack(_at(file, at, _STATE.size))
    return np.frombuffer(_at(file, where, listed * _BLOCK.itemsize), _BLOCK)


def _fills(file: BinaryIO, block: Any, samples: int) -> bool:
    """Whether a compressed block holds as many samples as it must."""
    from orograph.dem.whole.kernels import run_lengths

    if not block["valid"]:
        return True
    data = _at(file, int(block["offset"]), int(block["size"]))
    _, runs, values, bits = _PACKED.unpack(data[: _PACKED.size])
    held = samples if runs == -1 else run_lengths(np.frombuffer(data, np.uint8)[_PACKED.size :], runs)
    needed = values + -(-(samples if runs == -1 else runs) * bits // 8)
    return bool(held == samples and 0 <= bits <= 32 and _PACKED.size <= values and needed <= len(data))


def _at(file: BinaryIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    data = file.read(size)
    if len(data) < size:
        raise ValueError("beyond the end")
    return data
