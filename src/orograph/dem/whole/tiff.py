"""TIFF: the parts of the file lie where they can.

GDAL trusts the directories. A file with inserted bytes still opens, with its samples shifted from there on; a changed
offset gives samples of another block; a broken link to further directories silently loses a mask. Such damage shows as
overlapping blocks, a chain of directories that breaks off, and, if samples are not compressed, bytes at the end of the
file that belong to nothing.

Sources: TIFF 6.0, section 2; BigTIFF (Aware Systems).
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.whole.blocks import CODECS
from orograph.dem.whole.tiff_tags import (
    COUNTS,
    LARGEST,
    OFFSETS,
    Directory,
    blocks_fault,
    lost_mask,
    plain_bytes,
    row_major,
    tags_fault,
)

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_CODES = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 17: "u8", 18: "u8"}  # 17 is signed, and no offset is negative
_INNER = (330, 34665, 34853, 40965)  # sub-directories, EXIF, GPS, interoperability
_MOST = 4096  # directories
_TAIL = 1 << 16
_BLOCK = 128  # zeros that pad the last such block are not part of a file


def fault(dataset: Any, file: IO[bytes]) -> str | None:
    """The fault in the layout of a TIFF, as a sentence; None if there is none.

    Args:
        dataset: of rasterio, open.
        file: its bytes.
    """
    size = file.seek(0, 2)
    file.seek(0)
    try:
        tiff = TiffFile(file, size)
    except (struct.error, ValueError):
        return None  # an unknown kind of TIFF, which is left to GDAL
    found, broken = tiff.directories()
    if broken:
        return "Its chain of directories breaks off: a mask or an overview after the first is lost."
    if not found:
        return None
    if found[0].following == 0 and lost_mask(tiff, found, tiff.directory):
        return "It holds a mask that no directory links to: its directories are damaged."
    return (
        tags_fault(tiff, found)
        or _overlap(dataset, tiff, found[0])
        or _places_fault(tiff, found)
        or _behind(dataset, tiff, found, size)
    )


def first_directory(file: IO[bytes]) -> tuple[TiffFile, Directory] | None:
    """A TIFF with its first directory; None if these cannot be read, which is left to GDAL."""
    size = file.seek(0, 2)
    file.seek(0)
    try:
        tiff = TiffFile(file, size)
        return tiff, tiff.directory(tiff.first)
    except (struct.error, ValueError):
        return None


def cut_off(file: IO[bytes]) -> str | None:
    """The fault of a TIFF that ends before its first raster, judged by its directory: an interrupted download.

    (Some writers do not pad the last block of uncompressed samples.)
    """
    found = first_directory(file)
    if found is None:
        return None
    tiff, first = found
    at, size = tiff.blocks(first)
    lacks = int((at + size).max(initial=0)) - tiff.size
    high = [int(n) for tag in (_LENGTH, _TILE_LENGTH, _STRIP_ROWS) for n in tiff.numbers(first, tag)[:1]]
    if tiff.plain(first) and len(high) == 2 and 0 < high[1] < high[0]:
        lacks -= int(size[int(at.argmax())]) * (-high[0] % high[1]) // high[1] if at.size else 0
    return f"It ends {lacks:,} bytes before the end of its last block." if lacks > 0 else None


_LENGTH, _TILE_LENGTH, _STRIP_ROWS = 257, 323, 278
_LERC = 34887
_FLOATS = 3
TURNED = "Rewrite it from its source in LERC's byte order (gdal_translate -co ENDIANNESS=LITTLE)."


def turned_floats(file: IO[bytes]) -> bool:
    """Whether a TIFF holds big-endian floats compressed by LERC.

    GDAL swaps the bytes before and after LERC, which then rounds other numbers: what is read is not what was written.
    """
    found = first_directory(file)
    if found is None:
        return False
    tiff, first = found
    codec, kinds = tiff.numbers(first, 259), tiff.numbers(first, 339)
    return tiff.order == ">" and _LERC in codec and _FLOATS in kinds


def _places_fault(tiff: TiffFile, found: list[Directory]) -> str | None:
    """Blocks at impossible places."""
    tiff.file.seek(0)
    ordered = row_major(tiff.file.read(1024))
    at, size = tiff.blocks(found[0])
    plain = plain_bytes(tiff, found[0]) if tiff.plain(found[0]) else 0
    return blocks_fault(tiff, found, at, size, plain, ordered)


_CODEC = {1: "", 5: "LZW", 8: "DEFLATE", 32946: "DEFLATE", 32773: "PACKBITS", 50000: "ZSTD"}


def tile_fault(data: bytes, wide: int = 0, high: int = 0) -> str | None:
    """The fault in a small TIFF in memory that is a tile of another file, as a sentence; None if there is none.

    Args:
        wide, high: the required samples; 0: any.
    """
    file = BytesIO(data)
    try:
        tiff = TiffFile(file, len(data))
        found, broken = tiff.directories()
    except (struct.error, ValueError):
        found, broken = [], True
    if broken or not found:
        return "It is not a TIFF."

    def one(tag: int, otherwise: int) -> int:
        numbers = tiff.numbers(found[0], tag)
        return int(numbers[0]) if numbers.size else otherwise

    cols, rows = one(256, 0), one(257, 0)
    line = cols if (tiled := one(322, 0)) == 0 else tiled
    tall = one(323, 0) or min(one(278, rows), rows)
    if not cols or not rows or not line or not tall or (wide and (cols, rows) != (wide, high)):
        return f"It has {rows} × {cols} samples."
    together = one(277, 1) if one(284, 1) == 1 else 1
    most = tall * -(-line * together * one(258, 1) // 8)
    at, sizes = tiff.blocks(found[0])
    down = -(-rows // tall)
    if at.size != down * -(-cols // line) * (one(277, 1) // together):
        return "It lacks blocks."
    for number, (begin, size) in enumerate(zip(at.tolist(), sizes.tolist(), strict=True)):
        held = data[begin : begin + size]
        across = -(-cols // line)
        least = min(tall, rows - (number // across % down) * tall) * (most // tall)
        check = CODECS.get(_CODEC.get(one(259, 1), "?"))
        short = len(held) < size or (one(259, 1) == 1 and size < least)
        if short or (check is not None and check(held, least, most) is not None):
            return "One of its blocks cannot be decoded."
    return None


class TiffFile:
    """The directories of a TIFF.

    Args:
        file: its bytes, at the first.
        size: how many.

    Raises:
        ValueError: it is not a TIFF (or struct.error).
    """

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size
        head = file.read(16)
        self.order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
        (version,) = struct.unpack((self.order or "<") + "H", head[2:4])
        if not self.order or version not in (42, 43):
            raise ValueError("no TIFF")
        self.big = version == 43
        self.entry = struct.Struct(self.order + ("HHQ8s" if self.big else "HHI4s"))
        self.word = self.order + ("Q" if self.big else "I")
        (self.first,) = struct.unpack_from(self.word, head, 8 if self.big else 4)

    def directories(self) -> tuple[list[Directory], bool]:
        """All directories, the first of the chain first, and whether the chain breaks off."""
        found: list[Directory] = []
        waiting, seen, broken = [(self.first, True)], set[int](), False
        while waiting and len(found) < _MOST:
            at, chained = waiting.pop()
            if at == 0 or at in seen:
                broken |= chained and at in seen
                continue
            seen.add(at)
            try:
                directory = self.directory(at)
            except (struct.error, ValueError):
                broken |= chained
                continue
            found.append(directory)
            for tag in _INNER:
                if tag in directory.tags:
                    waiting += [(int(inner), False) for inner in self.numbers(directory, tag)[:_MOST]]
            if chained:
                waiting.append((directory.following, True))
        return found, broken and bool(found)

    def directory(self, at: int) -> Directory:
        """The directory at a byte; struct.error or ValueError if there is none."""
        self.file.seek(at)
        (count,) = struct.unpack(self.order + ("Q" if self.big else "H"), self.file.read(8 if self.big else 2))
        if not 0 < count < _MOST:
            raise ValueError("no directory")
        data = self.file.read(count * self.entry.size)
        begin = at + (8 if self.big else 2)
        end = begin + count * self.entry.size + struct.calcsize(self.word)
        tags: dict[int, tuple[int, int, int]] = {}
        twice = 0
        for i in range(count):
            tag, kind, number, value = self.entry.unpack_from(data, i * self.entry.size)
            room = _SIZES.get(kind, 0) * number
            place = begin + i * self.entry.size + self.entry.size - len(value)
            if room > len(value):
                (place,) = struct.unpack(self.word, value)
                if place + room <= self.size:
                    end = max(end, place + room)
            twice = tag if tag in tags else twice
            tags.setdefault(tag, (kind, number, place))
        if not any(tag in tags for tag in (256, *OFFSETS, 513)) and at == self.first:
            raise ValueError("no directory of a picture")
        (following,) = struct.unpack(self.word, self.file.read(struct.calcsize(self.word)))
        return Directory(tags, at, end, following, twice)

    def numbers(self, directory: Directory, tag: int) -> NDArray[np.int64]:
        """The integers of a tag; none if it is missing or beyond the file."""
        kind, count, place = directory.tags.get(tag, (0, 0, 0))
        if kind not in _CODES or not 0 < count < LARGEST or place + count * _SIZES[kind] > self.size:
            return np.zeros(0, np.int64)
        self.file.seek(place)
        read = np.frombuffer(self.file.read(count * _SIZES[kind]), self.order + _CODES[kind])
        return np.minimum(read.astype(np.uint64), np.uint64(1 << 62)).astype(np.int64)

    def doubles(self, directory: Directory, tag: int) -> NDArray[np.float64]:
        """The doubles of a tag; none if it is missing or beyond the file."""
        kind, count, place = directory.tags.get(tag, (0, 0, 0))
        if kind != 12 or not 0 < count < _MOST or place + 8 * count > self.size:
            return np.zeros(0)
        self.file.seek(place)
        return np.frombuffer(self.file.read(8 * count), self.order + "f8").astype(np.float64)

    def text(self, directory: Directory, tag: int) -> str:
        """The text of a tag; "" if it is missing or beyond the file."""
        kind, count, place = directory.tags.get(tag, (0, 0, 0))
        if kind != 2 or not 0 < count < _TAIL or place + count > self.size:
            return ""
        self.file.seek(place)
        return self.file.read(count).rstrip(b"\0 ").decode("latin-1")

    def blocks(self, directory: Directory) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Offsets and sizes of the blocks that exist."""
        for places, sizes in zip(OFFSETS, COUNTS, strict=True):
            at, size = self.numbers(directory, places), self.numbers(directory, sizes)
            if at.size and at.size == size.size:
                there = (at > 0) & (size > 0)
                return at[there], size[there]
        return np.zeros(0, np.int64), np.zeros(0, np.int64)

    def plain(self, directory: Directory) -> bool:
        """Whether samples are not compressed."""
        code = self.numbers(directory, 259)
        return not code.size or code[0] == 1


