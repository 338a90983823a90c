"""TIFF: consistency of a directory's tags with each other and with the blocks.

libtiff only warns and continues where a tag is repeated, has an impossible type or number of values, or where its
tables list other blocks than there are; for a block with an offset and no size, GDAL gives nodata or 0.

Sources: TIFF 6.0, sections 2, 8 and 15; GeoTIFF 1.1 (OGC 19-008r4); COG as GDAL writes it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import IO, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

OFFSETS, COUNTS = (273, 324), (279, 325)
LARGEST = 1 << 27  # entries of a table that are checked

_WHOLE = (1, 3, 4, 16)
_TYPES: dict[int, tuple[int, ...]] = {
    **dict.fromkeys((254, 256, 257, 258, 259, 262, 266, 274, 277, 278, 284, 317, 322, 323, 338, 339), _WHOLE),
    **dict.fromkeys((33550, 33922, 34264, 34736), (11, 12)), 34735: (3,), 34737: (2,), 42113: (2,),
}  # fmt: skip
"""Tags that decide heights and places → the types that their values may have."""

_SINGLE = (254, 256, 257, 259, 262, 266, 274, 277, 278, 284, 317, 322, 323)
_COUNTED = {33550: 3, 34264: 16}
_MULTIPLE = {33922: 6, 34735: 4}
_LOOKED_AT = 4096
_SMALLEST = 64  # bytes of a directory that declares the size of its raster
_GAPS = 32
_SEARCHED = 1 << 18  # bytes at either end of a gap that are searched for a directory
_GUARDS = 9  # bytes around a block: its length, its repeated end, and one for even alignment
_MASK = 4  # as a bit of NewSubfileType, and as PhotometricInterpretation


class Directory(NamedTuple):
    """A directory of a TIFF.

    It has its tags' (type, count, offset of the values), where it begins, where it and all its values end, the next
    directory, and a repeated tag (0: none).
    """

    tags: dict[int, tuple[int, int, int]]
    begin: int
    end: int
    following: int
    twice: int = 0


class Tiff(Protocol):
    """What the checks here need from a file."""

    file: IO[bytes]
    size: int
    order: str
    big: bool

    def numbers(self, directory: Directory, tag: int) -> NDArray[np.int64]:
        """The integers of a tag."""


def tags_fault(tiff: Tiff, directories: list[Directory]) -> str | None:
    """The fault in the tags of directories (the first is the raster's), as a sentence; None if there is none."""
    for directory in directories:
        if directory.twice:
            return f"Its tag {directory.twice} occurs twice in a directory: it is damaged."
        wrong = next((tag for tag, (kind, count, _) in directory.tags.items() if not _may_be(tag, kind, count)), None)
        if wrong is not None:
            return f"Its tag {wrong} has an invalid type or number of values: it is damaged."
    first = directories[0]
    together = _one(tiff, first, 277, 1)
    for tag in (258, 339):
        if tag in first.tags and first.tags[tag][1] not in (1, together):
            return f"It has {together} samples per pixel, but {first.tags[tag][1]} values in its tag {tag}."
    if not all(map(first.tags.__contains__, (256, 257, 262))):
        return "A mandatory tag is missing: its directory is damaged."
    return _mask_fault(tiff, directories) or _tables_fault(tiff, first)


def _may_be(tag: int, kind: int, count: int) -> bool:
    return (
        kind in _TYPES.get(tag, (kind,))
        and (tag not in _SINGLE or count == 1)
        and count == _COUNTED.get(tag, count)
        and count % _MULTIPLE.get(tag, 1) == 0
    )


def _one(tiff: Tiff, directory: Directory, tag: int, otherwise: int) -> int:
    numbers = tiff.numbers(directory, tag)
    return int(numbers[0]) if numbers.size else otherwise


def _mask_fault(tiff: Tiff, directories: list[Directory]) -> str | None:
    """A mask that GDAL no longer recognises: it then takes missing samples as heights."""
    shapes = [tuple(_one(tiff, directory, tag, 0) for tag in (256, 257)) for directory in directories]
    masks = [bool(_one(tiff, directory, 254, 0) & _MASK) for directory in directories]
    for directory, shape, mask in zip(directories[1:], shapes[1:], masks[1:], strict=True):
        if mask != (_one(tiff, directory, 262, -1) == _MASK):
            return "One of its directories is a mask by one tag but not by another."
        alike = any(one == shape and not other for one, other in zip(shapes, masks, strict=True))
        bands = _one(tiff, directory, 277, 1)
        odd = bands not in (1, _one(tiff, directories[0], 277, 1)) or _one(tiff, directory, 258, 1) not in (1, 8)
        if mask and (odd or not alike):
            return "Its mask differs in size from what it masks, or is not a mask."
    return None


def _tables_fault(tiff: Tiff, first: Directory) -> str | None:
    """Tables that list too few blocks, or too many with content, or blocks with only an offset or only a size."""
    wanted = _blocks_wanted(tiff, first)
    for places, sizes in zip(OFFSETS, COUNTS, strict=True):
        at, size = tiff.numbers(first, places), tiff.numbers(first, sizes)
        if places in first.tags and sizes in first.tags and first.tags[places][1] != first.tags[sizes][1]:
            return (
                f"It lists the places of {first.tags[places][1]:,} blocks and the sizes of {first.tags[sizes][1]:,}: "
                "the table of its blocks is damaged."
            )
        for tag, read in ((places, at), (sizes, size)):
            kind, count, _ = first.tags.get(tag, (0, 0, 0))
            if kind in _WHOLE and 0 < count < LARGEST and not read.size:
                return "The table of its blocks lies beyond its end: it is truncated."
        if not at.size or at.size != size.size:
            continue
        if ((at == 0) & (size > 0)).any():
            return "One of its blocks has a size but no offset: the table of its blocks is damaged."
        if at.size > 1 and any(_holds(tiff, first, int(place)) for place in at[(at > 0) & (size == 0)][:_LOOKED_AT]):
            return "One of its blocks has an offset but no size: the table of its blocks is damaged."
        more = (size[wanted:] > 0) & (at[wanted:] > 0) & (at[wanted:] + size[wanted:] <= tiff.size)
        if wanted and (at.size < wanted or more.any()):
            return f"It lists {at.size:,} blocks, but its size requires {wanted:,}: one of the two is damaged."
    return None


def _holds(tiff: Tiff, first: Directory, place: int) -> bool:
    """Whether a block with an offset and no size has nonzero bytes.

    GDAL does not write blocks of zeros into sparse cloud-optimised files, where four bytes before a block give its
    length.
    """
    tiff.file.seek(0)
    if b"BLOCK_LEADER=SIZE_AS_UINT4" not in tiff.file.read(1024):
        return True
    tiff.file.seek(place - 4)
    length = int.from_bytes(tiff.file.read(4), "little")
    samples = _one(tiff, first, 322, 1) * _one(tiff, first, 323, 1) * _one(tiff, first, 258, 8) // 8
    if _one(tiff, first, 259, 1) == 1:
        return any(tiff.file.read(min(length, samples)))
    return length > samples // 50 + 32  # hardly any terrain is compressed to less


def _blocks_wanted(tiff: Tiff, first: Directory) -> int:
    """The number of blocks of a raster; 0 if its tags do not tell."""
    cols, rows = _one(tiff, first, 256, 0), _one(tiff, first, 257, 0)
    planes = _one(tiff, first, 277, 1) if _one(tiff, first, 284, 1) == 2 else 1
    wide, high = _one(tiff, first, 322, 0), _one(tiff, first, 323, 0)
    if OFFSETS[1] not in first.tags:
        wide, high = cols, min(_one(tiff, first, 278, rows), rows)
    return -(-cols // wide) * -(-rows // high) * planes if wide > 0 and high > 0 else 0


def blocks_fault(
    tiff: Tiff, directories: list[Directory], at: NDArray[np.int64], size: NDArray[np.int64], plain: int, ordered: bool
) -> str | None:
    """The fault in the places of the first directory's blocks, as a sentence; None if there is none.

    Args:
        at, size: of the existing blocks.
        plain: bytes of an uncompressed block; 0: they are compressed.
        ordered: whether the file declares that they are in row-major order.
    """
    if ordered and (np.diff(at) <= 0).any():
        return "Its blocks are not in the declared order: the table of their offsets is damaged."
    ends = at + size
    for directory in directories:
        if ((at < directory.end) & (ends > directory.begin) & (ends <= tiff.size)).any():
            return "One of its blocks overlaps one of its directories."
    if plain and at.size > 1 and (size[ends <= tiff.size] > plain + 1).any():
        return f"One of its blocks has {int(size.max()):,} bytes, but its samples need {plain:,}."
    at, size = at[ends <= tiff.size], size[ends <= tiff.size]
    order = np.argsort(at, kind="stable")
    twice = size[order][1:][np.diff(at[order]) == 0]
    if twice.size and any(_lost(size, twice, length, plain) for _, length in unused(tiff, directories)):
        return "It lists a block twice, and has bytes that belong to none: the table of its blocks is damaged."
    return None


def _lost(size: NDArray[np.int64], twice: NDArray[np.int64], length: int, plain: int) -> bool:
    """Whether unused bytes may be a block whose offset was overwritten with that of another.

    Compressed blocks may share a place, and leave gaps where they were rewritten. So only a gap of the same size counts
    as a lost block.
    """
    if plain:
        return bool(length >= size.min())
    return bool(((twice <= length) & (length <= twice + _GUARDS)).any())


def lost_mask(tiff: Tiff, directories: list[Directory], parse: Callable[[int], Directory]) -> bool:
    """Whether a mask of the raster exists that no directory leads to, and no reachable directory is one.

    Args:
        parse: the directory at an offset; struct.error or ValueError if there is none.
    """
    shape = [_one(tiff, directories[0], tag, 0) for tag in (256, 257)]
    if any(_one(tiff, directory, 254, 0) & _MASK for directory in directories):
        return False
    mark = struct.pack(tiff.order + "HH", 254, 4)
    gaps = [gap for gap in unused(tiff, directories) if gap[1] >= _SMALLEST]
    for begin, length in dict.fromkeys((*gaps[:_GAPS], *gaps[-_GAPS:])):
        for at in {begin, max(begin, begin + length - _SEARCHED)}:
            tiff.file.seek(at)
            data = tiff.file.read(min(_SEARCHED, begin + length - at))
            for found in re.finditer(re.escape(mark), data):
                try:
                    inner = parse(at + found.start() - (8 if tiff.big else 2))
                except (struct.error, ValueError):
                    continue
                is_mask = _one(tiff, inner, 254, 0) & _MASK and _one(tiff, inner, 262, -1) == _MASK
                if is_mask and [_one(tiff, inner, tag, 0) for tag in (256, 257)] == shape:
                    return True
    return False


def unused(tiff: Tiff, directories: list[Directory]) -> list[tuple[int, int]]:
    """First byte and length of every range that belongs to no block and no directory."""
    begins = [np.array([0, tiff.size, *(directory.begin for directory in directories)])]
    stops = [np.array([8, tiff.size, *(directory.end for directory in directories)])]
    for directory in directories:
        for places, sizes in zip(OFFSETS, COUNTS, strict=True):
            starts, lengths = tiff.numbers(directory, places), tiff.numbers(directory, sizes)
            if starts.size == lengths.size:
                begins.append(np.minimum(starts, tiff.size))
                stops.append(np.minimum(starts + lengths, tiff.size))
    begin, stop = np.concatenate(begins), np.concatenate(stops)
    order = np.argsort(begin, kind="stable")
    begin, reached = begin[order], np.maximum.accumulate(stop[order])
    free = np.flatnonzero(begin[1:] > reached[:-1])
    return [(int(reached[i]), int(begin[i + 1] - reached[i])) for i in free]


def row_major(head: bytes) -> bool:
    """Whether a file declares in its first bytes that its blocks are in row-major order, and was not changed since."""
    return b"BLOCK_ORDER=ROW_MAJOR" in head and b"KNOWN_INCOMPATIBLE_EDITION=NO" in head


def plain_bytes(tiff: Tiff, first: Directory) -> int:
    """Bytes of a block, if samples are not compressed."""
    cols, rows = _one(tiff, first, 256, 0), _one(tiff, first, 257, 0)
    wide, high = _one(tiff, first, 322, 0), _one(tiff, first, 323, 0)
    if OFFSETS[1] not in first.tags:
        wide, high = cols, min(_one(tiff, first, 278, rows), rows)
    together = _one(tiff, first, 277, 1) if _one(tiff, first, 284, 1) == 1 else 1
    return high * -(-wide * together * _one(tiff, first, 258, 1) // 8)
