"""Ghosted surfaces: over the ground they cover it in part, under it they shine through, beside it there is nothing."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.scene.ghosts import Ghost

SIZE = (120, 90)
PLACE = Affine(50, 0, 500_000, 0, -50, 5_600_000)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:60, :80]
    return orograph.terrain((100 + 20 * np.sin(x / 7 + y / 9)).astype(np.float32), transform=PLACE, crs="EPSG:32630")


@pytest.fixture(scope="module")
def surface() -> np.ndarray:
    """Level: under most of the ground's crests, over its valleys; it rises in the east."""
    y, x = np.mgrid[:60, :80]
    return (90 + 0.5 * x + 0 * y).astype(np.float32)


def test_pixels_are_mixed_by_what_is_nearer(ground, surface):
    view = orograph.camera.whole(ground, SIZE)
    ghost = Ghost(surface, color="#c03020", opacity=0.6, hidden=0.3)
    made = orograph.render(ground, view, ghosts=ghost, progress=False)
    bare = orograph.render(ground, view, progress=False)
    alone = orograph.terrain(surface, transform=PLACE, crs="EPSG:32630", progress=False)
    other = orograph.render(alone, view, colormap=ghost.table, water="none", progress=False)
    over, under = other.depth <= bare.depth, other.depth > bare.depth
    assert over.sum() > 500 and under.sum() > 500
    part = np.where(over, 0.6, np.where(under, 0.3, 0.0))[..., None]
    one, two = (srgb_to_linear(p.pixels / 255) for p in (bare, other))
    expected = linear_to_srgb(one * (1 - part) + two * part) * 255
    border = np.isnan(other.depth) | np.isnan(bare.depth)  # (the last half sample, and what only one of them shows)
    assert np.abs(made.pixels - expected)[~border].max() < 1.0
    np.testing.assert_array_equal(made.depth, bare.depth)
    assert "surface" in made.describe()


def test_a_file_in_another_crs_and_larger_than_the_terrain(ground, tmp_path):
    path = tmp_path / "table.tif"
    with rasterio.open(path, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32", crs="EPSG:4326",
                       transform=Affine(0.002, 0, -3.03, 0, -0.002, 50.57)) as file:  # fmt: skip
        file.write(np.full((60, 60), 150.0, np.float32), 1)
        file.units = ("m",)
    view = orograph.camera.plan(ground, SIZE)
    bare = orograph.render(ground, view, progress=False)
    made = orograph.render(ground, view, ghosts=str(path), progress=False)
    changed = (made.pixels != bare.pixels).any(-1)
    inside = np.isfinite(bare.depth)
    assert changed[inside].mean() > 0.95 and not changed[~inside].any()


def test_backends_and_the_command_line(ground, surface, tmp_path):
    from click.testing import CliRunner

    from orograph.cli import cli

    orograph.export(ground, tmp_path / "ground.tif", progress=False)
    top = orograph.terrain(surface, transform=PLACE, crs="EPSG:32630", progress=False)
    orograph.export(top, tmp_path / "top.tif", progress=False)
    out = tmp_path / "o.png"
    said = f"{tmp_path / 'top.tif'},color=#c03020,opacity=0.6,hidden=0.3,name=Table"
    ran = CliRunner().invoke(cli, ["-q", "render", str(tmp_path / "ground.tif"), "-o", str(out), "--size", "120x90",
                                   "--ghost", said], obj={})  # fmt: skip
    assert ran.exit_code == 0, ran.output
    from PIL import Image

    ghost = Ghost(surface, color="#c03020", opacity=0.6, hidden=0.3)
    made = orograph.render(ground, size=SIZE, ghosts=ghost, progress=False)
    assert np.abs(np.asarray(Image.open(out).convert("RGB")).astype(int) - made.pixels).max() <= 1


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Ghost("a.tif", opacity=2), "from 0 to 1"),
        (lambda: Ghost("a.tif", color="nocolor"), "#rrggbb"),
        (lambda: Ghost.parse("a.tif,colour=red"), "color"),
        (lambda: Ghost.parse("a.tif,hidden=x"), "number"),
    ],
)
def test_what_makes_no_sense_is_refused(make, says):
    with pytest.raises(UsageError) as told:
        make()
    assert says in f"{told.value.what} {told.value.remedy}"


def test_surfaces_that_do_not_belong_are_refused(ground):
    with pytest.raises(UsageError, match="60 × 80 samples"):
        orograph.render(ground, size=SIZE, ghosts=np.zeros((9, 9), np.float32), progress=False)
    away = orograph.terrain(np.zeros((9, 9), np.float32), transform=Affine(50, 0, 900_000, 0, -50, 5_600_000),
                            crs="EPSG:32630", progress=False)  # fmt: skip
    with pytest.raises(UsageError, match="no heights over the terrain"):
        orograph.render(ground, size=SIZE, ghosts=away, progress=False)
    other = orograph.terrain(np.zeros((9, 9), np.float32), transform=PLACE, crs="EPSG:32631", progress=False)
    with pytest.raises(UsageError, match="a different CRS"):
        orograph.render(ground, size=SIZE, ghosts=other, progress=False)
