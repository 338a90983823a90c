"""Heights at a place are those of the file's own samples, whatever grid the terrain was brought to."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import rasterio
from affine import Affine
from closed_forms import rough, terrain_of
from pyproj import CRS, Transformer
from scipy.interpolate import RegularGridInterpolator

from orograph import measuring, store
from orograph.dem.mosaic import Mosaic
from orograph.geo.grid import Grid
from orograph.store.prepare import prepare
from orograph.store.source import ArraySource

CELL = 1 / 1200


def degrees(heights, west=-71.5, north=44.5, cell=CELL):
    """A raster in longitude and latitude."""
    return ArraySource(heights, Grid(heights.shape, Affine(cell, 0, west, 0, -cell, north), CRS(4326)), "degrees")


def test_at_a_file_s_own_samples_heights_are_the_file_s(shared_data):
    path = shared_data / "n44w072-hgt" / "N44W072.hgt"
    with rasterio.open(path) as file:
        raw, transform = file.read(1), file.transform
    terrain = prepare([str(path)])
    rng = np.random.default_rng(2)
    row, col = np.append(rng.integers(0, len(raw), 200), 875), np.append(rng.integers(0, raw.shape[1], 200), 836)
    lon, lat = transform @ (col + 0.5, row + 0.5)
    points = measuring.Places(terrain).of_lonlat(np.stack([lon, lat], axis=-1))
    hits = [measuring.place(terrain, p) for p in points]
    np.testing.assert_allclose([h.height for h in hits], raw[row, col], atol=1e-3)
    surface = np.array([h.surface_height for h in hits])
    assert 1.0 < np.abs(surface - raw[row, col]).max() < 60.0  # it is drawn on another grid
    line = measuring.profile(terrain, points[:4])
    np.testing.assert_allclose(line.heights[line.vertices], raw[row[:4], col[:4]], atol=1e-3)
    np.testing.assert_allclose(line.surface_heights[line.vertices], surface[:4], atol=1e-6)


def test_between_samples_heights_are_bilinear(tmp_path):
    h = np.random.default_rng(0).uniform(0, 900, (70, 90)).astype(np.float32)
    raster = degrees(h)
    terrain = store.terrain(Mosaic([raster]))
    rng = np.random.default_rng(1)
    x, y = rng.uniform(2, 87, 300), rng.uniform(2, 67, 300)
    lon, lat = raster.grid.xy(x, y)
    expected = RegularGridInterpolator((np.arange(70.0), np.arange(90.0)), h.astype(np.float64))(np.stack([y, x], -1))
    points = measuring.Places(terrain).of_lonlat(np.stack([lon, lat], axis=-1))
    found = [measuring.place(terrain, p).height for p in points]
    np.testing.assert_allclose(found, expected, atol=1e-3)
    line = measuring.profile(terrain, points[:3])
    line.save(tmp_path / "p.csv", every=500.0)
    with (tmp_path / "p.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    at = np.array([[float(r["longitude"]), float(r["latitude"])] for r in rows])
    u, v = raster.grid.index(*at.T)
    expected = RegularGridInterpolator((np.arange(70.0), np.arange(90.0)), h.astype(np.float64))(np.stack([v, u], -1))
    np.testing.assert_allclose([float(r["height_m"]) for r in rows], expected, atol=0.05)  # 8 decimals of a degree
    surface = line.at([float(r["distance_m"]) for r in rows[:-1]])[1]
    np.testing.assert_allclose([float(r["surface_height_m"]) for r in rows[:-1]], surface, atol=0.05)


@pytest.mark.parametrize("columns", [72, 73])  # the last as the first once more
@pytest.mark.parametrize("west", [-180.0, 0.0])
def test_across_the_seam_of_a_globe_heights_are_bilinear(tmp_path, west, columns):
    """Between the last column and the first lies ground like any other; the band is that of the tropics."""
    cell = 5.0
    lon, lat = west + cell * (np.arange(columns) + 0.5), 30 - cell * (np.arange(12) + 0.5)
    h = 1000 + 500 * np.cos(np.radians(lon - 40))[None, :] * np.cos(np.radians(2 * lat))[:, None]
    mosaic = Mosaic([degrees(h.astype(np.float32), west, 30.0, cell)], crs="+proj=eqc +lon_0=90 +datum=WGS84")
    rng = np.random.default_rng(3)
    at_lon = np.append(west + rng.uniform(-cell / 2, cell / 2, 60), rng.uniform(-180, 180, 60))
    at_lat = rng.uniform(-25, 25, 120)
    x, y = Transformer.from_crs(4326, mosaic.grid.crs, always_xy=True).transform(at_lon, at_lat)
    around = np.append(lon[:72], lon[0] + 360) if columns == 72 else lon
    model = RegularGridInterpolator((-lat, around), h if columns == 73 else np.append(h, h[:, :1], axis=1))
    expected = model(np.stack([-at_lat, (at_lon - lon[0]) % 360 + lon[0]], -1))
    truth = 1000 + 500 * np.cos(np.radians(at_lon - 40)) * np.cos(np.radians(2 * at_lat))
    assert np.abs(expected - truth).max() < 500 * np.radians(cell) ** 2 * (1 + 4) / 8
    np.testing.assert_allclose(mosaic.heights_at(x, y), expected, atol=1e-3)
    kept = store.build(mosaic, tmp_path / "globe.oro", shard=64, chunk=32)
    np.testing.assert_allclose(kept.samples.heights_at(x, y), expected, atol=1e-3)


def test_of_several_lattices_the_finest_that_has_a_height_counts():
    coarse = degrees(np.full((40, 40), 100, np.float32), cell=2 * CELL)
    fine = np.full((30, 30), 700, np.float32)
    fine[10:20, 10:20] = np.nan
    mosaic = Mosaic([degrees(fine), coarse])
    west, north = -71.5, 44.5
    lon = west + CELL * np.array([5.5, 15.5, 60.5, -9.0])
    lat = north - CELL * np.array([5.5, 15.5, 60.5, 5.5])
    x, y = Transformer.from_crs(4326, mosaic.grid.crs, always_xy=True).transform(lon, lat)
    np.testing.assert_allclose(mosaic.heights_at(x, y), [700, 100, 100, np.nan])


def test_a_raster_that_is_kept_has_heights_of_its_own_samples_and_between_them():
    h = rough((40, 50), 4)
    h[20, 20] = np.nan
    terrain = terrain_of(h, crs="EPSG:32611")
    x, y = terrain.grid.xy([7.0, 7.25, 20.4, 49.0], [9.0, 9.5, 20.4, 39.0])
    hits = [measuring.place(terrain, p) for p in np.stack([x, y], axis=-1)]
    assert hits[0].height == hits[0].surface_height == h[9, 7] and hits[3].height == h[39, 49]
    assert hits[1].height == pytest.approx(0.375 * (h[9, 7] + h[10, 7]) + 0.125 * (h[9, 8] + h[10, 8]), abs=1e-3)
    assert hits[2].height is None and hits[2].surface_height is None


def test_converted_heights_are_converted_at_places_too(shared_data):
    h = np.random.default_rng(3).uniform(0, 900, (30, 40)).astype(np.float32)
    grid = Grid(h.shape, Affine(900, 0, 500_000, 0, -900, 5_200_000), CRS(32633))
    raster = ArraySource(h, grid, "metres", "EGM96 height")
    mosaic = Mosaic([raster], to_vertical="ellipsoidal", geoid=shared_data / "egm96-grid" / "egm96_15.gtx")
    x, y = mosaic.grid.xy(np.arange(3, 30.0), np.arange(2, 29.0))
    kept = mosaic.read(0, 30, 0, 40)
    np.testing.assert_allclose(mosaic.heights_at(x, y), kept[np.arange(2, 29), np.arange(3, 30)], atol=2e-3)
    assert np.abs(kept - h).min() > 10
