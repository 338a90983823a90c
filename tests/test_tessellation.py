"""Welding against a reference in plain Python (a dictionary and exact fractions of area), and files against NumPy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from orograph.errors import OutputError, ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.tessellation import Tessellation

NORTH_UP, SOUTH_UP = Affine(10, 0, 5e5, 0, -20, 4e6), Affine(10, 0, 5e5, 0, 20, 4e6)
TURNED = Affine(8, 6, 5e5, 6, -8, 4e6)
TRANSFORMS = [NORTH_UP, SOUTH_UP, TURNED, Affine(0, 5, 0, 5, 0, 0), Affine(-3, 0, 0, 0, -3, 0)]

Corner = tuple[int, int]


def keys(corners: Any) -> np.ndarray:
    """(…, 2) rows and columns → int64 keys."""
    a = np.asarray(corners, np.int64) if len(corners) else np.empty((0, 2), np.int64)
    return a[..., 0] << 32 | a[..., 1]


def heights_of(k: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """A height that tells the sample a key is squeezed onto."""
    return (np.minimum(k >> 32, rows - 1) * 1000 + np.minimum(k & 0xFFFFFFFF, cols - 1)).astype(np.float32)


def turn(a: Corner, b: Corner, c: Corner) -> int:
    """Sign of the area of (row, col) corners as drawn with rows downwards: 1 clockwise."""
    value = (b[1] - a[1]) * (c[0] - a[0]) - (c[1] - a[1]) * (b[0] - a[0])
    return (value > 0) - (value < 0)


def map_area(mesh: Tessellation, grid: Grid) -> np.ndarray:
    """Signed areas on the map: positive if counter-clockwise, from CRS coordinates."""
    p = mesh.positions(grid)[mesh.triangles][..., :2]
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2


def rotated(t: Any) -> tuple[Corner, ...]:
    """A triangle that begins at its smallest corner, turning as before."""
    i = min(range(3), key=lambda j: t[j])
    return tuple(t[i:]) + tuple(t[:i])


corner = st.tuples(st.integers(0, 8), st.integers(0, 8))


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(corner, corner, corner), max_size=40),
    st.integers(1, 9), st.integers(1, 9), st.sampled_from(TRANSFORMS), st.booleans(),
)  # fmt: skip
def test_triangles_are_squeezed_welded_and_turned(soup, rows, cols, transform, clockwise):
    """Arbitrary triangles, all turning the same way: the same ones, squeezed, come back counter-clockwise."""
    want = 1 if clockwise else -1
    given_ = [t if turn(*t) == want else (t[0], t[2], t[1]) for t in soup if turn(*t) != 0]
    squeezed = [tuple((min(r, rows - 1), min(c, cols - 1)) for r, c in t) for t in given_]
    kept = [t for t in squeezed if turn(*t) == want]  # arbitrary ones may turn over; the hierarchy's cannot
    given_ = [g for g, t in zip(given_, squeezed) if turn(*t) in (0, want)]
    grid = Grid((rows, cols), transform)
    k = keys(given_).reshape(-1, 3)
    mesh = Tessellation.from_triangles(grid, k, heights_of(k, rows, cols), clockwise=clockwise)
    assert (map_area(mesh, grid) > 0).all()
    assert len(np.unique(mesh.vertices[:, :2], axis=0)) == len(mesh.vertices) == len({v for t in kept for v in t})
    assert np.array_equal(mesh.vertices[:, 2], mesh.vertices[:, 1] * 1000 + mesh.vertices[:, 0])
    place = [(int(r), int(c)) for c, r, _ in mesh.vertices]
    found = [tuple(place[i] for i in t) for t in mesh.triangles]
    flip = (transform.determinant > 0) != clockwise
    assert [rotated(t) for t in found] == [rotated((t[0], t[2], t[1]) if flip else t) for t in kept]


@settings(max_examples=150, deadline=None)
@given(st.lists(corner, max_size=40), st.integers(1, 9), st.integers(1, 9), st.sampled_from(TRANSFORMS), st.booleans())
def test_strips_alternate_and_skip_triangles_without_area(walk, rows, cols, transform, clockwise):
    grid = Grid((rows, cols), transform)
    k = keys(walk).reshape(-1)
    mesh = Tessellation.from_strip(grid, k, heights_of(k, rows, cols), clockwise=clockwise)
    squeezed = [(min(r, rows - 1), min(c, cols - 1)) for r, c in walk]
    flip = (transform.determinant > 0) != clockwise
    expected = []
    for i in range(len(walk) - 2):
        a, b, c = squeezed[i : i + 3]
        if turn(a, b, c) != 0:
            expected.append(rotated((a, b, c) if (i % 2 == 1) == flip else (a, c, b)))
    place = [(int(r), int(c)) for c, r, _ in mesh.vertices]
    assert [rotated([place[i] for i in t]) for t in mesh.triangles] == expected
    assert len(set(place)) == len(place)
    # The strip alone says the same: every second triangle turned over, those without area left out.
    assert mesh.strip is not None
    drawn = []
    for i in range(len(mesh.strip) - 2):
        t = [place[j] for j in mesh.strip[i : i + 3]]
        if turn(*t) != 0:
            drawn.append(rotated([t[0], t[2], t[1]] if i % 2 else t))
    assert drawn == expected


def cells(n: int) -> np.ndarray:
    """The n × n cells of a square as (2 n², 3) keys, clockwise as drawn with rows downwards."""
    r, c = np.mgrid[0:n, 0:n]
    a, b, d, e = (keys(np.stack([r + i, c + j], -1)) for i in (0, 1) for j in (0, 1))
    return np.stack([np.stack([a, b, e], -1), np.stack([a, e, d], -1)], -2).reshape(-1, 3)


@pytest.mark.parametrize("shape", [(65, 65), (40, 65), (65, 33), (50, 37), (2, 64)])
def test_a_square_squeezed_onto_a_raster_covers_it_once(shape):
    """More vertices than the table begins with, in random order: areas add up to the raster's, every sample is used."""
    k = cells(64)[np.random.default_rng(3).permutation(2 * 64 * 64)]
    grid = Grid(shape, NORTH_UP)
    mesh = Tessellation.from_triangles(grid, k, heights_of(k, *shape), clockwise=True)
    rows, cols = shape
    assert len(mesh.triangles) == 2 * (rows - 1) * (cols - 1)
    assert map_area(mesh, grid).sum() == (rows - 1) * (cols - 1) * 200
    assert len(mesh.vertices) == rows * cols


