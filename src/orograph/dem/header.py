"""A raster's header in one convention: the place of its samples, their unit, and their vertical datum.

- *North-west first.* South-up and east-first rasters are flipped as they are read, so that sample (0, 0) is the
  north-west one; a rotated or sheared geotransform is kept, but never mirrored. East and north are those of the ground,
  even if the CRS's coordinates increase westwards or southwards (``axes``).
- *Pixel-is-point.* GDAL already shifts such files (GeoTIFF's GTRasterTypeGeoKey, SRTM .hgt, DTED) by half a cell, so
  that the centre of its pixel is the sample: nothing is left to do, and tests verify it.
- *No place.* GDAL's identity geotransform means that the file has none (a PNG, a file with control points only): rows
  are then assumed to run south, ``spacing`` metres apart, and the CRS is unknown.
- *Horizontal CRS.* The vertical part of a compound or 3D CRS is split off: its name becomes ``vertical``, its unit
  that of the heights unless the band says otherwise.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from affine import Affine
from pyproj import CRS
from pyproj.exceptions import CRSError, ProjError

from orograph.dem.axes import east_north
from orograph.dem.bands import tags_of, unit_tag
from orograph.dem.prj import notes, unit_of_heights
from orograph.dem.units import METRES, metres_per
from orograph.dem.whole.cf import is_depth_of, transform_of
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose
from orograph.geo.vertical import ELLIPSOIDAL, KNOWN_DATUMS, known_datum


@dataclass(frozen=True, slots=True)
class Place:
    """A raster's place: its grid (north-west first) and how the file's rows and columns must be flipped for it."""

    grid: Grid
    flip_rows: bool
    flip_cols: bool
    georeferenced: bool


def place_of(
    dataset: Any, *, spacing: float | None, assume_crs: str | None, warnings: list[str]
) -> tuple[Place, CRS | None]:
    """The place of a dataset, and its full CRS (perhaps compound), None if unknown.

    Raises:
        ReadError: a degenerate geotransform.
        UsageError: ``spacing`` is not a positive number, or ``assume_crs`` is not a CRS.
    """
    shape = (dataset.height, dataset.width)
    full = full_crs(dataset, warnings)
    if spacing is not None and not (0 < spacing < float("inf")):
        raise UsageError(f"The spacing must be a positive number of metres, not {spacing:g}.")
    assumed = None if assume_crs is None else parsed_crs(assume_crs)
    transform = _transform_of(dataset)
    if full is None and (beside := notes(dataset)) is not None:
        warnings.append(f"The CRS file beside it cannot be understood ({beside.name}).")
    if transform.is_identity:
        return Place(_local(dataset, shape, spacing, full, assumed, warnings), False, False, False), None
    if spacing is not None:
        warnings.append("It is georeferenced, so `spacing` is not used for it.")
    if full is None:
        full = assumed
    elif assumed is not None and assumed != full:
        warnings.append("It has its own CRS, so `assume_crs` is not used for it.")
    _refuse_impossible(dataset, transform)
    try:
        place = oriented(shape, transform, full)
    except ValueError as error:
        raise ReadError(
            f"{str(error).capitalize()}.", path=dataset.name, remedy="Correct it with gdal_edit -a_ullr."
        ) from None
    if full is None:
        warnings.append(_nameless(place.grid))
    return place, full


_NORTH_FIRST = {
    "AAIGrid", "BT", "DTED", "EHdr", "GRASSASCIIGrid", "GS7BG", "GSAG", "GSBG", "GTX", "ILWIS", "ISG", "NTv2",
    "RRASTER", "RST", "SAGA", "SIGDEM", "SRTMHGT", "ZMap",
}  # fmt: skip
"""Formats whose rows run south and columns east by definition, so that anything else is a damaged header."""

_FAR = 1e13
"""Coordinates that no CRS of any body has, in any unit."""


def _transform_of(dataset: Any) -> Affine:
    """The geotransform of a dataset.

    For a PNM without a world file, GDAL returns uninitialised memory and ignores the .aux.xml beside it.
    """
    if dataset.driver == "netCDF":
        return transform_of(dataset)
    beside = [str(name) for name in dataset.files[1:]]
    if dataset.driver != "PNM" or any(not name.endswith(".aux.xml") for name in beside):
        return Affine(*dataset.transform[:6])
    text = ET.fromstring(Path(beside[0]).read_bytes()).findtext("GeoTransform") if beside else None
    try:
        return Affine.identity() if text is None else Affine.from_gdal(*map(float, text.split(",")))
    except (ValueError, TypeError):
        raise ReadError(
            "The GeoTransform beside the raster does not have six numbers.", path=beside[0],
            remedy="Restore it from a copy, or remove it if the raster needs none.",
        ) from None  # fmt: skip


def _refuse_impossible(dataset: Any, transform: Affine) -> None:
    """Raise ReadError if samples cannot lie as a header says."""
    a, b, c, d, e, f = transform[:6]
    reach = max(abs(c), abs(f)) + dataset.width * max(abs(a), abs(d)) + dataset.height * max(abs(b), abs(e))
    step = min(max(abs(a), abs(d)), max(abs(b), abs(e)))
    fault = None
    if not reach < _FAR:
        fault = "which is nowhere"
    elif step < reach * 2**-48 or step < 1e-14:
        fault = "where neighbours coincide"
    elif dataset.driver in _NORTH_FIRST and not (a > 0 > e):
        fault = "which this format does not allow: its extent is reversed"
    if fault is not None:
        raise ReadError(
            f"Its header places samples by ({', '.join(f'{v:.6g}' for v in (a, b, c, d, e, f))}), {fault}.",
            path=dataset.name, remedy="Correct it with gdal_edit -a_ullr, or restore it from a copy.",
        )  # fmt: skip


def oriented(shape: tuple[int, int], transform: Affine, crs: CRS | None) -> Place:
    """The place of samples from a geotransform; compound CRSs lose their vertical part.

    Raises:
        ValueError: the transform is degenerate.
    """
    a, b, c, d, e, f = transform[:6]
    turned = compose(_to_east_north(crs), transform)
    if turned.b == 0 and turned.d == 0:
        flip_rows, flip_cols = turned.e > 0, turned.a < 0
    else:
        flip_rows, flip_cols = turned.determinant > 0, False
    if flip_rows:
        b, c, e, f = 0.0 - b, c + b * shape[0], -e, f + e * shape[0]
    if flip_cols:
        a, c, d, f = -a, c + a * shape[1], 0.0 - d, f + d * shape[1]
    return Place(Grid(shape, Affine(a, b, c, d, e, f), horizontal(crs)), flip_rows, flip_cols, True)


def _to_east_north(crs: CRS | None) -> Affine:
    flat = horizontal(crs)
    return Affine.identity() if flat is None else east_north(flat)[1]


def _local(
    dataset: Any,
    shape: tuple[int, int],
    spacing: float | None,
    crs: CRS | None,
    assumed: CRS | None,
    warnings: list[str],
) -> Grid:
    """The grid of a raster without georeferencing: metres from its south-west corner."""
    if dataset.gcps[0]:
        points = len(dataset.gcps[0])
        why = f"It is placed by {points} ground control points only, which are not used (gdalwarp makes a map of it)"
    elif dataset.rpcs is not None:
        why = "It is placed by rational polynomials (RPC) only, which are not used (gdalwarp makes a map of it)"
    else:
        why = "It has no georeferencing"
    if spacing is None:
        warnings.append(f"{why}: its samples are assumed to be 1 m apart (give `spacing=METRES`).")
    if assumed is not None:
        warnings.append("Without georeferencing, `assume_crs` cannot be used for it.")
    if crs is not None:
        warnings.append(f"Its CRS ({crs.name}) is not used, since it has no position in it.")
    step = 1.0 if spacing is None else float(spacing)
    return Grid(shape, Affine(step, 0, 0, 0, -step, shape[0] * step), None)


def _nameless(grid: Grid) -> str:
    west, south, east, north = grid.bounds()
    if max(-west, east) <= 360.5 and max(-south, north) <= 90.5 and abs(grid.transform.determinant) < 1:
        return 'It has no CRS; its coordinates look like degrees (give `assume_crs="EPSG:4326"` if they are).'
    return "It has no CRS; its coordinates are assumed to be metres (give `assume_crs=CODE`)."


@lru_cache(maxsize=64)
def parsed_crs(text: Any) -> CRS:
    """A CRS as users give it: a code, WKT or PROJ text, or pyproj's or rasterio's object.

    Raises:
        UsageError: PROJ does not know it.
    """
    try:
        return CRS.from_user_input(text)
    except CRSError:
        raise UsageError(f"{text!r} is not a CRS known to PROJ (e.g. EPSG:32611, or a WKT or PROJ string).") from None


@lru_cache(maxsize=64)
def _from_wkt(wkt: str) -> CRS:
    return CRS.from_wkt(wkt)


def full_crs(dataset: Any, warnings: list[str]) -> CRS | None:
    """The CRS of a dataset, perhaps compound; None if it has no valid one, for which a warning is added."""
    from rasterio.errors import RasterioError

    if not dataset.crs:
        return None
    try:
        crs = _from_wkt(dataset.crs.to_wkt())
    except (CRSError, RasterioError) as error:
        warnings.append(f"Its CRS cannot be understood ({' '.join(str(error).split())[:200]}) and is not used.")
        return None
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def horizontal(crs: CRS | None) -> CRS | None:
    """The horizontal part of a compound or 3D CRS; any other unchanged."""
    if crs is None:
        return None
    if crs.is_compound and crs.sub_crs_list:
        return horizontal(crs.sub_crs_list[0])
    if len(crs.axis_info) == 3 and (crs.is_geographic or crs.is_projected):
        flat = crs.to_2d()
        code = flat.to_epsg()  # to_2d() loses the code: EPSG:4979 would become a nameless twin of EPSG:4326
        return CRS.from_epsg(code) if code is not None else flat
    return crs


def crs_datum(crs: CRS | None) -> str | None:
    """The name of the vertical datum of a CRS; None if it has none."""
    if crs is not None and crs.is_compound and len(crs.sub_crs_list) > 1:
        # "NAVD88 height (ftUS)" becomes NAVD88 height once it is in metres
        name = re.sub(r" \((ft|ftUS|m|cm)\)$", "", str(crs.sub_crs_list[1].name))
        return re.sub(r" depth$", " height", name)  # which it becomes once its sign is changed (unit_of)
    if crs is not None and len(crs.axis_info) == 3 and (crs.is_geographic or crs.is_projected):
        return ELLIPSOIDAL
    return None


def vertical_of(dataset: Any, crs: CRS | None) -> str | None:
    """The name of the vertical datum that the file declares, or its format prescribes; None if unknown."""
    datum = crs_datum(crs)
    if datum is not None:
        return datum
    if dataset.driver == "SRTMHGT":
        return "EGM96 height"  # SRTM product specification: heights above the EGM96 geoid
    if dataset.driver == "DTED":  # MIL-PRF-89020B, DSI record: MSL (mean sea level) or E96 (EGM96)
        return {"MSL": "mean sea level", "E96": "EGM96 height"}.get(tags_of(dataset).get("DTED_VerticalDatum", ""))
    return tags_of(dataset).get("VERTICAL_DATUM") or None  # fetched files declare it this way if a CRS cannot


def attribution_of(dataset: Any) -> tuple[str, ...]:
    """The credit that the makers of a file ask for, in its tag ATTRIBUTION."""
    text = (tags_of(dataset).get("ATTRIBUTION") or "").strip()
    return (text,) if text else ()


def assumed_vertical(text: str) -> str:
    """The name of a vertical datum given by a user: a known geoid, the ellipsoid, or a vertical CRS known to PROJ.

    Raises:
        UsageError: there is no such datum.
    """
    name = known_datum(text.strip())
    if name in KNOWN_DATUMS:
        return name
    try:
        crs = CRS.from_user_input(text)
        if crs.is_vertical and not crs.is_compound:
            return str(crs.name)
    except CRSError:
        pass
    raise UsageError(
        f"{text!r} is not a known vertical datum.",
        remedy="Give EGM96, EGM2008, ellipsoidal, or a vertical CRS such as EPSG:5703 (NAVD88 height).",
    )


def unit_of(dataset: Any, band: int, crs: CRS | None, unit: str | None, warnings: list[str]) -> float:
    """Metres per unit of the (scaled) values; negative for depths, unless a unit is requested.

    In this order: the requested unit, the band's unit tag, the .prj beside it, the vertical axis of the CRS.

    Raises:
        UsageError: the requested unit is unknown.
    """
    if unit is not None:
        factor = metres_per(unit)
        if factor is None:
            known = ", ".join(sorted({min((n for n, f in METRES.items() if f == v), key=len) for v in METRES.values()}))
            raise UsageError(f"{unit!r} is not a known unit of length (known: {known} and their full names).")
        return factor
    axis = vertical_axis(crs)
    by_crs = float(axis.unit_conversion_factor) if axis is not None and axis.unit_conversion_factor > 0 else None
    sign = 1.0
    if (axis is not None and axis.direction == "down" and dataset.driver != "BAG") or is_depth_of(dataset, band):
        sign = -1.0  # (BAG's elevations grow upwards whatever its CRS says: Format Specification, section 4)
        warnings.append(
            "Its numbers are depths and become heights below 0 (give `vertical_unit` if they are not depths)."
        )
    tag = unit_tag(dataset, band) or unit_of_heights(dataset)
    tagged = metres_per(tag) if tag else None
    if tag and tagged is None:
        warnings.append(f"The unit of its values is {tag!r}, which is not a length: are these heights?")
    if tagged is not None and by_crs is not None and abs(tagged - by_crs) > 1e-6:
        warnings.append(
            f"It says that heights are in {tag}, but its CRS has another unit ({by_crs:.9g} m): {tag} is used."
        )
    return sign * (tagged or by_crs or 1.0)


def vertical_axis(crs: CRS | None) -> Any:
    """The axis of a CRS along which heights or depths increase; None if it has none."""
    try:
        return next((a for a in (crs.axis_info if crs is not None else ()) if a.direction in ("up", "down")), None)
    except ProjError:
        return None


def settled_vertical(declared: str | None, assumed: str | None, warnings: list[str]) -> str | None:
    if assumed is None:
        return declared
    name = assumed_vertical(assumed)
    if declared is None:
        return name
    if known_datum(declared) != name:
        warnings.append(f"It has its own vertical datum ({declared}), so `assume_vertical` is not used for it.")
    return declared


def plain_copyright(attribution: tuple[str, ...]) -> str:
    """The credit for the copyright tags of TIFF and EXIF, which are ASCII."""
    return "; ".join(attribution).replace("©", "(c)")


def copyright_tags(attribution: tuple[str, ...]) -> dict[str, str]:
    """The tags of a GeoTIFF for the credit."""
    if not attribution:
        return {}
    return {"ATTRIBUTION": "; ".join(attribution), "TIFFTAG_COPYRIGHT": plain_copyright(attribution)}
