"""A store of a resampled raster keeps the raster's own samples, and knows what resampling has lost."""

from __future__ import annotations

import math
import shutil

import numpy as np
import pytest
import rasterio
import zarr
from affine import Affine
from pyproj import CRS, Transformer
from surfaces import grid_of, rough
from surfaces import surface as plain_surface

from orograph import measuring, store
from orograph.dem.mosaic import Mosaic
from orograph.errors import DamagedChunkError, StoreError, StoreReplacedError
from orograph.geo.grid import Grid
from orograph.measuring.text import lines
from orograph.store.repair import repair
from orograph.store.source import ArraySource
from orograph.store.storage import FolderStorage

CELL = 1 / 1200
SIZES = {"shard": 64, "chunk": 32}


def degrees(heights, west=-71.5, north=44.5, cell=CELL):
    return ArraySource(heights, Grid(heights.shape, Affine(cell, 0, west, 0, -cell, north), CRS(4326)), "degrees")


def write(path, heights, west=-71.5, north=44.5, nodata=-32768):
    numbers = np.where(np.isnan(heights), nodata, heights).astype(np.int16)
    with rasterio.open(
        path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1, dtype="int16",
        crs="EPSG:4326", transform=Affine(CELL, 0, west, 0, -CELL, north), nodata=nodata,
    ) as file:  # fmt: skip
        file.write(numbers, 1)
    return path


