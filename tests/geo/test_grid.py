"""Affine maps against matrices, and grids against rasterio: whichever affine is installed, and without warnings."""

from __future__ import annotations

import numpy as np
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import rowcol, xy

from orograph.geo.grid import Grid, apply, compose, name_of

numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
maps = st.builds(Affine, numbers, numbers, numbers, numbers, numbers, numbers)


def matrix(transform: Affine) -> np.ndarray:
    return np.array(tuple(transform)[:9], float).reshape(3, 3)


@given(st.lists(maps, min_size=1, max_size=4))
def test_compose_is_the_product_of_matrices(several: list[Affine]) -> None:
    product = np.eye(3)
    size = np.eye(3)  # of the terms that are summed: what rounding is relative to
    for one in several:
        product, size = product @ matrix(one), size @ abs(matrix(one))
    assert (abs(matrix(compose(*several)) - product) <= 1e-14 * size).all()


@given(maps, numbers, numbers)
def test_apply_is_the_matrix_times_the_point(transform: Affine, x: float, y: float) -> None:
    found = apply(transform, [x, 0], [y, 0])
    expected = matrix(transform) @ [x, y, 1]
    size = abs(matrix(transform)) @ [abs(x), abs(y), 1]
    assert abs(found[0][0] - expected[0]) <= 1e-14 * size[0] and abs(found[1][0] - expected[1]) <= 1e-14 * size[1]
    assert (found[0][1], found[1][1]) == (transform.c, transform.f)


def test_places_and_extent_are_rasterio_s() -> None:
    transform = Affine(8.0, 3.0, 500_000.0, 4.0, -9.0, 4_000_000.0)  # sheared and turned
    grid = Grid((30, 40), transform)
    cols, rows = np.array([0, 39, 7, 0]), np.array([0, 29, 11, 29])
    expected = xy(transform, rows, cols, offset="center")
    np.testing.assert_allclose(grid.xy(cols, rows), expected, rtol=0, atol=1e-8)
    col, row = grid.index(*expected)
    np.testing.assert_allclose((col, row), (cols, rows), rtol=0, atol=1e-6)
    assert np.array_equal(rowcol(transform, *expected), (rows, cols))
    corners = [xy(transform, r, c, offset="ul") for r in (0, 30) for c in (0, 40)]
    xs, ys = zip(*corners)
    assert grid.bounds() == (min(xs), min(ys), max(xs), max(ys))
    part = grid.window(5, 9, -2, 6)
    np.testing.assert_allclose(part.xy(0, 0), grid.xy(-2, 5), rtol=0, atol=1e-8)


def test_a_crs_without_a_name_has_that_of_the_one_it_equals() -> None:
    from pyproj import CRS

    nad27 = CRS("EPSG:26710")
    text = nad27.to_wkt("WKT1_GDAL").replace('PROJCS["NAD27 / UTM zone 10N"', 'PROJCS["unnamed"')
    assert name_of(CRS(text)) == name_of(nad27) == "NAD27 / UTM zone 10N"
    odd = CRS("+proj=tmerc +lon_0=8.3 +k=0.99971 +x_0=12345 +ellps=bessel +units=m")
    assert name_of(odd) is None
    assert Grid((2, 2), Affine.identity()).crs_name == "no CRS"
