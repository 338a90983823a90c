"""The loop of a flood: from wet samples that water has reached to their wet neighbours, within one window."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel

WET, REACHED = np.uint8(1), np.uint8(2)


@kernel
def fill(state, row0, row1, col0, col1, spring, stack):
    """Let water flow in a window, from what is reached in it and around it, until nothing more is wetted.

    Neighbours are joined by an edge of the surface: along rows and columns, and along the diagonal of a cell from its
    (even, even) to its (odd, odd) corner. So two samples are joined wherever both belong to one piece of the surface
    below the water level.

    Args:
        state: (rows, cols) uint8, ``WET`` and ``REACHED``; of the window, ``REACHED`` is added.
        spring: some of it may be reached that water has not flowed from yet; else only what lies around it.
        stack: int64, as long as the window has samples.

    Returns:
        how many samples were reached now.
    """
    rows, cols = state.shape
    top = 0
    count = 0
    for i in range(row0, row1):
        for j in range(col0, col1):
            if not spring and i > row0 and i < row1 - 1 and j > col0 and j < col1 - 1:
                continue
            if state[i, j] != WET:
                continue
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    r, c = i + di, j + dj
                    if r < 0 or r >= rows or c < 0 or c >= cols or (di == 0 and dj == 0):
                        continue
                    if di != 0 and dj != 0 and ((i + j) & 1) == 1:
                        continue
                    if state[r, c] == WET | REACHED and state[i, j] == WET:
                        state[i, j] = WET | REACHED
                        stack[top] = i * cols + j
                        top += 1
                        count += 1
    while top > 0:
        top -= 1
        i, j = stack[top] // cols, stack[top] % cols
        for di in range(-1, 2):
            for dj in range(-1, 2):
                r, c = i + di, j + dj
                if r < row0 or r >= row1 or c < col0 or c >= col1:
                    continue
                if di != 0 and dj != 0 and ((i + j) & 1) == 1:
                    continue
                if state[r, c] == WET:
                    state[r, c] = WET | REACHED
                    stack[top] = r * cols + c
                    top += 1
                    count += 1
    return count
