"""Formats of raw samples whose drivers do not compare the file's size with its header.

A shorter file lacks samples; a longer one has inserted bytes, or a header that promises too little. Zeros that pad the
last block of 128 bytes are no fault: that is how records are padded.
"""

from __future__ import annotations

import gzip
import json
import math
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.header_text import kind_fault, pairs
from orograph.errors import ReadError

_BLOCK = 128
_TAIL = 1 << 16
_CHUNKS = 1 << 16  # of a Zarr, that are checked


def exact(path: str | Path, wanted: int) -> str | None:
    """The fault in the size of a file that should have ``wanted`` bytes, as a sentence; None if there is none."""
    file = Path(path)
    if not file.is_file():
        return f"Its file {file.name} is missing."
    size = file.stat().st_size
    if size < wanted:
        return f"It ends after {size:,} of the {wanted:,} bytes that its header promises."
    if size == wanted or (size % _BLOCK == 0 and not _any(file, wanted)):
        return None
    return f"It has {size:,} bytes where its header promises {wanted:,}: one of the two is damaged."


def _any(file: Path, begin: int) -> bool:
    """Whether a file has any nonzero byte from an offset on."""
    with file.open("rb") as opened:
        opened.seek(max(begin, file.stat().st_size - _TAIL))
        return any(opened.read())


def _samples(dataset: Any) -> int:
    return int(dataset.width * dataset.height * sum(np.dtype(t).itemsize for t in dataset.dtypes))


def behind(begin: int) -> Callable[[Any, str], str | None]:
    """The check for formats whose samples fill their file from an offset on."""
    return lambda dataset, path: exact(path, begin + _samples(dataset))


def beside(*endings: str) -> Callable[[Any, str], str | None]:
    """The check for formats whose samples fill a companion file with one of these endings ("": none)."""

    def check(dataset: Any, path: str) -> str | None:
        stem = Path(path).with_suffix("")
        files = [Path(f"{stem}{ending}") for ending in endings]
        found = next((file for file in files if file.is_file()), None)
        return None if found is None else exact(found, _samples(dataset))

    return check


def terrain(dataset: Any, path: str) -> str | None:
    """BT: a header of 256 bytes, which says whether the CRS is in a companion file (.prj), then all samples."""
    with Path(path).open("rb") as file:
        head = file.read(256)
    beside_it = Path(path).with_suffix(".prj")
    if head[60:62] == b"\x01\0" and not beside_it.is_file() and not str(dataset.name).startswith("/vsigzip/"):
        return f"Its CRS is in {beside_it.name}, which is missing."
    return exact(path, 256 + _samples(dataset))


def sigdem(dataset: Any, path: str) -> str | None:
    """SIGDEM: a header of 132 bytes, which states its place twice, then 32-bit integers."""
    with Path(path).open("rb") as file:
        head = file.read(132)
    factor, west, south, low, east, north, high = struct.unpack_from(">7d", head, 52)
    step_x, step_y = struct.unpack_from(">2d", head, 116)
    if not 0 < factor < math.inf:
        return f"Its header has {factor:g} height steps per metre."
    if not (step_x > 0 and step_y > 0):
        return f"Its header has samples {step_x:g} × {step_y:g} apart."
    reach = np.array([east - west, north - south]) / (step_x, step_y)
    if not np.allclose(reach, (dataset.width, dataset.height), atol=0.01):
        return f"Its header places {dataset.width} × {dataset.height} samples where {reach[0]:g} × {reach[1]:g} fit."
    return exact(path, 132 + 4 * dataset.width * dataset.height) or _beyond(dataset, low, high, 2 / factor)


def _beyond(dataset: Any, low: float, high: float, rounding: float) -> str | None:
    """Heights beyond the extremes in the header."""
    if not low < high:
        return None
    for _, window in dataset.block_windows(1):
        heights = dataset.read(1, window=window, masked=True)
        if heights.count() and not (low - rounding <= heights.min() and heights.max() <= high + rounding):
            return (
                f"It holds heights from {heights.min():g} to {heights.max():g} where its header has all between "
                f"{low:g} and {high:g}."
            )
    return None


