"""Checks whether a raster's file is intact, for damage that GDAL's drivers do not report.

Most drivers notice a file that was cut short or a block that does not decode. Some do not, and return zeros or
uninitialised memory. ``check_file`` examines those formats when a file is first opened, and again when it or a file
beside it has changed; ``check_blocks`` examines the blocks of a GeoTIFF as they are read. The formats that need it were
found by cutting and altering files of every driver (``tests/dem/test_mutants.py``):

- GeoTIFF: streams that do not fill their block, or yield more than it holds; JPEG that libjpeg only warns of
  (``blocks``); overlapping blocks, inserted bytes, an unreachable mask (``tiff``).
- Raw samples: sizes that differ from what the header promises (``sizes``, ``labels``, ``ilwis``); text headers with
  damaged words, invalid numbers, or contradictions (``header_text``).
- PNG: a file that ends early is padded with uninitialised memory (``png``).
- HFA (.img), classic netCDF: blocks beyond the end of the file are uninitialised or 0 (``hfa``, ``netcdf``).
- JPEG 2000, MRF: tiles that are lost or do not decode are uninitialised memory (``jp2``, ``mrf``).
- GeoPackage, MBTiles: tiles that do not decode are 0; HDF5: extra bytes (``containers``).
- USGS DEMs: profiles that contradict their own headers (``usgs``).
- GRIB 2: packed pictures whose checksums differ (``grib``).
- Text (``text``): a word that is not a number is read as 0 or as the number it begins with; a missing number is 0.
- VRT: the drivers above read its parts (``virtual``).
- netCDF: uneven axes, and missing data that GDAL does not recognise (``cf``).
- DTED: columns out of order, headers that contradict each other (``dted``).
- Archives: GDAL reads on where their checksums differ (``files``).
- Unreadable companions (.aux.xml) and masks (.msk), which GDAL ignores; a CRS (.prj) that was cut short.
- GTI: a lost tile is 0. Nothing lists the tiles that should exist, so it is refused.

In formats without checksums (raw samples, LZW…) an altered number cannot be detected.
"""

from __future__ import annotations

import os
import re
import threading
import xml.etree.ElementTree as ET
from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

from orograph.dem.whole import (
    blocks,
    cf,
    containers,
    dted,
    grib,
    header_text,
    hfa,
    ilwis,
    jp2,
    labels,
    mrf,
    netcdf,
    pcidsk,
    png,
    raw,
    sizes,
    text,
    tiff,
    usgs,
)
from orograph.dem.whole.files import (
    DAMAGED,
    archived,
    check_packed,
    files_listed,
    here,
    local_file,
    main_file,
    on_disk,
    stream,
)
from orograph.dem.whole.virtual import Part, Place, check_parts
from orograph.errors import ReadError

Window = tuple[int, int, int, int]
Lend = Callable[[str], AbstractContextManager[tuple[Any, object]]]
"""Opens GDAL's name: returns a dataset, and the file's name and state (``handles.lent``)."""

__all__ = ["DAMAGED", "check_blocks", "check_file", "check_mask", "fault_before"]


def _refuse_index(path: str) -> None:
    raise ReadError(
        "It is an index of tiles (GTI): a lost or changed tile would go unnoticed, and GDAL would read 0.",
        path=path, remedy="Name the tiles themselves, or make a VRT from them (gdalbuildvrt).",
    )  # fmt: skip


def _check_layout(dataset: Any, key: object) -> None:
    """Check once where the parts of a TIFF lie."""
    name = main_file(dataset)
    known = ("layout", key)
    if dataset.driver != "GTiff" or not here(name) or _seen(known):
        return
    with stream(name) as file:
        fault, turned = tiff.fault(dataset, file), tiff.turned_floats(file)
    if turned:
        raise ReadError(
            "Its floats are LERC-compressed in big-endian order, which GDAL decodes to other numbers.",
            path=dataset.name, remedy=tiff.TURNED,
        )  # fmt: skip
    if fault is not None:
        raise ReadError(fault, path=dataset.name, remedy=DAMAGED)
    _remember(known)


def _refuse_lost_notes(dataset: Any) -> None:
    """Refuse a raster whose .aux.xml (nodata, CRS…) is not XML, which GDAL ignores."""
    notes = Path(f"{main_file(dataset)}.aux.xml")
    if not notes.is_file():
        return
    try:
        ET.fromstring(notes.read_bytes())
    except ET.ParseError as error:
        raise ReadError(
            f"The metadata file beside the raster cannot be parsed ({error}).", path=notes,
            remedy="Restore it from a copy, or remove it if the raster needs none.",
        ) from None  # fmt: skip


def _refuse_cut_crs(dataset: Any) -> None:
    """Refuse a raster whose .prj was cut short: GDAL makes another CRS of the rest."""
    for name in files_listed(dataset):
        file = Path(name)
        if file.suffix.lower() != ".prj" or not file.is_file():
            continue
        text = re.sub(r'"[^"]*"', "", file.read_text("latin-1"))
        if re.match(r"\s*[A-Z_]+\s*[\[(]", text) and any(text.count(a) != text.count(b) for a, b in ("[]", "()")):
            raise ReadError("The CRS file beside the raster is truncated or damaged.", path=file, remedy=DAMAGED)


