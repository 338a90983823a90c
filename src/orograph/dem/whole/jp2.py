"""JPEG 2000: the codestream has all its tiles, each as long as it says, and its end marker.

OpenJPEG returns what it has of a stream that ends early; lost tiles are uninitialised memory.

Source: ITU-T T.800, annexes A (markers) and I (boxes).
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import IO, Any

_SIZ, _SOT, _END = b"\xff\x51", b"\xff\x90", b"\xff\xd9"


_FIRST = b"\x00\x00\x00\x0cjP  "
_NESTS = (b"jp2h", b"asoc", b"res ", b"uinf")


def fault_before(path: str) -> str | None:
    """The fault in the boxes of a file that GDAL has not opened yet; None if there is none, or it is not JPEG 2000.

    A nested box with an impossible length would keep GDAL busy for ever.
    """
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        if file.read(8) != _FIRST:
            return None
        waiting = [(0, size, True)]
        while waiting:
            at, end, outer = waiting.pop()
            while at + 8 <= end:
                file.seek(at)
                head = file.read(16)
                length, kind = struct.unpack(">I4s", head[:8])
                begin = at + (16 if length == 1 else 8)
                if length == 1 and len(head) == 16:
                    (length,) = struct.unpack(">Q", head[8:])
                if length == 0 and outer:
                    break
                if not outer and not begin <= at + length <= end:
                    return f"Its box {kind.decode('latin-1')!r} at byte {at:,} has an impossible length."
                if not begin <= at + length <= end:
                    break  # cut short; the check of the open file finds this
                if kind in _NESTS:
                    waiting.append((begin, at + length, False))
                at += length
    return None


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a JPEG 2000 file, as a sentence; None if there is none."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        if file.read(4) == b"\xff\x4f\xff\x51":
            return stream_fault(file, 0, size)
        at = 0
        while at < size:
            file.seek(at)
            head = file.read(16)
            if len(head) < 8:
                break
            length, kind = struct.unpack(">I4s", head[:8])
            begin = at + (16 if length == 1 else 8)
            end = size if length == 0 else at + (struct.unpack(">Q", head[8:])[0] if length == 1 else length)
            if end < begin or end > size:
                return f"It ends after {size:,} bytes, within its box {kind.decode('latin-1')!r} or before."
            if kind == b"jp2c":
                return stream_fault(file, begin, end)
            at = end
    return "It has no codestream."


def nitf(dataset: Any, path: str) -> str | None:
    """The fault in a NITF file's JPEG 2000 codestream, as a sentence; None if there is no fault or no codestream."""
    if dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION") != "JPEG2000":
        return None
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as held:
        at = held.find(b"\xff\x4f\xff\x51")
        return "It has no codestream." if at < 0 else stream_fault(file, at, size)


def stream_fault(file: IO[bytes], begin: int, end: int) -> str | None:
    """The fault in the codestream between two bytes of a file, as a sentence; None if there is none."""
    file.seek(begin + 2)
    tiles, lost = 0, "Its codestream is truncated or damaged"
    while True:
        mark = file.read(2)
        if mark == _SOT:
            break
        length = int.from_bytes(file.read(2), "big")
        if len(mark) < 2 or mark[0] != 255 or length < 2 or file.tell() + length > end:
            return f"{lost}, in its header."
        content = file.read(length - 2)
        if mark == _SIZ:
            x1, y1, _, _, wide, high, x0, y0 = struct.unpack_from(">8I", content, 2)
            if not wide or not high:
                return f"{lost}, in its header."
            tiles = -(-(x1 - x0) // wide) * -(-(y1 - y0) // high)
    at, parts = file.tell() - 2, dict[int, set[int]]()
    promised: dict[int, int] = {}
    while True:
        file.seek(at)
        head = file.read(12)
        if head[:2] == _END:
            at += 2
            break
        if head[:2] != _SOT or len(head) < 12:
            return f"{lost}: at byte {at:,} there is neither a tile nor the end."
        _, tile, length, part, count = struct.unpack(">HHIBB", head[2:])
        following = end - 2 if length == 0 else at + length
        if tile >= tiles or following > end or following < at + 12:
            return f"{lost}, in its tile {tile}."
        parts.setdefault(tile, set()).add(part)
        promised[tile] = max(promised.get(tile, 0), count)
        at = following
    lacking = next((t for t in range(tiles) if len(parts.get(t, ())) < max(1, promised.get(t, 0))), None)
    if lacking is not None:
        return f"{lost}: tile {lacking} of {tiles} is incomplete."
    return None
