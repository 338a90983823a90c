"""PCIDSK: the file, and the files that hold its channels, are as long as the header says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.sizes import exact


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a PCIDSK file, whose header states its length in blocks of 512 bytes; channels may be elsewhere."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        blocks = file.read(32)[16:32].decode("latin-1").strip()
        file.seek(0)
        kind = file.read(512)[360:364]
    if not blocks.isdigit():
        return "Its header does not declare its length."
    if kind == b"FILE":
        broken = _channels_fault(dataset, path)
        if broken is not None:
            return broken
    wanted = int(blocks) * 512
    if size % 512 and (size > wanted or _whole_blocks(dataset, path)):
        return f"It has {size:,} bytes where its header promises {wanted:,}: one of the two is damaged."
    if size >= wanted or _tiled(path):
        return None
    return f"It ends after {size:,} of the {wanted:,} bytes that its header promises."


def _whole_blocks(dataset: Any, path: str) -> bool:
    """Whether a PCIDSK file's samples lie in uncompressed tiles of whole blocks of 512 bytes."""
    rows, cols = dataset.block_shapes[0]
    whole = all(rows * cols * np.dtype(kind).itemsize % 512 == 0 for kind in dataset.dtypes)
    with Path(path).open("rb") as file:
        head = file.read(1 << 20)
    return whole and b"Block Tile Directory" in head and b"NONE" in head


def _channels_fault(dataset: Any, path: str) -> str | None:
    """The fault in the files of a PCIDSK file's channels (image headers: name, first byte, steps)."""
    with Path(path).open("rb") as file:
        head = file.read(512)
        at = (int(head[336:352]) - 1) * 512
        for band in range(dataset.count):
            file.seek(at + 1024 * band)
            header = file.read(1024)
            name = header[64:128].decode("latin-1").strip()
            channel = Path(path).with_name(Path(name).name)
            if not name or name.startswith("/SIS=") or not channel.is_file():
                continue
            first, pixel, line = int(header[168:184]), int(header[184:192]), int(header[192:200])
            item = np.dtype(dataset.dtypes[band]).itemsize
            if pixel < item or line < pixel * dataset.width or header[201:202] not in b"NS":
                return f"Its header contradicts itself about channel {band + 1}."
            short = exact(channel, first + (dataset.height - 1) * line + (dataset.width - 1) * pixel + item)
            if short is not None:
                return short
    return None


def _tiled(path: str) -> bool:
    """Whether a PCIDSK file's samples lie in a block system, whose segment is longer than its content."""
    with Path(path).open("rb") as file:
        return b"Block Tile Directory" in file.read(1 << 20)
