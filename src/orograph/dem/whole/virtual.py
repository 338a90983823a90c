"""VRTs: the parts of other files that make up a window are checked like those files themselves.

GDAL reads the sources of a VRT with their own drivers, and so overlooks the same damage. The VRT's XML says which
rectangle of which file lies where (https://gdal.org/drivers/raster/vrt.html). Files whose rectangles are not simply
mapped (warped, pansharpened) are checked as a whole. Files that are not on this disk are not checked. Units: samples.
"""

from __future__ import annotations

import math
import threading
import xml.etree.ElementTree as ET
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from affine import Affine

from orograph.dem.whole.files import DAMAGED, archive_name, file_in, here, main_file, on_disk, stream
from orograph.errors import ReadError

Rect = tuple[float, float, float, float]
Window = tuple[int, int, int, int]

Place = tuple[Affine, object]
"""Transform and CRS of a file."""

MARGIN = 2
"""Samples around a mapped window that resampling may read."""

SHIFT = 0.75
"""Tolerance in samples between a part's place and its file's: mosaics are placed to the nearest sample."""

_COMPARED = 8
_CONVERTING = ("ScaleRatio", "ScaleOffset", "LUT", "Exponent")
_KNOWN = 64
_parts: OrderedDict[object, list[Part]] = OrderedDict()
_lock = threading.Lock()


class Part(NamedTuple):
    """A source of a VRT.

    Attributes:
        location: what GDAL opens.
        band: of it, from 1.
        source, target: left, top, width, height in it and in the VRT; None: all of it.
        needs: minimum bytes of a file of raw samples; 0 for other files.
        shape: rows, cols that the VRT declares for it; None: it does not.
        by_mask: whether its mask is read, not its band.
        for_mask: whether it is a part of the VRT's mask.
        taken: left, top, width, height of the part that is used, mapped or not; None: unknown.
        tag: the element that names it.
        onto: the VRT's band that it is a part of, from 1; 0: no single band; −1: of a VRT nested in this one's text.
        converted: whether its numbers are changed on the way.
        fills: whether its missing samples are left out.
    """

    location: str
    band: int
    source: Rect | None
    target: Rect | None
    needs: int
    shape: tuple[int, int] | None
    by_mask: bool
    for_mask: bool
    taken: Rect | None = None
    tag: str = ""
    onto: int = 0
    converted: bool = False
    fills: bool = False

    @property
    def reach(self) -> tuple[int, int] | None:
        """The minimum rows, cols of the file for the part that is used, to the nearest sample; None: unknown."""
        if self.taken is None:
            return None
        left, top, width, height = self.taken
        return round(top + height), round(left + width)


def check_parts(
    dataset: Any,
    key: object,
    window: Window,
    check: Callable[[Part, Window | None], None],
    place: Callable[[Part], Place],
    mask: bool = False,
) -> None:
    """Raise ReadError if a part of a file that contributes to a window of a VRT is damaged.

    Args:
        dataset: of rasterio, open, of the VRT.
        key: the VRT's name and state.
        window: top, left, height, width.
        check: checks a window (None: all) of a part whose file is on this disk.
        place: the place that a part's file declares.
        mask: check the VRT's mask instead.
    """
    parts = parts_of(dataset, key)
    for part in parts:
        mapped = _mapped(part, window)
        if part.for_mask != mask or mapped == ():
            continue
        if not on_disk(part.location).is_file():
            if _named_here(part.location):
                raise ReadError(
                    "One of its parts is missing, and would be read as missing or 0.", path=part.location,
                    remedy="Restore it, or make the VRT again (gdalbuildvrt).",
                )  # fmt: skip
            continue
        if not part.needs:
            check(part, mapped or None)
            if _shifted(dataset, part, place):
                _check_place(dataset, parts, part, place)
        elif Path(part.location).is_file():
            _check_length(part, max(one.needs for one in parts if one.location == part.location), dataset)


def _check_length(part: Part, needs: int, dataset: Any) -> None:
    """Raise ReadError unless a file of raw bands has the required samples, in whole rows.

    (It may have further bands, which the VRT does not mention.)
    """
    behind = Path(part.location).stat().st_size - needs
    if behind < 0:
        raise ReadError("It has fewer samples than the VRT declares.", path=part.location, remedy=DAMAGED)
    if 0 < behind < dataset.width:
        raise ReadError(
            f"It has {behind:,} bytes more than the samples that the VRT declares need.",
            path=part.location,
            remedy=DAMAGED,
        )


