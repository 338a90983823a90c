"""Formats of raw samples whose drivers do not compare the file's size with what its header promises."""

from __future__ import annotations

import configparser
from pathlib import Path
from typing import Any

import numpy as np


def _short(path: str, wanted: int) -> str | None:
    size = Path(path).stat().st_size
    return None if size >= wanted else f"It ends after {size:,} of the {wanted:,} bytes that its header promises."


def _samples(dataset: Any) -> int:
    return int(dataset.width * dataset.height * sum(np.dtype(t).itemsize for t in dataset.dtypes))


def envi(dataset: Any, path: str) -> str | None:
    """ENVI: the header's offset, then all samples (a compressed file has its own end)."""
    header = dataset.tags(ns="ENVI")
    if header.get("file_compression", "0").strip() not in ("", "0"):
        return None
    return _short(path, int(header.get("header_offset", "0").strip() or 0) + _samples(dataset))


def pcraster(dataset: Any, path: str) -> str | None:
    """PCRaster: a header of 256 bytes, then all samples (CSF, version 2)."""
    return _short(path, 256 + _samples(dataset))


def pcidsk(dataset: Any, path: str) -> str | None:
    """PCIDSK: the header's second field says how many blocks of 512 bytes the file has."""
    with Path(path).open("rb") as file:
        blocks = file.read(32)[16:32].decode("latin-1").strip()
    return _short(path, int(blocks) * 512) if blocks.isdigit() else "Its header does not say how long it is."


def ilwis(dataset: Any, path: str) -> str | None:
    """ILWIS: the samples lie in a file of their own (.mp#), whose type the header (.mpr) names."""
    header = configparser.ConfigParser(strict=False, interpolation=None)
    header.read_string(Path(path).read_text("latin-1"))
    kind = header.get("MapStore", "Type", fallback="Byte").lower()
    item = {"byte": 1, "int": 2, "long": 4, "float": 4, "real": 8}.get(kind, 1)
    data = Path(path).with_name(header.get("MapStore", "Data", fallback=Path(path).stem + ".mp#").strip("'\""))
    return _short(str(data), dataset.width * dataset.height * item) if data.is_file() else None
