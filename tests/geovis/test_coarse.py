"""Coarse levels of images without overviews: the texels of the file itself, made once, whatever interrupts it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.errors import StoreError
from orograph.geo.grid import Grid
from orograph.geovis import coarse
from orograph.geovis.coarse import FINEST, TOP, CoarseLevels, Stopped
from orograph.geovis.drape import Drape
from orograph.geovis.imagery import ImageWindow, read_into
from orograph.geovis.layers import Layer
from orograph.geovis.laying import Laid
from orograph.progress import Progress, Task

ROWS, COLS = 4300, 5000
GRID = Grid((430, 500), Affine(30, 0, 500_000, 0, -30, 6_700_000), CRS.from_epsg(32633))
KINDS = ("rgb", "rgba", "palette", "values", "strips", "mask")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(coarse, "MUCH", 1 << 20)
    return tmp_path / "cache"


def write(path: Path, kind: str = "rgb", seed: int = 0) -> str:
    """Cells of several sizes over the grid, as what ``kind`` says."""
    rng = np.random.default_rng(seed)
    count = {"rgba": 4, "palette": 1, "values": 1}.get(kind, 3)
    pixels: NDArray[Any] = np.zeros((count, ROWS, COLS), np.uint8)
    for cells in (7, 90, 1300):
        r, c = np.arange(ROWS) * cells // ROWS, np.arange(COLS) * cells // COLS
        pixels += rng.integers(0, 85, (count, cells, cells), np.uint8)[:, r[:, None], c[None, :]]
    if kind == "rgba":
        pixels[3] = np.where(pixels[3] > 120, 255, pixels[3])
        pixels[3, 1000:1500] = 0
    if kind == "values":
        pixels = pixels.astype(np.float32) * 3 - 100
        pixels[0, 200:900, 300:4500] = -9999
    options: dict[str, Any] = {"tiled": True, "blockxsize": 256, "blockysize": 256}
    if kind == "strips":
        options = {"blockysize": 3}
    if kind in ("rgb", "rgba", "strips", "mask"):
        options["photometric"] = "rgb"
    with rasterio.open(
        path, "w", driver="GTiff", count=count, height=ROWS, width=COLS, dtype=pixels.dtype, crs=GRID.crs.to_wkt(),
        transform=Affine(3, 0, 500_000, 0, -3, 6_700_000), nodata=-9999 if kind == "values" else None,
        compress="deflate", zlevel=1, **options,
    ) as file:  # fmt: skip
        file.write(pixels)
        if kind == "palette":
            file.write_colormap(1, {k: (k, 255 - k, (7 * k) % 256, 255 if k % 5 else 0) for k in range(256)})
        if kind == "mask":
            file.write_mask(pixels[0] > 60)
    return str(path)


def levels_of(path: str, **more: Any) -> CoarseLevels:
    laid = Laid.open(Layer(path, **more), GRID)
    assert coarse.wanted(laid)
    return CoarseLevels(laid)


class Count(Progress):
    """Counts what is made."""

    def __init__(self) -> None:
        self.made = 0.0

    def task(self, what: str, total: float | None = None) -> Task:
        outer = self

        class Counting(Task):
            def advance(self, n: float = 1) -> None:
                outer.made += n

        return Counting()


@pytest.mark.stress
@pytest.mark.parametrize("kind", KINDS)
def test_texels_are_those_of_the_file(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "a.tif", kind)
    kept = levels_of(path, **({"colormap": "viridis"} if kind == "values" else {}))
    assert len(kept.blocks) == 4 and not kept.complete
    kept.make(kept.blocks)
    assert kept.complete
    for k in range(FINEST, TOP + 1):
        rows, cols = -(-ROWS >> k), -(-COLS >> k)
        truth = np.empty((rows, cols, 4), np.uint8)
        read_into(truth, path, ImageWindow(0, ROWS, 0, COLS, 1 << k), kept.laid.bands)
        found, whole = kept.read(k, 0, rows, 0, cols)
        assert whole
        # Sums of 64 pixels are kept in single precision: a tie in a million is rounded otherwise.
        off = np.abs(found.astype(int) - truth)
        assert off.max() <= 1 and (off > 0).mean() < 1e-4
        a, b = rows // 3, cols // 2
        np.testing.assert_array_equal(kept.read(k, a, rows, b, cols)[0], found[a:, b:])


@pytest.mark.stress
def test_what_was_interrupted_goes_on_and_is_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = levels_of(write(tmp_path / "a.tif"))
    with pytest.raises(Stopped):
        stop = threading.Event()
        stop.set()
        kept.make(kept.blocks, stop=stop)
    read = CoarseLevels._read

    def failing(self: CoarseLevels, run: list[Any], *more: Any) -> None:
        if self.made == 2:
            raise KeyboardInterrupt
        read(self, run, *more)

    monkeypatch.setattr(CoarseLevels, "_read", failing)
    with pytest.raises(KeyboardInterrupt):
        kept.make(kept.blocks, jobs=1)
    monkeypatch.setattr(CoarseLevels, "_read", read)
    again, told = levels_of(kept.laid.location), Count()
    assert again.folder == kept.folder and again.made == 2 and not list(kept.folder.glob("*.part"))
    found, whole = again.read(5, 0, 134, 0, 156)
    assert not whole and found[:128, :128, 3].all() and not found[128:, 128:, 3].any()
    again.make(again.blocks, told)
    assert told.made == 2 and again.complete
    again.make(again.blocks, told)
    assert told.made == 2


@pytest.mark.stress
def test_a_damaged_block_is_made_again_and_a_changed_file_has_its_own(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif")
    drape = Drape.open(path, GRID, 4 << 20)
    kept = drape.texels.kept
    assert kept is not None
    whole = drape.texels.read(6, 0, 60, 0, 60)
    block = kept.folder / "0_0"
    data = bytearray(block.read_bytes())
    data[-3] ^= 255  # the coarsest level
    data[400] ^= 255
    block.write_bytes(data)
    np.testing.assert_array_equal(drape.texels.read(FINEST, 0, 512, 0, 512), drape.texels.read(FINEST, 0, 512, 0, 512))
    np.testing.assert_array_equal(drape.texels.read(TOP, 0, 1, 0, 1).shape, (1, 1, 4))
    np.testing.assert_array_equal(drape.texels.read(6, 0, 60, 0, 60), whole)
    before = kept.folder
    write(Path(path), seed=1)
    after = levels_of(path)
    assert after.folder != before and after.made == 0


@pytest.mark.stress
def test_threads_that_want_the_same_block_make_it_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, reads, read = levels_of(write(tmp_path / "a.tif")), [], CoarseLevels._read
    monkeypatch.setattr(CoarseLevels, "_read", lambda self, run, *more: (reads.append(run), read(self, run, *more)))
    threads = [threading.Thread(target=kept.make, args=(kept.blocks,), kwargs={"jobs": 1}) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert kept.complete and sorted(b for run in reads for b in run) == kept.blocks


@pytest.mark.stress
def test_a_folder_that_cannot_be_written_is_told_with_what_to_do(tmp_path: Path, cache: Path) -> None:
    cache.write_text("a file")
    kept = levels_of(write(tmp_path / "a.tif"))
    with pytest.raises(StoreError, match=r"coarse levels of a\.tif cannot be kept.*"):
        kept.make(kept.blocks)


@pytest.mark.stress
def test_pictures_are_those_of_the_whole_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Near and far footprints: out of kept levels as out of one reading of all of it."""
    path = write(tmp_path / "a.tif", "rgba")
    rng = np.random.default_rng(2)
    n = 150
    x, y = 500_000 + rng.uniform(0, 15_000, n), 6_700_000 - rng.uniform(0, 12_900, n)
    wide = np.exp(rng.uniform(np.log(3), np.log(4000), n))
    ground = np.stack([wide, 0 * wide, 0 * wide, 0.2 * wide], 1)
    some = Drape.open(path, GRID, 300 << 20)
    assert some.tiles is not None and some.texels.kept is not None
    some.prepare(x, y, ground, 0.01 * wide)
    assert some.texels.kept.complete and some.coarser == 0
    monkeypatch.setattr(coarse, "MUCH", 1 << 60)
    whole = Drape.open(path, GRID)
    got, truth = some.spread(x, y, ground, 0.01 * wide), whole.spread(x, y, ground, 0.01 * wide)
    np.testing.assert_allclose(got, truth, atol=0.03)