def _shifted(dataset: Any, part: Part, place: Callable[[Part], Place]) -> bool | None:
    """Whether a VRT places a part elsewhere than its own file; None: unknown."""
    if part.source is None or part.target is None or part.by_mask or part.for_mask:
        return None
    transform, crs = place(part)
    if crs is None or crs != dataset.crs or dataset.transform == Affine.identity():
        return None
    vrt, step = dataset.transform, abs(transform.a) + abs(transform.b)
    for right, below in ((0.0, 0.0), part.source[2:]):
        x, y = part.source[0] + right, part.source[1] + below  # a corner in the file, and in the VRT
        u = part.target[0] + right * part.target[2] / part.source[2]
        v = part.target[1] + below * part.target[3] / part.source[3]
        east = vrt.a * u + vrt.b * v + vrt.c - (transform.a * x + transform.b * y + transform.c)
        if dataset.crs.is_geographic:
            east = math.remainder(east, 360)  # tiles beyond the antimeridian
        north = vrt.d * u + vrt.e * v + vrt.f - (transform.d * x + transform.e * y + transform.f)
        if max(abs(east), abs(north)) > SHIFT * step:
            return True
    return False


def _check_place(dataset: Any, parts: list[Part], part: Part, place: Callable[[Part], Place]) -> None:
    """Raise ReadError if a VRT moves one part away from its file's own place but leaves another in place.

    A VRT may place all its parts anew, but not a single one.
    """
    others = [one for one in parts if one.location != part.location and _named_here(one.location)]
    for other in others[:_COMPARED]:
        if on_disk(other.location).is_file() and _shifted(dataset, other, place) is False:
            raise ReadError(
                f"It places {part.location} elsewhere than that file's own georeferencing.", path=str(dataset.name),
                remedy="Make the VRT again (gdalbuildvrt), or restore the replaced file from a copy.",
            )  # fmt: skip


def _named_here(location: str) -> bool:
    """Whether a name can only refer to a file on this disk, in an archive or not."""
    return archive_name(location) or not (location.startswith(("/vsi", "<")) or ":" in location[2:])


def locations(dataset: Any, key: object) -> list[str]:
    """GDAL's names of all parts of a VRT, files or not; arguments as for ``check_parts``."""
    return list(dict.fromkeys(part.location for part in parts_of(dataset, key)))


def parts_of(dataset: Any, key: object) -> list[Part]:
    """All parts of a VRT on this disk; arguments as for ``check_parts``.

    Raises:
        ReadError: they cannot be understood.
    """
    name = main_file(dataset)
    if not here(name):
        return []
    with _lock:
        found = _parts.get(key)
    if found is None:
        try:
            found = list(_read(ET.fromstring(_text(dataset, name)), name))
        except (ValueError, TypeError, SyntaxError) as error:
            raise ReadError(f"Its parts cannot be parsed ({error}).", path=name, remedy=DAMAGED) from None
        with _lock:
            _parts[key] = found
            while len(_parts) > _KNOWN:
                _parts.popitem(last=False)
    return found


def _text(dataset: Any, name: str) -> str | bytes:
    """The XML of a VRT; for ``vrt://FILE?…``, the XML that GDAL generates."""
    if str(dataset.name).startswith("vrt://"):
        return str(dataset.tags(ns="xml:VRT")["xml:VRT"])
    with stream(name) as file:
        return file.read()


