"""Windows of levels against the cells that they hold, counted one by one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orograph.hierarchy.clip_stack import ClipStack, Rectangle


@st.composite
def windows(draw, level: int = 0, most: int = 60) -> Rectangle:
    row0, col0 = draw(st.integers(0, most - 2)), draw(st.integers(0, most - 2))
    return Rectangle(level, row0, draw(st.integers(row0 + 2, most)), col0, draw(st.integers(col0 + 2, most)))


def cells(window: Rectangle) -> set[tuple[int, int]]:
    """The cells between a window's samples, in units of the finest level."""
    step = 1 << window.level
    rows, cols = (range(a * step, (b - 1) * step) for a, b in ((window.row0, window.row1), (window.col0, window.col1)))
    return {(r, c) for r in rows for c in cols}


@given(windows(), st.integers(0, 4))
def test_coarser_windows_around_and_inside(window: Rectangle, level: int) -> None:
    own, step = cells(window), 1 << level
    touched = {(r // step, c // step) for r, c in own}
    whole = {
        (r, c) for r, c in touched
        if all((r * step + i, c * step + j) in own for i in range(step) for j in range(step))
    }  # fmt: skip
    assert {(r // step, c // step) for r, c in cells(window.around(level))} == touched
    inside = window.inside(level)
    found = cells(inside) if min(inside.shape) > 0 else set()
    assert {(r // step, c // step) for r, c in found} == whole


@given(windows(), windows())
def test_joined_and_grown(one: Rectangle, other: Rectangle) -> None:
    both = one.joined(other)
    assert cells(one) | cells(other) <= cells(both)
    assert both.row0 in (one.row0, other.row0) and both.col1 in (one.col1, other.col1)
    assert one.grown(3).samples == (one.shape[0] + 6) * (one.shape[1] + 6)


@given(windows(), st.integers(1, 70), st.integers(1, 70), st.integers(1, 2), st.booleans())
def test_cut(window: Rectangle, rows: int, cols: int, least: int, even: bool) -> None:
    cut = window.cut((rows, cols), least=least, even=even)
    assert 0 <= cut.row0 < cut.row1 <= rows and 0 <= cut.col0 < cut.col1 <= cols
    assert cut.shape[0] >= min(least, rows) and cut.shape[1] >= min(least, cols)
    inner = {(r, c) for r in range(window.row0, min(window.row1, rows))
             for c in range(window.col0, min(window.col1, cols))}  # fmt: skip
    assert inner <= {(r, c) for r in range(cut.row0, cut.row1) for c in range(cut.col0, cut.col1)}
    if even:
        assert cut.row0 % 2 == cut.col0 % 2 == 0


@pytest.mark.parametrize("size", [(33, 65), (100, 70), (513, 513), (2, 900)])
def test_a_filled_stack_nests_and_holds_the_raster(size: tuple[int, int]) -> None:
    def shape(level: int) -> tuple[int, int]:
        return tuple(-(-(n - 1) >> level) + 1 for n in size)  # type: ignore[return-value]

    levels = next(k for k in range(20) if max(shape(k)) <= 9) + 1
    rng = np.random.default_rng(3)
    for _ in range(40):
        row, col = int(rng.integers(size[0])), int(rng.integers(size[1]))
        finest = Rectangle(0, row, row + 7, col, col + 5).cut(shape(0), least=2, even=True)
        stack = ClipStack([finest]).filled(shape, levels, 4)
        assert [window.level for window in stack] == list(range(len(stack) - 1, -1, -1))
        assert stack[-1].samples >= finest.samples and stack.samples == sum(window.samples for window in stack)
        assert stack[0] == Rectangle.whole(stack[0].level, shape(stack[0].level)) or stack[0].level == levels - 1
        for outer, inner in pairwise(stack):
            fine, coarse = ([n << window.level for n in (window.row0, 1 - window.row1, window.col0, 1 - window.col1)]
                            for window in (inner, outer))  # fmt: skip
            assert all(a >= b for a, b in zip(fine, coarse, strict=True)) and outer.row0 % 2 == outer.col0 % 2 == 0


@given(windows(0), st.integers(0, 3))
def test_rings_share_the_ground(inner: Rectangle, margin: int) -> None:
    outer = inner.around(1).grown(margin)
    ring, finest = ClipStack([outer, inner]).rings()
    assert finest.hole is None and finest.where == inner and ring.hole is not None
    first_row, last_row, first_col, last_col = ring.hole
    hole = Rectangle(1, first_row, last_row + 1, first_col, last_col + 1)
    assert cells(inner) <= cells(hole) <= cells(outer)
    assert ring.open_sides() == (margin > 0,) * 4 and finest.open_sides() == (False,) * 4


def test_hidden_windows_are_left_out() -> None:
    shapes = {0: (33, 30), 1: (17, 16), 2: (9, 9)}
    whole = [Rectangle.whole(level, shapes[level]) for level in (2, 1, 0)]
    part = Rectangle(0, 0, 33, 2, 30)
    assert ClipStack(whole).visible(shapes.__getitem__) == (whole[2],)
    assert ClipStack([whole[0], whole[1], part]).visible(shapes.__getitem__) == (whole[1], part)
