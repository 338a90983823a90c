"""Which stored numbers mean "no height here": the nodata value, and masks.

The nodata value is compared with numbers as stored, in their own type, before any scaling; a value that cannot occur in
that type (−9999 declared for bytes) is ignored.

netCDF may also name a ``missing_value`` beside ``_FillValue``, and a valid range (CF 1.11, §2.5.1). GDAL puts 0 where a
number is outside it and no fill value is declared; datasets are opened so as to prevent this
(``handles.open_dataset``).
"""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import IO, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.dem.whole.files import here, main_file, stream
from orograph.errors import ReadError, UsageError

_GDAL_NODATA = 42113
_LIMITS = ("valid_range", "valid_min", "valid_max")

KEEP_RANGE = {"HONOUR_VALID_RANGE": "NO"}
"""How GDAL opens a netCDF file without putting 0 where numbers are beyond the valid range."""


def is_nodata(raw: NDArray[Any], nodata: float | int) -> NDArray[np.bool_]:
    """Where stored numbers mean "missing".

    Integers are compared exactly. Floats are compared as float32, as the result is float32 anyway: the tag may be a
    float64 text of a float32 value or the reverse (−3.4028234663852886e+38, −99.9); unless float32 would turn it into
    0.
    """
    missing: NDArray[np.bool_]
    with np.errstate(over="ignore", under="ignore"):
        narrow = np.float32(nodata) if raw.dtype.kind == "f" else np.float32(0)
        if np.isnan(nodata):
            missing = np.isnan(raw)
        elif raw.dtype.kind != "f" or narrow == 0 or np.isinf(narrow):
            missing = raw == nodata
        else:
            missing = raw.astype(np.float32, copy=False) == narrow
    return missing


def nodata_of(dataset: Any, band: int, given: float | str | None, dtype: str) -> float | int | None:
    """The nodata number in the band's own type; None if there is none, or it cannot occur in that type."""
    if isinstance(given, str):
        if given.strip().lower() == "none":
            return None
        try:
            given = int(given) if given.strip().lstrip("+-").isdigit() else float(given)
        except ValueError:
            raise UsageError(f"The nodata value must be a number or 'none', not {given!r}.") from None
    value = _declared(dataset, band, dtype) if given is None else given
    if value is None:
        return None
    if isinstance(value, int) and abs(value) >= 1 << 64:
        value = float(str(value))  # no integer stored is that large; a long text is a float, or infinite
    if np.dtype(dtype).kind == "f":
        return float(value)
    info = np.iinfo(dtype)
    if not np.isfinite(value) or value != int(value) or not info.min <= int(value) <= info.max:
        return None  # -9999 declared for uint8, for example: no stored number equals it
    return int(value)


def _declared(dataset: Any, band: int, dtype: str) -> float | int | None:
    """The nodata value that a file declares.

    Raises:
        ReadError: GDAL may have truncated it: for 64-bit integers it reads −9.22e+18 as −9.
    """
    value: float | None = dataset.nodatavals[band - 1]
    if value is None or dtype not in ("int64", "uint64") or not 0 < abs(value) < 10:
        return value
    text = nodata_text(dataset, band)
    if text is None:
        raise ReadError(
            f"Its nodata value is read as {value:g}, which may be the first digit of another such as {value:g}e+18.",
            path=dataset.name, remedy="Give the number that means missing: `nodata=N`, or none.",
        )  # fmt: skip
    return int(float(text))


_NUMBER = re.compile(r"[+-]?(?:nan|inf(?:inity)?|1\.#\w+|(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)", re.I)


def check_text(dataset: Any, text: str | None) -> None:
    """Raise ReadError if a GeoTIFF's nodata value is not a number: GDAL would use its beginning, or 0."""
    value = None if text is None else text.partition("\0")[0].strip()
    if value and not _NUMBER.fullmatch(value.replace(",", ".") if re.fullmatch(r"[+-]?\d+,0*", value) else value):
        raise ReadError(
            f"Its nodata value ({value!r}) is not a number.", path=dataset.name,
            remedy="Give the number that means missing: `nodata=N`, or none.",
        )  # fmt: skip


def is_default_fill(dataset: Any, band: int) -> bool:
    """Whether a nodata value of 0 is just Zarr's default fill value, for unwritten chunks."""
    tags = {**dataset.tags(), **dataset.tags(band)}
    return bool(dataset.driver == "Zarr" and dataset.nodatavals[band - 1] == 0 and "_FillValue" not in tags)


def nodata_text(dataset: Any, band: int) -> str | None:
    """The nodata value as text in a GeoTIFF or a VRT; None for other formats."""
    name = main_file(dataset)
    if not here(name):
        return None
    with stream(name) as file:
        if dataset.driver == "VRT" and dataset.name == name:
            bands = ET.fromstring(file.read()).findall("VRTRasterBand")
            return bands[band - 1].findtext("NoDataValue")
        return _tag(file, _GDAL_NODATA) if dataset.driver == "GTiff" and dataset.name == name else None