def envi(dataset: Any, path: str) -> str | None:
    """ENVI: the header's offset, then all samples (a compressed file has its own end)."""
    header = {key.lower(): value for key, value in dataset.tags(ns="ENVI").items()}
    if header.get("file_compression", "0").strip() not in ("", "0"):
        return None
    return exact(path, int(header.get("header_offset", "0").strip() or 0) + _samples(dataset))


def ehdr(dataset: Any, path: str) -> str | None:
    """ESRI .hdr: bytes to skip, then rows, padded to whole bytes per band or per row."""
    header = next((p for e in (".hdr", ".HDR") if (p := Path(path).with_suffix(e)).is_file()), None)
    if header is None:
        return None
    fields = {key.upper(): value for key, value in pairs(header.read_text("latin-1"), None)}
    if fault := _row_fault(fields, dataset.width, dataset.count) or kind_fault(dataset, fields):
        return fault
    bits = int(fields.get("NBITS", 8 * np.dtype(dataset.dtypes[0]).itemsize))
    rows, bands = dataset.height, dataset.count
    layout = fields.get("LAYOUT", "BIL").upper()
    line = -(-dataset.width * bits // 8)
    skip = int(fields.get("SKIPBYTES", 0))
    if layout == "BSQ":
        return exact(path, skip + bands * rows * line + (bands - 1) * int(fields.get("BANDGAPBYTES", 0)))
    if layout == "BIP":
        line = -(-dataset.width * bits * bands // 8)
        return exact(path, skip + rows * max(line, int(fields.get("TOTALROWBYTES", line))))
    line = bands * int(fields.get("BANDROWBYTES", line))
    return exact(path, skip + rows * max(line, int(fields.get("TOTALROWBYTES", line))))


def _row_fault(fields: dict[str, str], cols: int, bands: int) -> str | None:
    """Rows are as long as their samples: GDAL reads padded rows as if they were not."""
    needed = -(-cols * int(fields.get("NBITS", 8)) // 8)
    for key, sizes in (("BANDROWBYTES", (needed,)), ("TOTALROWBYTES", (needed, needed * bands))):
        if key in fields and int(fields[key]) not in sizes:
            return (
                f"Its header says {key!r} is {fields[key]} where {cols} samples of its 'NBITS' need {needed}: it is "
                "damaged, or its rows are padded, which GDAL misreads."
            )
    return None


def ers(dataset: Any, path: str) -> str | None:
    """ERS: the samples are in the file that the header is named after, after an offset."""
    text = Path(path).read_text("latin-1")
    data = Path(path).with_suffix("")
    offset = re.search(r"^\s*HeaderOffset\s*=\s*(\d+)", text, re.M)
    if not re.search(r"DataSetType\s*=\s*ERStorage", text) or not data.is_file():
        return None
    return exact(data, (int(offset[1]) if offset else 0) + _samples(dataset))


def saga(dataset: Any, path: str) -> str | None:
    """SAGA: the samples follow an offset in the header (.sgrd)."""
    fields = dict(pairs(Path(path).with_suffix(".sgrd").read_text("latin-1"), "="))
    return exact(path, int(fields.get("DATAFILE_OFFSET", "0") or 0) + _samples(dataset))


_CHANNEL = re.compile(r"(8U|16U|16S|32U|32S|32R|64R|C16U|C16S|C32R)\s+\d+\s+\d+\s+\d+(\s+(Swapped|Unswapped))?\s*")


def paux(dataset: Any, path: str) -> str | None:
    """PCI .aux: each channel's first byte, and the steps between samples and between rows."""
    end = 0
    for key, value in pairs(Path(path).with_suffix(".aux").read_text("latin-1"), ":"):
        if key.startswith("ChanDefinition"):
            if not _CHANNEL.fullmatch(value):
                return f"Its header says {key!r} is {value[:40]!r}, which is impossible."
            kind, first, pixel, line = value.split()[:4]
            item = int(re.sub(r"\D", "", kind) or 8) // 8
            last = int(first) + (dataset.height - 1) * int(line) + (dataset.width - 1) * int(pixel) + item
            end = max(end, last)
    return exact(path, end) if end else None


def mff(dataset: Any, path: str) -> str | None:
    """MFF: one file for each band, numbered by its ending after a letter for its type (.b00…)."""
    for file in sorted(Path(path).parent.glob(f"{Path(path).stem}.*")):
        if re.fullmatch(r"\.[bijrx]\d\d", file.suffix.lower()) and (fault := exact(file, _band_bytes(dataset))):
            return fault
    return None


def _band_bytes(dataset: Any) -> int:
    return int(dataset.width * dataset.height * np.dtype(dataset.dtypes[0]).itemsize)


def surfer7(dataset: Any, path: str) -> str | None:
    """Surfer 7: sections with their lengths; one of them holds all samples."""
    size = Path(path).stat().st_size
    at, found = 0, False
    with Path(path).open("rb") as file:
        while at < size:
            file.seek(at)
            head = file.read(8)
            if len(head) < 8 or not head[:4].isalpha():
                return f"There is no section at byte {at:,}, where one should begin."
            length = struct.unpack("<i", head[4:])[0]
            if length < 0 or (head[:4] == b"DATA" and length != 8 * dataset.width * dataset.height):
                return f"Its section {head[:4].decode()} has {length:,} bytes, which does not match its grid."
            found |= head[:4] == b"DATA"
            at += 8 + length
    if at > size:
        return f"It ends after {size:,} of the {at:,} bytes of its sections."
    return None if found else "It has no section of samples."


def ntv2(dataset: Any, path: str) -> str | None:
    """NTv2: a header of 11 records; for each grid, 11 records and one for each of its points; an end record."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        head = file.read(176)
        order = "<" if head[8:12] == b"\x0b\0\0\0" else ">"
        (grids,) = struct.unpack_from(order + "i", head, 40)
        at = 176
        for _ in range(max(0, min(grids, 1 << 16))):
            file.seek(at)
            sub = file.read(176)
            if len(sub) < 176 or sub[:8] != b"SUB_NAME":
                return f"There is no grid at byte {at:,}, where one should begin."
            (points,) = struct.unpack_from(order + "i", sub, 168)
            south, north, east, west, lat, lon = struct.unpack_from(order + "d8xd8xd8xd8xd8xd", sub, 72)
            if min(abs(lat), abs(lon)) == 0 or not np.isfinite((south, north, east, west, lat, lon)).all():
                return "The extent of its grid is damaged."
            rows, cols = round(abs((north - south) / lat)) + 1, round(abs((west - east) / lon)) + 1
            if rows * cols != points:
                return f"Its grid has {rows} × {cols} points by its extent, and {points:,} by its count."
            at += 176 + 16 * points
    if size < at:
        return f"It ends after {size:,} of the {at:,} bytes that its header promises."
    if size - at not in (0, 8, 16):
        return f"It has {size:,} bytes where its header promises {at + 16:,}: one of the two is damaged."
    return None


def pcraster(dataset: Any, path: str) -> str | None:
    """PCRaster: a header of 256 bytes, all samples, and perhaps a table of attributes (CSF, version 2)."""
    wanted = 256 + _samples(dataset)
    with Path(path).open("rb") as file:
        head = file.read(256)
    order = "<" if head[46:50] == b"\x01\0\0\0" else ">"
    across, down, angle = struct.unpack_from(order + "3d", head, 108)
    if not (0 < across == down < math.inf):
        return f"Its cells are {across:g} × {down:g}: PCRaster's cells are squares, and GDAL misplaces others."
    if angle != 0:
        raise ReadError(
            f"It is rotated by {angle:g} radians, which GDAL ignores.", path=dataset.name,
            remedy="Resample it to an unrotated grid (PCRaster's resample).",
        )  # fmt: skip
    (attributes,) = struct.unpack_from(order + "I", head, 40)
    if attributes:
        size = Path(path).stat().st_size
        return None if size >= wanted else f"It ends after {size:,} of the {wanted:,} bytes that its header promises."
    return exact(path, wanted)


def nitf(dataset: Any, path: str) -> str | None:
    """NITF: the header states the length of the file (MIL-STD-2500C, field FL)."""
    with Path(path).open("rb") as file:
        head = file.read(360)
    at = {b"NITF02.10": 342, b"NSIF01.00": 342, b"NITF02.00": 342}.get(head[:9])
    length = b"" if at is None else head[at : at + 12]
    if at is None or (head[:9] == b"NITF02.00" and not length.isdigit()) or length == b"9" * 12:
        return None
    if not length.isdigit():
        return "Its header does not declare its length."
    return exact(path, int(length))


def bmp(dataset: Any, path: str) -> str | None:
    """BMP: the header states the length of the file, or 0."""
    with Path(path).open("rb") as file:
        head = file.read(14)
    (length,) = struct.unpack_from("<I", head, 2)
    return exact(path, length) if length else None


def elas(dataset: Any, path: str) -> str | None:
    """ELAS: the header states its own length, and that of a record, of which each row has one."""
    with Path(path).open("rb") as file:
        header, record = struct.unpack(">2I", file.read(8))
    return exact(path, header + record * dataset.height)


def rdata(dataset: Any, path: str) -> str | None:
    """R's data: a gzip file, whose checksum GDAL does not read."""
    with Path(path).open("rb") as file:
        if file.read(2) != b"\x1f\x8b":
            return None
    try:
        with gzip.open(path) as unpacked:
            while unpacked.read(1 << 20):
                pass
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        return f"It cannot be unpacked ({error})."
    return None


def zarr(dataset: Any, path: str) -> str | None:
    """Zarr, version 2: uncompressed chunks have the right size.

    All chunks must exist if there is no fill value for absent ones.
    """
    header = next((p for name in dataset.files if (p := Path(str(name))).name == ".zarray" and p.is_file()), None)
    if header is None:
        return _zarr3(dataset)
    meta = json.loads(header.read_bytes())
    counts = [-(-size // chunk) for size, chunk in zip(meta["shape"], meta["chunks"], strict=True)]
    wanted = math.prod(meta["chunks"]) * np.dtype(meta["dtype"]).itemsize
    if math.prod(counts) > _CHUNKS:
        return None
    for index in np.ndindex(*counts):
        chunk = header.parent / meta.get("dimension_separator", ".").join(map(str, index))
        if not chunk.is_file():
            if meta.get("fill_value") is None:
                return f"Its chunk {chunk.name} is missing, and no fill value is declared for it."
        elif meta.get("compressor") is None and not meta.get("filters") and chunk.stat().st_size != wanted:
            return f"Its chunk {chunk.name} has {chunk.stat().st_size:,} bytes, not {wanted:,}."
    return None


def _zarr3(dataset: Any) -> str | None:
    """Zarr, version 3: chunks of plain bytes have the right size."""
    for header in (Path(str(file)) for file in dataset.files):
        meta = json.loads(header.read_bytes()) if header.name == "zarr.json" and header.is_file() else {}
        shape = meta.get("chunk_grid", {}).get("configuration", {}).get("chunk_shape")
        if shape is None or [codec.get("name") for codec in meta.get("codecs", ())] not in ([], ["bytes"], ["endian"]):
            continue
        wanted = math.prod(shape) * np.dtype(meta["data_type"]).itemsize
        for chunk in sorted((header.parent / "c").rglob("*"))[:_CHUNKS]:
            if chunk.is_file() and chunk.stat().st_size != wanted:
                return (
                    f"Its chunk {chunk.relative_to(header.parent)} has {chunk.stat().st_size:,} bytes, not {wanted:,}."
                )
    return None


def terragen(dataset: Any, path: str) -> str | None:
    """Terragen: the last section holds two numbers and the samples; an end marker may follow."""
    with Path(path).open("rb") as file:
        at = file.read(1024).find(b"ALTW")
        end = at + 8 + 2 * dataset.width * dataset.height
        file.seek(max(end, 0))
        mark = file.read(4)
    if at < 0:
        return "It has no section of samples."
    return exact(path, end + 4 if mark == b"EOF " else end)
