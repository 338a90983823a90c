"""Pictures drawn by bands have the pixels of pictures drawn at once, furniture and antialiasing included."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scenes import hills, holes, read, terrain

from orograph.errors import OutputError, UsageError
from orograph.lighting.sun import Sun
from orograph.rendering import large
from orograph.rendering.cpu.draw import draw
from orograph.rendering.large import bands, draw_large
from orograph.scene import camera
from orograph.scene.scene import Scene

SIZE = (417, 250)

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def ground():
    heights = holes(hills(140, 180))
    heights[90:125, 60:110] = 640.0  # a lake
    return terrain(heights)


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


def test_a_plan_is_a_geotiff_in_its_place(tmp_path):
    land = ground()
    scene = Scene.of(land, camera.plan(land, SIZE, azimuth=150), furniture=True)
    at_once = draw(scene)
    at_once.save(tmp_path / "once.tif")
    draw_large(scene, tmp_path / "large.tif", pixels=417 * 32)
    with rasterio.open(tmp_path / "once.tif") as a, rasterio.open(tmp_path / "large.tif") as b:
        np.testing.assert_array_equal(a.read(), b.read())
        assert a.transform.almost_equals(b.transform, 1e-9) and a.crs == b.crs


@pytest.mark.parametrize(("size", "pixels"), [((417, 250), 1000), ((16384, 16384), 1 << 22), ((16384, 300), 100_000)])
def test_bands_cover_a_picture_once(size, pixels):
    rows = 0
    for band in bands(*size, pixels):
        assert {(t, h) for _, t, _, h in band} == {(rows, band[0][3])} and rows % large.ROWS == 0
        columns = 0
        for left, _, wide, tall in band:
            assert left == columns and left % large.COLUMNS == 0
            assert wide * tall <= max(pixels, large.ROWS * large.COLUMNS)
            columns += wide
        assert columns == size[0]
        rows += band[0][3]
    assert rows == size[1]


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
