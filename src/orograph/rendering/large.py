"""Pictures larger than memory: drawn in bands of rows, each a tile of the view, and assembled in a file.

A tile is what the whole picture shows there, to the bit (``cpu.draw``), so bands have no seam and the file has the same
pixels as a picture that fits into memory. Tiles lie compressed beside the result (``assembly``); the furniture, which
depends on all of the picture, is painted over them; and GDAL encodes the result from there. Memory is that of a tile.

Units: pixels, bytes.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError, UsageError
from orograph.folders import cache_folder
from orograph.geovis.layers import drawn as visible
from orograph.output import check_folder
from orograph.parallel import aside, threads_for
from orograph.progress import SILENT, Progress
from orograph.rendering.assembly import Assembly, Raster
from orograph.rendering.backends import Session, session
from orograph.rendering.memory import BYTES_PER_PIXEL, amount, band_pixels
from orograph.rendering.metadata import check_dpi
from orograph.rendering.picture import Picture, picture_format, plan_grid
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

BYTES, DEPTH_BYTES = 3, 6
"""Of a pixel on disk, about: its pieces, overviews and result, compressed; of its depth as well."""

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
        path: the picture: .png, .jpg, .webp or .tif (cloud-optimised, BigTIFF where needed; of a plan a GeoTIFF).
        depth: where to write the depth as well: float32 TIFF (cloud-optimised), metres, NaN where nothing is hit.
        draw: a backend that draws tiles; None: the CPU caster.
        progress: gets the progress.
        pixels: how many are drawn at a time; None: as many as ``memory.band_pixels`` says.
        across: columns that a tile has at most; None: as many as the picture, if so many pixels make ``ROWS`` of them.
        dpi: dots per inch in print; None: not said.
        by: what adds all tiles to the sheet; None: they are drawn here, one after the other.

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
    for path in (out,) if depth is None else (out, Path(depth)):
        check_folder(path)
    needed = (BYTES if depth is None else BYTES + DEPTH_BYTES) * view.width * view.height
    free = shutil.disk_usage(out.parent).free
    if needed > free:
        raise OutputError(f"This takes about {amount(needed)} on disk, but {amount(free)} are free.",
                          path=out, remedy="Make room, or make it smaller.")  # fmt: skip
    began = time.perf_counter()
    place = plan_grid(view, scene.terrain.grid.crs)
    with ExitStack() as stack:
        files = [stack.enter_context(Assembly(out, view.width, view.height, place=place))]
        if depth is not None:
            files.append(stack.enter_context(Assembly(Path(depth), view.width, view.height, depth=True, place=place)))
        sheet = Sheet(scene, files, session(progress) if draw is None else draw, progress)
        facts = sheet.fill(by or partial(in_bands, pixels=pixels, across=across))
        for file in files:
            with progress.task(f"Writing {file.out.name}"):
                aside(partial(file.encode, "TIFF" if file.depth else kind, scene.attribution, dpi,
                              threads_for(scene.budget.jobs)))  # fmt: skip
    return {**facts, "seconds": {"all": round(time.perf_counter() - began, 4)}}


def draw_apart(
    scene: Scene, folder: Path, *, draw: Session, progress: Progress = SILENT, pixels: int | None = None,
    by: Callable[[Sheet, Progress], None] | None = None,
) -> Picture:  # fmt: skip
    """Draw a scene in tiles, as ``draw_large`` does, and put them together in memory.

    Args:
        folder: where the tiles lie until then. The others: as of ``draw_large``.
    """
    began, view, terrain = time.perf_counter(), scene.view, scene.terrain
    place = plan_grid(view, terrain.grid.crs)
    whole = 0, 0, view.width, view.height
    with (
        Assembly(folder / "pixels.tif", view.width, view.height) as colours,
        Assembly(folder / "depth.tif", view.width, view.height, depth=True) as depths,
    ):
        sheet = Sheet(scene, [colours, depths], draw, progress)
        facts = sheet.fill(by or partial(in_bands, pixels=pixels))
        found = colours.read(*whole), np.ascontiguousarray(depths.read(*whole)[..., 0])
    facts["seconds"] = {"all": round(time.perf_counter() - began, 4)}
    return Picture(*found, view, facts, place, None, sheet.tint, terrain.grid.crs, scene.surface.exaggeration,
                   scene.attribution)  # fmt: skip


@contextmanager
def temporary() -> Iterator[Path]:
    """A folder for tiles, in the cache folder, which the workers of a cluster must see, too."""
    base = cache_folder()
    base.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".picture.", dir=base) as name:
        yield Path(name)


Box = tuple[int, int, int, int]
"""A tile: left, top, width, height."""


def in_bands(sheet: Sheet, progress: Progress, *, pixels: int | None, across: int | None = None) -> None:
    """Draw all tiles of a sheet, one after the other; ``pixels`` and ``across`` as of ``draw_large``."""
    scene, view = sheet.scene, sheet.scene.view
    with progress.task("Drawing", total=view.width * view.height) as task:
        for box in bands(view.width, view.height, pixels or band_pixels(scene.budget.max_memory), across):
            tile = draw_tile(scene, box, sheet.session)
            rasters: list[Raster] = [tile.pixels, tile.depth]
            for file, raster in zip(sheet.files, rasters, strict=False):
                file.write(*box[:2], raster)
            sheet.add(box, seen(scene, box, tile))
            task.advance(box[2] * box[3])


def bands(width: int, height: int, pixels: int, most: int | None = None) -> Iterator[Box]:
    """Tiles that make up a picture, row by row, of at most about ``pixels`` pixels and ``most`` columns, at multiples
    of ``ROWS`` and ``COLUMNS``."""
    most = min(width, pixels // ROWS, most or width)
    across = width if most == width else max(COLUMNS, most // COLUMNS * COLUMNS)
    rows = max(ROWS, pixels // across // ROWS * ROWS)
    for top in range(0, height, rows):
        for left in range(0, width, across):
            yield left, top, min(across, width - left), min(rows, height - top)


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


class Seen(NamedTuple):
    """What is remembered of a tile that was drawn, for the picture's facts and furniture.

    Attributes:
        facts: as of a ``Picture``. tint: as of a ``Tile``.
        cover: its ground, as rows of a ``Cover``. column: depths of the picture's middle column, as far as the tile has
            them. samples: of depths, for the legend. All three are empty where there is no furniture.
    """

    facts: dict[str, Any]
    cover: NDArray[np.uint8]
    column: NDArray[np.float32]
    samples: NDArray[np.float64]
    tint: Any = None


def seen(scene: Scene, box: Box, tile: Tile) -> Seen:
    """What to remember of a tile."""
    if not scene.annotations.furniture:
        nothing = np.empty(0)
        return Seen(tile.facts, nothing.astype(np.uint8), nothing.astype(np.float32), nothing, tile.tint)
    from orograph.rendering.furniture.furnish import cover_step
    from orograph.rendering.furniture.legend import sampled

    view, (left, top, _, _) = scene.view, box
    step = cover_step((view.width, view.height))
    middle = view.width // 2 - left
    column = tile.depth[:, middle] if 0 <= middle < box[2] else np.empty(0, np.float32)
    samples = sampled(tile.depth, view.height, view.width, top, left)
    return Seen(tile.facts, np.packbits(tile.ground[::step, ::step], axis=1), column, samples, tile.tint)


class Sheet:
    """What is known of a large picture while it is assembled, from tiles in any order.

    Args:
        files: the picture's, and that of its depth if there is one. session: draws.
    """

    def __init__(self, scene: Scene, files: list[Assembly], session: Session, progress: Progress) -> None:
        self.scene, self.files, self.session, self.progress = scene, files, session, progress
        self._seen: dict[Box, Seen] = {}
        self._warned: set[str] = set()
        self.tint: Any = None

    def fill(self, by: Callable[[Sheet, Progress], None]) -> dict[str, Any]:
        """Have all tiles added by ``by``, and paint the furniture over them; returns the picture's facts."""
        by(self, self.progress)
        facts = self.facts()
        if self.scene.annotations.furniture:
            self.furnish(facts)
        return facts

    def add(self, box: Box, seen: Seen) -> None:
        """Remember a tile, whose pixels are in the files."""
        self._seen[box] = seen
        if seen.tint is not None:
            self.tint = seen.tint
        for warning in seen.facts.get("warnings", ()):
            if warning not in self._warned:
                self._warned.add(warning)
                self.progress.warn(warning)

    def _sorted(self) -> list[tuple[Box, Seen]]:
        return sorted(self._seen.items(), key=lambda item: (item[0][1], item[0][0]))

    def facts(self) -> dict[str, Any]:
        """The picture's facts, of those of all tiles."""
        whole: dict[str, Any] = {}
        pixels = self.scene.view.width * self.scene.view.height
        for (_, _, wide, tall), tile in self._sorted():
            facts = tile.facts
            shown = whole.get("shown", dict.fromkeys(facts["shown"], 0))
            sums: dict[str, Any] = {name: whole.get(name, 0.0) + wide * tall / pixels * facts[name]
                    for name in ("hit_fraction", "edge_fraction") if name in facts}  # fmt: skip
            sums |= {name: whole.get(name, 0) + facts[name] for name in ("patches", "triangles") if name in facts}
            whole = {**facts, **sums, "shown": {k: shown[k] + n for k, n in facts["shown"].items()}}
        return whole

    def furnish(self, facts: dict[str, Any]) -> None:
        """Paint the furniture over the picture."""
        from PIL import Image

        from orograph.rendering.furniture.furnish import Cover, cover_step, lay_out
        from orograph.rendering.furniture.legend import Drawn, furniture_of
        from orograph.rendering.inset import inset_of

        view = self.scene.view
        step = cover_step((view.width, view.height))
        cover = Cover.empty((view.width, view.height), step)
        column = np.full(view.height, np.nan)
        for (left, top, _, tall), tile in self._sorted():
            rows, cols = tile.cover.shape
            cover.rows[top // step : top // step + rows, left // step // 8 : left // step // 8 + cols] = tile.cover
            if tile.column.size:
                column[top : top + tall] = tile.column
        samples = np.concatenate([tile.samples for _, tile in self._sorted()])
        drawn = Drawn(self.tint, facts["shown"], bool(visible(self.scene.data.layers)), samples, column)
        pieces = furniture_of(self.scene, drawn) | {"inset": inset_of(self.scene, self.session)}
        layout = lay_out((view.width, view.height), ground=cover, **pieces)
        around = 4 * layout.style.margin
        for i, (_, box) in enumerate(layout.placed):
            x0, y0 = max(box[0] - around, 0), max(box[1] - around, 0)
            x1, y1 = min(box[2] + around, view.width), min(box[3] + around, view.height)
            sheet = Image.fromarray(self.files[0].read(x0, y0, x1, y1))
            layout.paint(sheet, (x0, y0), i)
            self.files[0].write(x0, y0, np.asarray(sheet, np.uint8))
