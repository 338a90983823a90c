"""How objects show themselves: one line in terminals, a card with a small picture in notebooks.

The small picture is a shaded relief (Horn 1981) of a few hundred samples, lit from the north-west. It helps to
recognise a terrain and needs none of the rendering code.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from orograph.geo.grid import Grid

SIDE = 240
"""Maximum pixels on the longer side of a small picture."""

Row = tuple[str, str]
"""A label and its text."""


def extent_rows(grid: Grid) -> list[Row]:
    """Size, spacing and CRS of a grid."""
    rows, cols = grid.shape
    unit = "m" if grid.crs is None else grid.crs.axis_info[0].unit_name if grid.crs.axis_info else "units"
    unit = {"metre": "m", "degree": "°"}.get(unit, unit)
    across, down = (f"{v:.6g}" for v in grid.spacing)
    gap = "" if unit == "°" else " "
    apart = f"{across}{gap}{unit}" if across == down else f"{across} × {down}{gap}{unit}"
    return [("samples", f"{rows:,} × {cols:,}"), ("spacing", apart), ("CRS", grid.crs_name)]


def heights_row(low: float, high: float, vertical: str | None) -> Row:
    """The range of heights, and their vertical datum."""
    if math.isnan(low):
        return "heights", "none"
    return "heights", f"{low:.6g} to {high:.6g} m" + (f" ({vertical})" if vertical else "")


def amount(size: float) -> str:
    """An amount of bytes as text."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} bytes"


def one_line(kind: str, name: str, rows: Sequence[Row]) -> str:
    """All of it as one line: ``<Dem 'hill': 643 × 1,197 samples, …>``."""
    said = [f"{text} samples" if label == "samples" else f"{text} apart" if label == "spacing" else text
            for label, text in rows]  # fmt: skip
    return f"<{kind} {name!r}: {', '.join(said)}>"


def card(kind: str, name: str, rows: Sequence[Row], picture: bytes | None = None) -> str:
    """A card of HTML: a title, rows of names and values, a PNG beside them."""
    import html

    cells = "".join(
        f'<tr><th style="text-align:left;font-weight:normal;opacity:.6;padding:0 1em 0 0">{html.escape(label)}</th>'
        f'<td style="text-align:left">{html.escape(text)}</td></tr>'
        for label, text in rows
    )
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode()
        image = f'<img alt="" style="margin-right:1em" src="data:image/png;base64,{data}">'
    title = f"<b>{html.escape(name)}</b> <span style='opacity:.6'>{html.escape(kind)}</span>"
    return f'<div style="display:flex;align-items:flex-start">{image}<div>{title}<table>{cells}</table></div></div>'


def table(rows: Sequence[Sequence[str]]) -> str:
    """A table of HTML; the first row is its head, the first column is aligned left."""
    import html

    def row(cells: Sequence[str], tag: str) -> str:
        sides = ["left", *["right"] * (len(cells) - 1)]
        return "".join(
            f'<{tag} style="text-align:{side}">{html.escape(cell)}</{tag}>' for cell, side in zip(cells, sides)
        )

    body = "".join(f"<tr>{row(cells, 'td')}</tr>" for cells in rows[1:])
    return f"<table><thead><tr>{row(rows[0], 'th')}</tr></thead><tbody>{body}</tbody></table>"


def relief(values: NDArray[np.float32], grid: Grid, step: float = 1.0) -> bytes:
    """A small shaded relief as a PNG.

    Args:
        values: (rows, cols) heights, NaN where missing.
        grid: of the raster at full resolution. step: samples of the raster from one value to the next.
    """
    thin = max(1, -(-max(values.shape) // SIDE))
    z = values[::thin, ::thin].astype(np.float64)
    if min(z.shape) < 2 or not np.isfinite(z).any():
        return png(np.full((*z.shape, 3), 255, np.uint8))
    metres = 1.0
    if grid.crs is not None and grid.crs.is_geographic:
        metres = 111_320.0
    dx, dy = (v * step * thin * metres for v in grid.spacing)
    down, across = np.gradient(z)
    # Gentle land is stretched so that its shape shows: the mean slope becomes at least 20°.
    rise, fall = across / dx, down / dy
    mean = float(np.nanmean(np.hypot(rise, fall))) or 1.0
    factor = max(1.0, 0.36 / mean)
    east, south = factor * rise, factor * fall
    light = (east + south + math.sqrt(2)) / 2 / np.sqrt(1 + east**2 + south**2)  # from the north-west, 45° high
    grey = np.clip(90 + 165 * np.nan_to_num(light), 0, 255).astype(np.uint8)
    grey[~np.isfinite(light)] = 255
    return png(np.repeat(grey[..., None], 3, 2))


def png(pixels: NDArray[Any]) -> bytes:
    """Pixels (height, width, 3 or 4) uint8 as the bytes of a PNG."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels).save(out, format="PNG")
    return out.getvalue()
