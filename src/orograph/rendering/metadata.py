"""What picture files state besides their pixels: attribution and print resolution.

Pillow writes that with the pixels (``told``). What GDAL has written a few rows at a time gets it afterwards
(``stamp``), in one pass over the file: a chunk pHYs (PNG 3rd edition, 11.3.4.3), the density of JFIF's header (ITU-T
T.871, 10.1), or EXIF in an extended WebP file (RFC 9649, 2.7). WebP has no resolution of its own: EXIF says it there.
Units: dots per inch.
"""

from __future__ import annotations

import math
import shutil
import struct
import zlib
from pathlib import Path
from typing import Any

from orograph.dem.header import plain_copyright
from orograph.errors import UsageError

COPYRIGHT, ACROSS, DOWN, UNIT = 0x8298, 0x011A, 0x011B, 0x0128
"""Tags of TIFF and EXIF."""

INCHES = 2
"""The code of TIFF, and so of EXIF, for resolutions per inch."""

METRE = 0.0254
"""Metres of an inch."""

MOST_DPI = 65535
"""What JFIF can hold."""


def check_dpi(dpi: float | None) -> None:
    """Raise UsageError unless files can hold a resolution; None: no resolution."""
    if dpi is not None and not (math.isfinite(dpi) and 1 <= dpi <= MOST_DPI):
        raise UsageError(f"A resolution must be 1 to {MOST_DPI} dots per inch, not {dpi:g}.")


def save_options(kind: str, attribution: tuple[str, ...], dpi: float | None) -> dict[str, Any]:
    """Metadata that Pillow writes into a file of a format: arguments of its ``save``."""
    from PIL.PngImagePlugin import PngInfo

    options: dict[str, Any] = {}
    if dpi is not None and kind != "WEBP":
        options["dpi"] = (dpi, dpi)
    if kind == "PNG" and attribution:
        options["pnginfo"] = PngInfo()
        options["pnginfo"].add_text("Copyright", "; ".join(attribution))
    elif kind == "TIFF" and attribution:
        options["tiffinfo"] = {COPYRIGHT: plain_copyright(attribution)}
    elif kind in ("WEBP", "JPEG") and (exif := _exif(attribution, dpi if kind == "WEBP" else None)):
        options["exif"] = exif
    return options


def tiff_tags(dpi: float | None) -> dict[str, Any]:
    """The tags of a TIFF that GDAL writes."""
    if dpi is None:
        return {}
    return {"TIFFTAG_XRESOLUTION": dpi, "TIFFTAG_YRESOLUTION": dpi, "TIFFTAG_RESOLUTIONUNIT": INCHES}


def stamp(path: Path, kind: str, attribution: tuple[str, ...], dpi: float | None) -> None:
    """Add what GDAL does not write to a file it has written: the resolution, and the attribution of WebP."""
    if kind == "PNG" and dpi is not None:
        dots = round(dpi / METRE)
        head = b"pHYs" + struct.pack(">IIB", dots, dots, 1)
        chunk = struct.pack(">I", 9) + head + struct.pack(">I", zlib.crc32(head))
        _rewritten(path, _start(path, 33), 33, chunk)  # (after the signature and IHDR)
    elif kind == "JPEG" and dpi is not None:
        with path.open("r+b") as file:
            if file.read(11)[6:] == b"JFIF\0":
                file.seek(13)
                file.write(struct.pack(">BHH", 1, round(dpi), round(dpi)))
    elif kind == "WEBP" and (exif := _exif(attribution, dpi)):
        _extend_webp(path, exif.removeprefix(b"Exif\0\0"))


def _exif(attribution: tuple[str, ...], dpi: float | None) -> bytes:
    """EXIF with attribution and resolution; empty if there is neither."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    exif = Image.Exif()
    if attribution:
        exif[COPYRIGHT] = plain_copyright(attribution)
    if dpi is not None:
        exif[ACROSS] = exif[DOWN] = IFDRational(round(dpi * 1000), 1000)
        exif[UNIT] = INCHES
    return exif.tobytes() if len(exif) else b""


def _start(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _rewritten(path: Path, head: bytes, skip: int, more: bytes, end: bytes = b"") -> None:
    """Write a file anew: ``head`` in place of its first ``skip`` bytes, ``more`` after it, and ``end`` after all."""
    part = path.with_name(path.name + ".said")
    with path.open("rb") as old, part.open("wb") as new:
        old.seek(skip)
        new.write(head + more)
        shutil.copyfileobj(old, new, 1 << 20)
        new.write(end)
    part.replace(path)


def _extend_webp(path: Path, exif: bytes) -> None:
    """Convert a simple lossless WebP file to the extended format, with EXIF."""
    head = _start(path, 25)
    if head[12:16] != b"VP8L":
        return
    sides = int.from_bytes(head[21:25], "little")
    across, down = sides & 0x3FFF, sides >> 14 & 0x3FFF  # (one less than the pixels, as VP8X has them)
    flags = 0x08 | (0x10 if sides >> 28 & 1 else 0)  # EXIF; alpha
    extended = b"VP8X" + struct.pack("<II", 10, flags) + across.to_bytes(3, "little") + down.to_bytes(3, "little")
    chunk = b"EXIF" + struct.pack("<I", len(exif)) + exif + b"\0" * (len(exif) % 2)
    size = int.from_bytes(head[4:8], "little") + len(extended) + len(chunk)
    _rewritten(path, b"RIFF" + struct.pack("<I", size) + b"WEBP", 12, extended, chunk)