def whole(shape, seed, **how):
    return np.round(rough(shape, seed, **how))


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with two files of one lattice, a void in one of them, and a store of them."""
    folder = tmp_path_factory.mktemp("made")
    write(folder / "a.tif", whole((130, 100), 1, hole=True))
    write(folder / "b.tif", whole((90, 110), 2, missing=0.01), west=-71.5 + 95 * CELL)
    store.build([folder / "a.tif", folder / "b.tif"], folder / "s.oro", errors=(), **SIZES).close()
    return folder


@pytest.fixture
def area(made, tmp_path):
    return shutil.copytree(made / "s.oro", tmp_path / "s.oro")


@pytest.mark.stress
def test_at_all_samples_of_a_real_raster_the_store_says_what_the_raster_says(shared_data, tmp_path):
    path = shared_data / "n44w072-hgt" / "N44W072.hgt"
    with rasterio.open(path) as file:
        raw, transform = file.read(1), file.transform
    terrain = store.build(path, tmp_path / "s.oro", errors=())
    row, col = np.indices(raw.shape).reshape(2, -1)
    x, y = Transformer.from_crs(4326, terrain.grid.crs, always_xy=True).transform(*(transform @ (col + 0.5, row + 0.5)))
    found = terrain.samples.heights_at(x, y)
    np.testing.assert_allclose(found, raw.ravel(), atol=1e-3)
    np.testing.assert_array_equal(found, Mosaic.open(path).heights_at(x, y))
    between = np.stack([x[5000:9000] + 31.0, y[5000:9000] - 47.0])
    np.testing.assert_array_equal(terrain.samples.heights_at(*between), Mosaic.open(path).heights_at(*between))
    highest = int(np.argmax(raw))
    hit = measuring.place(terrain, (x[highest], y[highest]))
    assert hit.height == pytest.approx(raw.max(), abs=1e-3) and hit.height_error is None
    assert hit.surface_height < hit.height
    lost = terrain.resampled
    assert lost.highest == raw.max() and 0 < lost.highest_loss <= lost.summit_loss <= lost.largest < 60
    assert 1 < lost.rms < 3


def test_samples_are_kept_as_the_file_has_them(made):
    mosaic = Mosaic.open([made / "a.tif", made / "b.tif"])
    terrain = store.open(made / "s.oro")
    (lattice,) = terrain.record.lattices
    assert (lattice.dtype, lattice.nodata) == ("int16", -32768)
    array = zarr.open_group(made / "s.oro", mode="r")["source/0/height"]
    assert array.dtype == np.int16
    with rasterio.open(made / "a.tif") as a, rasterio.open(made / "b.tif") as b:
        first, second = a.read(1), b.read(1)
    expected = np.full((130, 205), -32768, np.int16)
    expected[:90, 95:] = second
    expected[:130, :100] = np.where(first == -32768, expected[:, :100], first)
    np.testing.assert_array_equal(array[:], expected)
    assert array.attrs["_FillValue"] == -32768
    rng = np.random.default_rng(0)
    x, y = terrain.grid.xy(rng.uniform(0, terrain.grid.cols, 3000), rng.uniform(0, terrain.grid.rows, 3000))
    found = terrain.samples.heights_at(x, y)
    np.testing.assert_array_equal(found, mosaic.heights_at(x, y))
    assert np.isnan(found).any() and not np.isnan(found).all()


def test_other_tools_open_them_with_their_coordinates(made):
    xarray = pytest.importorskip("xarray")
    opened = xarray.open_zarr(made / "s.oro", group="source/0")
    assert opened.x.attrs["standard_name"] == "longitude" and opened.y.attrs["units"] == "degrees_north"
    assert float(opened.x[0]) == pytest.approx(-71.5 + CELL / 2, abs=1e-12)
    height = opened.height.values
    assert np.isnan(height).sum() == (zarr.open_group(made / "s.oro", mode="r")["source/0/height"][:] == -32768).sum()


@pytest.mark.parametrize("dtype", ["float32", "float64", "uint16", "int32"])
def test_what_is_no_small_whole_number_is_kept_as_it_is_read(tmp_path, dtype):
    heights = (rough((40, 50), 3) * 40).astype(dtype)
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=50, height=40, count=1, dtype=dtype, crs="EPSG:4326",
        transform=Affine(CELL, 0, 7, 0, -CELL, 46),
    ) as file:  # fmt: skip
        file.write(heights, 1)
    terrain = store.build(tmp_path / "a.tif", tmp_path / "s.oro", errors=(), **SIZES)
    assert terrain.record.lattices[0].dtype == "float32"
    kept = zarr.open_group(tmp_path / "s.oro", mode="r")["source/0/height"][:]
    np.testing.assert_array_equal(kept, heights.astype(np.float32))


def test_what_is_not_resampled_keeps_nothing_more(tmp_path):
    heights = rough((50, 60), 4)
    turned = Grid(heights.shape, Affine(20, 9, 5e5, 9, -20, 4e6), CRS(32611))
    for grid in (grid_of(heights.shape), turned):
        with store.build(Mosaic([ArraySource(heights, grid, "m")]), tmp_path / "s.oro", overwrite=True) as terrain:
            assert terrain.samples is None and terrain.resampled is None and not terrain.record.lattices
            assert not (tmp_path / "s.oro" / "source").exists()
            x, y = grid.xy(7, 9)
            assert measuring.place(terrain, (x, y)).height_error is None


@pytest.mark.parametrize("options", [{"resolution": 70.0}, {"crs": "EPSG:32612", "resampling": "cubic"}])
def test_a_projected_raster_that_is_resampled_is_kept(tmp_path, options):
    heights = rough((60, 70), 5)
    terrain = store.build(Mosaic([ArraySource(heights, grid_of(heights.shape), "m")], **options), tmp_path / "s.oro")
    x, y = grid_of(heights.shape).xy(*np.indices(heights.shape).reshape(2, -1)[::-1])
    x, y = Transformer.from_crs(32611, terrain.grid.crs, always_xy=True).transform(x, y)
    np.testing.assert_allclose(terrain.samples.heights_at(x, y), heights.ravel(), atol=1e-3)
    assert terrain.resampled.largest > 0.5 and terrain.check() == []


def losses(terrain, heights, grid, counts):
    """Deviations, losses of summits, and the highest sample with its loss, one sample after the other."""
    drawn = terrain.read(0, 0, terrain.grid.rows, 0, terrain.grid.cols)
    to = Transformer.from_crs(grid.crs, terrain.grid.crs, always_xy=True)
    off, summits, highest = [], [], (-math.inf, 0.0)
    rows, cols = heights.shape
    for i in range(rows):
        for j in range(cols):
            h = float(heights[i, j])
            if math.isnan(h) or not counts[i, j]:
                continue
            u, v = (float(w) for w in terrain.grid.index(*to.transform(*grid.xy(j, i))))
            if not (0 <= u < drawn.shape[1] - 1 and 0 <= v < drawn.shape[0] - 1):
                continue
            above = plain_surface(drawn, 0, v, u)
            if math.isnan(above):
                continue
            off.append(above - h)
            c, r = math.floor(u), math.floor(v)
            near = drawn[r : r + 2, c : c + 2]
            loss = max(h - float(np.nanmax(near)), 0.0)
            around = heights[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
            if h >= np.nanmax(around):
                summits.append(loss)
            if h > highest[0]:
                highest = (h, loss)
    off = np.array(off)
    return np.sqrt(np.mean(off**2)), np.abs(off).max(), max(summits), *highest


@pytest.mark.parametrize("resolution", [None, 31.0, 400.0])
def test_losses_are_what_looking_at_every_sample_finds(tmp_path, resolution):
    heights = rough((75, 66), 6, hole=True)
    heights[60, 40] += 300
    source = degrees(heights)
    terrain = store.build(Mosaic([source], resolution=resolution), tmp_path / "s.oro", errors=(), **SIZES)
    expected = losses(terrain, heights, source.grid, np.ones(heights.shape, bool))
    lost = terrain.resampled
    np.testing.assert_allclose([lost.rms, lost.largest, lost.summit_loss, *expected[3:]],
                               [*expected[:3], lost.highest, lost.highest_loss], atol=0.02)  # fmt: skip
    assert lost.largest > 20


@pytest.mark.parametrize("place", [(3, 3), (0, 31), (26, 40)], ids=["inside", "rim", "beside a void"])
def test_no_summit_loses_more_than_the_surface_is_off(tmp_path, place):
    """A summit where no surface is drawn, at the rim or beside a void, is no loss of the surface's."""
    heights = rough((60, 62), 3)
    heights[20:40, 20:40] = np.nan
    heights[place] = heights[~np.isnan(heights)].max() + 900
    terrain = store.build(Mosaic([degrees(heights)], resolution=400.0), tmp_path / "s.oro", errors=(), **SIZES)
    lost = terrain.resampled
    assert lost.highest_loss <= lost.summit_loss <= lost.largest
    assert (lost.highest > 1500) == (place == (3, 3))


