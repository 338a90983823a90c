"""Colours: the sRGB curve's published points, OKLab's, and the spans of tints."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis import color
from orograph.geovis.color import TINTS, color_table, linear_to_srgb, srgb_to_linear, tint_of
from orograph.geovis.tables import Table
from orograph.store import MemoryTerrain


def terrain(heights, crs="EPSG:32611"):
    heights = np.asarray(heights, np.float32)
    grid = Grid(heights.shape, Affine(30, 0, 0, 0, -30, 0), None if crs is None else CRS.from_user_input(crs))
    return MemoryTerrain(heights, grid, "made up")


def test_the_srgb_curve():
    """IEC 61966-2-1: 0.04045 ↔ 0.0031308, mid grey 0.5 → 0.21404, 18 % grey → 0.46136."""
    np.testing.assert_allclose(srgb_to_linear(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.214041, 1], rtol=1e-4)
    np.testing.assert_allclose(linear_to_srgb(np.array([0.18, 0.0031308])), [0.461356, 0.04045], rtol=1e-4)
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(x)), x, atol=2e-6)
    np.testing.assert_allclose(linear_to_srgb(np.array([-1.0, 2.0])), [0, 1], atol=1e-6)


def test_oklab_matrices_are_ottossons():
    """His published pairs: XYZ (0.950, 1, 1.089), white, is L = 1, a = b = 0; and sRGB red."""

    def lab(rgb):
        return color._M2 @ np.cbrt(color._M1 @ rgb)

    np.testing.assert_allclose(lab(np.ones(3)), [1, 0, 0], atol=1e-4)
    np.testing.assert_allclose(lab(np.array([1.0, 0, 0])), [0.62796, 0.22486, 0.12585], atol=1e-4)
    np.testing.assert_allclose(lab(np.array([0, 0, 1.0])), [0.45201, -0.03246, -0.31153], atol=1e-4)


@pytest.mark.parametrize("name", sorted(TINTS))
def test_tints_pass_through_their_stops(name):
    table = linear_to_srgb(color_table(name, 1001)) * 255
    for at, code in TINTS[name]:
        expected = [int(code[i : i + 2], 16) for i in (1, 3, 5)]
        np.testing.assert_allclose(table[round(at * 1000)], expected, atol=1.0)
    assert np.abs(np.diff(table, axis=0)).max() < 3  # no jumps


def test_names_of_the_catalogue():
    for name in ("viridis", "cmocean:topo", "matplotlib:gist_earth"):
        table = color_table(name, 256)
        assert table.shape == (256, 3) and table.dtype == np.float32 and table.min() >= 0 and table.max() <= 1
    first = np.round(linear_to_srgb(color_table("viridis", 256)[0]) * 255)
    np.testing.assert_allclose(first, [68, 1, 84], atol=1)  # matplotlib's viridis begins with #440154


@pytest.mark.parametrize(("wrong", "meant"), [("virids", "viridis"), ("alpin", "alpine"), ("gist_eart", "gist_earth")])
def test_unknown_names_are_answered_with_similar_ones(wrong, meant):
    with pytest.raises(UsageError, match=f"no colour map '{wrong}'.*{meant}"):
        color_table(wrong)


def test_a_name_like_nothing():
    with pytest.raises(UsageError, match="Try alpine"):
        color_table("zzzzqqq")


def test_spikes_do_not_wash_out_the_rest():
    heights = np.linspace(200, 800, 10_000).reshape(100, 100)
    heights[3, 3], heights[60, 60] = 9000, -500
    tint = tint_of(terrain(heights))
    assert tint.low == pytest.approx(203, abs=5) and tint.high == pytest.approx(797, abs=5) and not len(tint.sea)


def test_flat_ground_has_a_span_too():
    tint = tint_of(terrain(np.full((9, 9), 42.0)))
    assert tint.low < 42 < tint.high
    heights = np.full((9, 9), np.nan)
    heights[4, 4] = 7
    tint = tint_of(terrain(heights))
    assert tint.low < 7 < tint.high


def basin(part, depth=-80.0):
    heights = np.linspace(10, 2000, 10_000)
    heights[: int(part * 10_000)] = np.linspace(depth, -5, int(part * 10_000))
    return heights.reshape(100, 100)


def test_sea_floors_have_their_own_tint():
    """Death Valley lies 86 m below the sea in a few hundredths of its surroundings; an ocean takes more of a map."""
    assert not len(tint_of(terrain(basin(0.05))).sea)
    tint = tint_of(terrain(basin(0.5, -4000)))
    assert len(tint.sea) and tint.low == 0 and tint.floor == pytest.approx(-3960, abs=20)
    assert len(tint_of(terrain(basin(0.05)), sea=True).sea)
    assert not len(tint_of(terrain(basin(0.5)), sea=False).sea)
    assert not len(tint_of(terrain(basin(0.5)), "viridis").sea)
    assert not len(tint_of(terrain(np.linspace(-430, -20, 10_000).reshape(100, 100))).sea)  # around the Dead Sea
    floor = tint_of(terrain(basin(0.5) - 4000))  # no land is as deep
    assert len(floor.sea) and floor.floor == pytest.approx(-4080, abs=20)


def test_other_planets_have_no_sea():
    mars = tint_of(terrain(basin(0.5, -4000), "+proj=eqc +R=3396190 +units=m"))
    assert not len(mars.sea)
    np.testing.assert_array_equal(mars.land, color_table("mars"))
    moon = tint_of(terrain(basin(0.5, -4000), "+proj=eqc +R=1737400 +units=m"))
    np.testing.assert_array_equal(moon.land, color_table("grey"))
    named = tint_of(terrain(basin(0), "+proj=eqc +R=1737400 +units=m"), "viridis")
    np.testing.assert_array_equal(named.land, color_table("viridis"))


def hill(low: float, high: float):
    return np.linspace(low, high, 10_000).reshape(100, 100)


def color_at(tint, height):
    return [np.interp(height, np.linspace(tint.low, tint.high, len(tint.land)), tint.land[:, k]) for k in range(3)]


def test_a_color_of_the_default_tint_stands_for_a_height():
    """Two countries of which one has more relief: the same heights have the same colors."""
    alps, himalaya = tint_of(terrain(hill(400, 3500))), tint_of(terrain(hill(300, 7000)))
    for height in (600, 1500, 3000):
        np.testing.assert_allclose(color_at(alps, height), color_at(himalaya, height), atol=0.01)


def test_snow_lies_on_mountains_only():
    summit, lowland = color_table("alpine")[-1], color_table("alpine")[0]
    coast = tint_of(terrain(hill(1, 80)))
    assert np.abs(coast.land - summit).max(1).min() > 0.2  # nowhere near white
    np.testing.assert_allclose(coast.land[0], lowland, atol=0.02)
    assert np.abs(coast.land[-1] - coast.land[0]).max() > 0.2  # and yet not all of one color
    plateau = tint_of(terrain(hill(4900, 5100)))
    np.testing.assert_allclose(plateau.land[-1], summit, atol=0.02)
    assert np.abs(plateau.land[-1] - plateau.land[0]).max() > 0.1
    shelf, ocean = (tint_of(terrain(basin(0.5, depth))) for depth in (-40.0, -6000.0))
    assert shelf.sea[0].mean() > ocean.sea[0].mean() + 0.1  # shoals are paler than the deep


def test_a_range_is_the_scale_of_several_pictures():
    low, high = tint_of(terrain(hill(100, 900)), span=(0, 2000)), tint_of(terrain(hill(1000, 1900)), span=(0, 2000))
    assert (low.low, low.high) == (high.low, high.high) == (0, 2000)
    np.testing.assert_array_equal(low.land, high.land)
    assert not low.above and tint_of(terrain(hill(100, 900)), "viridis", span=(0, 500)).above
    coast = tint_of(terrain(basin(0.5, -4000)), span=(-2000, 1000))
    assert (coast.floor, coast.low, coast.high) == (-2000, 0, 1000) and coast.below and coast.above


def test_the_legend_shows_both_tables():
    tint = tint_of(terrain(basin(0.5, -4000)))
    low, high, table = tint.scale(1001)
    assert (low, high) == (tint.floor, tint.high)
    z = np.linspace(low, high, 1001)
    shore = np.searchsorted(z, 0.0)
    np.testing.assert_array_equal(table[0], tint.sea[0])
    depths = np.linspace(low, 0.0, len(tint.sea))
    wet = [np.interp(z[:shore], depths, tint.sea[:, k]) for k in range(3)]
    np.testing.assert_allclose(table[:shore].T, wet, atol=0.02)
    np.testing.assert_array_equal(table[shore], tint.land[0])
    np.testing.assert_allclose(table[-1], tint.land[-1], atol=0.01)
    plain = tint_of(terrain(basin(0)))
    low, high, table = plain.scale()
    assert (low, high) == (plain.low, plain.high)
    np.testing.assert_array_equal(table, plain.land)


@pytest.mark.parametrize("name", ["cmocean:topo", "oleron", "crameri:bukavu", "fes"])
def test_maps_with_a_shore_have_it_at_zero(name):
    """Their sea half for the sea, and none of it inland, whatever the range of heights."""
    import cmap

    published = srgb_to_linear(np.asarray(cmap.Colormap(name)([0.0, 0.49, 0.51, 1.0]))[:, :3])
    coast = tint_of(terrain(basin(0.3, -500)), name)
    assert coast.low == 0 and coast.floor == pytest.approx(-495, abs=10)
    np.testing.assert_allclose(coast.sea[[0, -3]], published[:2], atol=0.02)
    np.testing.assert_allclose(coast.land[[2, -1]], published[2:], atol=0.02)
    for inland in (tint_of(terrain(basin(0) + 105), name), tint_of(terrain(basin(0.3, -500)), name, sea=False)):
        assert not len(inland.sea)
        np.testing.assert_array_equal(inland.land, coast.land)
    assert tint_of(terrain(basin(0) + 105), name).low > 100


def test_what_is_no_land_and_sea_has_no_sea():
    assert not len(tint_of(terrain(basin(0.5, -15))).sea)  # a polder
    flat = basin(0.5, -80)
    assert not len(tint_of(terrain(np.where(flat > 0, flat / 200, flat))).sea)
    shallow = MemoryTerrain(np.asarray(basin(0.5) - 2100, np.float32) / 40, terrain(basin(0.5)).grid, "bathymetry_2020")
    assert len(tint_of(shallow).sea)
    for name, sea in (("egm96_15", False), ("us_geoid18", False), ("legmont", True)):
        heights = np.asarray(basin(0.5, -80), np.float32)
        grid = Grid(heights.shape, Affine(30, 0, 0, 0, -30, 0), CRS.from_user_input("EPSG:32611"))
        assert bool(len(tint_of(MemoryTerrain(heights, grid, name)).sea)) == sea


def test_clipped_ends_are_told():
    heights = np.linspace(200, 800, 10_000).reshape(100, 100)
    plain = tint_of(terrain(heights))
    assert not plain.below and not plain.above  # half a hundredth of the span: nobody sees it
    heights[3, 3] = 9000
    spiked = tint_of(terrain(heights))
    assert spiked.above and not spiked.below
    heights[9, 9] = -500
    assert tint_of(terrain(heights)).below


def test_a_name_that_several_catalogues_have_is_taken_silently(caplog):
    with caplog.at_level("WARNING", "cmap"):
        color_table("RdBu", 8)
        Table.of("RdGy")
    assert not caplog.records
