"""Elevation as text: what is no number is refused with its line and column, and numbers are counted."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from orograph.dem import Source, read
from orograph.errors import ReadError

ARC = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9999\n"
GRASS = "north: 2\nsouth: 0\neast: 3\nwest: 0\nrows: 2\ncols: 3\n"
SURFER = "DSAA\n3 2\n0 2\n0 1\n1 6\n"
FORMATS = {"arc.asc": ARC, "grass.asc": GRASS, "surfer.grd": SURFER}


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, newline="")
    return path


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    "token",
    ["abc", "--", "NULL", "0x10", "1,234.5", "*", "-", "1e", "1.5.2", "7m", "1_000", "1d3", "-nan", "1;2", "٣", "1\0"],
)
def test_a_token_that_is_no_number(tmp_path: Path, name: str, token: str) -> None:
    path = written(tmp_path, name, FORMATS[name] + f"1 2.5 3\n4 {token} 6\n")
    with pytest.raises(ReadError) as caught:
        read(path)
    line = FORMATS[name].count("\n") + 2
    assert f"Line {line}, column 3: {token!r} is not a number." in str(caught.value) and name in str(caught.value)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("1 2 3\n4 5\n", "holds 5 numbers where its header promises 6: line {} has 2 of 3"),
        ("1 2\n4 5 6\n", "line {} has 2 of 3"),
        ("1 2 3\n4 5 6 7\n", "holds 7 numbers"),
        ("1 2 3\n4 5 6\njunk\n", "Line {}, column 1: 'junk'"),
        ("1 2 3\r\n4 5 6\r\n 9\r\n", "line {} has 1 of 3"),
    ],
)
def test_numbers_missing_or_too_many(tmp_path: Path, name: str, body: str, said: str) -> None:
    odd = next(i for i, line in enumerate(body.splitlines(), 1) if len(line.split()) != 3)
    with pytest.raises(ReadError) as caught:
        read(written(tmp_path, name, FORMATS[name] + body))
    assert said.format(FORMATS[name].count("\n") + odd) in str(caught.value)


@pytest.mark.parametrize(
    ("body", "heights"),
    [
        ("1 -2.5 +3\n4e1 .5 6.\n", [[1, -2.5, 3], [40, 0.5, 6]]),
        ("1 2\n3 4 5\n6", [[1, 2, 3], [4, 5, 6]]),
        ("\t1\t2 3\r\n4 5 6\r\n\x1a", [[1, 2, 3], [4, 5, 6]]),
        ("1 nan 3\n4 -9999 NaN\n", [[1, np.nan, 3], [4, np.nan, np.nan]]),
        ("1 1.#QNAN 3\n4 inf 6\n", [[1, np.nan, 3], [4, np.nan, 6]]),
        ("1,5 2,25 3\n4 5 1234,567\n", [[1.5, 2.25, 3], [4, 5, 1234.567]]),
        ("1 2 3\n4 5 6.25\n", [[1, 2, 3], [4, 5, 6.25]]),
    ],
)
def test_what_is_right_is_read_right(tmp_path: Path, body: str, heights: list[list[float]]) -> None:
    np.testing.assert_array_equal(read(written(tmp_path, "a.asc", ARC + body)).heights, np.float32(heights))


def test_thousands_or_decimals(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"Line 8: the commas"):
        read(written(tmp_path, "a.asc", ARC + "1 2 3\n4 1,234 2,100\n"))


def test_decimals_behind_the_first_hundred_thousand_bytes(tmp_path: Path) -> None:
    """GDAL takes a grid for whole numbers by its beginning."""
    rows = ["100 " * 300] * 299 + ["100.75 " * 299 + "nan"]
    header = ARC.replace("ncols 3", "ncols 300").replace("nrows 2", "nrows 300")
    heights = read(written(tmp_path, "a.asc", header + "\n".join(rows) + "\n")).heights
    assert heights[299, 0] == 100.75 and heights[0, 0] == 100 and np.isnan(heights[299, 299])


@pytest.mark.parametrize("parting", [" ", "\t", ",", ", ", ";"])
@pytest.mark.parametrize("title", ["", "x{0}y{0}z\n"])
def test_columns_of_points(tmp_path: Path, parting: str, title: str) -> None:
    lines = [parting.join((str(i % 3), str(1 - i // 3), f"{i}.5")) for i in range(6)]
    text = title.format(parting) + "\n".join(lines) + "\n"
    np.testing.assert_array_equal(read(written(tmp_path, "a.xyz", text)).heights, [[0.5, 1.5, 2.5], [3.5, 4.5, 5.5]])
    with pytest.raises(ReadError, match=r"Line (3|4), column|cannot open"):
        read(written(tmp_path, "b.xyz", title.format(parting) + "\n".join(lines).replace("2.5", "2.5m")))


def test_a_token_at_the_border_of_two_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from orograph.dem.whole import text

    values = np.random.default_rng(1).normal(500, 300, (40, 50)).round(3)
    header = ARC.replace("ncols 3", "ncols 50").replace("nrows 2", "nrows 40")
    body = "\n".join(" ".join(map(str, row)) for row in values) + "\n"
    for piece in (8, 17, 64, 1000):
        monkeypatch.setattr(text, "_PIECE", piece)
        path = written(tmp_path, f"{piece}.asc", header + body)
        np.testing.assert_array_equal(read(path).heights, values.astype(np.float32))
        lines = (header + body).splitlines()
        lines[30] = lines[30].replace(" ", " x", 1)
        at = lines[30].index("x")
        path = written(tmp_path, f"{piece}bad.asc", "\n".join(lines))
        with pytest.raises(ReadError, match=f"Line 31, column {at + 1}: 'x"):
            read(path)


def test_large_grids_are_gone_through_fast(tmp_path: Path) -> None:
    """More than 40 MB a second, compiling aside: a hundred megabytes take seconds at most."""
    header = ARC.replace("ncols 3", "ncols 2000").replace("nrows 2", "nrows 2000")
    Source.open(written(tmp_path, "small.asc", ARC + "1 2 3\n4 5 6\n")).close()
    path = written(tmp_path, "large.asc", header + ("1234.5 " * 2000 + "\n") * 2000)
    begun = time.perf_counter()
    Source.open(path).close()
    assert time.perf_counter() - begun < path.stat().st_size / 40e6 + 1


def _points(folder: Path, heights: np.ndarray, gap: tuple[int, int] | None, by_columns: bool = False) -> Path:
    rows, cols = heights.shape
    order = [(r, c) for c in range(cols) for r in range(rows)] if by_columns else list(np.ndindex(rows, cols))
    lines = [f"{10 * c} {-10 * r} {heights[r, c]:.10g}\n" for r, c in order if (r, c) != gap]
    return written(folder, "points.xyz", "".join(lines))


@pytest.mark.parametrize("heights", [[0, 50, 200], [-40000, -35000, 0], [-40000.5, 2, 3]])
def test_a_gap_between_points_is_never_a_height(tmp_path: Path, heights: list[float]) -> None:
    """GDAL has no nodata value for bytes with 0 among them, nor for depths beyond −32768: gaps are 0 to it."""
    whole = np.resize(heights, (3, 4)).astype(float)
    np.testing.assert_array_equal(read(_points(tmp_path, whole, None)).heights, whole.astype(np.float32))
    with pytest.raises(ReadError, match=r"lacks 1 of 12 points"):
        read(_points(tmp_path, whole, (1, 2)))
    whole += 45000
    found = read(_points(tmp_path, whole, (1, 2))).heights
    whole[1, 2] = np.nan
    np.testing.assert_array_equal(found, whole.astype(np.float32))


@pytest.mark.parametrize("least", [-295, -1, 0, 1])
def test_points_along_columns(tmp_path: Path, least: int) -> None:
    """GDAL reads −295 as −294 there, if all numbers are whole."""
    heights = least + np.arange(12).reshape(3, 4) * 30
    path = _points(tmp_path, heights, None, by_columns=True)
    if least < 0:
        with pytest.raises(ReadError, match="sort them by rows"):
            read(path)
    else:
        np.testing.assert_array_equal(read(path).heights, heights)
    np.testing.assert_array_equal(read(_points(tmp_path, heights, None)).heights, heights)
