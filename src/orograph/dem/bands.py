"""Check the bands of an open dataset: can this one be read, and does it look like heights?"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from orograph.dem.encode import ENCODINGS
from orograph.errors import ReadError, UsageError

MAX_BLOCK_BYTES = 256 << 20
"""A file stored in larger blocks than this cannot be read by windows in bounded memory, and is refused."""


def check_size(dataset: Any, path: str | os.PathLike[str]) -> None:
    from rasterio.enums import Interleaving

    rows, cols = dataset.block_shapes[0]
    try:
        together = dataset.count if dataset.interleaving == Interleaving.pixel else 1
    except ValueError as error:
        raise ReadError(
            f"Its header is invalid ({error}).", path=path, remedy="Repair it, or restore it from a copy."
        ) from None
    size = rows * cols * together * _itemsize(dataset.dtypes[0])
    if size > MAX_BLOCK_BYTES:
        raise ReadError(
            f"It is stored in blocks of {rows} × {cols} samples × {together} bands, {size / 2**20:,.0f} MiB each, "
            f"which cannot be read in bounded memory (the limit is {MAX_BLOCK_BYTES / 2**20:.0f} MiB).",
            path=path,
            remedy="If the file is sound, rewrite it in tiles (gdal_translate -co TILED=YES).",
        )


def _itemsize(dtype: str) -> int:
    return 4 if dtype == "complex_int16" else np.dtype(dtype).itemsize


def check_band(dataset: Any, band: Any, path: str | os.PathLike[str]) -> None:
    if isinstance(band, str) and band in dataset.descriptions:
        number = dataset.descriptions.index(band) + 1
        raise UsageError(
            f"A band is given by its number: {band} is {number}.", path=path, remedy=f"Give `band={number}`."
        )
    if not isinstance(band, int):
        raise UsageError(f"A band is given by its number, from 1, not {band!r}.", path=path)
    if not 1 <= band <= dataset.count:
        raise UsageError(
            f"There is no band {band}: {_list_bands(dataset)}.", path=path, remedy="Choose another with `band`."
        )
    dtype = dataset.dtypes[band - 1]
    if dtype.startswith("complex"):
        raise ReadError(
            f"Its numbers are complex ({dtype}), which cannot be heights.",
            path=path,
            remedy="Take one part of them first.",
        )


def check_scale(dataset: Any, band: int) -> None:
    """Raise ReadError if its scale makes all numbers the same height, or none."""
    scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    if scale == 0 or not np.isfinite([scale, offset]).all():
        raise ReadError(
            f"Its heights would be number · {scale:g} + {offset:g}, which makes them all alike.", path=dataset.name,
            remedy="Correct its scale and offset (gdal_edit -scale 1 -offset 0).",
        )  # fmt: skip


def check_encoding(dataset: Any, encoding: str, path: str | os.PathLike[str]) -> None:
    if encoding not in ENCODINGS:
        raise UsageError(f"{encoding!r} is not a known encoding ({', '.join(ENCODINGS)}).", path=path)
    if dataset.count not in (3, 4) or set(dataset.dtypes) != {"uint8"}:
        raise UsageError(
            f"Encoding {encoding} needs three bands of 8 bits (and perhaps alpha), but {_list_bands(dataset)} of "
            f"{dataset.dtypes[0]}.",
            path=path,
            remedy="Leave out `encoding`.",
        )


def _list_bands(dataset: Any) -> str:
    if dataset.count == 1:
        return "it has one band"
    names = [f"{i}: {d}" for i, d in enumerate(_descriptions(dataset)[:12], 1) if d]
    return f"it has {dataset.count} bands" + (f" ({', '.join(names)})" if names else "")


def is_picture(dataset: Any) -> bool:
    return bool(dataset.count in (3, 4) and set(dataset.dtypes) == {"uint8"})


def is_palette(dataset: Any, band: int) -> bool:
    from rasterio.enums import ColorInterp

    if dataset.count >= 100 or dataset.colorinterp[band - 1] != ColorInterp.palette:
        return False
    try:
        table = dataset.colormap(band)
    except ValueError:
        return False
    return any(color[:3] != (i, i, i) for i, color in table.items())  # a table of plain greys changes nothing


def description_of(dataset: Any, band: int) -> str:
    """The band's name: GDAL's description, else a netCDF variable's name."""
    tags = tags_of(dataset, band)
    return str(_descriptions(dataset)[band - 1] or tags.get("long_name") or tags.get("standard_name") or "").strip()


def _descriptions(dataset: Any) -> Sequence[str | None]:
    """The names of its bands; none if they are in an unknown encoding."""
    try:
        return tuple(dataset.descriptions)
    except UnicodeDecodeError:
        return (None,) * int(dataset.count)


def tags_of(dataset: Any, band: int = 0) -> dict[str, str]:
    """The tags of a dataset (0) or a band; none if they are in an unknown encoding."""
    try:
        return dict(dataset.tags(band))
    except UnicodeDecodeError:
        return {}


def unit_tag(dataset: Any, band: int) -> str:
    """What the file calls the unit of a band's numbers, "" if it does not say.

    Raises:
        ReadError: it is not text.
    """
    try:
        return (dataset.units[band - 1] or "").strip()
    except UnicodeDecodeError:
        raise ReadError(
            "The unit of its values is not text.", path=dataset.name,
            remedy="Repair its header, or restore it from a copy.",
        ) from None  # fmt: skip


_ELEVATION = ("elev", "height", "altitude", "dem", "dtm", "dsm", "topo", "orog", "relief", "bathy", "hgt", "dhm", "dgm")


def band_warnings(dataset: Any, band: int) -> list[str]:
    from rasterio.enums import ColorInterp

    if dataset.count == 2 and dataset.colorinterp[1] == ColorInterp.alpha and band == 1:
        return []
    names = [d or "" for d in _descriptions(dataset)[:1000]]
    likely = [i for i, n in enumerate(names, 1) if any(word in n.lower() for word in _ELEVATION)]
    if band in likely:
        return []
    text = (
        f"Band {band}"
        + (f" ({names[band - 1]!r})" if names[band - 1 : band] != [""] else "")
        + f" of {dataset.count} is read"
    )
    if likely:
        name = names[likely[0] - 1]
        return [f"{text}, but band {likely[0]} ({name!r}) sounds like the heights (give `band={likely[0]}`)."]
    return [f"{text} (choose with `band`)."]
