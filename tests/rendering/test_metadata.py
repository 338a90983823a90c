"""What picture files say besides their pixels: the resolution for print, and whom to name, as other tools read it."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import rasterio
from PIL import Image
from scenes import hills, terrain

from orograph.errors import UsageError
from orograph.rendering.cpu.draw import draw
from orograph.rendering.large import draw_large
from orograph.scene import camera
from orograph.scene.scene import Scene

MAKERS = ("© the makers & others",)

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


@pytest.fixture(scope="module")
def scene():
    land = terrain(hills(50, 60))
    land.attribution = MAKERS
    return Scene.of(land, camera.plan(land, (121, 90)))


def said(path):
    """Dots per inch, and whom to name, as Pillow reads them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with Image.open(path) as image:
            image.load()
            exif = image.getexif()
            makers = image.info.get("Copyright") or exif.get(0x8298)
            if image.format == "WEBP":
                assert exif[0x0128] == 2
                return [float(exif[0x011A]), float(exif[0x011B])], makers
            return [float(v) for v in image.info["dpi"]], makers


@pytest.mark.parametrize("how", ["at once", "by bands"])
@pytest.mark.parametrize("ending", ["png", "jpg", "webp", "tif"])
def test_files_say_their_resolution_and_makers(scene, tmp_path, ending, how):
    out, picture = tmp_path / f"a.{ending}", draw(scene)
    if how == "at once":
        assert picture.save(out, dpi=254.0) == out
    else:
        draw_large(scene, out, pixels=121 * 32, dpi=254.0)
    dpi, makers = said(out)
    assert dpi == pytest.approx([254, 254], abs=0.01)
    assert makers == (MAKERS[0] if ending == "png" else "(c) the makers & others")
    with rasterio.open(out) as file:  # (GDAL reads it, too)
        pixels = np.moveaxis(file.read()[:3], 0, 2)
    if ending == "jpg":
        assert np.abs(pixels.astype(int) - picture.pixels).mean() < 4
    else:
        np.testing.assert_array_equal(pixels, picture.pixels)
    assert [f.name for f in tmp_path.iterdir()] == [out.name]


def test_without_a_resolution_files_say_none(scene, tmp_path):
    draw(scene).save(tmp_path / "a.png")
    draw_large(scene, tmp_path / "b.png", pixels=121 * 32)
    for name in ("a.png", "b.png"):
        with Image.open(tmp_path / name) as image:
            assert "dpi" not in image.info


@pytest.mark.parametrize("dpi", [0, -300, float("nan"), 1e6])
def test_what_is_no_resolution_is_refused(scene, tmp_path, dpi):
    for write in (lambda: draw(scene).save(tmp_path / "a.png", dpi=dpi),
                  lambda: draw_large(scene, tmp_path / "a.png", dpi=dpi)):  # fmt: skip
        with pytest.raises(UsageError, match=re.escape("1 to 65535 dots per inch")):
            write()
    assert not list(tmp_path.iterdir())
