"""Color errors in a store: those of the computation in memory, to the byte, and never those of other colours."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.color_errors import ColorErrors
from orograph.geovis.color_store import made_with, store_colors, stored
from orograph.store.colors import COLORS
from orograph.store.memory import MemoryTerrain
from orograph.store.source import ArraySource
from orograph.store.storage import FolderStorage

TRANSFORM = Affine(30, 0, 5e5, 0, -30, 4e6)


def heights(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 3, (rows, cols)).cumsum(0).cumsum(1).astype(np.float32)
    z[rows // 3 : rows // 2, cols // 4 : cols // 3] = np.nan
    return z


def image(path, rows: int, cols: int, seed: int = 5) -> str:
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 255, (3, rows // 4, cols // 4), dtype=np.uint8)
    with rasterio.open(
        path,
        "w",
        "GTiff",
        cols // 4,
        rows // 4,
        3,
        crs="EPSG:32611",
        transform=TRANSFORM @ Affine.scale(4),
        dtype="uint8",
    ) as file:
        file.write(pixels)
    return str(path)


def built(tmp_path, shape, name="s.oro", **options):
    grid = Grid(shape, TRANSFORM, CRS.from_epsg(32611))
    store.build(ArraySource(heights(*shape), grid, "test"), tmp_path / name, chunk=32, **options).close()
    return tmp_path / name


def all_of(color, terrain) -> list[np.ndarray]:
    """Every diamond's color error, level by level; 0 at entries that are none of the level's."""
    found = []
    for level in range(terrain.levels):
        rows, cols = terrain.diamond_shape(level)
        values = np.array(color(level, 0, rows, 0, cols))
        if level < terrain.levels - 1:
            values[::2, ::2] = 0
        found.append(values)
    return found


@pytest.mark.parametrize(("shape", "shard"), [((700, 530), 128), ((257, 257), 64), ((150, 400), 256), ((40, 30), 32)])
@pytest.mark.parametrize("draped", [False, True])
def test_they_are_those_of_the_computation_in_memory(tmp_path, shape, shard, draped) -> None:
    path = built(tmp_path, shape, shard=shard)
    drape = image(tmp_path / "ortho.tif", *shape) if draped else None
    with store_colors(path, drape, jobs=2) as terrain:
        found = stored(terrain, drape)
        assert found is not None
        memory = MemoryTerrain(heights(*shape), terrain.grid, "memory")
        expected = all_of(ColorErrors(memory, drape=drape), memory)
        for ours, theirs in zip(all_of(found, terrain), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert max(e.max() for e in expected) > 1.0
        assert terrain.check() == []


def test_an_interrupted_run_goes_on_to_the_same_bytes(tmp_path, monkeypatch) -> None:
    def files(path):
        return {p.relative_to(path).as_posix(): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}

    shape = (300, 280)
    whole = built(tmp_path, shape, "whole.oro", shard=64)
    path = built(tmp_path, shape, shard=64)
    assert files(whole) == files(path)
    before = files(path)
    store_colors(whole).close()
    put = FolderStorage.put
    for after in (1, 12, 30, 44):
        done = [0]

        def failing(self, key, parts, after=after, done=done):
            done[0] += 1
            if done[0] > after:
                raise KeyboardInterrupt
            return put(self, key, parts)

        monkeypatch.setattr(FolderStorage, "put", failing)
        with pytest.raises(KeyboardInterrupt):
            store_colors(path, jobs=1)
        monkeypatch.setattr(FolderStorage, "put", put)
        with store.open(path) as terrain:  # the store is as it was
            assert stored(terrain) is None
            assert not COLORS.of(terrain.record)
    kept = len(list((path / "colors" / ".partial").glob("*.part")))
    assert kept > 10
    # What is kept is not made again.
    made = [0]
    colors = ColorErrors.__mro__[1].colors

    def counted(self, *window):
        made[0] += window[1] - window[0] > 1
        return colors(self, *window)

    monkeypatch.setattr(ColorErrors.__mro__[1], "colors", counted)
    store_colors(path).close()
    assert made[0] <= 25 - kept
    assert files(path) == files(whole)
    assert set(before) < set(files(path))


def test_they_are_used_for_the_same_colors_only(tmp_path) -> None:
    shape = (130, 130)
    path = built(tmp_path, shape, shard=64)
    first = image(tmp_path / "a.tif", *shape, seed=1)
    with store.open(path) as terrain:
        assert stored(terrain, first) is None
    with store_colors(path, first) as terrain:
        assert stored(terrain, first) is not None
        assert stored(terrain) is None  # the tint
        assert stored(terrain, first, sun=(90.0, 30.0)) is None
        renamed = shutil.copy(first, tmp_path / "b.tif")
        assert stored(terrain, renamed) is not None
        image(tmp_path / "a.tif", *shape, seed=2)  # another one under the same name
        assert stored(terrain, first) is None
        # The same pixels elsewhere are other colours.
        with rasterio.open(renamed, "r+") as file:
            file.transform = TRANSFORM @ Affine.translation(1, 0) @ Affine.scale(4)
        assert stored(terrain, renamed) is None
    with store_colors(path, first) as terrain:  # takes the place of the others
        assert stored(terrain, first) is not None
    assert stored(MemoryTerrain(heights(9, 9), Grid((9, 9), TRANSFORM, None), "m")) is None


def test_a_mosaic_is_told_by_its_parts(tmp_path) -> None:
    part = image(tmp_path / "part.tif", 64, 64)
    vrt = tmp_path / "all.vrt"
    with rasterio.open(part) as file:
        vrt.write_text(
            f'<VRTDataset rasterXSize="{file.width}" rasterYSize="{file.height}">'
            '<VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
            '<SourceFilename relativeToVRT="1">part.tif</SourceFilename><SourceBand>1</SourceBand>'
            "</SimpleSource></VRTRasterBand></VRTDataset>"
        )
    before = made_with(vrt)
    image(tmp_path / "part.tif", 64, 64, seed=9)
    assert before is not None and before != made_with(vrt)


def test_what_cannot_be_done_is_said(tmp_path) -> None:
    with pytest.raises(StoreError, match="no such store"):
        store_colors(tmp_path / "none.oro")
    path = built(tmp_path, (40, 40), shard=32)
    with store.open(path) as terrain, pytest.raises(StoreError, match="no color errors"):
        terrain.derived("colors").read(0, 0, 1, 0, 1)
    with rasterio.MemoryFile() as memory:
        with memory.open(driver="GTiff", width=10, height=10, count=1, dtype="uint8", crs="EPSG:32611",
                         transform=TRANSFORM) as file:  # fmt: skip
            file.write(np.ones((1, 10, 10), np.uint8))
        with pytest.raises(UsageError, match="changed image"):
            store_colors(path, memory.name)
