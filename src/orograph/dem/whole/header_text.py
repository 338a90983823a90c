"""Text headers of raw samples: every number is valid, every word is known, nothing occurs twice.

GDAL uses the parts of a header that it understands, and defaults for the rest: 8 bits for ``NBITS x``, this machine's
byte order for a damaged ``BYTEORDER``, a step of 1 if ``XDIM`` is lost. A key that differs from a known one by one
letter is taken for a damaged form of it. All other keys are ignored, because they are their writers' own.

Sources: ESRI's .hdr, ENVI's header, ER Mapper's .ers, Idrisi's .rdc, SAGA's .sgrd, R's .grd and PCI's .aux as their
makers document them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\Z")
_WHOLE = re.compile(r"\d+\Z")


class Form(NamedTuple):
    """The permitted content of a text header.

    Attributes:
        endings: of the header's file; "": the main file itself.
        parting: the separator of key and value; None: white space.
        whole, numbers: keys of whole numbers, and of any.
        words: keys and their permitted words, in capitals.
        needed: groups of keys that occur together or not at all; a group that begins with "" is required.
        ordered: pairs of keys, of which the first has the smaller number.
        other: further keys.
        shortest: minimum length of a key whose damaged forms are recognised.
    """

    endings: tuple[str, ...]
    parting: str | None
    whole: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    words: dict[str, tuple[str, ...]] = {}  # noqa: RUF012 (never changed)
    needed: tuple[tuple[str, ...], ...] = ()
    ordered: tuple[tuple[str, str], ...] = ()
    other: tuple[str, ...] = ()
    shortest: int = 4


_MFF_CORNERS = tuple(
    f"{side}_CORNER_{axis}"
    for side in ("TOP_LEFT", "TOP_RIGHT", "BOTTOM_RIGHT", "BOTTOM_LEFT")
    for axis in ("LATITUDE", "LONGITUDE")
)

FORMS = {
    "EHdr": Form(
        (".hdr", ".HDR"), None,
        ("NROWS", "NCOLS", "NBANDS", "NBITS", "BANDROWBYTES", "TOTALROWBYTES", "BANDGAPBYTES", "SKIPBYTES"),
        ("ULXMAP", "ULYMAP", "XDIM", "YDIM", "XLLCORNER", "YLLCORNER", "XLLCENTER", "YLLCENTER", "CELLSIZE"),
        {"BYTEORDER": ("I", "M", "LSBFIRST", "MSBFIRST"), "LAYOUT": ("BIL", "BIP", "BSQ"),
         "PIXELTYPE": ("SIGNEDINT", "UNSIGNEDINT", "SIGNEDBYTE", "FLOAT")},
        (("", "NROWS", "NCOLS"), ("ULXMAP", "ULYMAP", "XDIM", "YDIM")),
        other=("NODATA", "NODATA_VALUE"),
    ),
    "ENVI": Form(
        (".hdr", ".HDR", "+.hdr"), "=", ("samples", "lines", "bands", "header offset", "data type"), (),
        {"interleave": ("BSQ", "BIL", "BIP"), "byte order": ("0", "1")},
        (("", "samples", "lines", "data type"),),
        other=("map info", "coordinate system string", "data ignore value", "description", "file type", "band names",
               "sensor type", "wavelength units", "geo points", "projection info", "pixel size", "default bands"),
    ),
    "ERS": Form(
        ("",), "=", ("NrOfLines", "NrOfCellsPerLine", "NrOfBands", "HeaderOffset"),
        ("Xdimension", "Ydimension", "Eastings", "Northings", "RegistrationCellX", "RegistrationCellY"),
        {"ByteOrder": ("LSBFIRST", "MSBFIRST"),
         "CellType": (*(f"{sign}SIGNED{bits}BITINTEGER" for sign in ("", "UN") for bits in (8, 16, 32)),
                      "IEEE4BYTEREAL", "IEEE8BYTEREAL")},
        (("", "NrOfLines", "NrOfCellsPerLine", "CellType"), ("Xdimension", "Ydimension"), ("Eastings", "Northings")),
        other=("DataSetType", "Datum", "Projection", "Rotation", "NullCellValue"),
    ),
    "RST": Form(
        (".rdc", ".RDC"), ":", ("columns", "rows"), ("unit dist.", "min. X", "max. X", "min. Y", "max. Y"),
        {"data type": ("BYTE", "INTEGER", "REAL", "RGB24"), "file type": ("BINARY", "ASCII", "PACKED BINARY")},
        (("", "columns", "rows", "data type", "file type", "min. X", "max. X", "min. Y", "max. Y",
          "flag value"),),
        (("min. X", "max. X"), ("min. Y", "max. Y")),
        ("ref. system", "ref. units", "resolution", "flag value", "flag def'n", "value units", "min. value",
         "max. value"),
    ),
    "SAGA": Form(
        (".sgrd", ".SGRD"), "=", ("CELLCOUNT_X", "CELLCOUNT_Y", "DATAFILE_OFFSET"),
        ("POSITION_XMIN", "POSITION_YMIN", "CELLSIZE", "Z_FACTOR"),
        {"DATAFORMAT": ("BIT", "BYTE_UNSIGNED", "BYTE", "SHORTINT_UNSIGNED", "SHORTINT", "INTEGER_UNSIGNED",
                        "INTEGER", "FLOAT", "DOUBLE"),
         "BYTEORDER_BIG": ("TRUE", "FALSE"), "TOPTOBOTTOM": ("TRUE", "FALSE")},
        (("", "CELLCOUNT_X", "CELLCOUNT_Y", "POSITION_XMIN", "POSITION_YMIN", "CELLSIZE", "DATAFORMAT",
          "NODATA_VALUE"),),
        other=("NODATA_VALUE", "DESCRIPTION"),
    ),
    "RRASTER": Form(
        ("",), "=", ("nrows", "ncols", "nbands"), ("xmin", "xmax", "ymin", "ymax"),
        {"byteorder": ("LITTLE", "BIG"), "bandorder": ("BIL", "BIP", "BSQ"),
         "datatype": ("INT1S", "INT2S", "INT4S", "INT1U", "INT2U", "INT4U", "FLT4S", "FLT8S", "LOG1S")},
        (("", "nrows", "ncols", "datatype", "xmin", "xmax", "ymin", "ymax"),),
        (("xmin", "xmax"), ("ymin", "ymax")),
        ("nodatavalue", "projection", "minvalue", "maxvalue"),
    ),
    "PAux": Form(
        (".aux", ".AUX"), ":", (), ("UpLeftX", "UpLeftY", "LoRightX", "LoRightY"), {},
        (("", "RawDefinition", "ChanDefinition-1"), ("UpLeftX", "UpLeftY", "LoRightX", "LoRightY")),
        (("UpLeftX", "LoRightX"), ("LoRightY", "UpLeftY")),
        ("RawDefinition", "ChanDefinition-1", "AuxilaryTarget"),
    ),
    "EIR": Form(
        ("",), None, ("WIDTH", "HEIGHT", "NUM_LAYERS", "DATA_OFFSET"), (),
        {"FORMAT": ("BIL", "BIP", "BSQ"), "BYTE_ORDER": ("LSB", "MSB", "NA"),
         "DATATYPE": ("U1", "U2", "U4", "U8", "U16", "U32", "S16", "S32", "F32", "F64")},
        (("", "WIDTH", "HEIGHT", "DATATYPE", "BYTE_ORDER"),), other=("PIXEL_FILES",),
    ),
    "GenBin": Form(
        (".hdr", ".HDR"), ":", ("ROWS", "COLS", "BANDS"),
        ("UL_X_COORDINATE", "UL_Y_COORDINATE", "LR_X_COORDINATE", "LR_Y_COORDINATE"),
        {"INTERLEAVING": ("BIL", "BIP", "BSQ"), "BYTE_ORDER": ("LSB", "MSB", "NA"),
         "DATATYPE": ("U1", "U2", "U4", "U8", "U16", "U32", "S8", "S16", "S32", "F32", "F64")},
        (("", "ROWS", "COLS", "BANDS", "DATATYPE", "BYTE_ORDER"),
         ("UL_X_COORDINATE", "UL_Y_COORDINATE", "LR_X_COORDINATE", "LR_Y_COORDINATE")),
        (("UL_X_COORDINATE", "LR_X_COORDINATE"), ("LR_Y_COORDINATE", "UL_Y_COORDINATE")),
        ("PROJECTION_NAME", "PROJECTION_ZONE", "DATUM_NAME"),
    ),
    "ROI_PAC": Form(
        ("+.rsc",), None, ("WIDTH", "FILE_LENGTH"),
        ("X_FIRST", "X_STEP", "Y_FIRST", "Y_STEP", "Z_OFFSET", "Z_SCALE"), {},
        (("", "WIDTH", "FILE_LENGTH"), ("X_FIRST", "X_STEP", "Y_FIRST", "Y_STEP")),
        other=("PROJECTION", "DATUM", "X_UNIT", "Y_UNIT"),
    ),
    "MFF": Form(
        ("",), "=", ("IMAGE_LINES", "LINE_SAMPLES"), _MFF_CORNERS, {"BYTE_ORDER": ("LSB", "MSB")},
        (("", "IMAGE_LINES", "LINE_SAMPLES"), _MFF_CORNERS),
        other=("BYTE_ORDER", "FILE_TYPE"),
    ),
}  # fmt: skip


def pairs(text: str, parting: str | None) -> list[tuple[str, str]]:
    """Keys and values from a text's lines, separated by a character or by white space (None)."""
    found = []
    for line in text.splitlines():
        key, _, value = line.strip().partition(parting) if parting else _first_word(line.strip())
        if key and (value or parting is None):
            found.append((key.strip(), value.strip().strip('"')))
    return found