def _read(root: ET.Element, name: str) -> Iterator[Part]:
    """The parts of the VRT with this name."""
    shape = int(root.get("rasterXSize", 0)), int(root.get("rasterYSize", 0))
    bands = {
        inner: (number, "Derived" in band.get("subClass", ""))
        for number, band in enumerate(root.findall("VRTRasterBand"), 1)
        for inner in band.iter()
    }
    of_mask = {inner for mask in root.iter("MaskBand") for inner in mask.iter()}
    for element in root.iter():
        file = element.find("SourceFilename")
        file = element.find("SourceDataset") if file is None else file
        if file is None or not file.text:
            continue
        location = file.text
        if location.lstrip().startswith("<"):  # a VRT nested in a VRT's own text
            yield from (
                inner._replace(source=None, target=None, taken=None, onto=-1)
                for inner in _read(ET.fromstring(location), name)
            )
            continue
        if file.get("relativeToVRT", file.get("relativetoVRT")) == "1":
            before, inner, after = file_in(location)
            location = f"{before}{name.rpartition('/')[0] or '.'}/{inner}{after}"
        kind, _, band = (element.findtext("SourceBand") or "1").rpartition(",")
        as_is = element.find("OpenOptions") is None  # or it is an overview of the file, for example
        mapped = as_is and element.tag in ("SimpleSource", "ComplexSource")
        source, target = (_rect(element.find(tag)) if mapped else None for tag in ("SrcRect", "DstRect"))
        needs = _raw_bytes(element, *shape) if element.tag == "VRTRasterBand" else 0
        number, by_mask = int(band) if band.isdigit() else 1, kind == "mask"
        given = element.find("SourceProperties") if as_is else None
        size = None if given is None else (int(given.get("RasterYSize", 0)), int(given.get("RasterXSize", 0)))
        size = None if size == (0, 0) else size
        taken = _rect(element.find("SrcRect")) if as_is and element.tag != "VRTRasterBand" else None
        onto, derived = bands.get(element, (0, False))
        use_mask = (element.findtext("UseMaskBand") or "").lower() == "true"
        part = Part(
            location, number, source, target, needs, size, by_mask, element in of_mask, taken, element.tag, onto,
            derived or any(element.find(tag) is not None for tag in _CONVERTING),
            use_mask or element.find("NODATA") is not None,
        )  # fmt: skip
        if taken is not None and min(round(taken[0]), round(taken[1])) < 0:
            raise ValueError(f"it takes samples of {location} from beyond its edge, which would be 0")
        if target is not None and not _meets(target, shape):
            raise ValueError(f"{location} lies outside it")
        yield part
        if use_mask:
            yield part._replace(by_mask=True)


def _rect(element: ET.Element | None) -> Rect | None:
    if element is None:
        return None
    given = [element.get(side) for side in ("xOff", "yOff", "xSize", "ySize")]
    if None in given:
        raise ValueError(f"a {element.tag} has no position")
    left, top, width, height = (float(side or 0) for side in given)
    if not (math.isfinite(left + top) and 0 < width < math.inf and 0 < height < math.inf):
        raise ValueError(f"a {element.tag} has an invalid position")
    return left, top, width, height


def _meets(target: Rect, shape: tuple[int, int]) -> bool:
    """Whether a rectangle overlaps a VRT of so many columns and rows."""
    left, top, width, height = target
    return left < shape[0] and top < shape[1] and left + width > 0 and top + height > 0


def _raw_bytes(band: ET.Element, cols: int, rows: int) -> int:
    """Bytes up to the end of the last sample of a raw band."""
    kind = band.get("dataType", "Byte")
    bits = kind.lstrip("CUIntFloa")
    item = (int(bits) // 8 if bits.isdigit() else 1) * (2 if kind.startswith("C") else 1)
    first, pixel = int(band.findtext("ImageOffset") or 0), int(band.findtext("PixelOffset") or item)
    line = int(band.findtext("LineOffset") or pixel * cols)
    return first + max((rows - 1) * line, 0) + max((cols - 1) * pixel, 0) + item


def _mapped(part: Part, window: Window) -> Window | tuple[()] | None:
    """The window of a part's file that a window of the VRT needs; None: all of it; (): nothing."""
    if part.source is None or part.target is None or not part.target[2] or not part.target[3]:
        return None
    top, left, height, width = window
    x0, x1 = _along(left, left + width, part.target[0], part.target[2], part.source[0], part.source[2])
    y0, y1 = _along(top, top + height, part.target[1], part.target[3], part.source[1], part.source[3])
    return (y0, x0, y1 - y0, x1 - x0) if x0 < x1 and y0 < y1 else ()


def _along(begin: float, end: float, onto: float, onto_size: float, of: float, of_size: float) -> tuple[int, int]:
    """The range of a file that [begin, end) of the VRT maps to, along one axis; empty if they do not meet."""
    a, b = max(begin, onto), min(end, onto + onto_size)
    if a >= b:
        return 0, 0
    scale = of_size / onto_size
    first, last = of + (a - onto) * scale, of + (b - onto) * scale
    return math.floor(first) - MARGIN, math.ceil(last) + MARGIN
