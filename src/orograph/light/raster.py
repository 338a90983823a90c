"""Rasters of light while they are made: canvases of one or several bands, in memory or in a scratch file.

A canvas as large as the terrain is kept in memory while it fits in what is allowed; beyond that it is a file in the
temporary folder, mapped into memory, whose pages are let go of after each block. The file has no name once it is open:
nothing is left of it however the process ends.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError

Values = NDArray[np.float32]


class Canvas:
    """Bands of float32 as large as the terrain, zero to begin with.

    Args:
        bands, shape: how many, and their (rows, cols).
        on_disk: keep it in a scratch file.

    Attributes:
        values: (bands, rows, cols) float32.
        on_disk: whether it is a scratch file.

    Raises:
        OutputError: the temporary folder has no room.
    """

    def __init__(self, bands: int, shape: tuple[int, int], on_disk: bool = False) -> None:
        size = (bands, *shape)
        self.on_disk = on_disk
        self._release: Callable[[], None] | None = None
        self.values: Values
        if on_disk:
            space, self._release = scratch(4 * bands * shape[0] * shape[1])
            self.values = space.view(np.float32).reshape(size)
        else:
            self.values = np.zeros(size, np.float32)

    def release(self) -> None:
        """Let go of the memory of a canvas on disk; what was written stays."""
        if self._release is not None:
            self._release()


def scratch(length: int) -> tuple[NDArray[np.uint8], Callable[[], None]]:
    """So many zero bytes in a scratch file, as an array, and a function that lets go of their memory.

    Raises:
        OutputError: the temporary folder has no room.
    """
    try:
        with tempfile.TemporaryFile(prefix="orograph-") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, length)  # a full disk is an error here, not a signal later
            else:
                file.truncate(length)
            mapped = mmap.mmap(file.fileno(), length)
    except OSError as error:
        raise OutputError(
            f"There is no room for {length >> 20} MiB of scratch: {error.strerror}.",
            path=tempfile.gettempdir(),
            remedy="Set TMPDIR to a folder with room, or allow more memory.",
        ) from error

    def release() -> None:
        if hasattr(mapped, "madvise"):
            with contextlib.suppress(OSError):
                mapped.madvise(mmap.MADV_DONTNEED)  # of a shared mapping: the file keeps what was written

    return np.frombuffer(mapped, np.uint8), release


def rectangles(shape: tuple[int, int], height: int, width: int | None = None) -> Iterator[tuple[int, int, int, int]]:
    """Windows (row0, row1, col0, col1) that cover a raster, row by row, at most ``height`` × ``width`` samples."""
    rows, cols = shape
    width = cols if width is None else width
    for row in range(0, rows, height):
        for col in range(0, cols, width):
            yield row, min(row + height, rows), col, min(col + width, cols)
