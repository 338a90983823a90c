"""Every sample of an area has one tile, and lies where that tile says: any product, any box on the globe."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from orograph.fetching.areas import area_of
from orograph.fetching.products import products
from orograph.fetching.tiling import lay_out
from orograph.geo.ellipsoid import EARTH

DEGREES = [name for name, one in products().items() if one.tiling == "degrees"]


@given(
    st.sampled_from(DEGREES), st.floats(-180, 180), st.floats(-88, 86), st.floats(0.001, 1.5), st.floats(0.001, 1.5),
    st.booleans(),
)  # fmt: skip
@settings(max_examples=150, deadline=None)
def test_each_sample_has_one_tile_and_lies_where_that_says(name, west, south, wide, high, whole):
    product = products()[name]
    if whole:  # bounds on whole degrees
        west, south, wide, high = round(west), round(south), 1 + round(wide), 1 + round(high)
    assume(south < product.extent[3] and south + high > product.extent[1])
    box = area_of((west, south, west + wide, south + high), None, EARTH)
    layout = lay_out(product, box)
    rows = 0
    for band in layout.bands:
        assert band.row0 == rows
        rows = band.row1
        cols = 0
        for piece in band.pieces:
            size = piece.row1 - piece.row0, piece.col1 - piece.col0
            assert (piece.row, piece.col, size[0]) == (0, cols, band.row1 - band.row0)
            cols += size[1]
            own = piece.tile.grid
            more = int(product.shared)
            assert 0 <= piece.row0 < piece.row1 <= own.rows + more
            assert 0 <= piece.col0 < piece.col1 <= own.cols + more
            for row, col in ((0, 0), (size[0] - 1, size[1] - 1)):
                x, y = own.xy(piece.col0 + col, piece.row0 + row)
                place = (piece.col + col - band.start) / band.step
                u, v = layout.grid.xy(place, band.row0 + piece.row + row)
                assert (float(u - x) + 180) % 360 - 180 == pytest.approx(0, abs=1e-9)
                assert float(v) == pytest.approx(float(y), abs=1e-9)
        assert cols == band.cols
        last = band.start + (layout.grid.cols - 1) * band.step
        assert band.start >= -1e-6
        assert last <= band.cols - 1 + 1e-6
    assert rows == layout.grid.rows


@given(st.sampled_from(DEGREES), st.floats(-179, 178), st.floats(-54, 58), st.floats(0.001, 1.2), st.floats(0.001, 1.2))
@settings(max_examples=150, deadline=None)
def test_samples_surround_the_area_and_are_no_more(name, west, south, wide, high):
    product = products()[name]
    assume(south < product.extent[3] and south + high > product.extent[1])
    box = area_of((west, south, west + wide, south + high), None, EARTH)
    grid = lay_out(product, box).grid
    x, y = grid.spacing
    if product.registration == "point":
        (left, top), (right, bottom) = grid.xy(0, 0), grid.xy(grid.cols - 1, grid.rows - 1)
    else:
        left, bottom, right, top = grid.bounds()
    slack = 1e-5
    assert box.west - x * (1 + slack) < left <= box.west + x * slack
    assert box.east - x * slack <= right < box.east + x * (1 + slack)
    assert box.north - y * slack <= top < box.north + y * (1 + slack)
    assert box.south - y * (1 + slack) < bottom <= box.south + y * slack


def test_the_whole_globe_has_each_meridian_once():
    layout = lay_out(products()["copernicus-90"], area_of((-180, 0.25, 180, 0.5), None, EARTH))
    assert layout.grid.cols == 360 * 1200
    assert len(layout.tiles) == 360


def test_names_of_tiles_are_those_of_their_makers():
    """Of places in the four quarters of the globe, and on corners."""

    def urls(name, *box):
        return [tile.url.rpartition("/")[2] for tile in lay_out(products()[name], area_of(box, None, EARTH)).tiles]

    assert urls("copernicus-30", 6.2, 0.2, 6.3, 0.3) == ["Copernicus_DSM_COG_10_N00_00_E006_00_DEM.tif"]
    assert urls("copernicus-30", -171.5, -13.5, -171.4, -13.4) == ["Copernicus_DSM_COG_10_S14_00_W172_00_DEM.tif"]
    assert urls("srtm-1", -0.5, -0.5, -0.4, -0.4) == ["S01W001.tif"]
    assert urls("alos-30", -10.5, 15.5, -10.4, 15.6) == ["ALPSMLC30_N015W011_DSM.tif"]
    assert urls("3dep-10", -105.5, 39.5, -105.4, 39.6) == ["USGS_13_n40w106.tif"]
    assert urls("3dep-30", 144.7, 13.4, 144.8, 13.5) == ["USGS_1_n14e144.tif"]
    assert urls("aster", -73.5, 9.5, -73.4, 9.6) == ["ASTGTMV003_N09W074_dem.tif"]
    assert urls("srtm-1-nasa", 13.1, 0.1, 13.2, 0.2) == ["N00E013.SRTMGL1.hgt.zip"]
    assert urls("copernicus-30", 7, 46, 8, 47) == [  # their last row and column are the next ones'
        f"Copernicus_DSM_COG_10_N{lat}_00_E00{lon}_00_DEM.tif" for lat in (46, 45) for lon in (7, 8)
    ]


@pytest.mark.parametrize(
    ("south", "columns"), [(0, 3600), (49, 3600), (50, 2400), (60, 1800), (70, 1200), (80, 720), (85, 360),
                           (-1, 3600), (-50, 3600), (-51, 2400), (-61, 1800), (-90, 360)],
)  # fmt: skip
def test_widths_of_copernicus_tiles_are_those_of_its_readme(south, columns):
    """copernicus-dem-30m.s3.amazonaws.com/readme.html: COG widths by latitude."""
    layout = lay_out(products()["copernicus-30"], area_of((10.25, south + 0.25, 10.5, south + 0.5), None, EARTH))
    assert layout.tiles[0].grid.shape == (3600, columns)
