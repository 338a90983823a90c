"""Which samples of which tiles an area needs, and their common grid: index arithmetic, no network.

All samples of a product lie on one lattice around the globe, cut into tiles; one tile owns each sample, so rows and
columns at the seams appear once. A tile of degrees whose south-west corner is (L, W) owns the samples of latitudes in
(L, L + side] and longitudes in [W, W + side), as the COGs of the Copernicus DEM are cut; tiles that share their borders
(SRTM) have one row and one column more. An area gets the samples that surround it: one beyond its bounds, unless a
sample lies on the bound (for products whose cells lie on whole degrees: the border of a cell).

Towards the poles, the columns of some products lie farther apart. The grid has the columns of the tiles nearest to the
equator; rows of other tiles, whose latitudes are the same, are interpolated along the row. Units: samples; degrees or
metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from affine import Affine
from pyproj import CRS, Transformer

from orograph.errors import UsageError
from orograph.fetching.areas import Box
from orograph.fetching.products import Product
from orograph.geo.grid import Grid

EPS = 1e-6  # of a sample: bounds that lie on a sample up to rounding
MERCATOR = 20037508.342789244  # half of the circumference of EPSG:3857, metres
MOST_LATITUDE = 85.0511287798066  # of EPSG:3857's square

Shape = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Tile:
    """One of a product's tiles.

    Attributes:
        row, col: from the north-west one. zoom: of web-mercator tiles. key: its name, for people and files.
        url: where it lies. location: what GDAL opens. grid: the samples that it owns; None: its file defines them.
        covered: whether the product claims to cover this place.
    """

    row: int
    col: int
    key: str
    url: str
    location: str
    grid: Grid | None
    zoom: int = 0
    covered: bool = True


@dataclass(frozen=True, slots=True)
class Piece:
    """Samples of one tile: [row0, row1) × [col0, col1) in the tile, whose first one is (row, col) of its band."""

    tile: Tile
    row0: int
    row1: int
    col0: int
    col1: int
    row: int
    col: int


@dataclass(frozen=True, slots=True)
class Band:
    """Rows of an area with one spacing of columns.

    Attributes:
        row0, row1: of the area. cols: of the band's own samples. pieces: that fill it.
        start, step: column of the band at which the area's first column lies, and from one to the next; (0, 1) where
            they are the same.
    """

    row0: int
    row1: int
    cols: int
    pieces: tuple[Piece, ...]
    start: float = 0.0
    step: float = 1.0

    @property
    def resampled(self) -> bool:
        return (self.start, self.step) != (0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Layout:
    """An area's grid and its bands of tiles."""

    grid: Grid
    bands: tuple[Band, ...]

    @property
    def tiles(self) -> list[Tile]:
        """All tiles, each once."""
        return list({piece.tile.key: piece.tile for band in self.bands for piece in band.pieces}.values())


def lay_out(product: Product, box: Box, zoom: int | None = None, header: Grid | None = None) -> Layout:
    """The grid and the tiles of an area.

    Args:
        zoom: of web-mercator tiles, if not the product's usual one.
        header: of a product of one file, its grid.

    Raises:
        UsageError: the product covers no part of it, or has no such zoom.
    """
    _, south, _, north = product.extent
    if box.north <= south or box.south >= north:
        raise UsageError(
            f"{product.title} covers latitudes {south:g} to {north:g}, but the area has {box.south:g} to "
            f"{box.north:g}.",
            remedy="Choose another product (`orograph.fetching.products()`).",
        )
    if product.tiling == "degrees":
        return _degrees(product, box)
    if product.tiling == "web-mercator":
        return _mercator(product, box, product.zoom if zoom is None else zoom)
    assert header is not None
    return _one(product, box, header)


def one_tile(product: Product) -> Tile:
    """The only tile of a product of one file."""
    return _tile(product, 0, 0, "global", None, {})