def test_tables_grow_in_the_middle_of_the_work():
    """Triangles that share no vertex: three times as many vertices as triangles, six times what is expected."""
    n = 5000
    at = np.arange(n) * 4
    corners = np.stack([np.stack([at * 0, at], -1), np.stack([at * 0, at + 1], -1), np.stack([at * 0 + 1, at], -1)], 1)
    k = keys(corners)
    grid = Grid((2, 4 * n), SOUTH_UP)
    mesh = Tessellation.from_triangles(grid, k, heights_of(k, 2, 4 * n), clockwise=True)
    assert np.array_equal(mesh.vertices[mesh.triangles][..., :2], corners[..., ::-1])
    strip = Tessellation.from_strip(grid, k.reshape(-1), heights_of(k, 2, 4 * n).reshape(-1), clockwise=True)
    assert np.array_equal(strip.vertices[strip.strip][:, :2], corners.reshape(-1, 2)[:, ::-1])


def test_nothing_is_a_mesh_without_triangles():
    grid = Grid((5, 5), NORTH_UP)
    none = Tessellation.from_triangles(grid, np.empty((0, 3), np.int64), np.empty((0, 3), np.float32), clockwise=True)
    assert none.vertices.shape == (0, 3) and none.triangles.shape == (0, 3)
    for clockwise in (True, False):
        none = Tessellation.from_strip(grid, np.empty(0, np.int64), np.empty(0, np.float32), clockwise=clockwise)
        assert none.strip is not None and none.strip.shape == (0,)


def small() -> tuple[Tessellation, Grid]:
    grid = Grid((9, 9), TURNED, CRS.from_epsg(32633))
    k = cells(8)
    made = Tessellation.from_triangles(grid, k, heights_of(k, 9, 9), clockwise=True)
    return Tessellation(
        made.vertices, made.triangles, np.arange(5, dtype=np.int32), {"method": "test", "ms": 1.5}
    ), grid