def _first_word(line: str) -> tuple[str, str, str]:
    key, *rest = line.split(None, 1) or [""]
    return key, " ", rest[0] if rest else ""


def check(driver: str) -> Callable[[Any, str], str | None]:
    """The fault of the header of a dataset of this driver, given its main file."""
    form = FORMS[driver]

    def fault(dataset: Any, path: str) -> str | None:
        file = _header(path, form.endings)
        if file is None:
            return None
        text = file.read_text("latin-1")
        return braces_fault(text) or form_fault(form, pairs(_flat(text), form.parting))

    return fault


def _header(path: str, endings: Iterable[str]) -> Path | None:
    """The header of a raster with this main file."""
    files = (
        Path(path) if not ending else Path(path + ending[1:]) if ending[0] == "+" else Path(path).with_suffix(ending)
        for ending in endings
    )
    return next((file for file in files if file.is_file()), None)


def braces_fault(text: str) -> str | None:
    """The fault in a header's braces, as a sentence; None if there is none."""
    open_parts: list[str] = []
    if text.lstrip().startswith("DatasetHeader"):
        for name, what in re.findall(r"^[ \t]*(\w+)[ \t]+(Begin|End)[ \t]*\r?$", text, re.M):
            if what == "Begin":
                open_parts.append(name)
            elif not open_parts or open_parts.pop() != name:
                return f"The parts of its header are inconsistent ({name})."
        if open_parts:
            return f"The part {open_parts[-1]!r} of its header does not end: it is damaged or truncated."
    if text.lstrip().startswith("ENVI") and text.count("{") != text.count("}"):
        return "A brace in its header is not closed: it is damaged or truncated."
    return None


