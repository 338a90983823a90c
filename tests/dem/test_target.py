"""The choice of projection and grid, against EPSG's database, geodesics and published definitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS, Geod, Transformer

from orograph.dem import projection
from orograph.dem.lattice import group
from orograph.dem.projection import flat_crs, geodetic_base, horizontal, in_metres, scale_error, unwrapped, utm_crs
from orograph.dem.target import Target, choose, ground_spacing, parse_crs
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose

WGS84 = CRS.from_epsg(4326)


@dataclass
class Header:
    """A raster of which only the grid matters."""

    grid: Grid
    name: str = "header"
    vertical: str | None = None

    def read(self, row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
        raise AssertionError("the choice of a target reads no samples")


def degrees(west: float, south: float, east: float, north: float, n: int = 200, crs: CRS = WGS84) -> Grid:
    """A geographic raster of about n columns, square in degrees, of pixel areas."""
    step = (east - west) / n
    return Grid((round((north - south) / step), n), Affine(step, 0, west, 0, -step, north), crs)


def target(*grids: Grid, **options: object) -> Target:
    headers = [Header(g) for g in grids]
    return choose(sorted(group(headers, list(grids)), key=lambda g: ground_spacing(g.grid)), **options)  # type: ignore[arg-type]


def lonlat_error(grid: Grid) -> float:
    """Largest difference between distances in the grid and geodesics, relative, over short segments all over it."""
    crs = grid.crs
    assert crs is not None
    cols, rows = np.meshgrid(np.linspace(0, grid.cols - 1, 7), np.linspace(0, grid.rows - 1, 7))
    back = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    geod = Geod(a=crs.ellipsoid.semi_major_metre, b=crs.ellipsoid.semi_minor_metre)
    x, y = grid.xy(cols, rows)
    worst = 0.0
    for dx, dy in ((100.0, 0.0), (0.0, 100.0)):
        lon0, lat0 = back.transform(x - dx / 2, y - dy / 2)
        lon1, lat1 = back.transform(x + dx / 2, y + dy / 2)
        worst = max(worst, float(np.abs(100.0 / geod.inv(lon0, lat0, lon1, lat1)[2] - 1).max()))
    return worst


@pytest.mark.parametrize(
    ("box", "code"),
    [
        ((7.1, 46.0, 8.1, 47.0), 32632),
        ((-123.5, 45.0, -122.5, 46.0), 32610),
        ((175.0, -40.0, 176.0, -39.0), 32760),
        ((-180.0, 51.0, -179.0, 52.0), 32601),
        ((179.0, 65.0, 180.0, 66.0), 32660),
        ((6.0, -0.5, 12.0, 0.5), 32632),  # the whole width of a zone
        ((5.0, 45.0, 11.0, 48.0), 32632),
        ((367.1, 46.0, 368.1, 47.0), 32632),  # 0…360 and beyond
        ((237.0, 45.0, 238.0, 46.0), 32610),
    ],
)
def test_a_degree_tile_goes_to_its_utm_zone(box: tuple[float, ...], code: int) -> None:
    got = target(degrees(*box))
    assert got.grid.crs == CRS.from_epsg(code)
    assert lonlat_error(got.grid) < projection.UTM_LIMIT


@pytest.mark.parametrize(("code", "zone", "south", "utm"), [(4269, 11, False, 26911), (4258, 32, False, 25832)])
def test_datum_is_kept(code: int, zone: int, south: bool, utm: int) -> None:
    middle = zone * 6 - 183
    grid = degrees(middle - 1, 45, middle + 1, 47, crs=CRS.from_epsg(code))
    assert target(grid).grid.crs == CRS.from_epsg(utm)


def test_utm_codes_are_those_of_epsg() -> None:
    """Every code in the table is UTM of that zone on that datum, by EPSG's own definition."""
    for code, (north, south, zones) in projection._UTM_CODES.items():
        base = CRS.from_epsg(code)
        for zone in (zones[0], zones[len(zones) // 2], zones[-1]):
            for is_south in (s for s, first in ((False, north), (True, south)) if first is not None):
                crs = utm_crs(base, zone, is_south)
                assert crs.to_epsg() is not None
                assert crs.geodetic_crs == base
                assert f"zone {zone}" in crs.name
                parameters = {p.name: p.value for p in crs.coordinate_operation.params}
                assert parameters["Longitude of natural origin"] == zone * 6 - 183
                assert parameters["False northing"] == (10_000_000 if is_south else 0)


def test_a_datum_without_codes_gets_the_same_definition() -> None:
    base = CRS.from_epsg(4223)  # Carthage
    crs = utm_crs(base, 32, False)
    point = Transformer.from_crs(base, crs, always_xy=True).transform(9.5, 36.5)
    truth = Transformer.from_crs(base, CRS.from_epsg(22332), always_xy=True).transform(9.5, 36.5)  # Carthage / UTM 32N
    assert np.allclose(point, truth, atol=1e-6)


def test_wide_mid_latitudes_get_lambert_with_parallels_at_the_sixths() -> None:
    got = target(degrees(-125, 36, -114, 40, 1100))
    assert got.grid.crs is not None
    operation = got.grid.crs.coordinate_operation
    assert operation.method_name == "Lambert Conic Conformal (2SP)"
    parameters = {p.name: p.value for p in operation.params}
    assert sorted(parameters[f"Latitude of {n} standard parallel"] for n in ("1st", "2nd")) == pytest.approx(
        [36 + 4 / 6, 40 - 4 / 6], abs=0.01
    )
    assert parameters["Longitude of false origin"] == pytest.approx(-119.5, abs=0.01)
    assert lonlat_error(got.grid) < 0.0007


@pytest.mark.parametrize(
    ("box", "method", "error"),
    [
        ((-180, -90, 180, -60), "Polar Stereographic (variant A)", 0.04),  # Antarctica
        ((-180, 85, 180, 90), "Polar Stereographic (variant A)", 0.002),
        ((20, 85, 24, 86), "Polar Stereographic (variant A)", 0.0005),
        ((-60, -8, 60, 8), "Mercator (variant A)", 0.006),  # along the equator
        ((-10, 35, 40, 70), "Stereographic", 0.03),  # Europe, as wide as high
        ((-4, -35, 4, 37), "Transverse Mercator", 0.003),
        ((175, -48, 190, -33), "Transverse Mercator", 0.004),  # across the antimeridian
    ],
)
def test_other_areas_get_the_conformal_projection_that_fits(box: tuple[float, ...], method: str, error: float) -> None:
    grid = degrees(*box, n=720)
    got = target(grid)
    assert got.grid.crs is not None
    assert got.grid.crs.coordinate_operation.method_name == method
    lon, lat = (a.ravel() for a in np.meshgrid(np.linspace(box[0], box[2], 15), np.linspace(box[1], box[3], 15)))
    low, high = scale_error(got.grid.crs, lon, np.clip(lat, -89.9, 89.9))
    assert max(1 - low, high - 1) < error


@pytest.mark.parametrize("box", [(-180, -90, 180, 90), (0, -80, 360, 80), (-100, -70, 50, 75)])
def test_what_cannot_be_flat_is_refused_with_a_way_out(box: tuple[float, ...]) -> None:
    with pytest.raises(ReadError, match=r"too large for a flat projection.*`crs`"):
        target(degrees(*box, n=360))
    assert target(degrees(*box, n=360), crs=parse_crs("EPSG:8857")).grid.crs == CRS.from_epsg(8857)


@pytest.mark.parametrize("west", [-180, 0])
def test_a_whole_world_is_said_to_be_one(west: float) -> None:
    at_points = Grid((721, 1440), Affine(0.25, 0, west - 0.125, 0, -0.25, 90.125), WGS84)  # rows at the poles
    for grid in (at_points, degrees(west, -90, west + 360, 90, n=1440)):
        with pytest.raises(ReadError, match=r"360° of longitude by 180° of latitude"):
            target(grid)


@pytest.mark.parametrize("code", ["IAU_2015:49900", "IAU_2015:30100"])
def test_other_bodies_get_a_projection_on_their_own_ellipsoid(code: str) -> None:
    crs = CRS.from_user_input(code)
    got = target(degrees(10, 4, 12, 6, crs=crs))
    assert got.grid.crs is not None and "UTM" not in got.grid.crs.name
    assert got.grid.crs.ellipsoid.semi_major_metre == crs.ellipsoid.semi_major_metre
    assert lonlat_error(got.grid) < 0.001


def test_rotated_pole_goes_to_where_it_is() -> None:
    crs = CRS.from_proj4("+proj=ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p=39.25 +lon_0=18 +ellps=WGS84 +no_defs")
    got = target(Grid((100, 120), Affine(0.01, 0, -0.6, 0, -0.01, 0.5), crs))
    assert got.grid.crs is not None and got.grid.crs.is_projected
    middle = Transformer.from_crs(crs, WGS84, always_xy=True).transform(0.0, 0.0)
    x, y = Transformer.from_crs(WGS84, got.grid.crs, always_xy=True).transform(*middle)
    col, row = got.grid.index(x, y)
    assert abs(col - got.grid.cols / 2) < got.grid.cols * 0.05 and abs(row - got.grid.rows / 2) < got.grid.rows * 0.05


@pytest.mark.parametrize("latitude", [0.0, 38.0, -60.0, 80.0])
def test_cells_are_square_aligned_and_as_dense_as_the_source(latitude: float) -> None:
    source = degrees(7, latitude, 8, latitude + 1, 1200)
    grid = target(source).grid
    spacing = grid.transform.a
    assert grid.transform.e == -spacing and grid.transform.b == grid.transform.d == 0
    assert float(f"{spacing:.4g}") == spacing
    left, top = grid.transform.c / spacing, grid.transform.f / spacing
    assert abs(left - round(left)) < 1e-6 and abs(top - round(top)) < 1e-6
    lon, lat = source.xy(600, 600)
    geod = Geod(ellps="WGS84")
    d = source.transform.a / 2
    sides = geod.inv(lon - d, lat, lon + d, lat)[2], geod.inv(lon, lat - d, lon, lat + d)[2]
    assert spacing == pytest.approx(np.sqrt(sides[0] * sides[1]), rel=1e-3)


@pytest.mark.parametrize("box", [(7, 46, 8, 47), (-180, -90, 180, -70), (175, -48, 190, -33)])
def test_extent_covers_every_source_sample_and_little_more(box: tuple[float, ...]) -> None:
    source = degrees(*box, n=360)
    grid = target(source).grid
    cols, rows = np.meshgrid(np.arange(source.cols), np.arange(source.rows))
    x, y = Transformer.from_crs(source.crs, grid.crs, always_xy=True).transform(*source.xy(cols, rows))
    col, row = grid.index(x, y)
    assert col.min() >= -0.5 - 1e-6 and row.min() >= -0.5 - 1e-6
    assert col.max() <= grid.cols - 0.5 + 1e-6 and row.max() <= grid.rows - 0.5 + 1e-6
    assert col.min() < 0.5 and row.min() < 0.5 and col.max() > grid.cols - 1.5 and row.max() > grid.rows - 1.5


def test_a_projected_raster_is_kept_rotated_or_not() -> None:
    for transform in (
        Affine(30, 0, 500_000.5, 0, -30, 4_000_000),
        compose(Affine.translation(5e5, 4e6), Affine.rotation(20), Affine.scale(5, -5)),
    ):
        grid = Grid((30, 40), transform, CRS.from_epsg(32611))
        got = target(grid)
        assert got.grid == grid and got.kept


def test_resolution_and_crs_override() -> None:
    grid = Grid((300, 400), Affine(30, 0, 500_010, 0, -30, 4_000_020), CRS.from_epsg(32611))
    coarse = target(grid, resolution=100.0).grid
    assert coarse.crs == grid.crs and coarse.transform[:6] == (100, 0, 500_000, 0, -100, 4_000_000 + 100)
    other = target(grid, crs=parse_crs("EPSG:32612")).grid
    assert other.crs == CRS.from_epsg(32612) and other.transform.a == pytest.approx(30, rel=0.02)
    same = target(grid, crs=parse_crs("EPSG:32611"))
    assert same.grid == grid and same.kept


def test_projected_lattice_is_extended_by_whole_samples_over_coarser_ones() -> None:
    fine = Grid((100, 100), Affine(10, 0, 500_003, 0, -10, 4_000_007), CRS.from_epsg(32611))
    coarse = Grid((50, 50), Affine(90, 0, 499_000, 0, -90, 4_002_000), CRS.from_epsg(32611))
    got = target(fine, coarse).grid
    col, row = got.index(*fine.xy(0, 0))
    assert (col, row) == (pytest.approx(round(float(col))), pytest.approx(round(float(row))))
    for grid in (fine, coarse):
        for c, r in ((0, 0), (grid.cols - 1, grid.rows - 1)):
            col, row = got.index(*grid.xy(c, r))
            assert -0.5 <= col <= got.cols - 0.5 and -0.5 <= row <= got.rows - 0.5


@pytest.mark.parametrize("value", [0.0, -3.0, float("nan"), float("inf")])
def test_senseless_resolutions_are_refused(value: float) -> None:
    with pytest.raises(UsageError, match="length in metres"):
        target(degrees(7, 46, 8, 47), resolution=value)


def test_absurd_sizes_are_refused() -> None:
    with pytest.raises(UsageError, match="coarser `resolution`"):
        target(degrees(7, 46, 8, 47), resolution=0.001)


@pytest.mark.parametrize("text", ["EPSG:4326", "EPSG:4978", "no such thing", "EPSG:5773"])
def test_crs_that_is_not_flat_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError):
        parse_crs(text)


@pytest.mark.parametrize("code", [2229, 3089, 2277, 32664])  # US survey feet of several kinds
def test_feet_become_metres_without_moving_a_point(code: int) -> None:
    feet = CRS.from_epsg(code)
    metres, factor = in_metres(feet)
    assert factor == pytest.approx(1200 / 3937) and all(a.unit_conversion_factor == 1 for a in metres.axis_info)
    area = feet.area_of_use
    lon, lat = (area.west + area.east) / 2, (area.south + area.north) / 2
    base = feet.geodetic_crs
    x, y = Transformer.from_crs(base, feet, always_xy=True).transform(lon, lat)
    mx, my = Transformer.from_crs(base, metres, always_xy=True).transform(lon, lat)
    assert np.allclose([mx, my], [x * factor, y * factor], atol=1e-6)
    again, one = in_metres(metres)
    assert again == metres and one == 1
    assert parse_crs(f"EPSG:{code}") == metres


def test_horizontal_part_of_compound_bound_and_3d() -> None:
    assert horizontal(CRS.from_user_input("EPSG:32611+5773")) == CRS.from_epsg(32611)
    assert horizontal(CRS.from_epsg(4979)) == WGS84
    bound = CRS.from_proj4("+proj=utm +zone=33 +ellps=intl +towgs84=-87,-98,-121")
    assert not horizontal(bound).is_bound and horizontal(bound).is_projected


def test_paris_meridian_in_grads_falls_back_to_greenwich() -> None:
    ntf = CRS.from_epsg(4807)
    assert geodetic_base(ntf) == WGS84
    grid = Grid((100, 100), Affine(0.01, 0, 0.0, 0, -0.01, 52.0), ntf)  # grads east of Paris
    got = target(grid)
    assert got.grid.crs == CRS.from_epsg(32631)
    assert got.grid.transform.a == pytest.approx(np.sqrt(1000 * 1000 * np.cos(np.radians(46.4))), rel=0.01)


def test_unwrapped_leaves_the_widest_gap_outside() -> None:
    assert np.ptp(unwrapped(np.array([179.0, -179.0, 180.0]))) == pytest.approx(2)
    assert np.allclose(unwrapped(np.array([350.0, 10.0, 359.0])), [-10, 10, -1])
    assert np.allclose(unwrapped(np.array([-120.0, -110.0])), [-120, -110])


def test_flat_crs_is_the_same_for_wrapped_longitudes() -> None:
    lon, lat = np.meshgrid(np.linspace(170, 185, 20), np.linspace(-45, -35, 20))
    a = flat_crs(WGS84, lon.ravel(), lat.ravel())
    b = flat_crs(WGS84, ((lon + 180) % 360 - 180).ravel(), lat.ravel())
    assert a.crs == b.crs and a.scale_error == b.scale_error


def test_an_area_whose_middle_is_the_180th_meridian_but_for_rounding_has_a_zone():
    lon = np.array([179.5, 180.5, 179.5, 180.5]) - 4e-14
    flat = flat_crs(CRS.from_epsg(4326), lon, np.array([-16.5, -16.5, -17.5, -17.5]))
    assert flat.reason in ("UTM zone 60S", "UTM zone 1S")