def test_what_was_lost_does_not_depend_on_the_shards(tmp_path):
    noise = np.random.default_rng(3).normal(0, 30, (300, 277)).astype(np.float32)
    source = degrees(rough((300, 277), 3) + noise)
    lost = [
        store.build(Mosaic([source]), tmp_path / f"{shard}.oro", errors=(), shard=shard, chunk=64).resampled
        for shard in (64, 128, 1024)
    ]
    assert lost[0] == lost[1] == lost[2]


@pytest.mark.stress
def test_samples_under_a_finer_lattice_do_not_count(tmp_path):
    fine, coarse = degrees(rough((70, 60), 7) + 5000, cell=CELL / 3), degrees(rough((60, 60), 8))
    mosaic = Mosaic([coarse, fine])
    terrain = store.build(mosaic, tmp_path / "s.oro", errors=(), **SIZES)
    assert [x.grid.shape for x in terrain.record.lattices] == [(70, 60), (60, 60)]
    u, v = fine.grid.index(*coarse.grid.xy(*np.indices((60, 60))[::-1]))
    free = (np.floor(u + 0.5) >= 60) | (np.floor(v + 0.5) >= 70)
    parts = [losses(terrain, fine.heights, fine.grid, np.ones((70, 60), bool)),
             losses(terrain, coarse.heights, coarse.grid, free)]  # fmt: skip
    lost = terrain.resampled
    assert lost.largest == pytest.approx(max(p[1] for p in parts), abs=0.02)
    assert lost.summit_loss == pytest.approx(max(p[2] for p in parts), abs=0.02)
    assert (lost.highest, lost.highest_loss) == pytest.approx(max(p[3:] for p in parts), abs=0.02)
    rng = np.random.default_rng(0)
    x, y = terrain.grid.xy(rng.uniform(0, terrain.grid.cols, 500), rng.uniform(0, terrain.grid.rows, 500))
    np.testing.assert_array_equal(terrain.samples.heights_at(x, y), mosaic.heights_at(x, y))


def test_converted_heights_are_kept_converted(shared_data, tmp_path):
    heights = rough((50, 60), 9)
    source = degrees(heights)
    source.vertical = "EGM96 height"
    mosaic = Mosaic([source], to_vertical="ellipsoidal", geoid=shared_data / "egm96-grid" / "egm96_15.gtx")
    terrain = store.build(mosaic, tmp_path / "s.oro", errors=())
    x, y = terrain.grid.xy(np.linspace(5, 40, 50), np.linspace(6, 42, 50))
    found = terrain.samples.heights_at(x, y)
    np.testing.assert_array_equal(found, mosaic.heights_at(x, y))
    plain = Mosaic([source]).heights_at(x, y)
    assert np.abs(found - plain).min() > 10