def _refuse_lost_mask(dataset: Any) -> None:
    """Refuse a raster whose mask file cannot be opened: GDAL would read missing samples as heights."""
    from rasterio.enums import MaskFlags

    mask = Path(f"{main_file(dataset)}.msk")
    used = any(MaskFlags.per_dataset in flags for flags in dataset.mask_flag_enums)
    if mask.is_file() and not used:
        raise ReadError("Its mask, which lies beside it, cannot be read.", path=mask, remedy=DAMAGED)


Check = Callable[[Any, str], str | None]


def _checks(*checks: Check) -> Check:
    """Run checks up to the first fault."""
    return lambda dataset, path: next((fault for check in checks if (fault := check(dataset, path))), None)


_CHECKS: dict[str, Check] = {
    "PNG": png.fault,
    "HFA": hfa.fault,
    "netCDF": _checks(netcdf.fault, containers.hdf5),
    "HDF5": containers.hdf5,
    "HDF5Image": containers.hdf5,
    "BAG": containers.hdf5,
    "GPKG": containers.database,
    "MBTiles": containers.database,
    "Rasterlite": containers.database,
    "JP2OpenJPEG": jp2.fault,
    "MRF": mrf.fault,
    "PCIDSK": pcidsk.fault,
    "PCRaster": sizes.pcraster,
    "ILWIS": ilwis.fault,
    "NITF": _checks(sizes.nitf, jp2.nitf),
    "BMP": sizes.bmp,
    "DTED": dted.fault,
    "SRTMHGT": dted.hgt,
    "GS7BG": sizes.surfer7,
    "NTv2": sizes.ntv2,
    "ENVI": _checks(header_text.check("ENVI"), sizes.envi),
    "EHdr": _checks(header_text.check("EHdr"), sizes.ehdr),
    "ERS": _checks(header_text.check("ERS"), sizes.ers),
    "SAGA": _checks(header_text.check("SAGA"), sizes.saga),
    "PAux": _checks(header_text.check("PAux"), sizes.paux),
    "MFF": _checks(header_text.check("MFF"), sizes.mff),
    "RST": _checks(header_text.check("RST"), sizes.behind(0)),
    "RRASTER": _checks(header_text.check("RRASTER"), sizes.beside(".gri", ".GRI")),
    "ISCE": sizes.behind(0),
    "BT": sizes.terrain,
    "SIGDEM": sizes.sigdem,
    "GSBG": sizes.behind(56),
    "GTX": sizes.behind(40),
    "KRO": sizes.behind(20),
    "CTable2": sizes.behind(160),
    "LAN": sizes.behind(128),
    "ELAS": sizes.elas,
    "Terragen": sizes.terragen,
    "FIT": raw.fit,
    "R": _checks(sizes.rdata, text.r_numbers),
    "BYN": sizes.behind(80),
    "Leveller": raw.leveller,
    "LCP": raw.landscape,
    "NGSGEOID": raw.geoid,
    "USGSDEM": usgs.fault,
    "EIR": _checks(header_text.check("EIR"), raw.eir),
    "GenBin": _checks(header_text.check("GenBin"), sizes.behind(0)),
    "ROI_PAC": _checks(header_text.check("ROI_PAC"), raw.roi_pac),
    "PNM": raw.pnm,
    "RMF": raw.rmf,
    "WEBP": raw.webp,
    "GIF": raw.gif,
    "BIGGIF": raw.gif,
    "XPM": raw.xpm,
    "PDS": raw.pds3,
    "ISIS2": raw.isis2,
    "ISG": text.isg,
    "ZMap": text.zmap,
    "Zarr": sizes.zarr,
    "GRIB": grib.fault,
    "ISIS3": labels.isis,
    "VICAR": labels.vicar,
    "PDS4": labels.pds4,
    "GXF": text.gxf,
    "AAIGrid": text.arc,
    "GRASSASCIIGrid": text.grass,
    "GSAG": text.surfer,
    "XYZ": text.points,
}
"""Format → a function from an open dataset and the path of its file on this disk to its fault, or None."""

_KNOWN = 1024
_DIRECTORIES = 8  # the mask comes before the overviews, or directly after the raster
_whole: OrderedDict[object, None] = OrderedDict()
_lock = threading.Lock()


def fault_before(location: str) -> str | None:
    """The known fault of a file that GDAL must not open; None if there is none."""
    path = on_disk(location)
    if archived(location) or not path.is_file():
        return None
    try:
        return netcdf.fault_before(str(path)) or jp2.fault_before(str(path))
    except OSError:
        return None  # GDAL says why it cannot be opened


