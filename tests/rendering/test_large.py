"""Pictures drawn by bands have the pixels of pictures drawn at once, furniture and antialiasing included."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from scenes import hills, holes, read, terrain

from orograph.errors import OutputError, UsageError
from orograph.lighting.sun import Sun
from orograph.rendering import large
from orograph.rendering.assembly import Assembly
from orograph.rendering.cpu.draw import draw
from orograph.rendering.furniture import furnish
from orograph.rendering.large import bands, draw_large
from orograph.scene import camera
from orograph.scene.scene import Scene

SIZE = (417, 250)

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def ground():
    heights = holes(hills(140, 180))
    heights[90:125, 60:110] = 640.0  # a lake
    return terrain(heights)


@pytest.mark.stress
@pytest.mark.parametrize(
    ("ending", "pixels", "options"),
    [
        ("png", 417 * 16, {"furniture": True}),
        ("png", 417 * 80, {"furniture": True, "sky": True, "sun": Sun(120, 12), "samples": 5}),
        ("tif", 64 * 16, {"furniture": True, "title": "A very long title that has to be set in small type"}),
        ("webp", 130 * 16, {"sky": True}),
    ],
)
def test_no_seam(tmp_path, ending, pixels, options):
    land = ground()
    scene = Scene.of(land, camera.around(land, SIZE, azimuth=215, pitch=22, distance=3500), **options)
    at_once = draw(scene)
    out, depth = tmp_path / f"large.{ending}", tmp_path / "depth.tif"
    facts = draw_large(scene, out, depth=depth, pixels=pixels)
    np.testing.assert_array_equal(read(out), at_once.pixels)
    with rasterio.open(depth) as file:
        np.testing.assert_array_equal(file.read(1), at_once.depth)
    assert facts["shown"] == at_once.facts["shown"]
    assert facts["hit_fraction"] == pytest.approx(at_once.facts["hit_fraction"])
    assert facts["edge_fraction"] == pytest.approx(at_once.facts["edge_fraction"])
    assert sorted(f.name for f in tmp_path.iterdir()) == sorted([out.name, "depth.tif"])


@pytest.mark.stress
@pytest.mark.parametrize("step", [2, 4, 8])
def test_of_large_pictures_furniture_spares_what_some_pixels_show(tmp_path, monkeypatch, step):
    """Drawn at once, by bands and by tiles the furniture stands in the same places."""
    monkeypatch.setattr(furnish, "COVERED", -(-SIZE[0] * SIZE[1] // step**2))
    assert furnish.cover_step(SIZE) == step
    land = ground()
    scene = Scene.of(land, camera.around(land, SIZE, azimuth=215, pitch=22, distance=3500), furniture=True)
    draw_large(scene, tmp_path / "tiles.png", pixels=64 * 32)
    np.testing.assert_array_equal(read(tmp_path / "tiles.png"), draw(scene).pixels)


@given(st.integers(1, 90), st.integers(1, 90), st.integers(0, 2**32 - 1), st.data())
def test_ground_under_a_box(width, height, seed, data):
    mask = np.random.default_rng(seed).random((height, width)) < 0.5
    cover = furnish.Cover.of(mask)
    x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
    x1, y1 = data.draw(st.integers(x0, width)), data.draw(st.integers(y0, height))
    assert cover.size == mask.size and cover.under((x0, y0, x1, y1)) == mask[y0:y1, x0:x1].sum()
    for step in (2, 4, 8):
        some = mask[::step, ::step]
        coarse = furnish.Cover(np.packbits(some, axis=1), some.shape[1], step)
        own = [(y, x) for y in range(y0, y1) for x in range(x0, x1) if y % step == 0 == x % step and mask[y, x]]
        assert coarse.under((x0, y0, x1, y1)) == len(own) * step**2


def test_a_plan_is_a_geotiff_in_its_place(tmp_path):
    land = ground()
    scene = Scene.of(land, camera.plan(land, SIZE, azimuth=150), furniture=True)
    at_once = draw(scene)
    at_once.save(tmp_path / "once.tif")
    draw_large(scene, tmp_path / "large.tif", pixels=417 * 32)
    with rasterio.open(tmp_path / "once.tif") as a, rasterio.open(tmp_path / "large.tif") as b:
        np.testing.assert_array_equal(a.read(), b.read())
        assert a.transform.almost_equals(b.transform, 1e-9) and a.crs == b.crs


@pytest.mark.stress
def test_tiffs_are_cloud_optimised(tmp_path):
    """Tiles, overviews that average the picture, and the layout that GDAL's driver promises; also of depths."""
    land = ground()
    scene = Scene.of(land, camera.plan(land, (1310, 1130)))
    draw_large(scene, tmp_path / "a.tif", depth=tmp_path / "depth.tif", pixels=1310 * 64)
    for name, bands_ in (("a.tif", 3), ("depth.tif", 1)):
        with rasterio.open(tmp_path / name) as file:
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and file.count == bands_
            assert file.block_shapes[0] == (512, 512) and file.overviews(1) == [2, 4]
            whole = file.read().astype(float)
        with rasterio.open(tmp_path / name, overview_level=0) as file:
            half = file.read().astype(float)
        assert half.shape[1:] == (565, 655)
        four = np.stack([whole[:, i::2, j::2] for i in (0, 1) for j in (0, 1)])
        if bands_ == 3:
            assert np.abs(half - four.mean(axis=0)).max() <= 0.5
        else:  # nearest: a depth that is there
            there = np.isfinite(half)
            assert (half == four).any(axis=0)[there].all()