def test_without_the_source_heights_say_how_far_off_they_are(made, tmp_path):
    inputs = [made / "a.tif", made / "b.tif"]
    terrain = store.build(inputs, tmp_path / "s.oro", keep_source=False, errors=(), **SIZES)
    kept = store.open(made / "s.oro")
    assert terrain.samples is None and not (tmp_path / "s.oro" / "source").exists() and terrain.check() == []
    assert terrain.resampled == kept.resampled
    points = np.stack(terrain.grid.xy(np.array([20.3, 55.7]), np.array([101.2, 93.1])), axis=-1)
    hit, own = measuring.place(terrain, points[0]), measuring.place(kept, points[0])
    assert hit.height == hit.surface_height == own.surface_height != own.height
    assert hit.height_error == terrain.resampled.largest and own.height_error is None
    text = f"resampled, ± {hit.height_error:.3g} m"
    assert text in {name: value for name, value, _ in lines(hit)}["height"]
    assert not any("resampled" in value for _, value, _ in lines(own))
    line = measuring.profile(terrain, points)
    np.testing.assert_allclose(line.heights, line.surface_heights, atol=1e-9)
    assert line.to_dict()["height_error_m"] == hit.height_error
    assert ("heights", text, "") in lines(line)
    assert measuring.profile(kept, points).to_dict()["height_error_m"] is None


def test_workers_do_not_matter(made, tmp_path):
    for jobs in (1, 4):
        inputs = [made / "a.tif", made / "b.tif"]
        store.build(inputs, tmp_path / str(jobs), errors=(), jobs=jobs, **SIZES).close()
        assert files(tmp_path / str(jobs)) == files(made / "s.oro")


class Stop(BaseException):
    """Stands for the end of the process."""


@pytest.mark.cases(1)
@pytest.mark.parametrize("keep", [True, False])
def test_resumed_from_any_write_it_is_the_same(made, tmp_path, monkeypatch, keep):
    inputs, options = [made / "a.tif", made / "b.tif"], {"errors": (), "keep_source": keep, "jobs": 1, **SIZES}
    store.build(inputs, tmp_path / "whole", **options).close()
    put, count = FolderStorage.put, [0]

    def counted(self, key, parts):
        count[0] += 1
        if count[0] == stop_at:
            raise Stop
        put(self, key, parts)

    monkeypatch.setattr(FolderStorage, "put", counted)
    reached = set()
    for stop_at in range(3, 90, 6):
        count[0] = 0
        try:
            store.build(inputs, tmp_path / "s", **options).close()
        except Stop:
            reached |= {p.name for p in (tmp_path / "s.partial" / "parts").glob("source/*")}
            stop_at = -1
            store.build(inputs, tmp_path / "s", resume=True, **options).close()
        assert files(tmp_path / "s") == files(tmp_path / "whole")
        shutil.rmtree(tmp_path / "s")
    assert len(reached) >= 3


def test_resuming_makes_a_damaged_shard_again(made, tmp_path, monkeypatch):
    inputs = [made / "a.tif", made / "b.tif"]
    put = FolderStorage.put

    def stopping(self, key, parts):
        if key == "zarr.json":
            raise Stop
        put(self, key, parts)

    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", stopping)
        with pytest.raises(Stop):
            store.build(inputs, tmp_path / "s", errors=(), **SIZES)
    with pytest.raises(StoreError, match="source samples to keep differ"):
        store.build(inputs, tmp_path / "s", errors=(), resume=True, keep_source=False, **SIZES)
    damage(tmp_path / "s.partial" / "source/0/height/c/1/0")
    store.build(inputs, tmp_path / "s", errors=(), resume=True, **SIZES).close()
    assert files(tmp_path / "s") == files(made / "s.oro")


