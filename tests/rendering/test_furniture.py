"""Furniture: what is drawn where, what goes when room is short, and the numbers on it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import orograph
from orograph.geovis.keys import Legend, Scale
from orograph.rendering.furniture import furnish as furniture
from orograph.rendering.furniture import lettering
from orograph.rendering.furniture.furnish import furnish
from orograph.rendering.furniture.key import WIDEST, key
from orograph.rendering.furniture.pieces import bar_length, number, ticks

RAMP = np.linspace([0.1, 0.4, 0.2], [1.0, 0.9, 0.9], 256)
LEGEND = Legend((Scale(12.0, 4392.0, RAMP),), (("Water", (112, 153, 178)), ("No data", (0.6, 0.6, 0.6))))
ALL: dict[str, Any] = {
    "title": "Sierra Nevada", "subtitle": "UTM zone 11N", "legend": LEGEND, "north": 0.0, "metres_per_pixel": 85.0,
    "note": "Light from 315°, 45° · heights ×2",
}  # fmt: skip


def blank(width: int, height: int, value: int = 90) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def touched(width: int, height: int, **pieces: Any) -> np.ndarray:
    before = blank(width, height)
    return (furnish(before, **pieces) != before).any(2)


def quarters(width: int, height: int, **pieces: Any) -> tuple[bool, ...]:
    """Whether something was drawn in the corners: top left, top right, bottom left, bottom right."""
    t = touched(width, height, **pieces)
    m = round(height * 0.06)
    top, bottom, left, right = slice(0, 2 * m), slice(-2 * m, None), slice(0, width // 3), slice(-2 * m, None)
    return tuple(bool(t[r, c].any()) for r in (top, bottom) for c in (left, right))


def test_each_piece_has_its_corner() -> None:
    assert quarters(1280, 720, **ALL) == (True, True, True, True)
    assert quarters(1280, 720, title="A") == (True, False, False, False)
    assert quarters(1280, 720, north=30.0) == (False, True, False, False)
    assert quarters(1280, 720, note="A") == quarters(1280, 720, metres_per_pixel=3.0) == (False, False, True, False)
    assert quarters(1280, 720, legend=LEGEND) == (False, False, False, True)
    assert quarters(1280, 720) == (False, False, False, False)


@pytest.mark.stress
@settings(max_examples=60, deadline=None)
@given(st.integers(1, 900), st.integers(1, 700), st.text(max_size=60), st.floats(1e-3, 1e6))
def test_any_size_and_words(width: int, height: int, words: str, scale: float) -> None:
    before = blank(width, height)
    after = furnish(before, **{**ALL, "title": words, "metres_per_pixel": scale})
    assert after.shape == before.shape and after.dtype == np.uint8
    assert (before == 90).all()  # the caller's picture stays as it is
    assert (after == 90).all(2).mean() > 0.55


@pytest.mark.parametrize("size", [(320, 240), (640, 360), (400, 700), (1280, 720), (200, 120), (100, 60)])
def test_pieces_never_meet(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    boxes: list[tuple[int, int, int, int]] = []
    paint = furniture._paint
    monkeypatch.setattr(
        furniture, "_paint", lambda s, p, box, style, framed: (boxes.append(box), paint(s, p, box, style))
    )
    after = furnish(blank(*size), **{**ALL, "title": "A title that is far too long " * 3})
    cover = np.zeros(size[::-1], int)
    for x0, y0, x1, y1 in boxes:
        assert 0 < x0 < x1 < size[0] and 0 < y0 < y1 < size[1]
        cover[y0:y1, x0:x1] += 1
    assert boxes and cover.max() == 1
    assert (after[cover == 0] == 90).all()  # type stays on its paper


def test_what_goes_first() -> None:
    def kept(width: int, height: int) -> set[str]:
        whole = furnish(blank(width, height), **ALL)
        return {k for k in ALL if (furnish(blank(width, height), **{**ALL, k: None}) != whole).any()}

    order = ["title", "legend", "metres_per_pixel", "north", "note", "subtitle"]
    assert kept(1280, 720) == set(order)
    assert kept(320, 240) >= {"title", "legend", "metres_per_pixel", "north"}
    assert "title" in kept(110, 60) and "subtitle" not in kept(110, 60)
    assert kept(30, 20) == set()


def test_ramp_runs_from_low_to_high() -> None:
    after = furnish(blank(1280, 720), legend=LEGEND).astype(int)
    high, low = (np.abs(after - np.round(RAMP[i] * 255)).sum(2) < 4 for i in (-2, 1))
    assert high.sum() > 15 and low.sum() > 15
    assert np.nonzero(high)[0].mean() < np.nonzero(low)[0].mean() - 100
    swatch = (after == (112, 153, 178)).all(2)
    assert swatch.sum() > 100 and np.nonzero(swatch)[0].min() > np.nonzero(low)[0].max()


def test_scale_bar_is_as_long_as_it_says() -> None:
    scale = 85.0
    after = furnish(blank(1280, 720), metres_per_pixel=scale).astype(int)
    dark = np.abs(after - furniture.INK).sum(2) < 12
    row = np.argmax(dark.sum(1))  # the bar's edge is the longest dark line
    columns = np.nonzero(dark[row])[0]
    distance, _, name = bar_length(min(0.24 * (1280 - 36), 15 * 720 / 44) * scale)
    assert name == "20 km"
    assert columns.max() - columns.min() + 1 == pytest.approx(distance / scale, abs=3.0)


@pytest.mark.parametrize("north", [0.0, 45.0, 120.0, 200.0, 315.0])
def test_needle_points_north(north: float) -> None:
    before = blank(1280, 720)
    dark = furnish(before, north=north).astype(int).sum(2) < 200
    rows, cols = np.nonzero(dark)
    # The dark half-needle is slim: its long axis, through the letter, is the direction of north.
    points = np.stack([cols, rows], 1) - np.array([cols.mean(), rows.mean()])
    axis = np.linalg.svd(points, full_matrices=False)[2][0]
    wanted = np.array([math.sin(math.radians(north)), -math.cos(math.radians(north))])
    assert abs(axis @ wanted) > math.cos(math.radians(12))
    # Beyond the middle of the paper, towards north, lies the letter: upright, so it does not shrink to a line.
    paper = (furnish(before, north=north) != before).any(2)
    middle = np.array([np.nonzero(paper)[1].mean(), np.nonzero(paper)[0].mean()])
    ahead = (np.stack([cols, rows], 1) - middle) @ wanted
    assert ((ahead > 0.24 * math.sqrt(paper.sum())).sum()) > 10


def test_turning_the_needle_by_a_full_turn_changes_nothing() -> None:
    np.testing.assert_array_equal(furnish(blank(640, 360), north=-40.0), furnish(blank(640, 360), north=320.0))


def test_numbers() -> None:
    assert ticks(12, 4392, 5) == [1000, 2000, 3000, 4000]
    assert ticks(-85, 4404, 7) == [0, 1000, 2000, 3000, 4000]
    assert ticks(5, 5, 4) == [5] and ticks(math.nan, 5, 4) == []
    assert [number(v, [0.5, 1.0]) for v in (0.5, 1.0, -0.0)] == ["0.5", "1.0", "0"]
    assert number(12500, [10000, 12500]) == "12 500" and number(-400, [-400, -200]) == "−400"
    assert bar_length(7400) == (5000, 5, "5 km") and bar_length(999)[2] == "500 m" and bar_length(0.3)[2] == "20 cm"


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e4), st.integers(2, 12))
def test_ticks_are_round_within_and_enough(low: float, span: float, most: int) -> None:
    values = ticks(low, low + span, most)
    assert len(values) <= most and all(low - 1e-6 * span <= v <= low + span * (1 + 1e-6) for v in values)
    assert len(values) >= max(2, (most - 1) // 3)
    assert len({number(v, values) for v in values}) == len(values)


def test_signs_without_a_glyph_get_a_plain_form(monkeypatch: pytest.MonkeyPatch) -> None:
    style = lettering.Style.of((1280, 720), "heights ×2, 45° · north")
    assert style.face is None and style.text("×2 −1 45° · m²") == "×2 −1 45° · m²"
    monkeypatch.setattr(lettering, "FALLBACKS", ())
    monkeypatch.setattr(lettering, "_shipped", list)
    lettering._face.cache_clear()
    bare = lettering.Style.of((1280, 720), "Río 山")
    assert bare.text("Río 山") == "Rio ?"
    lettering._face.cache_clear()
    pytest.importorskip("matplotlib")
    monkeypatch.undo()
    assert lettering.Style.of((1280, 720), "Río").text("Río") == "Río"
    lettering._face.cache_clear()


def shown_at(width: int, height: int, ground: np.ndarray, **pieces: Any) -> list[tuple[int, int, int, int]]:
    """The boxes of what is drawn over ``ground``, and that they hide as little of it as their framing says."""
    boxes: list[tuple[int, int, int, int]] = []
    with pytest.MonkeyPatch.context() as patch:
        paint = furniture._paint
        patch.setattr(furniture, "_paint", lambda s, p, b, st, framed: (boxes.append(b), paint(s, p, b, st, framed)))
        furnish(blank(width, height), ground=ground, **pieces)
    return boxes


def test_insets_are_where_the_pieces_stand() -> None:
    for width, height in ((1280, 720), (900, 600), (2000, 2000), (700, 1000)):
        left, right, top, bottom = furniture.insets((width, height))
        free = np.zeros((height, width), bool)
        free[round(top * height) : round((1 - bottom) * height), round(left * width) : round((1 - right) * width)] = (
            True
        )
        pieces = {**ALL, "subtitle": None}
        sheet = np.empty((height, width, 3), np.uint8)
        sheet[:] = furniture.PAPER
        after = furnish(sheet, ground=free, paper=True, **pieces)
        assert not (after != furniture.PAPER).any(2)[free].any()
        assert not (after == furniture.EDGE).all(2).any()  # nothing is hidden, so no slips
        assert (furnish(sheet, ground=~free, paper=True, **pieces) == furniture.EDGE).all(2).any()
        assert (furnish(sheet, ground=free, paper=False, **pieces) == furniture.EDGE).all(2).any()
    assert max(furniture.insets((60, 40))) <= furniture.MOST_INSET


def test_a_long_note_has_room() -> None:
    """A note of data that takes two lines beside the legend."""
    note = "Temperature: mean of 31 at 12 h, sizes begin at 7.3 °C, ± standard deviation"
    size, legend = (900, 640), Legend((), (), note=note)
    _, right, top, bottom = furniture.insets(size, keys=(legend,))
    assert bottom > furniture.insets(size)[3]
    free = np.zeros((640, 900), bool)
    free[round(top * 640) : round((1 - bottom) * 640), : round((1 - right) * 900)] = True
    sheet = np.full((640, 900, 3), furniture.PAPER, np.uint8)
    told = {**ALL, "subtitle": None, "note": f"{furniture.PLAIN_NOTE} · {note}"}
    assert not (furnish(sheet, ground=free, paper=True, **told) == furniture.EDGE).all(2).any()


def test_pieces_go_where_less_ground_is() -> None:
    ground = np.zeros((720, 1280), bool)
    ground[360:, 640:] = True  # at the legend's usual corner
    (x0, y0, x1, y1), *_ = shown_at(1280, 720, ground, legend=LEGEND)
    assert not ground[y0:y1, x0:x1].any()
    ((x0, *_),) = shown_at(1280, 720, np.ones_like(ground), legend=LEGEND)
    assert x0 > 640  # no corner is better: it stays
    ((_, y0, *_),) = shown_at(1280, 720, np.arange(720)[:, None].repeat(1280, 1) < 360, title="A")
    assert y0 < 360  # a title is read first


def test_ends_of_the_ramp_tell_of_ground_beyond() -> None:
    def reach(**more: bool) -> tuple[int, int]:
        after = furnish(blank(1280, 720), legend=Legend((Scale(12.0, 4392.0, RAMP, **more),))).astype(int)
        return tuple(int((np.abs(after - np.round(RAMP[i] * 255)).sum(2) < 4).sum()) for i in (-1, 0))  # type: ignore[return-value]

    high, low = reach()
    assert reach(above=True)[0] > high + 40 and reach(above=True)[1] <= low + 5
    assert reach(below=True)[1] > low + 40 and reach(below=True)[0] <= high + 5


def test_patterns_are_drawn_pixel_by_pixel() -> None:
    tile = np.zeros((7, 7, 3), np.uint8)
    tile[..., 0], tile[..., 1] = np.arange(7)[:, None] + 201, np.arange(7) + 11
    after = furnish(blank(1280, 720), legend=Legend((), (("No data", tile),))).astype(int)
    rows, cols = np.nonzero((after[..., 2] == 0) & (after[..., 0] >= 201))
    assert len(rows) > 150
    swatch = after[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    np.testing.assert_array_equal(
        swatch[..., 0], ((np.arange(len(swatch)) % 7) + 201)[:, None].repeat(swatch.shape[1], 1)
    )
    assert (swatch[0, :, 1] - 11 == np.arange(swatch.shape[1]) % 7).all()


def test_grid_north_is_named() -> None:
    plain, named = (touched(1280, 720, north=0.0, grid_north=grid) for grid in (False, True))
    assert named.sum() > plain.sum() and np.nonzero(named)[0].max() > np.nonzero(plain)[0].max() + 8


@pytest.mark.parametrize(("low", "high"), [(291.6, 292.4), (0.2, 0.3), (9, 11), (-0.7, 0.4), (1999, 2001.5)])
def test_a_short_scale_has_two_values(low, high):
    values = ticks(low, high, 2)
    assert len(values) == 2 and low - 1e-9 <= values[0] < values[1] <= high + 1e-9
    assert [float(number(v, values).replace("−", "-")) for v in values] == pytest.approx(values, abs=1e-9)


def test_a_long_legend_keeps_its_classes() -> None:
    few, many = (
        Legend(LEGEND.scales, (("land cover", None), *((str(k), (9 * k, 80, 90)) for k in range(n)))) for n in (3, 60)
    )
    for legend, shown in ((few, 3), (many, 0)):
        layout = furniture.lay_out((1000, 700), legend=legend)
        words = [text[2] for piece, _ in layout.placed for text in piece.texts]
        assert "land cover" in words and all(str(k) in words for k in range(shown))
    assert any(word.startswith("and ") and word.endswith(" more") for word in words)


def test_long_titles_take_two_lines_and_are_whole_in_words() -> None:
    long = "Mean 2 metre temperature of the month's days at noon, as the model has it"
    for scale, whole in ((long[:30], True), (long, False), ("Potentialtemperaturunterschied" * 2, False)):
        legend = Legend((Scale(0.0, 1.0, np.zeros((2, 3)), "°C", scale),))
        piece = key(legend, style := lettering.Style(14.0, None), 9.0)
        lines = [text[2] for text in piece.texts if not text[2].replace(".", "").isdigit()]
        assert len(lines) <= 2 and lines[-1].endswith("(°C)")
        assert (" ".join(lines) == f"{scale} (°C)") is whole and (style.text("…") in lines[-1]) is not whole
        assert piece.width <= (WIDEST + 2) * style.unit
    one = orograph.terrain(np.zeros((20, 20), np.float32), spacing=10.0, progress=False)
    data = orograph.Dataset(np.indices((20, 20))[0].astype(float), name=long)
    assert long in orograph.render(one, "plan", size=(90, 60), data=data, furniture=True, samples=1).describe()


def test_a_plan_stands_beside_a_legend_with_a_long_title() -> None:
    x = np.linspace(0, 1, 60)
    ground = orograph.terrain(np.zeros((60, 60), np.float32), spacing=10.0, progress=False)
    data = orograph.Dataset(np.add.outer(x, x), name="potential temperature in kelvin")
    views = [orograph.render(ground, "plan", size=(420, 400), data=one, furniture=True, samples=1).view
             for one in (data, data.but(name="T"))]  # fmt: skip
    assert views[0].pixel_metres > 1.03 * views[1].pixel_metres


@pytest.mark.parametrize("unit", [9.0, 40.0])
def test_signs_that_the_typeface_lacks_are_drawn(unit: float) -> None:
    """× is a saltire, which an x with its feet is not: as high as wide, and the same turned by a quarter; − is a bar;
    ² stands above the baseline. None is the box of a missing character."""
    from PIL import Image

    style = lettering.Style(unit, None)

    def ink(words: str, anchor: str = "ls") -> np.ndarray:
        sheet = Image.new("L", (1200, 200), 0)
        lettering.set_type(sheet, (500, 100), words, style.font(), 255, anchor)  # type: ignore[arg-type]
        return np.asarray(sheet) > 100

    def box(found: np.ndarray) -> tuple[int, int, int, int]:
        rows, cols = np.nonzero(found.any(1))[0], np.nonzero(found.any(0))[0]
        return int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1

    top, bottom, left, right = box(ink("×"))
    cross, part = ink("×")[top:bottom, left:right], max(2, (right - left) // 4)
    assert abs((bottom - top) - (right - left)) <= 1 + 0.05 * unit
    assert all(corner.any() for corner in (cross[:part, :part], cross[:part, -part:], cross[-part:, -part:]))
    assert not cross[0, cross.shape[1] // 2] and not cross[-1, cross.shape[1] // 2]
    top, bottom, left, right = box(ink("−"))
    assert right - left > 2 * (bottom - top) and bottom < 100
    assert box(ink("²"))[1] <= 100 - round(0.25 * unit) and box(ink("²"))[1] - box(ink("²"))[0] < unit / 2 + 1
    # They take room, and anchors hold: what ends at a place ends there, its middle lies there.
    for words in ("heights ×1.3", "Wh/m²", "−7"):
        wide = lettering.length(style.font(), words)
        assert box(ink(words, "rs"))[3] <= 501 and abs(box(ink(words, "ls"))[3] - 500 - wide) < 0.2 * unit
        assert abs(sum(box(ink(words, "ms"))[2:]) / 2 - 500) < 0.15 * unit + 1
