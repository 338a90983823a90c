"""Tiles of an image that does not fit into memory: what a picture sees is what it sees of all of it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import ReadError
from orograph.geo.grid import Grid
from orograph.geovis.drape import Drape
from orograph.slots import HELD

GRID = Grid((400, 400), Affine(30, 0, 500_000, 0, -30, 6_700_000), CRS.from_epsg(32633))
SPAN = 12_000.0
Floats = NDArray[np.float64]


def write(path: Path, side: int = 1900, crs: int = 32633, transform: Affine | None = None) -> str:
    """Noise at every scale, partly transparent."""
    rng = np.random.default_rng(0)
    pixels = np.zeros((side, side, 4), np.int64)
    for cells in (4, 30, 200, side):
        at = np.arange(side) * cells // side
        pixels[..., :3] += rng.integers(0, 64, (cells, cells, 3))[at[:, None], at[None, :]]
    pixels[..., 3] = 255
    pixels[300:500, 900:1500, 3] = 0
    with rasterio.open(
        path, "w", driver="GTiff", count=4, height=side, width=side, dtype="uint8", crs=CRS(crs).to_wkt(),
        transform=transform or Affine(SPAN / side, 0, 500_000, 0, -SPAN / side, 6_700_000), tiled=True, blockxsize=256,
        blockysize=256, photometric="rgb",
    ) as file:  # fmt: skip
        file.write(np.moveaxis(pixels.astype(np.uint8), -1, 0))
    return str(path)


def footprints(n: int = 250, seed: int = 1) -> tuple[Floats, Floats, Floats, Floats]:
    """Places over the terrain and a little beyond, and ellipses of all sizes, shapes and directions there."""
    rng = np.random.default_rng(seed)
    x, y = 500_000 + rng.uniform(-200, SPAN + 200, n), 6_700_000 - rng.uniform(-200, SPAN + 200, n)
    x[7] = np.nan
    wide, turn, thin = np.exp(rng.uniform(0, np.log(1500), n)), rng.uniform(0, 7, n), rng.uniform(0.01, 1, n)
    c, s = np.cos(turn), np.sin(turn)
    ground = np.stack([wide * c, wide * s, -thin * wide * s, thin * wide * c], 1)
    return x, y, ground, 0.05 * thin * wide


def small(path: str, memory: int = 10 << 20) -> Drape:
    drape = Drape.open(path, GRID, memory)
    assert drape.tiles is not None and drape.texels.base >= 2
    assert drape.texels.pool.nbytes + drape.tiles._pool.nbytes <= memory // 4
    return drape


@pytest.mark.cases(2)
@pytest.mark.parametrize("overviews", [False, True])
@pytest.mark.parametrize("crs", [32633, 4326])
def test_they_show_what_the_whole_image_shows(tmp_path: Path, overviews: bool, crs: int) -> None:
    degrees = Affine(0.23 / 1900, 0, 14.995, 0, -0.115 / 1900, 60.4395)
    path = write(tmp_path / "a.tif", crs=crs, transform=degrees if crs == 4326 else None)
    if overviews:
        with rasterio.open(path, "r+") as file:
            file.build_overviews([2, 4, 8], rasterio.enums.Resampling.average)
    whole, some = Drape.open(path, GRID), small(path)
    assert whole.tiles is None
    x, y, ground, least = footprints()
    truth, got = whole.spread(x, y, ground, least), some.spread(x, y, ground, least)
    there = (truth[:, 3] > 0.05) & (got[:, 3] > 0.05)
    assert 0.5 < there.mean() < 1 and some.tiles is not None and some.tiles.read > some.tiles.capacity  # some left
    # Bytes are rounded once instead of level by level; a file's overviews are means of its bytes, not of light.
    np.testing.assert_allclose(got[:, 3], truth[:, 3], atol=0.02)
    assert np.abs(got - truth)[there, :3].max() < (0.12 if overviews else 0.03)
    assert np.abs(got - truth)[there, :3].mean() < (0.03 if overviews else 1e-3)
    plain = whole.sample(x, y, least), some.sample(x, y, least)
    assert np.abs(plain[0] - plain[1])[plain[0][:, 3] > 0.05, :3].mean() < (0.03 if overviews else 1e-3)
    assert (got[7] == 0).all()


def test_neither_threads_nor_order_nor_memory_change_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif")
    x, y, ground, least = footprints(90)
    alone = small(path).spread(x, y, ground, least)
    drape = small(path)
    parts = [np.arange(k, 90, 6) for k in range(6)]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(2):
            got = pool.map(lambda i: drape.spread(x[i], y[i], ground[i], least[i]), parts)
            for i, values in zip(parts, got, strict=True):
                np.testing.assert_array_equal(values, alone[i])
    assert drape.tiles is not None and not drape.tiles._users.any()


def test_a_file_that_vanishes_is_an_error_in_every_thread_and_works_again_when_it_is_back(tmp_path: Path) -> None:
    path = Path(write(tmp_path / "a.tif"))
    x, y, ground, least = footprints(120)
    ground *= 1e-3  # the finest levels
    truth = small(str(path)).spread(x, y, ground, 1e-3 * least)
    drape = small(str(path))
    data = path.read_bytes()
    path.unlink()
    with ThreadPoolExecutor(4) as pool:
        for job in [pool.submit(drape.spread, x, y, ground, 1e-3 * least) for _ in range(4)]:
            with pytest.raises(ReadError, match=r"a\.tif"):
                job.result(60)
    tiles = drape.tiles
    assert tiles is not None and not tiles._users.any() and tiles._slots.room(HELD) == tiles.capacity
    path.write_bytes(data)
    np.testing.assert_array_equal(drape.spread(x, y, ground, 1e-3 * least), truth)


def test_a_small_part_of_a_huge_image_is_read_alone(tmp_path: Path) -> None:
    """10^10 pixels without overviews; from near by only the few that are seen are read."""
    side = 100_000
    path = tmp_path / "huge.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=3, height=side, width=side, dtype="uint8", crs=CRS(32633).to_wkt(),
        transform=Affine(SPAN / side, 0, 500_000, 0, -SPAN / side, 6_700_000), tiled=True, blockxsize=512,
        blockysize=512, compress="deflate", sparse_ok=True, photometric="rgb", BIGTIFF="YES",
    ) as file:  # fmt: skip
        i, j = np.mgrid[:2048, :2048]
        board = np.broadcast_to(np.where((i // 4 + j // 4) % 2, 200, 20).astype(np.uint8), (3, 2048, 2048))
        file.write(board, window=((50_000, 52_048), (50_000, 52_048)))
    drape = Drape.open(str(path), GRID, 64 << 20)
    assert drape.warnings == [] and drape.tiles is not None and drape.texels.kept is not None
    pixel = SPAN / side
    at = 50_200 + np.arange(400) * 4 + 2.0
    x, y = 500_000 + pixel * at, 6_700_000 - pixel * np.full(400, 50_202.0)
    square = pixel * np.tile([1.0, 0.0, 0.0, 1.0], (400, 1))
    got = drape.spread(x, y, square, np.zeros(400))[:, 0]
    bright, dark = (np.array([200, 20]) / 255 + 0.055) / 1.055
    np.testing.assert_allclose(got[::2], got[0], atol=1e-6)
    assert {round(float(v), 4) for v in (got[0], got[1])} == {round(float(v**2.4), 4) for v in (bright, dark)}
    assert drape.tiles.read < 30 and not drape.texels.held and not drape.texels.kept.folder.exists()
