"""Report what a GeoTIFF declares wrongly, twice, or in a way that GDAL ignores, when it is opened.

GDAL silently takes the first tie point, a pixel scale before a matrix, the unit of the vertical CRS before
``VerticalUnits``, and the first of several images; it ignores a nodata value that its type cannot hold.

Sources: TIFF 6.0, section 2 and Orientation; GeoTIFF 1.1 (OGC 19-008r4), sections 7 and 8.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.missing import check_text, impossible_nodata, nodata_of
from orograph.dem.whole.files import here, stream
from orograph.dem.whole.tiff import TiffFile, first_directory
from orograph.dem.whole.tiff_tags import COUNTS, Directory
from orograph.errors import ReadError

_SCALE, _TIES, _MATRIX, _KEYS, _NODATA = 33550, 33922, 34264, 34735, 42113
_VERTICAL_UNITS = 4099
_UNITS = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9036: 1000.0}  # EPSG → metres
_REDUCED, _MASK = 1, 4  # as bits of tag 254
_APART = 0.75  # samples
_MOST_IMAGES = 64


def diagnose(dataset: Any, band: int, asked: float | str | None, masked: bool, unit: float | None) -> list[str]:
    """Warnings about the declarations of a GeoTIFF on this disk; none for other formats.

    Args:
        dataset: of rasterio, open.
        band: of the heights, from 1.
        asked: the nodata value that a user states; None: none.
        masked: whether a mask or an alpha band says what is missing.
        unit: metres in the unit of the vertical CRS; None: there is none.

    Raises:
        ReadError: its nodata value is not a number, a key of its CRS occurs twice, or it has a pixel scale but no
            place.
    """
    name = str(dataset.name)
    if dataset.driver != "GTiff" or not here(name):  # (a name that selects a directory of a file is not checked)
        return []
    found: list[str] = []
    with stream(name) as file:
        begun = first_directory(file)
        if begun is None:
            return []
        tiff, first = begun
        keys = _keys(tiff, first, name)
        found += _diagnose_place(dataset, tiff, first, name)
        text = tiff.text(first, _NODATA)
        if asked is None and dataset.nodatavals[band - 1] is not None:
            check_text(dataset, text)
        if asked is None and text:
            found += impossible_nodata(dataset, band, text)
        if asked is None and not masked and nodata_of(dataset, band, None, dataset.dtypes[band - 1]) is None:
            found += _diagnose_blocks(tiff, first)
        found += _diagnose_images(tiff, first, name)
    declared = _UNITS.get(keys.get(_VERTICAL_UNITS, 0))
    if declared is not None and unit is not None and abs(declared - unit) > 1e-9:
        found.append(
            f"Its tags give heights in a unit of {declared:.9g} m (VerticalUnits), but its vertical CRS in one of "
            f"{unit:.9g} m, which is used (give `vertical_unit` if the former is right)."
        )
    return found


def _keys(tiff: TiffFile, first: Directory, name: str) -> dict[int, int]:
    """The GeoKeys that are numbers of their own.

    Raises:
        ReadError: one occurs twice with different values.
    """
    words = tiff.numbers(first, _KEYS)
    keys: dict[int, tuple[int, int, int]] = {}
    for key, place, count, value in words[4 : 4 + 4 * int(words[3])].reshape(-1, 4).tolist() if words.size > 4 else ():
        entry = (place, count, value)
        if keys.setdefault(key, entry) != entry:
            raise ReadError(
                f"A key of its CRS occurs twice ({key}: {keys[key][2]} and {value}).", path=name,
                remedy="Rewrite it with the right CRS (gdal_translate -a_srs EPSG:CODE).",
            )  # fmt: skip
    return {key: value for key, (place, _, value) in keys.items() if place == 0}


def _diagnose_place(dataset: Any, tiff: TiffFile, first: Directory, name: str) -> Iterator[str]:
    """Compare the place in its tags with the place that GDAL derives from them."""
    scale, ties, matrix = (tiff.doubles(first, tag) for tag in (_SCALE, _TIES, _MATRIX))
    turned = tiff.numbers(first, 274)
    if turned.size and turned[0] != 1:
        yield (
            f"Its tag Orientation says that it is rotated or mirrored ({turned[0]}), but its georeferencing does not: "
            "rows are taken as stored."
        )
    if scale.size < 2 or not scale[:2].all():
        return
    to_place = dataset.transform
    if not ties.size and not matrix.size and (to_place.a, to_place.c, to_place.f) == (abs(scale[0]), 0, 0):
        raise ReadError(
            "It declares the size of its samples but not their place (a pixel scale without a tie point).", path=name,
            remedy="Give its place: gdal_edit -a_ullr WEST NORTH EAST SOUTH.",
        )  # fmt: skip
    if scale[1] < 0:
        yield (
            "Its pixel scale is negative in y, so its rows would run north: like GDAL, this takes them to run south "
            "(if they do not, flip it with gdal_translate -a_ullr)."
        )
    step = min(abs(scale[0]), abs(scale[1]))
    points = ties.reshape(-1, 6) if ties.size % 6 == 0 else np.zeros((0, 6))
    off = (points[:, 3] - scale[0] * points[:, 0]) - (points[0, 3] - scale[0] * points[0, 0]) if len(points) else ties
    down = (points[:, 4] + abs(scale[1]) * points[:, 1]) if len(points) else ties
    if len(points) > 1 and max(np.abs(off).max(), np.ptp(down)) > _APART * step:
        yield (
            f"Its {len(points)} tie points contradict its pixel scale: only the first one places it (correct it with "
            "gdal_edit -a_ullr)."
        )
    if matrix.size == 16:
        there = np.array([matrix[3] - to_place.c, matrix[7] - to_place.f, *_far(matrix, dataset)])
        if np.abs(there).max() > _APART * step:
            yield "It gives two different places: its pixel scale is used, its matrix is not."


def _far(matrix: NDArray[np.float64], dataset: Any) -> tuple[float, float]:
    """How far the last corner by the matrix lies from where GDAL puts it."""
    cols, rows = dataset.width, dataset.height
    a, b, c, d, e, f = dataset.transform[:6]
    return (
        float((matrix[0] - a) * cols + (matrix[1] - b) * rows + matrix[3] - c),
        float((matrix[4] - d) * cols + (matrix[5] - e) * rows + matrix[7] - f),
    )


def _diagnose_blocks(tiff: TiffFile, first: Directory) -> Iterator[str]:
    """Unwritten blocks, if nothing says that they are missing."""
    for tag in COUNTS:
        sizes = tiff.numbers(first, tag)
        lacking = int(sizes.size - np.count_nonzero(sizes))
        if lacking:
            yield (
                f"{lacking:,} of its {sizes.size:,} blocks are not written, and it declares no nodata value: they are "
                "read as heights of 0 (`nodata=0` if they are missing)."
            )


def _diagnose_images(tiff: TiffFile, first: Directory, name: str) -> Iterator[str]:
    """Other images that are neither overviews nor masks of the first, which is the one that is read."""
    directory, number = first, 1
    shape = _shape(tiff, first)
    while directory.following and number < _MOST_IMAGES:
        try:
            directory = tiff.directory(directory.following)
        except (struct.error, ValueError):
            return
        number += 1
        kind, old = tiff.numbers(directory, 254), tiff.numbers(directory, 255)
        rows, cols = _shape(tiff, directory)
        if (kind.size and kind[0] & (_REDUCED | _MASK)) or 2 in old or rows * cols < shape[0] * shape[1]:
            continue
        yield (
            f"It holds several images, of which the first, with {shape[0]} × {shape[1]} samples, is read; number "
            f"{number} has {rows} × {cols} (open it as GTIFF_DIR:{number}:{name})."
        )
        return


def _shape(tiff: TiffFile, directory: Directory) -> tuple[int, int]:
    rows, cols = (tiff.numbers(directory, tag) for tag in (257, 256))
    return (int(rows[0]), int(cols[0])) if rows.size and cols.size else (0, 0)
