"""Further formats whose headers or parts state their length.

Sources: Erdas' raw format (EIR), the headers of GenBin, ISIS 2, PDS 3 and ROI_PAC, Netpbm's PNM, Panorama's RMF, SGI's
FIT, WebP's container (RFC 9649), GIF 89a, XPM 3.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.header_text import pairs
from orograph.dem.whole.sizes import exact

_LABEL = 1 << 18


def _samples(dataset: Any) -> int:
    return int(dataset.width * dataset.height * sum(np.dtype(t).itemsize for t in dataset.dtypes))


def eir(dataset: Any, path: str) -> str | None:
    """EIR: the samples are in a file that the header names, after an offset."""
    header = {key.upper(): value for key, value in pairs(Path(path).read_text("latin-1"), None)}
    beside = Path(path).with_name(header.get("PIXEL_FILES", Path(path).stem))
    return exact(beside, int(header.get("DATA_OFFSET", "0")) + _samples(dataset))


def roi_pac(dataset: Any, path: str) -> str | None:
    """ROI_PAC: only samples; a file of two bands must have both."""
    return exact(path, _samples(dataset))


def pnm(dataset: Any, path: str) -> str | None:
    """PNM: a header of a few words, then all samples."""
    with Path(path).open("rb") as file:
        found = re.match(rb"P[56]((?:\s|#[^\n]*\n)+\d+){3}\s", file.read(_LABEL))
    return "Its header cannot be parsed." if found is None else exact(path, found.end() + _samples(dataset))


def rmf(dataset: Any, path: str) -> str | None:
    """RMF: the header says how long the file is (version 2.0)."""
    with Path(path).open("rb") as file:
        version, size = struct.unpack("<II", file.read(12)[4:])
    return exact(path, size) if version == 0x200 else None


def fit(dataset: Any, path: str) -> str | None:
    """FIT: pages of samples after an offset in the header; the last page must be complete to be read."""
    high, wide = dataset.block_shapes[0]
    if dataset.height % high or dataset.width % wide:
        return "Its last page is not full, which GDAL misreads."
    with Path(path).open("rb") as file:
        head = file.read(76)
    return exact(path, struct.unpack_from(">I", head, 72)[0] + _samples(dataset)) if head[:4] == b"IT02" else None


def landscape(dataset: Any, path: str) -> str | None:
    """LCP: a header of 7316 bytes, then 16-bit integers, with all bands of a sample together."""
    return exact(path, 7316 + 2 * dataset.count * dataset.width * dataset.height)


def geoid(dataset: Any, path: str) -> str | None:
    """NGSGEOID: a header of 44 bytes, then 32-bit numbers."""
    return exact(path, 44 + 4 * dataset.width * dataset.height)


def leveller(dataset: Any, path: str) -> str | None:
    """Leveller: parts with a name and a length, up to the end of the file; one of them holds all samples."""
    size, at, samples = Path(path).stat().st_size, 5, 4 * dataset.width * dataset.height
    found = None
    with Path(path).open("rb") as file:
        while at < size:
            file.seek(at)
            name = file.read((file.read(1) or b"\0")[0])
            length = file.read(4)
            if not name.isascii() or not name or len(length) < 4:
                return f"There is no part at byte {at:,}, where one should begin."
            at = file.tell() + int.from_bytes(length, "little")
            found = int.from_bytes(length, "little") if name == b"hf_data" else found
    if at != size or found != samples:
        return f"Its parts end at byte {at:,} of {size:,}, and its samples are {found or 0:,} bytes of {samples:,}."
    return None


def webp(dataset: Any, path: str) -> str | None:
    """WebP: the container states its length."""
    with Path(path).open("rb") as file:
        head = file.read(12)
    return exact(path, 8 + int.from_bytes(head[4:8], "little")) if head[:4] == b"RIFF" else None


def gif(dataset: Any, path: str) -> str | None:
    """GIF: consecutive blocks up to the end marker, with which the file ends."""
    data = Path(path).read_bytes()
    table = 3 << ((data[10] & 7) + 1) if data[10] & 128 else 0
    at = 13 + table
    try:
        while data[at] != 0x3B:
            if data[at] == 0x2C:
                at += 11 + (3 << ((data[at + 9] & 7) + 1) if data[at + 9] & 128 else 0)
            elif data[at] == 0x21:
                at += 2
            else:
                return f"There is no block at byte {at:,}, where one should begin."
            while data[at]:
                at += 1 + data[at]
            at += 1
    except IndexError:
        return f"It ends after {len(data):,} bytes, before its end marker."
    return exact(path, at + 1)


_QUOTED = re.compile(rb'"([^"\n]*)"')


def xpm(dataset: Any, path: str) -> str | None:
    """XPM: strings for the size, each colour, and each row, with one code per sample."""
    texts = _QUOTED.findall(Path(path).read_bytes())
    if not texts or len(texts[0].split()) < 4:
        return "Its header cannot be parsed."
    cols, rows, colours, letters = map(int, texts[0].split()[:4])
    if len(texts) != 1 + colours + rows:
        return f"It has {len(texts) - 1:,} texts where its header promises {colours + rows:,}."
    if any(len(row) != cols * letters for row in texts[1 + colours :]):
        return f"One of its rows does not have {cols:,} samples."
    return None


_NUMBER = r"[ \t]*=[ \t]*(\d+)"
_SAMPLE_TYPES = {
    "MSB_INTEGER", "LSB_INTEGER", "INTEGER", "MSB_UNSIGNED_INTEGER", "LSB_UNSIGNED_INTEGER", "UNSIGNED_INTEGER",
    "SUN_INTEGER", "SUN_UNSIGNED_INTEGER", "MAC_INTEGER", "MAC_UNSIGNED_INTEGER", "PC_INTEGER", "PC_UNSIGNED_INTEGER",
    "VAX_INTEGER", "VAX_UNSIGNED_INTEGER", "IEEE_REAL", "REAL", "FLOAT", "SUN_REAL", "MAC_REAL", "PC_REAL",
}  # fmt: skip


def pds3(dataset: Any, path: str) -> str | None:
    """PDS 3: the label states the number of records in the sample file."""
    text = _label(path)
    kind = re.search(r"^[ \t]*SAMPLE_TYPE[ \t]*=[ \t]*\"?(\w*)", text, re.M)
    if kind is not None and kind[1].upper() not in _SAMPLE_TYPES:
        return f"Its label declares samples of type {kind[1]!r}, which is not a known type."
    pointer = re.search(r"^\^(?:IMAGE|QUBE)[ \t]*=[ \t]*\(?[ \t]*(?:\"([^\"]*)\"[ \t]*,?)?[ \t]*(\d*)", text, re.M)
    if pointer is None or "<BYTES>" in text[pointer.start() : pointer.end() + 20]:
        return None
    data = Path(path)
    if pointer[1]:
        names = {file.name.lower(): file for file in data.parent.iterdir()}
        data = names.get(pointer[1].lower(), data.with_name(pointer[1]))
    return _records_fault(data, text, int(pointer[2] or 1), _samples(dataset))


def isis2(dataset: Any, path: str) -> str | None:
    """ISIS 2: the label states the number of records in the file."""
    text = _label(path)
    pointer = re.search(r"^\^QUBE" + _NUMBER, text, re.M)
    return None if pointer is None else _records_fault(Path(path), text, int(pointer[1]), _samples(dataset))


def _label(path: str) -> str:
    with Path(path).open("rb") as file:
        return file.read(_LABEL).decode("latin-1")


def _records_fault(data: Path, text: str, first: int, samples: int) -> str | None:
    """The fault in the size of a file of records, given the record of the first sample and the samples' bytes."""
    size, count = (re.search(rf"^[ \t]*{key}{_NUMBER}", text, re.M) for key in ("RECORD_BYTES", "FILE_RECORDS"))
    if size is None:
        return None
    record = int(size[1])
    if count is not None and data.is_file() and data.stat().st_size == record * int(count[1]):
        return None
    return exact(data, (first - 1) * record + samples)