def _degrees(product: Product, box: Box) -> Layout:
    per_degree = round(3600 / product.spacing)
    point, tall = product.registration == "point", per_degree * product.side
    last = 180 * per_degree - (0 if point and product.shared else 1)
    row0, row1 = _covering((90 - box.north) * per_degree, (90 - box.south) * per_degree, point)
    row0, row1 = max(row0, 0), min(row1, last + 1)
    strips = list(_cut(row0, row1, tall, product.shared))
    factors = [product.width(90 - product.side * (t + 1), 90 - product.side * t) for t, _, _ in strips]
    finest = min(factors)
    columns = round(per_degree / finest)
    col0, col1 = _covering((box.west + 180) * columns, (box.east + 180) * columns, point)
    col1 = min(col1, col0 + 360 * columns)  # the whole globe includes each meridian once
    half = 0.5 if point else 0.0
    transform = Affine(
        1 / columns, 0, (col0 - half) / columns - 180, 0, -1 / per_degree, 90 - (row0 - half) / per_degree
    )
    grid = Grid((row1 - row0, col1 - col0), transform, CRS.from_user_input(product.crs))
    bands, row = [], 0
    for (t, a, b), factor in zip(strips, factors):
        here = round(per_degree / factor)
        start, step, first, end = 0.0, 1.0, col0, col1
        if here != columns:
            step = here / columns
            shift = 0.0 if point else 0.5
            positions = [(c + shift) * step - shift for c in (col0, col1 - 1)]
            first, end = math.floor(positions[0] + EPS), math.ceil(positions[1] - EPS) + 1
            start = positions[0] - first
        pieces = [
            Piece(_degree_tile(product, t, c, (tall, here * product.side), per_degree, here), a, b, lo, hi, 0, at)
            for c, lo, hi, at in _along(first, end, here * product.side, product.shared)
        ]
        bands.append(Band(row, row + b - a, end - first, tuple(pieces), start, step))
        row += b - a
    return Layout(grid, tuple(bands))


def _degree_tile(product: Product, t: int, c: int, shape: Shape, rows: int, cols: int) -> Tile:
    around = 360 // product.side
    south, west = 90 - product.side * (t + 1), product.side * (c % around) - 180
    lat, lon = (south if product.corner == "sw" else south + product.side), west
    half = 0.5 if product.registration == "point" else 0.0
    transform = Affine(1 / cols, 0, west - half / cols, 0, -1 / rows, south + product.side + half / rows)
    folder = next((name for least, name in sorted(product.folders, reverse=True) if south >= least), "")
    names: dict[str, object] = {
        "NS": "N" if lat >= 0 else "S", "EW": "E" if lon >= 0 else "W", "lat": abs(lat), "lon": abs(lon),
        "ns": "n" if lat >= 0 else "s", "ew": "e" if lon >= 0 else "w", "folder": folder,
    }  # fmt: skip
    key = f"{names['NS']}{abs(lat):02d}{names['EW']}{abs(lon):03d}"
    least, lowest, most, highest = product.extent
    covered = south + product.side > lowest and south < highest and west + product.side > least and west < most
    return _tile(product, t, c % around, key, Grid(shape, transform, CRS.from_user_input(product.crs)), names, covered)


def _mercator(product: Product, box: Box, zoom: int) -> Layout:
    if not 0 <= zoom <= product.most_zoom:
        raise UsageError(f"{product.name} has zooms 0 to {product.most_zoom}, not {zoom}.")
    if box.north > MOST_LATITUDE or box.south < -MOST_LATITUDE:
        raise UsageError(
            f"{product.title} reaches to 85.05° north and south.", remedy="Choose another product, or a smaller area."
        )
    side = 256 << zoom
    there = Transformer.from_crs(4326, 3857, always_xy=True)
    (_, top), (_, bottom) = there.transform(0, box.north), there.transform(0, box.south)
    per_metre, per_degree = side / (2 * MERCATOR), side / 360
    row0, row1 = _covering((MERCATOR - top) * per_metre, (MERCATOR - bottom) * per_metre, False)
    col0, col1 = _covering((box.west + 180) * per_degree, (box.east + 180) * per_degree, False)
    row0, row1, col1 = max(row0, 0), min(row1, side), min(col1, col0 + side)
    size = 2 * MERCATOR / side
    crs = CRS.from_epsg(3857)
    grid = Grid(
        (row1 - row0, col1 - col0), Affine(size, 0, col0 * size - MERCATOR, 0, -size, MERCATOR - row0 * size), crs
    )
    bands = []
    for y, a, b, row in _along(row0, row1, 256, False):
        pieces = []
        for column, lo, hi, at in _along(col0, col1, 256, False):
            x = column % (1 << zoom)
            tile = _tile(product, y, x, f"{zoom}-{x}-{y}", None, {"z": zoom, "x": x, "y": y}, zoom=zoom)
            pieces.append(Piece(tile, a, b, lo, hi, 0, at))
        bands.append(Band(row, row + b - a, col1 - col0, tuple(pieces)))
    return Layout(grid, tuple(bands))