@pytest.mark.stress
def test_a_picture_whose_tiles_do_not_fit_is_coarser_and_reads_each_once(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif")
    side = 1300
    j, i = (a.ravel() for a in np.meshgrid(np.arange(side), np.arange(side)))
    x, y = 500_000 + 3.0 * (j + 0.5), 6_700_000 - 3.0 * (i + 0.5)
    square, least = np.tile([3.0, 0.0, 0.0, 3.0], (len(x), 1)), np.zeros(len(x))
    told: list[str] = []
    progress = Progress()
    progress.warn = told.append  # type: ignore[method-assign]
    drape = Drape.open(path, GRID, 20 << 20)
    assert drape.tiles is not None and drape.tiles.capacity < (side / 128) ** 2
    some = np.arange(0, len(x), 37)
    drape.prepare(x[some], y[some], square[some], least[some], progress=progress)
    assert drape.coarser in (0.5, 1.0) and "coarser than it could be" in told[0] and "`max_memory`" in told[0]
    for column in range(0, side, 130):  # tiles of a picture that go down, not across
        part = np.flatnonzero((j >= column) & (j < column + 130))
        drape.spread(x[part], y[part], square[part], least[part])
    assert drape.tiles.read <= drape.tiles.capacity
    roomy = Drape.open(path, GRID, 60 << 20)
    roomy.prepare(x[some], y[some], square[some], least[some], progress=progress)
    assert roomy.coarser == 0


def test_the_span_of_a_huge_raster_is_found_without_reading_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from orograph.geovis import imagery

    path = write(tmp_path / "a.tif", "values")
    plain = Laid.open(Layer(path), GRID).bands.span
    monkeypatch.setattr(imagery, "MANY", 1 << 20)
    spots = Laid.open(Layer(path), GRID).bands.span
    np.testing.assert_allclose(spots, plain, atol=0.06 * (plain[1] - plain[0]))
