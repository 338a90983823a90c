"""Pictures larger than memory: drawn in bands of rows, each a tile of the view, and assembled in a file.

A tile is what the whole picture shows there, to the bit (``cpu.draw``), so bands have no seam and the file has the same
pixels as a picture that fits into memory. What is drawn goes to a scratch file beside the result, row after row; the
furniture, which depends on all of the picture, is painted into that; and GDAL encodes it, scan line by scan line.
Memory is that of a band; room on disk for three bytes per pixel is needed besides the result's.

Units: pixels, bytes.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from orograph.dem.header import copyright_tags, plain_copyright
from orograph.dem.writing import raster_file
from orograph.errors import OutputError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.layers import drawn as visible
from orograph.output import beside, check_folder, remove
from orograph.parallel import aside
from orograph.progress import SILENT, Progress
from orograph.rendering.backends import Session, session
from orograph.rendering.memory import BYTES_PER_PIXEL, amount, band_pixels
from orograph.rendering.metadata import check_dpi, stamp, tiff_tags
from orograph.rendering.picture import picture_format, plan_grid
from orograph.scene.scene import Scene

ROWS, COLUMNS = 16, 64
"""Tiles begin at multiples of these, the caster's blocks (``raycast.kernels``), which it then casts once."""

MOST_PIXELS = 1 << 30
"""Of a picture: 32768 × 32768. More would take hours and is probably a typing error."""

MOST_TOGETHER = 1 << 33
"""Of a picture that workers draw: 131072 × 65536."""

ACROSS = 2048
"""The most columns of a tile that a graphics card draws."""

SIDE = 8192
"""Pixels per side that any graphics card can draw at once."""

MOST = {"JPEG": 65500, "WEBP": 16383}
"""Pixels per side that a format can hold."""