def _one(product: Product, box: Box, whole: Grid) -> Layout:
    """A window of one file, in a geographic CRS or a cylindrical projection along whose rows longitudes grow evenly."""
    assert whole.crs is not None
    base = whole.crs if whole.crs.is_geographic else whole.crs.geodetic_crs
    there = Transformer.from_crs(base, whole.crs, always_xy=True)
    middle = (box.south + box.north) / 2
    col, row = whole.index(*there.transform([0.0, 1.0, 0.0, 0.0], [middle, middle, box.north, box.south]))
    per_degree = float(col[1] - col[0])
    if not (per_degree > 0 and whole.transform.b == 0 and whole.transform.d == 0):
        raise UsageError(f"{product.title} is not cylindrical, so a box cannot be cut from it.")
    around = round(360 * per_degree)
    full = abs(360 * per_degree - around) < 0.01 and whole.cols >= around
    # Rows and columns of cells that the box meets: sample i covers i − ½ to i + ½.
    row0, row1 = _covering(float(row[2]) + 0.5, float(row[3]) + 0.5, False)
    left, right = (float(col[0]) + per_degree * lon + 0.5 for lon in (box.west, box.east))
    turn = math.floor(left / around) * around if full else 0
    col0, col1 = _covering(left - turn, right - turn, False)
    row0, row1 = max(row0, 0), min(row1, whole.rows)
    col1 = min(col1, col0 + around)
    if not full:
        col0, col1 = max(col0, 0), min(col1, whole.cols)
    if row0 >= row1 or col0 >= col1:
        raise UsageError(f"{product.title} has nothing at {box}.")
    tile = one_tile(product)
    cuts = _along(col0, col1, around, False) if full else [(0, col0, col1, 0)]
    pieces = tuple(Piece(tile, row0, row1, lo, hi, 0, at) for _, lo, hi, at in cuts)
    return Layout(whole.window(row0, row1, col0, col1), (Band(0, row1 - row0, col1 - col0, pieces),))


def _covering(low: float, high: float, point: bool) -> tuple[int, int]:
    """Samples [first, end) around low to high: those that surround it, or (cells) those that meet it."""
    if point:
        return math.floor(low + EPS), math.ceil(high - EPS) + 1
    first = math.floor(low + EPS)
    return first, max(math.ceil(high - EPS), first + 1)


def _cut(first: int, end: int, size: int, shared: bool) -> Iterator[tuple[int, int, int]]:
    """Samples [first, end) cut into tiles of ``size``: (tile, from, to).

    A last sample that a tile shares with the one before is left to that.
    """
    at = first
    while at < end:
        tile = at // size
        stop = min((tile + 1) * size, end)
        if shared and stop == end - 1 and stop == (tile + 1) * size:
            stop = end
        yield tile, at - tile * size, stop - tile * size
        at = stop


def _along(first: int, end: int, size: int, shared: bool) -> Iterator[tuple[int, int, int, int]]:
    """Like ``_cut``, with the position of each piece, counted from ``first``."""
    for tile, low, high in _cut(first, end, size, shared):
        yield tile, low, high, tile * size + low - first


def _tile(
    product: Product, row: int, col: int, key: str, grid: Grid | None, names: dict[str, object], covered: bool = True,
    zoom: int = 0,
) -> Tile:  # fmt: skip
    names = {**dict.fromkeys(("NS", "EW", "ns", "ew", "folder"), ""), **names, "base": product.base.rstrip("/")}
    try:
        url, member = product.url.format(**names), product.member.format(**names)
    except (KeyError, ValueError, IndexError) as error:
        raise UsageError(f"The rule of {product.name}'s URLs does not fit its tiling: {error}.") from None
    location = f"/vsicurl/{url}"
    if member:
        location = f"/vsizip/{{{location}}}/{member}"
    elif url.endswith(".gz"):
        location = f"/vsigzip/{location}"
    return Tile(row, col, key, url, location, grid, zoom, covered)