def _flat(text: str) -> str:
    """A text without the parts in braces, which are free text."""
    return re.sub(r"\{[^}]*\}", "{}", text)


def form_fault(form: Form, entries: list[tuple[str, str]]) -> str | None:
    """The fault in a header's content, as a sentence; None if there is none."""
    spelt = {key.lower(): key for key in _keys(form)}
    values: dict[str, str] = {}
    for written, value in entries:
        key = spelt.get(re.sub(r"\s+", " ", written).lower())
        if key is None:
            long = (known for known in spelt.values() if len(known) >= form.shortest)
            meant = next((known for known in long if _nearly(written.lower(), known.lower())), None)
            if meant is not None:
                return f"Its header says {written!r}, which is {meant!r} damaged."
            continue
        if key in (*form.whole, *form.numbers, *form.words) and values.get(key, value) != value:
            return f"Its header gives twice what its {key!r} is: {values[key]!r} and {value!r}."
        values[key] = value
    return _value_fault(form, values) or _lack(form, values)


def _keys(form: Form) -> tuple[str, ...]:
    return (*form.whole, *form.numbers, *form.words, *form.other)


def _value_fault(form: Form, values: dict[str, str]) -> str | None:
    for key, value in values.items():
        wrong = (
            (key in form.whole and not _WHOLE.match(value))
            or (key in form.numbers and not (_NUMBER.match(value) and math.isfinite(float(value))))
            or (re.search("dim|cellsize", key, re.I) and float(value) <= 0)
            or (key in form.words and value.upper() not in form.words[key])
        )
        if wrong:
            return f"Its header says {key!r} is {value[:40]!r}, which is impossible."
    for less, more in form.ordered:
        if less in values and more in values and not float(values[less]) < float(values[more]):
            return f"Its header says {less!r} is {values[less]} and {more!r} {values[more]}: one of them is wrong."
    return None


