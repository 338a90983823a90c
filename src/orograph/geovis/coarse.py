"""Coarse levels of an image whose file has no overviews: made once, kept in the user's cache folder.

Without overviews a texel of 2^k pixels a side takes 4^k pixels of reading, and a view to the horizon all of the file.
So the file is cut into blocks of ``SIDE`` × ``SIDE`` pixels, and of one reading of a block all its levels from
``FINEST`` on are made; they take 1/12 of a byte per pixel before they are compressed. A block is a file that takes its
place when it is complete: making goes on where it was interrupted, several processes may make the same at once, and
only blocks that are seen from afar are made at all. The folder's name is made of what decides the texels: the image's
files (path, size, time of change), its shape, and how its values become colours.

Sums of linear light weighted by opacity are halved in float64 and every level is rounded once: the texels are those of
``imagery.read_into`` (but for a tie in a million, as sums of 8 × 8 pixels are kept in single precision). What is
coarser than a block is averaged of its last level. Units: pixels of the file, texels of a level.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.dem.deciding import files_of, states
from orograph.dem.handles import HANDLES
from orograph.errors import StoreError
from orograph.folders import cache_folder
from orograph.geovis.imagery import PICKS, ImageWindow, pieces, shrink
from orograph.geovis.laying import Laid
from orograph.geovis.mipmap import curves
from orograph.parallel import for_each
from orograph.progress import SILENT, Progress
from orograph.store.kept import IMAGES, Use, make_room

Bytes = NDArray[np.uint8]
Colors = NDArray[np.float32]
Floats = NDArray[np.float64]
Block = tuple[int, int]
"""Row and column of a block."""

FINEST, TOP = 3, 12
"""Levels that are kept of a block; its last one is a single texel."""

SIDE = 1 << TOP
MUCH = 1 << 26
"""Pixels over a terrain that have no overviews to speak of, from which on levels are kept."""

WIDE = 16
"""Blocks side by side that are read at once where the file's own blocks are rows: 64 MiB of sums."""

VERSION = 1
OLD = 3600.0
"""Seconds after which half a file is one that a process has left behind."""

_MAGIC = b"orograph coarse\n"


class Stopped(Exception):
    """Making was asked to end."""