def is_large(size: tuple[int, int], max_memory: int | None, *, gpu: bool = False) -> bool:
    """Whether a picture of this size is drawn in bands: its arrays take more than half of the memory allowed, or it is
    drawn by a graphics card and exceeds the size that every card supports."""
    pixels = size[0] * size[1]
    if pixels > MOST_PIXELS:
        return False
    return (max_memory is not None and BYTES_PER_PIXEL * pixels > max_memory // 2) or (gpu and max(size) > SIDE)


def check_most(size: tuple[int, int]) -> None:
    """Raise UsageError if the picture is too large even for workers."""
    if size[0] * size[1] > MOST_TOGETHER:
        raise UsageError(f"A picture of {size[0]} × {size[1]} pixels is too large.",
                         remedy="Make it smaller: 131072 × 65536 is the most.")  # fmt: skip


def draw_large(
    scene: Scene, path: str | os.PathLike[str], *, depth: str | os.PathLike[str] | None = None,
    draw: Session | None = None, progress: Progress = SILENT, pixels: int | None = None, across: int | None = None,
    dpi: float | None = None, by: Callable[[Sheet, Progress], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Draw a scene into a file, within ``scene.budget.max_memory`` whatever the picture's size.

    Args:
        scene: its view gives the size.
        path: the picture: .png, .jpg, .webp or .tif (BigTIFF where needed; of a plan a GeoTIFF).
        depth: where to write the depth as well: float32 TIFF, metres, NaN where nothing is hit.
        draw: a backend that draws tiles; None: the CPU caster.
        progress: gets the progress.
        pixels: how many are drawn at a time; None: as many as ``memory.band_pixels`` says.
        across: columns that a tile has at most; None: as many as the picture, if so many pixels make ``ROWS`` of them.
        dpi: dots per inch in print; None: not said.
        by: what puts all bands onto the sheet; None: they are drawn here, one after the other.

    Returns:
        the picture's facts, as in ``Picture``.

    Raises:
        UsageError: the ending is unknown, its format cannot hold this size, or the scene has a wireframe.
        OutputError: a file cannot be written, or there is no room for it.
        NothingInViewError and others: as ``cpu.draw``.
    """
    out, view = Path(path), scene.view
    kind = picture_format(out)
    check_dpi(dpi)
    most = MOST.get(kind)
    if most is not None and max(view.width, view.height) > most:
        raise UsageError(f"A {kind} has at most {most} × {most} pixels, not {view.width} × {view.height}.", path=out,
                         remedy="Use .png or .tif.")  # fmt: skip
    if scene.surface.wireframe and draw is None:
        raise UsageError("A wireframe needs the whole picture in memory.",
                         remedy="Allow more (`max_memory`), or make it smaller.")  # fmt: skip
    for file in filter(None, (out, None if depth is None else Path(depth))):
        check_folder(file)
    needed = 3 * view.width * view.height * 2 + (4 * view.width * view.height if depth is not None else 0)
    free = shutil.disk_usage(out.parent).free
    if needed > free:
        raise OutputError(f"This may take {amount(needed)} on disk while it is made, but {amount(free)} are free.",
                          path=out, remedy="Make room, or make it smaller.")  # fmt: skip
    began = time.perf_counter()
    place = plan_grid(view, scene.terrain.grid.crs)
    with ExitStack() as stack:
        scratch = stack.enter_context(Scratch(out, view.width, view.height))
        depths = None if depth is None else stack.enter_context(DepthFile(Path(depth), view.width, view.height, place))
        sheet = Sheet(scene, scratch, depths, session(progress) if draw is None else draw)
        if by is not None:
            by(sheet, progress)
        else:
            with progress.task("Drawing", total=view.width * view.height) as task:
                for band in bands(view.width, view.height, pixels or band_pixels(scene.budget.max_memory), across):
                    sheet.put(band, (sheet.tile(box) for box in band), progress)
                    task.advance(sum(w * h for _, _, w, h in band))
        if scene.annotations.furniture:
            sheet.furnish()
        scratch.close()
        with progress.task(f"Writing {out.name}"):
            aside(lambda: encode(scratch, kind, place, scene.attribution, dpi))
    sheet.facts["seconds"] = {"all": round(time.perf_counter() - began, 4)}
    return sheet.facts


Box = tuple[int, int, int, int]
"""A tile: left, top, width, height."""

Band = list[Box]
"""Tiles of the same rows, from left to right."""


def bands(width: int, height: int, pixels: int, most: int | None = None) -> Iterator[Band]:
    """Tiles that make up a picture, of at most about ``pixels`` pixels and ``most`` columns, at multiples of ``ROWS``
    and ``COLUMNS``."""
    most = min(width, pixels // ROWS, most or width)
    across = width if most == width else max(COLUMNS, most // COLUMNS * COLUMNS)
    rows = max(ROWS, pixels // across // ROWS * ROWS)
    for top in range(0, height, rows):
        tall = min(rows, height - top)
        yield [(left, top, min(across, width - left), tall) for left in range(0, width, across)]


class Tile(NamedTuple):
    """A tile as it was drawn.

    Attributes:
        pixels: (rows, cols, 3). depth: (rows, cols) metres. ground: (rows, cols) where ground is seen, or filled in.
        facts: as of a ``Picture``. tint: how heights are coloured; None: not known.
    """

    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    ground: NDArray[np.bool_]
    facts: dict[str, Any]
    tint: Any = None


def draw_tile(scene: Scene, box: Box, draw: Session) -> Tile:
    """Draw a tile (left, top, width, height) of a scene's picture, without its furniture."""
    picture = draw(scene.but(view=scene.view.tile(*box), furniture=False, title=None))
    ground = np.isfinite(picture.depth)
    if picture.void_filled is not None:
        ground = ground | picture.void_filled
    return Tile(picture.pixels, picture.depth, ground, picture.facts, picture.tint)


class Sheet:
    """What is known of a large picture while it is assembled.

    Attributes:
        facts: as of a ``Picture``.
    """

    def __init__(self, scene: Scene, scratch: Scratch, depths: DepthFile | None, session: Session) -> None:
        self.scene, self.scratch, self.depths, self._session = scene, scratch, depths, session
        self.facts: dict[str, Any] = {}
        self.tint: Any = None
        height, width = scene.view.height, scene.view.width
        self.column = np.full(height, np.nan)
        self.samples: list[NDArray[np.float64]] = []
        self.cover = np.zeros((height, -(-width // 8)), np.uint8) if scene.annotations.furniture else None

    def tile(self, box: Box) -> Tile:
        """Draw a tile."""
        return draw_tile(self.scene, box, self._session)

    def put(self, band: Band, tiles: Iterable[Tile], progress: Progress) -> None:
        """Write the rows of the next band, of its tiles."""
        from orograph.rendering.furniture.legend import sampled

        view = self.scene.view
        _, top, _, tall = band[0]
        pixels, depth = np.empty((tall, view.width, 3), np.uint8), np.empty((tall, view.width), np.float32)
        ground = np.zeros((tall, view.width), bool)
        for (left, _, wide, _), tile in zip(band, tiles, strict=True):
            here = slice(left, left + wide)
            pixels[:, here], depth[:, here], ground[:, here] = tile.pixels, tile.depth, tile.ground
            self.tint = tile.tint
            self._add(tile.facts, wide * tall / (view.width * view.height), progress)
        self.scratch.write(pixels)
        if self.depths is not None:
            self.depths.write(depth, top)
        if self.cover is not None:
            self.cover[top : top + tall] = np.packbits(ground, axis=1)
            self.column[top : top + tall] = depth[:, view.width // 2]
            self.samples.append(sampled(depth, view.height, view.width, top))

    def _add(self, facts: dict[str, Any], part: float, progress: Progress) -> None:
        """Count a tile's facts, ``part`` of the picture, into the picture's."""
        for warning in facts.get("warnings", ()):
            if warning not in self.facts.get("warnings", ()):
                progress.warn(warning)
        shown = self.facts.get("shown", dict.fromkeys(facts["shown"], 0))
        means: dict[str, Any] = {name: self.facts.get(name, 0.0) + part * facts[name]
                 for name in ("hit_fraction", "edge_fraction") if name in facts}  # fmt: skip
        means |= {name: self.facts.get(name, 0) + facts[name] for name in ("patches", "triangles") if name in facts}
        self.facts = {**facts, **means, "shown": {k: shown[k] + n for k, n in facts["shown"].items()}}

    def furnish(self) -> None:
        """Paint the furniture into the scratch file."""
        from PIL import Image

        from orograph.rendering.furniture.furnish import Cover, lay_out
        from orograph.rendering.furniture.legend import Drawn, furniture_of
        from orograph.rendering.inset import inset_of

        view = self.scene.view
        assert self.cover is not None
        layered = bool(visible(self.scene.data.layers))
        drawn = Drawn(self.tint, self.facts["shown"], layered, np.concatenate(self.samples), self.column)
        inset = inset_of(self.scene, self._session)
        pieces = furniture_of(self.scene, drawn) | {"inset": inset}
        layout = lay_out((view.width, view.height), ground=Cover(self.cover, view.width), **pieces)
        around = 4 * layout.style.margin
        for i, (_, box) in enumerate(layout.placed):
            x0, y0 = max(box[0] - around, 0), max(box[1] - around, 0)
            x1, y1 = min(box[2] + around, view.width), min(box[3] + around, view.height)
            sheet = Image.fromarray(self.scratch.read(x0, y0, x1, y1))
            layout.paint(sheet, (x0, y0), i)
            self.scratch.put(x0, y0, np.asarray(sheet, np.uint8))


class Scratch:
    """Pixels on disk, three bytes each, row after row: raw, with a header by which GDAL can read them (ENVI's)."""

    def __init__(self, out: Path, width: int, height: int) -> None:
        self.out, self.width, self.height = out, width, height
        self.path = beside(out, "raw")
        self.header = self.path.with_name(self.path.name + ".hdr")
        self.virtual = self.path.with_name(self.path.name + ".vrt")

    def __enter__(self) -> Scratch:
        try:
            self.file = self.path.open("w+b")
            self.header.write_text(
                f"ENVI\nsamples = {self.width}\nlines = {self.height}\nbands = 3\nheader offset = 0\n"
                "file type = ENVI Standard\ndata type = 1\ninterleave = bip\nbyte order = 0\n",
                encoding="ascii",
            )
        except OSError as error:
            raise OutputError(f"The file cannot be written: {error.strerror}.", path=self.out) from error
        return self

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """The next rows (rows, width, 3)."""
        try:
            self.file.write(np.ascontiguousarray(pixels).data)
        except OSError as error:
            raise OutputError(f"The file cannot be written: {error.strerror}.", path=self.out,
                              remedy="Check that the disk has space.") from error  # fmt: skip

    def read(self, x0: int, y0: int, x1: int, y1: int) -> NDArray[np.uint8]:
        """Pixels [y0, y1) × [x0, x1)."""
        found = np.empty((y1 - y0, x1 - x0, 3), np.uint8)
        for row in range(y0, y1):
            self.file.seek(3 * (row * self.width + x0))
            found[row - y0] = np.frombuffer(self.file.read(3 * (x1 - x0)), np.uint8).reshape(-1, 3)
        return found

    def put(self, x0: int, y0: int, pixels: NDArray[np.uint8]) -> None:
        """Replace pixels from (x0, y0) on."""
        for row, line in enumerate(pixels, y0):
            self.file.seek(3 * (row * self.width + x0))
            self.file.write(np.ascontiguousarray(line).data)

    def described(self, attribution: tuple[str, ...]) -> Path:
        """What GDAL reads with metadata that name the makers, for PNG and EXIF (into WebP ``stamp`` writes them)."""
        if not attribution:
            return self.path
        import rasterio.shutil

        rasterio.shutil.copy(self.path, self.virtual, driver="VRT")
        said = {"Copyright": "; ".join(attribution), "EXIF_Copyright": plain_copyright(attribution)}
        items = "".join(f'<MDI key="{name}">{escape(text)}</MDI>' for name, text in said.items())
        head, bracket, rest = self.virtual.read_text(encoding="utf-8").partition(">")
        self.virtual.write_text(f"{head}{bracket}<Metadata>{items}</Metadata>{rest}", encoding="utf-8")
        return self.virtual

    def close(self) -> None:
        """Let GDAL see all of it."""
        self.file.close()

    def __exit__(self, *error: object) -> None:
        self.file.close()
        for path in (self.path, self.header, self.virtual):
            remove(path)


class DepthFile:
    """A float32 TIFF written by whole rows; it appears when it is complete."""

    def __init__(self, out: Path, width: int, height: int, place: Grid | None) -> None:
        self.out, self.width, self.height, self.place = out, width, height, place
        self.stack = ExitStack()

    def __enter__(self) -> DepthFile:
        import rasterio

        with ExitStack() as stack:
            part = stack.enter_context(raster_file(self.out))
            self.file: Any = stack.enter_context(rasterio.open(
                part, "w", driver="GTiff", width=self.width, height=self.height, count=1, dtype="float32",
                compress="deflate", predictor=3, nodata=float("nan"), BIGTIFF="IF_SAFER", **located(self.place),
            ))  # fmt: skip
            self.file.set_band_description(1, "view-space depth, metres")
            self.stack = stack.pop_all()
        return self

    def write(self, depth: NDArray[np.float32], top: int) -> None:
        """Rows (rows, width) from ``top`` on."""
        from rasterio.windows import Window

        self.file.write(depth, 1, window=Window(0, top, self.width, len(depth)))

    def __exit__(self, *error: Any) -> None:
        self.stack.__exit__(*error)


def encode(
    scratch: Scratch, kind: str, place: Grid | None, attribution: tuple[str, ...] = (), dpi: float | None = None
) -> None:
    """Write what is in the scratch file as a picture, reading and writing a few rows at a time.

    Raises:
        OutputError: it cannot be written.
    """
    import rasterio
    import rasterio.shutil

    options: dict[str, dict[str, Any]] = {
        "PNG": {"ZLEVEL": 4},
        "JPEG": {"QUALITY": 92, "JPEG_QUALITY": 92},
        "WEBP": {"LOSSLESS": "YES"},
        "TIFF": {"COMPRESS": "DEFLATE", "PREDICTOR": 2, "BIGTIFF": "IF_SAFER", "PHOTOMETRIC": "RGB"},
    }
    options["PNG"]["WRITE_METADATA_AS_TEXT"] = "YES"
    driver = {"TIFF": "GTiff"}.get(kind, kind)
    with raster_file(scratch.out) as part:
        if kind == "TIFF":
            with rasterio.open(scratch.path) as source, rasterio.open(
                part, "w", driver=driver, width=scratch.width, height=scratch.height, count=3, dtype="uint8",
                interleave="pixel", **options[kind], **located(place),
            ) as file:  # fmt: skip
                file.update_tags(**copyright_tags(attribution), **tiff_tags(dpi))
                for _, window in source.block_windows(1):
                    file.write(source.read(window=window), window=window)
        else:
            rasterio.shutil.copy(scratch.described(attribution), part, driver=driver, **options[kind])
            stamp(part, kind, attribution, dpi)


def located(place: Grid | None) -> dict[str, Any]:
    """The part of a raster's profile that gives its position."""
    if place is None:
        return {}
    return {"transform": place.transform} | ({} if place.crs is None else {"crs": place.crs.to_wkt()})