def _lack(form: Form, values: dict[str, str]) -> str | None:
    for group in form.needed:
        keys = [key for key in group if key]
        there = [key for key in keys if key in values]
        if len(there) < len(keys) and (there or group[0] == ""):
            lacks = next(key for key in keys if key not in values)
            return f"Its header does not say what its {lacks!r} is."
    return None


def _nearly(a: str, b: str) -> bool:
    """Whether two words differ by one letter: changed (except one digit for another), lost or added."""
    if abs(len(a) - len(b)) > 1 or a == b:
        return False
    if len(a) == len(b):
        changed = [(x, y) for x, y in zip(a, b, strict=True) if x != y]
        return len(changed) == 1 and not (changed[0][0].isdigit() and changed[0][1].isdigit())
    short, long = sorted((a, b), key=len)
    return any(long[:i] + long[i + 1 :] == short for i in range(len(long)))


_ROWS, _PLAUSIBLE, _GREATEST = 16, (1e-6, 1e6), 1e8


def kind_fault(dataset: Any, header: dict[str, str]) -> str | None:
    """Faults of a header's numbers that GDAL does not notice.

    32-bit floats may be declared as integers or with the opposite byte order; or a corner may have no step, for which
    GDAL assumes 1.
    """
    if any(key.startswith(("XLL", "YLL")) for key in header) and not {"CELLSIZE", "XDIM"} & set(header):
        return "Its header lacks 'CELLSIZE'."
    if np.dtype(dataset.dtypes[0]).itemsize != 4:
        return None
    first = dataset.read(1, window=((0, min(_ROWS, dataset.height)), (0, dataset.width)))
    words = np.ascontiguousarray(first).view(np.uint32).reshape(-1)  # (as GDAL reads them)
    if first.dtype.kind == "f":
        turned = not _floating(words) and _floating(words.byteswap())
        return "Its numbers are in the opposite byte order from its header ('BYTEORDER')." if turned else None
    large = words[words > 0]
    if "PIXELTYPE" in header or not _floating(words) or np.median(np.abs(large.view(np.int32) / 1.0)) < _GREATEST:
        return None
    return "Its numbers look like floats, but its header does not declare them so ('PIXELTYPE FLOAT')."


def _floating(words: NDArray[np.uint32]) -> bool:
    """Whether 32-bit words are floating-point heights: nearly all plausible, and not all 0."""
    there = words[words > 0]
    values = np.abs(there.view(np.float32))
    return bool(there.size) and float(((values > _PLAUSIBLE[0]) & (values < _PLAUSIBLE[1])).mean()) > 0.5
