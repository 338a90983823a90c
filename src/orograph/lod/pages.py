"""Pages of vertices as kernels see them: where the numbers of a vertex lie in memory.

Entry (i, j) of a page is not at 256·i + j. Traversals of the hierarchy are local in both directions, so pages are cut
into blocks of 16 × 16 entries (4 KiB), blocks into lines of 2 × 2 (64 bytes, a cache line): a square diamond and two of
its four children come with one line (the fourth entry, rows and columns even, belongs to a coarser octave), and what
is near in the terrain is near in memory, at every octave. ``locate`` and ``find`` know the way.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from orograph._numba import inlined

SHIFT = 8
SIDE = 1 << SHIFT
PAGE_BYTES = SIDE * SIDE * 16

BEYOND = -3
"""Slot of a vertex of the padded square that no level of the raster has."""


class Pages(NamedTuple):
    """What kernels get of a field.

    Attributes:
        data: float32 (slots, 256, 256, 4), the pages; ``find`` says where in them.
        flat: the same, float32 (slots · 256 · 256 · 4,).
        table: int32 (pages of the padded square,), the slot of each page; −1 absent, −2 absent and asked for, −3 beyond
            the raster.
        base: int64 (levels,), where each level's pages begin in the table.
        width: int64 (levels,), pages across.
        down, across: int64 (256,), what a row and a column of a page add to the index of an entry's first number.
        used: uint8 (slots,), set when a page is read.
        misses: int32, the pages asked for; count: int64 (1,), how many. Threads that ask at once may lose some of
            these, but not the mark in the table, and count is greater than 0.
        edge: int64 (3,): the raster's last row and column, and the top level.
    """

    data: NDArray[np.float32]
    flat: NDArray[np.float32]
    table: NDArray[np.int32]
    base: NDArray[np.int64]
    width: NDArray[np.int64]
    down: NDArray[np.int64]
    across: NDArray[np.int64]
    used: NDArray[np.uint8]
    misses: NDArray[np.int32]
    count: NDArray[np.int64]  # type: ignore[assignment]  # tuples have a method of that name
    edge: NDArray[np.int64]


@inlined
def locate(pages, row, col, octave):
    """(slot, at): the four numbers of a vertex of an octave are ``pages.flat[at : at + 4]``.

    A negative slot means that the page is absent, which is then asked for, or that the vertex lies beyond all pages
    (BEYOND); ``at`` means nothing then.
    """
    level = np.uint64(min(octave, pages.edge[2]))
    i = np.uint64(row) >> level
    j = np.uint64(col) >> level
    page = np.uint64(pages.base[level]) + (i >> np.uint64(8)) * np.uint64(pages.width[level]) + (j >> np.uint64(8))
    slot = np.int64(pages.table[page])
    if slot >= 0:
        if pages.used[np.uint64(slot)] == 0:  # threads must not write what they share over and over
            pages.used[np.uint64(slot)] = 1
    elif slot == -1:
        pages.table[page] = -2
        pages.misses[pages.count[0]] = page
        pages.count[0] += 1
    return slot, (slot << 18) + pages.down[i & np.uint64(255)] + pages.across[j & np.uint64(255)]


@intrinsic
def _touch(typing, array, index):
    """Ask the processor to bring the cache line of array[index] (LLVM's ``prefetch``, for reading, to be used soon)."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place.type, number, number, number])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")  # type: ignore[no-untyped-call]
        builder.call(function, [place, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.uint64), generate


_call: Any = _touch  # (Numba passes the first argument.)


@inlined
def prefetch(pages, row, col, octave):
    """Have a square diamond's numbers ready in the cache, if its page is there, and those of the four on its edges.

    Two of these share its line; those below and to the right, which the next page may hold, are called in this page.
    """
    level = np.uint64(min(octave, pages.edge[2]))
    i = np.uint64(row) >> level
    j = np.uint64(col) >> level
    page = np.uint64(pages.base[level]) + (i >> np.uint64(8)) * np.uint64(pages.width[level]) + (j >> np.uint64(8))
    slot = np.int64(pages.table[page])
    at = np.uint64(max(slot, np.int64(0)) << 18)
    down = np.uint64(pages.down[i & np.uint64(255)])
    across = np.uint64(pages.across[j & np.uint64(255)])
    below = np.uint64(pages.down[(i + np.uint64(1)) & np.uint64(255)])
    beside = np.uint64(pages.across[(j + np.uint64(1)) & np.uint64(255)])
    _call(pages.flat, at + down + across)
    _call(pages.flat, at + below + across)
    _call(pages.flat, at + down + beside)


@inlined
def find(pages, row, col, octave):
    """(slot, i, j) of a vertex of an octave: its numbers are ``pages.data[slot, i, j]``; slot as for ``locate``."""
    slot, at = locate(pages, row, col, octave)
    return slot, (at >> 10) & 255, (at >> 2) & 255