def test_files_hold_everything(tmp_path: Path):
    mesh, grid = small()
    assert mesh.save(tmp_path / "mesh.npz", grid) == tmp_path / "mesh.npz"
    again = Tessellation.load(tmp_path / "mesh.npz")
    assert np.array_equal(again.vertices, mesh.vertices) and np.array_equal(again.triangles, mesh.triangles)
    assert again.strip is not None and np.array_equal(again.strip, np.arange(5))
    assert again.stats == mesh.stats and again.grid == grid
    with np.load(tmp_path / "mesh.npz") as file:  # as others read it
        assert file["vertices"].dtype == np.float64 and file["triangles"].dtype == np.int32
        assert json.loads(str(file["stats"]))["method"] == "test"
        assert CRS.from_wkt(str(file["crs"])).to_epsg() == 32633
    bare = Tessellation(mesh.vertices, mesh.triangles)
    bare.save(tmp_path / "bare.npz", Grid((9, 9), NORTH_UP))
    again = Tessellation.load(tmp_path / "bare.npz")
    assert again.strip is None and again.stats == {} and again.grid is not None and again.grid.crs is None
    assert again.save(tmp_path / "bare.npz").read_bytes() and np.array_equal(
        again.positions(), bare.positions(again.grid)
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bare.npz", "mesh.npz"]


def test_files_that_cannot_be_used(tmp_path: Path):
    mesh, grid = small()
    with pytest.raises(OutputError, match="no folder"):
        mesh.save(tmp_path / "none" / "mesh.npz", grid)
    with pytest.raises(UsageError, match="not JSON"):
        Tessellation(mesh.vertices, mesh.triangles, None, {"error": float("nan")}).save(tmp_path / "m.npz", grid)
    with pytest.raises(UsageError, match=r"has no grid.*terrain\.grid"):
        mesh.save(tmp_path / "m.npz")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ReadError, match="cannot be read"):
        Tessellation.load(tmp_path / "absent.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ReadError, match="not a tessellation"):
        Tessellation.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ReadError, match="not a tessellation"):
        Tessellation.load(tmp_path / "other.npz")
    whole = mesh.save(tmp_path / "mesh.npz", grid).read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ReadError, match="not a tessellation"):
        Tessellation.load(tmp_path / "half.npz")


@pytest.mark.parametrize(
    ("vertices", "triangles", "strip"),
    [
        (np.zeros((3, 2)), np.zeros((1, 3), np.int32), None),
        (np.zeros((3, 3), np.float32), np.zeros((1, 3), np.int32), None),
        (np.zeros((3, 3)), np.zeros((1, 3), np.int64), None),
        (np.zeros((3, 3)), np.zeros(3, np.int32), None),
        (np.zeros((3, 3)), np.full((1, 3), 3, np.int32), None),
        (np.zeros((3, 3)), np.full((1, 3), -1, np.int32), None),
        (np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.zeros((2, 2), np.int32)),
        (np.zeros((3, 3)), np.zeros((1, 3), np.int32), np.full(4, 7, np.int32)),
        ([[0.0, 0.0, 0.0]], np.zeros((1, 3), np.int32), None),
    ],
)
def test_wrong_arrays_are_refused(vertices, triangles, strip):
    with pytest.raises(UsageError, match="tessellation"):
        Tessellation(vertices, triangles, strip)


def test_wrong_corners_are_refused():
    grid = Grid((9, 9), NORTH_UP)
    with pytest.raises(UsageError, match="keys"):
        Tessellation.from_triangles(grid, np.zeros((2, 3)), np.zeros((2, 3), np.float32), clockwise=True)
    with pytest.raises(UsageError, match="heights"):
        Tessellation.from_triangles(grid, np.zeros((2, 3), np.int64), np.zeros(2, np.float32), clockwise=True)
    with pytest.raises(UsageError, match="heights"):
        Tessellation.from_strip(grid, np.zeros(2, np.int64), np.zeros(2), clockwise=True)