def test_pieces_in_any_order_and_over_each_other(tmp_path):
    rng = np.random.default_rng(5)
    wanted = rng.integers(0, 256, (90, 1100, 3), dtype=np.uint8)
    with Assembly(tmp_path / "a.tif", 1100, 90) as assembly:
        assembly.write(640, 48, wanted[48:, 640:])
        assembly.write(0, 0, wanted[:48] // 2)
        assembly.write(0, 48, wanted[48:, :640])
        assembly.write(0, 0, wanted[:48])
        np.testing.assert_array_equal(assembly.read(600, 30, 700, 80), wanted[30:80, 600:700])
        assembly.encode("TIFF")
    with rasterio.open(tmp_path / "a.tif") as file:
        np.testing.assert_array_equal(file.read().transpose(1, 2, 0), wanted)
    assert [f.name for f in tmp_path.iterdir()] == ["a.tif"]


@pytest.mark.parametrize(("size", "pixels"), [((417, 250), 1000), ((16384, 16384), 1 << 22), ((16384, 300), 100_000)])
def test_bands_cover_a_picture_once(size, pixels):
    covered = np.zeros((-(-size[1] // large.ROWS), -(-size[0] // large.COLUMNS)), int)
    for left, top, wide, tall in bands(*size, pixels):
        assert left % large.COLUMNS == 0 and top % large.ROWS == 0
        assert left + wide <= size[0] and top + tall <= size[1]
        assert wide * tall <= max(pixels, large.ROWS * large.COLUMNS)
        rows, cols = (
            slice(top // large.ROWS, -(-(top + tall) // large.ROWS)),
            slice(left // 64, -(-(left + wide) // 64)),
        )
        covered[rows, cols] += 1
    assert (covered == 1).all()


@pytest.mark.stress
@pytest.mark.skipif(sys.platform == "win32", reason="peak memory is asked of POSIX")
def test_memory_stays_that_of_a_band(tmp_path):
    """A picture of 9 million pixels (450 MB of arrays, if drawn at once) within 100 MB more than a small one takes."""
    script = """
import resource, sys
import numpy as np
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from scenes import hills, terrain
from orograph.scene import camera
from orograph.rendering.large import draw_large
from orograph.scene.scene import Scene
land = terrain(hills(140, 180))
scene = lambda size: Scene.of(land, camera.whole(land, size), furniture=True, shadows=False)
draw_large(scene((300, 200)), Path(sys.argv[2]) / "small.png", pixels=1 << 19)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
draw_large(scene((3000, 3000)), Path(sys.argv[2]) / "large.png", pixels=1 << 19)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    ran = subprocess.run([sys.executable, "-c", script, str(Path(__file__).parent), str(tmp_path)],
                         capture_output=True, text=True, timeout=300)  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    scale = 1 if sys.platform == "darwin" else 1024
    assert int(ran.stdout) * scale < 100e6
    assert read(tmp_path / "large.png").shape == (3000, 3000, 3)


def test_what_cannot_be_drawn_by_bands(tmp_path, monkeypatch):
    land = ground()
    scene = Scene.of(land, camera.whole(land, SIZE))
    with pytest.raises(UsageError, match="wireframe"):
        draw_large(scene.but(method="soar", wireframe=True), tmp_path / "a.png")
    wide = scene.but(view=camera.whole(land, (20_000, 100)))
    with pytest.raises(UsageError, match="16383"):
        draw_large(wide, tmp_path / "a.webp")
    monkeypatch.setattr(large.shutil, "disk_usage", lambda path: type("", (), {"free": 1000}))
    with pytest.raises(OutputError, match="on disk"):
        draw_large(scene, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_what_was_there_stays_when_it_fails(tmp_path):
    out = tmp_path / "a.png"
    out.write_bytes(b"precious")
    land = ground()
    calls = []

    def failing(scene):
        calls.append(scene.view.part)
        if len(calls) == 3:
            raise RuntimeError("in the middle")
        return draw(scene)

    with pytest.raises(RuntimeError, match="in the middle"):
        draw_large(
            Scene.of(land, camera.whole(land, SIZE)), out, depth=tmp_path / "d.tif", draw=failing, pixels=417 * 32
        )
    assert out.read_bytes() == b"precious" and [f.name for f in tmp_path.iterdir()] == ["a.png"]