def wanted(laid: Laid) -> bool:
    """Whether coarse texels of an image take a reading of very many pixels."""
    window, _ = laid.aligned()
    pixels = (window.row1 - window.row0) * (window.col1 - window.col0)
    picks = 1 if laid.bands.palette is None else PICKS
    step = max((f // picks for f in laid.overviews if f > picks), default=1)
    return pixels // step**2 > MUCH


class CoarseLevels:
    """The kept levels of an image; safe from any thread.

    Args:
        laid: where it lies.

    Attributes:
        window: the pixels that there may be texels of. folder: where blocks are kept.
        made: how many blocks of the window have been found or made so far.
    """

    def __init__(self, laid: Laid) -> None:
        self.laid = laid
        self.window, _ = laid.aligned()
        self.folder = cache_folder() / IMAGES / _fingerprint(laid)[:20]
        self._use = Use(self.folder)
        self._changed = threading.Condition()
        self._busy: set[Block] = set()
        self._there: set[Block] = set()
        self.blocks = self._within(self.window)
        self.missing(self.blocks)

    @property
    def made(self) -> int:
        return len(self._there)

    @property
    def complete(self) -> bool:
        """Whether every block of the window is there."""
        return len(self._there) == len(self.blocks)

    def missing(self, blocks: Sequence[Block]) -> list[Block]:
        """Those that are not there yet."""
        lack = [block for block in blocks if block not in self._there]
        if lack and self.folder.is_dir():
            found = {block for block in lack if self._path(block).exists()}
            self._there |= found
            lack = [block for block in lack if block not in found]
        return lack

    def under(self, k: int, r0: int, r1: int, c0: int, c1: int) -> list[Block]:
        """Blocks of the window that have texels [r0, r1) × [c0, c1) of a level."""
        w = self.window
        return self._within(
            ImageWindow(
                max(r0 << k, w.row0), min(r1 << k, w.row1), max(c0 << k, w.col0), min(c1 << k, w.col1),
            )
        )  # fmt: skip

    def read(self, k: int, r0: int, r1: int, c0: int, c1: int) -> tuple[Bytes, bool]:
        """Texels [r0, r1) × [c0, c1) of a level, ``FINEST`` or coarser, counted from the file's corner.

        Returns:
            (rows, cols, 4) sRGB and opacity, transparent where blocks are not there yet and beyond the window; whether
            all of them were.
        """
        own = min(k, TOP)
        out = np.zeros(((r1 - r0) << (k - own), (c1 - c0) << (k - own), 4), np.uint8)
        row, col = r0 << (k - own), c0 << (k - own)
        whole = True
        for block in self.under(k, r0, r1, c0, c1):
            level = self._level(block, own)
            if level is None:
                whole = False
                continue
            top, left = block[0] << (TOP - own), block[1] << (TOP - own)
            a, b = max(top, row), min(top + level.shape[0], row + out.shape[0])
            c, d = max(left, col), min(left + level.shape[1], col + out.shape[1])
            if a < b and c < d:
                out[a - row : b - row, c - col : d - col] = level[a - top : b - top, c - left : d - left]
        if k == own:
            return out, whole
        small = np.zeros((r1 - r0, c1 - c0, 4), np.uint8)
        shrink(out, 1 << (k - own), *curves(), small)
        return small, whole

    def make(
        self, blocks: Sequence[Block], progress: Progress = SILENT, jobs: int | None = None,
        stop: threading.Event | None = None,
    ) -> None:  # fmt: skip
        """Make those that are not there yet.

        Args:
            progress: hears of it. jobs: threads. stop: ends it between two pieces of reading.

        Raises:
            ReadError: the image cannot be read. StoreError: blocks cannot be kept.
            Stopped: it was told to end.
        """
        lack = self.missing(blocks)
        if not lack:
            return
        self._begin()
        tasks, serial = self._tasks(lack)
        with progress.task(f"Making coarse levels of {self.laid.layer.label}", total=len(lack)) as task:
            task.note("once: they are kept")

            def work(run: list[Block]) -> None:
                self._make(run, stop)
                task.advance(len(run))

            for_each(work, tasks, 1 if serial else jobs)
        make_room(progress)

    def _within(self, window: ImageWindow) -> list[Block]:
        if window.row1 <= window.row0 or window.col1 <= window.col0:
            return []
        rows = range(window.row0 >> TOP, ((window.row1 - 1) >> TOP) + 1)
        cols = range(window.col0 >> TOP, ((window.col1 - 1) >> TOP) + 1)
        return [(row, col) for row in rows for col in cols]

    def _tasks(self, lack: list[Block]) -> tuple[list[list[Block]], bool]:
        """Runs of blocks that are read at once; whether one after the other, as the file's own order is."""
        with HANDLES.borrow(self.laid.location) as file:
            _, width = file.block_shapes[self.laid.bands.colors[0] - 1]
        if width <= SIDE:
            return [[block] for block in lack], False
        runs: list[list[Block]] = []
        for block in sorted(lack):
            last = runs[-1] if runs else []
            if last and len(last) < WIDE and block == (last[-1][0], last[-1][1] + 1):
                last.append(block)
            else:
                runs.append([block])
        return runs, True

    def _make(self, run: list[Block], stop: threading.Event | None) -> None:
        """Make blocks that lie side by side, but for those that another thread is at: it is waited for."""
        with self._changed:
            own = [block for block in run if block not in self._busy and block not in self._there]
            self._busy.update(own)
        try:
            if own:
                self._read([block for block in run if own[0] <= block <= own[-1]], own, stop)
        finally:
            with self._changed:
                self._busy.difference_update(own)
                self._changed.notify_all()
        with self._changed:
            while any(block in self._busy for block in run):
                self._changed.wait(0.5)

    def _read(self, run: list[Block], own: list[Block], stop: threading.Event | None) -> None:
        image, laid = self.laid.placement.image, self.laid
        row, col = run[0]
        row1 = min((row + 1) * SIDE, image.rows)
        col1 = (run[-1][1] + 1) * SIDE
        if not laid.cyclic:
            col1 = min(col1, image.cols)
        window = ImageWindow(row * SIDE, row1, col * SIDE, col1, 1 << FINEST)
        sums = np.empty((*window.shape, 4), np.float32)
        high = wide = np.empty(0)
        for first, last, piece, step in pieces(laid.location, window, laid.bands):
            if stop is not None and stop.is_set():
                raise Stopped
            accumulate(piece, step, curves()[0], sums[first:last])
            high = np.concatenate([high if first else high[:0], _counts(piece.shape[0], step)])
            wide = _counts(piece.shape[1], step)
        across = 1 << (TOP - FINEST)
        for block in own:
            part = slice((block[1] - col) * across, (block[1] - col + 1) * across)
            self._keep(block, _levels(sums[:, part].astype(np.float64), high, wide[part]))

    # ---- files ---------------------------------------------------------------------------------------------------

    def _path(self, block: Block) -> Path:
        return self.folder / f"{block[0]}_{block[1]}"

    def _begin(self) -> None:
        """Have the folder, saying what it is of, without what others left behind."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._use = Use(self.folder)
            about = self.folder / "about.json"
            if not about.exists():
                about.write_text(json.dumps({"image": str(self.laid.location), "what": "coarse levels"}) + "\n")
            for half in self.folder.glob("*.part"):
                with contextlib.suppress(OSError):
                    if time.time() - half.stat().st_mtime > OLD:
                        half.unlink()
        except OSError as error:
            raise self._unkept(error) from None

    def _keep(self, block: Block, levels: list[Bytes]) -> None:
        from orograph._blosc import blosc

        packed = [blosc.compress(np.ascontiguousarray(v), b"zstd", 1, blosc.NOSHUFFLE, 0) for v in levels]
        head = np.array(
            [[*v.shape[:2], len(p), crc32(p)] for v, p in zip(levels, packed, strict=True)], "<u4"
        ).tobytes()
        half = self.folder / f"{block[0]}_{block[1]}.{os.getpid()}.part"
        try:
            with half.open("wb") as out:
                out.write(_MAGIC + crc32(head).to_bytes(4, "little") + head)
                out.writelines(packed)
            half.replace(self._path(block))
        except BaseException as error:
            with contextlib.suppress(OSError):
                half.unlink()
            if isinstance(error, OSError):
                raise self._unkept(error) from None
            raise
        with self._changed:
            self._there.add(block)

    def _level(self, block: Block, k: int) -> Bytes | None:
        """A level of a block, None if it is not there; a damaged one is forgotten."""
        from orograph._blosc import blosc

        try:
            with self._path(block).open("rb") as file:
                begin = file.read(len(_MAGIC) + 4)
                head = file.read(16 * (TOP - FINEST + 1))
                if begin != _MAGIC + crc32(head).to_bytes(4, "little"):
                    raise ValueError
                table = np.frombuffer(head, "<u4").reshape(-1, 4)
                rows, cols, size, check = (int(v) for v in table[k - FINEST])
                file.seek(int(table[: k - FINEST, 2].sum()), os.SEEK_CUR)
                data = file.read(size)
                if len(data) != size or crc32(data) != check:
                    raise ValueError
                out = np.empty((rows, cols, 4), np.uint8)
                blosc.decompress(data, out)
                self._there.add(block)
                return out
        except FileNotFoundError:
            self._there.discard(block)
        except (OSError, ValueError, RuntimeError):
            with contextlib.suppress(OSError):
                self._path(block).unlink()
            self._there.discard(block)
        return None

    def _unkept(self, error: OSError) -> StoreError:
        return StoreError(
            f"The coarse levels of {self.laid.layer.label} cannot be kept: {error.strerror or error}.",
            path=self.folder,
            remedy="Set OROGRAPH_CACHE to a folder with room, or give the image overviews (gdaladdo).",
        )


def _counts(pixels: int, step: int) -> Floats:
    """How many pixels there are in each texel along an axis."""
    count = np.full(-(-pixels // step), float(step))
    count[-1] -= len(count) * step - pixels
    return count


def _halved(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Sums of pairs along an axis."""
    if values.shape[axis] % 2:
        values = np.concatenate([values, np.zeros_like(values.take([0], axis))], axis)
    before = (slice(None),) * axis
    return np.asarray(values[(*before, slice(0, None, 2))] + values[(*before, slice(1, None, 2))])


def _levels(sums: Floats, high: Floats, wide: Floats) -> list[Bytes]:
    """All levels from ``FINEST`` to ``TOP`` of a block, of its finest sums; high, wide: pixels along texels' sides."""
    found: list[Bytes] = []
    for _ in range(FINEST, TOP + 1):
        level = np.empty(sums.shape, np.uint8)
        finish(sums, high, wide, curves()[1], level)
        found.append(level)
        sums, high, wide = _halved(_halved(sums, 0), 1), _halved(high, 0), _halved(wide, 0)
    return found


@kernel
def accumulate(fine: Bytes, step: int, decode: Colors, out: Colors) -> None:
    """Sums over ``step`` × ``step`` pixels: red, green, blue (linear, times opacity) and opacity."""
    rows, cols = fine.shape[0], fine.shape[1]
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            red = green = blue = 0.0
            opacity = np.int64(0)
            for a in range(i * step, min(i * step + step, rows)):
                for b in range(j * step, min(j * step + step, cols)):
                    w = np.int64(fine[a, b, 3])
                    opacity += w
                    red += w * decode[fine[a, b, 0]]
                    green += w * decode[fine[a, b, 1]]
                    blue += w * decode[fine[a, b, 2]]
            out[i, j, 0], out[i, j, 1], out[i, j, 2], out[i, j, 3] = red, green, blue, opacity


@kernel
def finish(sums: Floats, high: Floats, wide: Floats, encode: Bytes, out: Bytes) -> None:
    """sRGB and opacity of sums over texels of high × wide pixels."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            opacity = sums[i, j, 3]
            out[i, j, 3] = np.uint8(opacity / (high[i] * wide[j]) + 0.5)
            scale = 65535.0 / opacity if opacity > 0 else 0.0
            for k in range(3):
                out[i, j, k] = encode[np.int64(sums[i, j, k] * scale + 0.5)]


def _fingerprint(laid: Laid) -> str:
    """A hash of all that decides the texels."""
    bands, image = laid.bands, laid.placement.image
    said = [str(VERSION), repr(image.shape), repr(bands.colors), str(bands.stretched), repr(bands.nodata)]
    said += [repr(bands.span) if bands.stretched else ""]
    said += [
        "" if table is None else hashlib.sha256(table.tobytes()).hexdigest() for table in (bands.palette, bands.table)
    ]
    said += states(files_of(laid.location))
    return hashlib.sha256("\n".join(said).encode()).hexdigest()