def _block_bytes(dataset: Any) -> int:
    """The maximum bytes of an uncompressed block."""
    from rasterio.enums import Interleaving

    high, wide = dataset.block_shapes[0]
    bits = dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS")
    sample = int(bits) if bits else 8 * np.dtype(dataset.dtypes[0]).itemsize
    together = dataset.count if dataset.interleaving == Interleaving.pixel else 1
    return int(high * -(-wide * together * sample // 8))


def _overlap(dataset: Any, tiff: TiffFile, first: Directory) -> str | None:
    """Blocks of the raster that overlap partly (several may share one place)."""
    at, size = tiff.blocks(first)
    if tiff.plain(first):
        size = np.minimum(size, _block_bytes(dataset))
    order = np.argsort(at, kind="stable")
    at, size = at[order], size[order]
    inside = at[1:] < (at + size)[:-1]
    if np.any(inside & ~((at[1:] == at[:-1]) & (size[1:] == size[:-1]))):
        return "Its blocks overlap: the table of their offsets is damaged."
    return None


def _behind(dataset: Any, tiff: TiffFile, found: list[Directory], size: int) -> str | None:
    """Bytes after everything that the directories refer to, in an uncompressed raster."""
    if not tiff.plain(found[0]) or not tiff.blocks(found[0])[0].size:
        return None
    end = max(directory.end for directory in found)
    for directory in found:
        at, sizes = tiff.blocks(directory)
        if not at.size:
            continue
        if directory is found[0] and (at + np.minimum(sizes, _block_bytes(dataset)) > size).any():
            return _cut_fault(dataset, tiff, at, size)
        # Some writers declare too little.
        wanted = np.maximum(sizes, _block_bytes(dataset)) if directory is found[0] else sizes
        for ends in (at + sizes, at + wanted):
            end = max(end, int(ends[ends <= size].max(initial=0)))
    end += 4 if _trailed(tiff.file) else 0
    if size <= end:
        return None
    tiff.file.seek(max(end, size - _TAIL))
    padded = size % _BLOCK == 0 or (size == end + 1 and end % 2)
    if padded and not any(tiff.file.read()):
        return None
    return f"It has {size - end:,} bytes after its last part: bytes were inserted, which shifts its samples."


def _cut_fault(dataset: Any, tiff: TiffFile, at: NDArray[np.int64], size: int) -> str | None:
    """The fault of an uncompressed raster that ends within a block.

    GDAL reports missing samples. In a padded last strip it does not notice missing bytes; some writers omit the
    padding.
    """
    high = dataset.block_shapes[0][0]
    down = -(-dataset.height // high)
    if OFFSETS[1] in tiff.directories()[0][0].tags or dataset.height % high == 0 or at.size % down:
        return None
    end = int(at.max()) + _block_bytes(dataset) // high * (dataset.height % high)
    if size <= end + 1:
        return None
    return f"It ends {int(at.max()) + _block_bytes(dataset) - size:,} bytes before the end of its last part."


def _trailed(file: IO[bytes]) -> bool:
    """Whether the last bytes of each block are repeated after it, as in cloud-optimised files."""
    file.seek(0)
    return b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED" in file.read(1024)