def damage(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 4
    path.write_bytes(content)


def test_a_flipped_bit_is_noticed_and_mended(area, made):
    key = "source/0/height/c/1/0"
    damage(area / key)
    terrain = store.open(area)
    assert [found.partition("[")[0] for found in terrain.check()] == [key]
    lattice = terrain.record.lattices[0].grid
    to = Transformer.from_crs(4326, terrain.grid.crs, always_xy=True)
    with pytest.raises(DamagedChunkError, match=key):
        terrain.samples.heights_at(*to.transform(*lattice.xy(*np.mgrid[5:60, 66:126].reshape(2, -1))))
    assert np.isfinite(terrain.samples.heights_at(*to.transform(*lattice.xy([90.0], [5.0])))).all()
    assert [found.partition("[")[0] for found in repair(area)] == [key]
    assert files(area) == files(made / "s.oro")


@pytest.mark.parametrize("other", ["source/0/height/c/0/1", "heights/0/height/c/0/0"])
def test_swapped_shards_are_noticed_and_mended(area, made, other):
    one = "source/0/height/c/0/0"
    first, second = (area / one).read_bytes(), (area / other).read_bytes()
    (area / one).write_bytes(second)
    (area / other).write_bytes(first)
    terrain = store.open(area)
    assert {found.partition("[")[0] for found in terrain.check()} == {one, other}
    grid = terrain.record.lattices[0].grid
    x, y = Transformer.from_crs(4326, terrain.grid.crs, always_xy=True).transform(*grid.xy(5, 5))
    with pytest.raises(DamagedChunkError, match=f"{one} is damaged: it is the shard {other}"):
        terrain.samples.heights_at(x, y)
    repair(area)
    assert files(area) == files(made / "s.oro")


def test_small_objects_are_mended_from_the_record(area, made):
    for key in ("source/0/x/c/0", "source/zarr.json", "source/0/height/zarr.json", "source/0/spatial_ref/c"):
        damage(area / key)
    repair(area)
    assert files(area) == files(made / "s.oro")


def test_samples_that_cannot_be_made_again_are_said(tmp_path):
    mosaic = Mosaic([degrees(rough((40, 40), 1))])
    store.build(mosaic, tmp_path / "s.oro", errors=()).close()
    before = files(tmp_path / "s.oro")
    (tmp_path / "s.oro/source/0/height/c/0/0").unlink()
    with pytest.raises(StoreError, match="heights in memory"):
        repair(tmp_path / "s.oro")
    repair(tmp_path / "s.oro", mosaic)
    assert files(tmp_path / "s.oro") == before


def test_a_bake_leaves_them_alone(area):
    from orograph.lighting.bake import bake

    before = {key: data for key, data in files(area).items() if key.startswith("source/")}
    bake(area, ["sky-view-factor"]).close()
    assert {key: data for key, data in files(area).items() if key.startswith("source/")} == before
    assert store.open(area).check() == []


def test_samples_of_a_store_that_was_replaced_are_not_given(area):
    terrain = store.open(area)
    x, y = terrain.grid.xy(50, 60)
    before = terrain.samples.heights_at(x, y)
    store.build(Mosaic([degrees(rough((130, 205), 5))]), area, overwrite=True, errors=(), **SIZES).close()
    with pytest.raises(StoreReplacedError):
        terrain.samples.heights_at(x, y)
    with terrain.reopen() as new:
        assert new.samples.heights_at(x, y) != before


def test_they_are_read_from_a_url(made, tmp_path):
    url = f"memory://lattices-{tmp_path.name}"
    inputs = [made / "a.tif", made / "b.tif"]
    terrain, local = store.build(inputs, url, errors=(), **SIZES), store.open(made / "s.oro")
    x, y = terrain.grid.xy(np.array([90.2, 12.0]), np.array([33.1, 90.0]))
    np.testing.assert_array_equal(terrain.samples.heights_at(x, y), local.samples.heights_at(x, y))
    assert terrain.check() == []


@pytest.mark.parametrize(
    ("shape", "cell", "west", "north", "resolution"),
    [
        ((2, 2), 0.01, 7.0, 46.0, None),
        ((3, 70), 0.01, 179.8, 46.0, None),  # across the antimeridian
        ((40, 120), 3.0, -180.0, 90.0, 200_000.0),  # half a globe, closed in longitude: around the pole
    ],
)
def test_odd_rasters(tmp_path, shape, cell, west, north, resolution):
    source = degrees(rough(shape, 3), west, north, cell)
    mosaic = Mosaic([source], resolution=resolution, crs="EPSG:3995" if cell == 3.0 else None)
    terrain = store.build(mosaic, tmp_path / "s.oro", errors=(), **SIZES)
    rows, cols = terrain.grid.shape
    x, y = terrain.grid.xy(*np.indices((rows, cols)).reshape(2, -1)[::-1])
    found = terrain.samples.heights_at(x, y)
    np.testing.assert_array_equal(found, mosaic.heights_at(x, y))
    assert np.isfinite(found).any() and terrain.check() == []
    assert terrain.resampled.largest >= terrain.resampled.rms >= 0


def test_where_nothing_is_known_nothing_is_said_to_be_lost(tmp_path):
    terrain = store.build(
        Mosaic([degrees(np.full((20, 30), np.nan, np.float32))]), tmp_path / "s.oro", keep_source=False
    )
    assert math.isnan(terrain.resampled.rms) and terrain.resampled.to_json()["largest"] is None
    assert "no sample of the source has ground" in str(terrain.resampled)
    hit = measuring.place(terrain, terrain.grid.xy(4, 5))
    assert hit.height is None and hit.height_error is None
