"""Labels of planetary rasters (ISIS 3, VICAR, PDS 4): the samples lie where the label says, with nothing after them.

Sources: the ISIS cube format (USGS), the VICAR file format (JPL), the PDS4 information model (Array).
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.sizes import exact

_TYPES = {"UnsignedByte": 1, "SignedWord": 2, "UnsignedWord": 2, "SignedInteger": 4, "UnsignedInteger": 4, "Real": 4}
_LABEL = 1 << 20


def isis(dataset: Any, path: str) -> str | None:
    """The fault of an ISIS cube, as a sentence; None if there is none."""
    with Path(path).open("rb") as file:
        text = file.read(_LABEL).partition(b"\0")[0].decode("latin-1")
    core = re.search(r"^\s*Object = Core\b(.*?)^\s*End_Object", text, re.M | re.S)
    fields = dict(re.findall(r"^\s*(\^?\w+)\s*=\s*(\S+)", core[1] if core else "", re.M))
    if fields.get("Format", "").strip('"') in ("GeoTIFF", "BigTIFF"):
        return None
    try:
        shape = int(fields["Samples"]), int(fields["Lines"]), int(fields["Bands"])
        item, begin = _TYPES[fields["Type"]], int(fields["StartByte"]) - 1
        good = fields["ByteOrder"] in ("Lsb", "Msb") and float(fields["Multiplier"]) != 0 and min(shape) > 0
        float(fields["Base"])
        if fields["Format"] == "Tile":
            tile = int(fields["TileSamples"]), int(fields["TileLines"])
            shape = -(-shape[0] // tile[0]) * tile[0], -(-shape[1] // tile[1]) * tile[1], shape[2]
        good &= fields["Format"] in ("Tile", "BandSequential")
    except (KeyError, ValueError, ZeroDivisionError):
        good = False
    if not good:
        return "Its label does not describe its samples: it is damaged."
    end = begin + shape[0] * shape[1] * shape[2] * item
    beside = fields.get("^Core")
    if beside is not None:
        return exact(Path(path).with_name(beside.strip('"')), end)
    return _parts_fault(path, text, begin, end)


def _parts_fault(path: str, text: str, begin: int, end: int) -> str | None:
    """The fault in the places of a cube's other parts (label, history, tables), given its samples' bytes."""
    last = end
    for name, content in re.findall(r"^Object = (\w+)\s*$(.*?)^End_Object", text, re.M | re.S):
        fields = dict(re.findall(r"^  (\w+)\s*=\s*(\d+)\s*$", content, re.M))
        if name == "IsisCube" or "Bytes" not in fields or re.search(r"^  \^\w+\s*=", content, re.M):
            continue
        first = int(fields.get("StartByte", 1)) - 1
        if first < end and begin < first + int(fields["Bytes"]):
            return f"Its samples and its part {name!r} overlap: its label is damaged."
        last = max(last, first + int(fields["Bytes"]))
    return exact(path, last)


def vicar(dataset: Any, path: str) -> str | None:
    """The fault in the size of a VICAR file, as a sentence; None if there is none."""
    with Path(path).open("rb") as file:
        fields = dict(re.findall(r"(\w+)=('[^']*'|[^\s']+)", file.read(4096).decode("latin-1")))
    if fields.get("COMPRESS", "'NONE'").strip("'") != "NONE" or fields.get("EOL", "0") != "0":
        return None
    wanted = ("LBLSIZE", "RECSIZE", "NLB", "NL", "NB", "NBB", "NS")
    if not all(fields.get(key, "").isdigit() for key in wanted):
        return "Its label does not declare its size: it is damaged."
    label, record, before, lines, bands, prefix, samples = (int(fields[key]) for key in wanted)
    item = np.dtype(dataset.dtypes[0]).itemsize
    if fields.get("ORG", "'BSQ'") == "'BSQ'" and record != prefix + samples * item:
        return f"Its label says that a record has {record:,} bytes, which does not match {samples:,} samples."
    records = before + lines * bands if fields.get("ORG", "'BSQ'") != "'BIP'" else before + lines * samples
    return exact(path, label + records * record)


def pds4(dataset: Any, path: str) -> str | None:
    """The fault in the file size of a PDS 4 array at the end of its file; None if there is none."""
    root = ET.fromstring(Path(path).read_bytes())
    begins = [int(element.text or 0) for element in root.iter() if element.tag.endswith("}offset")]
    arrays = [element for element in root.iter() if element.tag.rpartition("}")[2].startswith("Array_")]
    files = [element.text or "" for element in root.iter() if element.tag.endswith("}file_name")]
    if len(arrays) != 1 or len(files) != 1:
        return None
    begin = next((int(child.text or 0) for child in arrays[0] if child.tag.endswith("}offset")), -1)
    data = Path(path).with_name(files[0])
    if begin != max(begins, default=0) or not data.is_file():
        return None
    if data.suffix.lower() in (".tif", ".tiff") and not _before(data, begin):
        return None
    samples = sum(np.dtype(dtype).itemsize for dtype in dataset.dtypes) * dataset.width * dataset.height
    return exact(data, begin + samples)


def _before(file: Path, begin: int) -> bool:
    """Whether the directory of a TIFF lies before a byte after which there are only samples."""
    with file.open("rb") as opened:
        head = opened.read(8)
    return head[:4] == b"II*\0" and int.from_bytes(head[4:], "little") < begin