def check_file(dataset: Any, location: str, key: object) -> None:
    """Raise ReadError if the file of an open dataset is not whole, in a way that its driver would not notice.

    Args:
        dataset: of rasterio, just opened.
        location: what GDAL opened, for the message.
        key: the file's name and state; an intact file is not checked again.
    """
    key = key, _beside(dataset)
    if _seen(key):
        return
    check_packed(dataset)
    cf.refuse_uneven(dataset)
    _refuse_lost_notes(dataset)
    _refuse_cut_crs(dataset)
    _refuse_lost_mask(dataset)
    if dataset.driver == "GTI":
        _refuse_index(location)
    elif dataset.driver == "GTiff" and archived(main_file(dataset)):
        blocks.check_archived(dataset)
    check = _CHECKS.get(dataset.driver)
    if check is not None:
        with local_file(dataset) as path:
            fault = None if path is None else check(dataset, path)
        if fault is not None:
            raise ReadError(fault, path=location, remedy=text.REMEDY if check in text.CHECKS else DAMAGED)
    _remember(key)


def _beside(dataset: Any) -> tuple[object, ...]:
    """The states of a raster's companion files, which may change while the main file does not."""
    name = str(dataset.name)
    if not Path(name).exists():
        return ()
    found: list[tuple[int, int] | None] = []
    for file in (*files_listed(dataset), f"{name}.aux.xml", f"{name}.msk"):
        try:
            state = os.stat(file)  # noqa: PTH116 (of mosaics thousands at a time)
        except (OSError, ValueError):
            found.append(None)
        else:
            found.append((state.st_mtime_ns, state.st_size))
    return tuple(found)


def _seen(key: object) -> bool:
    with _lock:
        return key in _whole


def _remember(key: object) -> None:
    with _lock:
        _whole[key] = None
        while len(_whole) > _KNOWN:
            _whole.popitem(last=False)


def check_blocks(dataset: Any, key: object, band: int, window: Window, step: int, lend: Lend) -> None:
    """Raise ReadError if the data of a window are damaged in a way that GDAL would not notice.

    Args:
        dataset: of rasterio, open.
        key: the file's name and state.
        band: of the samples, from 1.
        window: top, left, height, width; of which every ``step``-th row is wanted.
        lend: opens the files of which a VRT is made.
    """
    if dataset.driver == "VRT":
        check_parts(dataset, key, window, partial(_check_part, lend), partial(_place_of, lend))
    else:
        _check_layout(dataset, key)
        blocks.check_blocks(dataset, key, band, window, step)


def check_mask(dataset: Any, key: object, window: Window, lend: Lend) -> None:
    """Raise ReadError if a window of a GeoTIFF's or VRT's mask is damaged (arguments as for ``check_blocks``).

    GDAL writes masks with Deflate.
    """
    name = main_file(dataset)
    if dataset.driver not in ("GTiff", "VRT") or not here(name):
        return
    if dataset.driver == "VRT":
        check_parts(dataset, key, window, partial(_check_part, lend), partial(_place_of, lend), mask=True)
        return
    beside = next((file for file in dataset.files if str(file).endswith(".msk")), None)
    location = _inner_mask(name, dataset.shape, lend) if beside is None else str(beside)
    if location is not None:
        _check_window(lend, location, 1, window, False)


def _inner_mask(name: str, shape: tuple[int, int], lend: Lend) -> str | None:
    """GDAL's name of the mask inside a GeoTIFF: a directory after the first, with one byte or bit for each sample."""
    for number in range(2, _DIRECTORIES):
        location = f"GTIFF_DIR:{number}:{name}"
        try:
            with lend(location) as (directory, _):
                if (directory.shape, directory.count, directory.dtypes[0]) == (shape, 1, "uint8"):
                    return location
        except ReadError:
            return None
    return None


def _check_part(lend: Lend, part: Part, window: Window | None) -> None:
    """Check a window (None: all) of a part of a VRT."""
    wanted = part.shape or part.reach
    if wanted is not None:
        with lend(part.location) as (dataset, _):
            there = dataset.shape if part.shape else (min(dataset.height, wanted[0]), min(dataset.width, wanted[1]))
            if there != wanted:
                raise ReadError(
                    f"It has {dataset.height} × {dataset.width} samples, but the VRT that contains it declares "
                    f"{wanted[0]} × {wanted[1]}: the rest would be read as missing or 0.",
                    path=part.location, remedy="Make the VRT again (gdalbuildvrt), or restore the file from a copy.",
                )  # fmt: skip
    _check_window(lend, part.location, part.band, window, part.by_mask)


def _place_of(lend: Lend, part: Part) -> Place:
    """The place that a part's file declares."""
    with lend(part.location) as (dataset, _):
        return dataset.transform, dataset.crs


def _check_window(lend: Lend, location: str, band: int, window: Window | None, mask: bool) -> None:
    """Check a window (None: all) of a file that is a part of another, or of that file's mask."""
    with lend(location) as (dataset, key):
        top, left, height, width = window or (0, 0, dataset.height, dataset.width)
        bottom, right = min(top + height, dataset.height), min(left + width, dataset.width)
        top, left = max(top, 0), max(left, 0)
        if top < bottom and left < right:
            window = top, left, bottom - top, right - left
            if mask:
                check_mask(dataset, key, window, lend)
            else:
                check_blocks(dataset, key, min(band, dataset.count), window, 1, lend)