def impossible_nodata(dataset: Any, band: int, said: str | None, whose: str = "Its nodata value") -> Iterator[str]:
    """A warning if the band's type cannot hold the nodata value of a GeoTIFF or a VRT, or of a user.

    Args:
        said: its text. whose: how the warning begins.
    """
    kind = np.dtype(dataset.dtypes[band - 1])
    text = (said or "").partition("\0")[0].strip()
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        return
    if kind.kind not in "iu" or np.isnan(value):
        return
    info = np.iinfo(kind)
    if value == np.trunc(value) and info.min <= value <= info.max:
        return
    stored = ""
    if value == np.trunc(value) and abs(value) < 2**63:
        wrapped = int(np.array(int(value), np.int64).astype(kind))
        stored = f"; missing samples may be stored as {wrapped} (if so, give `nodata={wrapped}`)"
    yield f"{whose} ({text}) cannot occur in {kind.name}, so it marks nothing as missing{stored}."


def _tag(file: IO[bytes], wanted: int) -> str | None:
    """The text of a tag of a TIFF's first directory (TIFF 6.0, section 2; BigTIFF)."""
    first = file.read(16)
    order, big = "<" if first[:2] == b"II" else ">", first[2] + first[3] == 43
    entry = struct.Struct(order + ("HHQQ" if big else "HHII"))
    (at,) = struct.unpack_from(order + ("Q" if big else "I"), first, 8 if big else 4)
    file.seek(at)
    (count,) = struct.unpack(order + ("Q" if big else "H"), file.read(8 if big else 2))
    for _ in range(count):
        content = file.read(entry.size)
        tag, _, size, where = entry.unpack(content)
        if tag == wanted:
            within = content[-(8 if big else 4) :]
            if size > len(within):
                file.seek(where)
                within = file.read(size)
            return within[:size].rstrip(b"\0 ").decode("latin-1")
    return None


def mask_of(dataset: Any, band: int, given: float | str | None) -> tuple[Literal["none", "gdal", "alpha"], int]:
    """Where else missing samples are marked: by GDAL's mask or a floating-point alpha band.

    GDAL's mask covers mask bands, alpha, and ISIS special pixels. It ignores alpha bands that are not integers
    (Spearfish: float32), hence the second kind.
    """
    from rasterio.enums import ColorInterp, MaskFlags

    flags = set(dataset.mask_flag_enums[band - 1])
    if MaskFlags.all_valid in flags:
        alphas = (
            [i + 1 for i, c in enumerate(dataset.colorinterp) if c == ColorInterp.alpha] if dataset.count < 100 else []
        )
        if alphas and band not in alphas:
            return "alpha", alphas[0]
        return "none", 0
    if MaskFlags.nodata in flags and (flags == {MaskFlags.nodata} or given is not None):
        return "none", 0  # only the nodata value, which is compared in this module
    if dataset.count < 100 and dataset.colorinterp[band - 1] == ColorInterp.alpha:
        return "none", 0
    return "gdal", 0


class Valid(NamedTuple):
    """Which stored numbers are heights, in addition to the nodata value.

    Attributes:
        others: further numbers that mean "missing".
        low, high: the valid range, both ends included.
    """

    others: tuple[float, ...] = ()
    low: float = -np.inf
    high: float = np.inf

    def outside(self, raw: NDArray[Any]) -> NDArray[np.bool_]:
        """Where stored numbers are not heights."""
        beyond: NDArray[np.bool_] = (raw < self.low) | (raw > self.high)
        for number in self.others:
            beyond |= is_nodata(raw, number)
        return beyond


def is_limited(dataset: Any) -> bool:
    """Whether a dataset is netCDF with a valid range."""
    return dataset.driver == "netCDF" and any(key.rpartition("#")[2] in _LIMITS for key in dataset.tags())


def valid_of(dataset: Any, band: int) -> Valid | None:
    """What a netCDF variable declares about missing data besides its nodata value; None: nothing."""
    if dataset.driver != "netCDF":
        return None
    tags = dataset.tags(band)
    span = _numbers(tags.get("valid_range", ""))
    low = next(iter(_numbers(tags.get("valid_min", ""))), span[0] if len(span) == 2 else -np.inf)
    high = next(iter(_numbers(tags.get("valid_max", ""))), span[1] if len(span) == 2 else np.inf)
    declared = dataset.nodatavals[band - 1]
    others = tuple(number for number in _numbers(tags.get("missing_value", "")) if number != declared)
    found = Valid(others, low, high)
    return None if found == Valid() else found


def _numbers(text: str) -> list[float]:
    """The numbers of an attribute: "5", "{0,300}"."""
    try:
        return [float(number) for number in re.split(r"[{},\s]+", text) if number]
    except ValueError:
        return []
