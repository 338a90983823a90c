"""What GDAL writes to a disk that becomes full: a file is whole or not there, and GDAL's libraries print nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem.synth import Synth
from orograph.dem.writing import check_written
from orograph.errors import OutputError
from orograph.geo.grid import Grid
from orograph.lighting.raster import Band
from orograph.lighting.raster import write as write_light
from orograph.rendering.assembly import Assembly
from orograph.rendering.picture import Picture
from orograph.viewpoint import View

resource = pytest.importorskip("resource", reason="files cannot be limited here")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SIDE = 400
NOISE = np.random.default_rng(1).integers(0, 255, (SIDE, SIDE, 3)).astype(np.uint8)
PLACE = Grid((SIDE, SIDE), Affine(1, 0, 0, 0, -1, 0), None)
Write = Callable[[Path], object]


def picture() -> Picture:
    view = View((200.0, -200.0, 900.0), (200.0, -200.0, 0.0), width=SIDE, height=SIDE)
    return Picture(NOISE, NOISE[..., 0].astype(np.float32) / 7, view, grid=PLACE)


def large(kind: str, depth: bool = False) -> Write:
    def write(out: Path) -> None:
        with Assembly(out, SIDE, SIDE, depth=depth, place=PLACE) as assembly:
            with at_most(resource.RLIM_INFINITY):
                assembly.write(0, 0, NOISE[..., 0].astype(np.float32) / 7 if depth else NOISE)
            assembly.encode(kind)

    return write


def light(out: Path) -> None:
    write_light(out, PLACE, [Band("x", "m", "noise")], [(0, 0, 0, NOISE[None, ..., 0].astype(np.float32) / 7)])


FORMATS: dict[str, tuple[str, Write]] = {
    "plan": (".tif", lambda out: picture().save(out)),
    "depth": (".tif", lambda out: picture().save_depth(out)),
    "large-depth": (".tif", large("TIFF", depth=True)),
    "synth": (".tif", lambda out: Synth((SIDE, SIDE)).write(out)),
    "large-tif": (".tif", large("TIFF")),
    "large-png": (".png", large("PNG")),
    "large-jpg": (".jpg", large("JPEG")),
    "large-webp": (".webp", large("WEBP")),
}


@contextmanager
def at_most(size: int) -> Iterator[None]:
    """Files of this process end at so many bytes: a write beyond that fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def samples(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read()


@pytest.mark.parametrize("name", FORMATS)
def test_wherever_the_disk_ends_a_file_is_whole_or_not_there(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
) -> None:
    ending, write = FORMATS[name]
    whole = tmp_path / f"whole{ending}"
    write(whole)
    size, expected = whole.stat().st_size, samples(whole)
    for room in (400, size // 2, size - 9000, size - 300, size - 1, size, size + 5000):
        out = tmp_path / f"out{ending}"
        with at_most(room):
            try:
                write(out)
                done = True
            except OutputError as error:
                assert "annot be written" in str(error) and str(out) in str(error), error
                done = False
        assert done == (room >= size), room
        assert done == out.exists()
        if done:
            assert np.array_equal(samples(out), expected, equal_nan=True)
            out.unlink()
        assert [p.name for p in tmp_path.iterdir()] == [whole.name]
    assert capfd.readouterr() == ("", "")


def test_a_file_with_overviews_is_whole_until_it_is_cut(tmp_path: Path) -> None:
    """Overviews of a COG lie in front of what they are of, the coarsest first. Each has blocks of its own (behind each
    four bytes that no reader needs)."""
    out, grid = tmp_path / "a.tif", Grid((1500, 2100), Affine(1, 0, 0, 0, -1, 0), None)
    noise = np.random.default_rng(2).random((2, 1500, 2100), np.float32)
    write_light(out, grid, [Band("x", "m", "noise"), Band("y", "m", "noise")], [(0, 0, 0, noise)])
    with rasterio.open(out) as file:
        assert len(file.overviews(1)) == 3
    data = out.read_bytes()
    for size in (len(data) - 5, len(data) * 9 // 10, len(data) // 3, len(data) // 50, 100):
        out.write_bytes(data[:size])
        with pytest.raises(OutputError, match="only part"):
            check_written(out, out)


def test_of_a_map_of_light_on_a_full_disk_nothing_is_left(
    small_disk: Callable[[int], Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The plain file fits, as is looked at before; its copy in the order of a COG, with overviews, does not."""
    light(tmp_path / "whole.tif")
    expected = samples(tmp_path / "whole.tif")
    told = []
    for kib in (1064, 1100, 1300, 1500, 1800, 2100, 2500):
        out = small_disk(kib) / "light.tif"
        try:
            light(out)
        except OutputError as error:
            told.append(str(error))
            assert not list(out.parent.iterdir())
        else:
            assert np.array_equal(samples(out), expected)
            assert list(out.parent.iterdir()) == [out]
    assert 0 < len(told) < 7 and all("full" in t or "cannot be written" in t for t in told), told
    assert capfd.readouterr() == ("", "")
