"""Classic netCDF: the file holds all that its header lays out. (netCDF-4 is HDF5, which notices by itself.)

Source: NetCDF Classic Format Specification (Unidata; formats CDF-1, CDF-2 and CDF-5).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, BinaryIO

_ITEM = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_STREAMING = 0xFFFFFFFF


def fault_before(path: str) -> str | None:
    """The fault in the header of a classic file that GDAL has not opened yet; None if there is none.

    Impossible numbers there make the library request memory for many seconds. Other formats have no fault here.
    """
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        magic = file.read(4)
        if len(magic) < 4 or magic[:3] != b"CDF" or magic[3] not in (1, 2, 5):
            return None
        try:
            end = _Header(file, magic[3], size).end()
        except (struct.error, LookupError, ValueError, OverflowError):
            return "Its header is truncated or damaged."
    return None if end <= size else f"It ends after {size:,} of the {end:,} bytes that its header promises."


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a netCDF file, as a sentence; None if there is none."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        magic = file.read(4)
        if magic[:3] != b"CDF" or magic[3] not in (1, 2, 5):
            return None
        try:
            header = _Header(file, magic[3], size)
            end = header.end()
        except (struct.error, LookupError, ValueError, OverflowError):
            return "Its header is truncated or damaged."
        file.seek(max(end, size - 65536))
        padded = size in (end, -(-end // 4) * 4) or (size % 128 == 0 and not any(file.read()))
        behind = not header.streaming and not padded
    if size < max(end, header.filled):
        return f"It ends after {size:,} of the {max(end, header.filled):,} bytes that its header promises."
    if behind:
        return f"It has {size:,} bytes where its header promises {end:,}: one of the two is damaged."
    return None


class _Header:
    """Reads the header of a classic file from its fifth byte."""

    def __init__(self, file: BinaryIO, version: int, size: int) -> None:
        self.file = file
        self.size = size
        self.count = ">q" if version == 5 else ">I"
        self.offset = ">I" if version == 1 else ">q"
        self.streaming = False
        self.filled = 0  # where the last variable without records ends, padded to four bytes

    def end(self) -> int:
        """The byte at which the last variable ends."""
        records = self._number(self.count)
        self.streaming = records in (_STREAMING, -1)
        lengths = [self._dimension() for _ in range(self._list_length())]
        self._attributes()
        plain, begins = 0, list[tuple[int, int]]()
        for _ in range(self._list_length()):
            self._name()
            shape = [lengths[self._number(self.count)] for _ in range(self._number(self.count))]
            self._attributes()
            item = _ITEM[self._number(">I")]
            self._number(self.count)  # vsize, which overflows for large variables
            begin = self._number(self.offset)
            size = item
            for length in shape[1:] if shape and shape[0] == 0 else shape:
                size *= length
            if shape and shape[0] == 0:
                begins.append((begin, size))
            else:
                plain = max(plain, begin + size)
                self.filled = max(self.filled, begin + -(-size // 4) * 4)
        if not begins or self.streaming:
            return plain
        per_record = sum(-(-s // 4) * 4 for _, s in begins) if len(begins) > 1 else begins[0][1]
        last = max(begins)
        return max(plain, last[0] + (records - 1) * per_record + last[1] if records else plain)

    def _number(self, form: str) -> int:
        return int(struct.unpack(form, self.file.read(struct.calcsize(form)))[0])

    def _list_length(self) -> int:
        tag, count = self._number(">I"), self._number(self.count)
        if tag not in (0, 10, 11, 12) or (tag == 0 and count) or count > self.size:
            raise ValueError("no list")
        return count

    def _name(self) -> None:
        self._skip(-(-self._number(self.count) // 4) * 4)

    def _skip(self, size: int) -> None:
        """Skip some bytes of the header."""
        if not 0 <= size <= self.size:
            raise ValueError("beyond the end")
        self.file.seek(size, 1)

    def _dimension(self) -> int:
        self._name()
        return self._number(self.count)

    def _attributes(self) -> None:
        for _ in range(self._list_length()):
            self._name()
            item = _ITEM[self._number(">I")]
            self._skip(-(-self._number(self.count) * item // 4) * 4)
