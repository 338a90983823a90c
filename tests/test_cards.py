"""What objects say of themselves: size, spacing, CRS, heights, datum, bytes; in notebooks with a small picture."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from PIL import Image
from pyproj import CRS

import orograph
from orograph import cards
from orograph.geo import Grid
from orograph.tessellation import Tessellation

GRID = Grid((40, 50), Affine(30, 0, 380000, 0, -30, 3790000), CRS.from_epsg(32611))


def dem() -> orograph.Dem:
    rows, cols = np.mgrid[:40, :50].astype(np.float32)
    heights = 500 + 7 * rows + 3 * cols
    heights[0, 0] = np.nan
    return orograph.Dem(heights, GRID, "EGM96 height", "<hill>")


def picture_in(card: str) -> np.ndarray:
    found = re.search(r"data:image/png;base64,([^\"]+)", card)
    assert found is not None
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))))


def test_terrain_of_all_kinds(tmp_path: Path) -> None:
    said = "'<hill>': 40 × 50 samples, 30 m apart, WGS 84 / UTM zone 11N, 503 to 920 m (EGM96 height), "
    assert repr(dem()) == f"<Dem {said}8 kB>"
    ground = orograph.terrain(dem())
    assert repr(ground) == f"<MemoryTerrain {said}1 level, 8 kB>"
    stored = orograph.build(dem(), tmp_path / "a.oro")
    assert repr(stored).startswith(f"<StoredTerrain {said}1 level, {tmp_path / 'a.oro'}, ")
    for thing in (dem(), ground, stored):
        card = thing._repr_html_()
        assert "&lt;hill&gt;" in card and "<hill>" not in card and "503 to 920 m" in card
        assert picture_in(card).shape == (40, 50, 3)
    stored.close()


def test_terrain_without_anything() -> None:
    empty = orograph.Dem(np.full((3, 3), np.nan, np.float32), Grid((3, 3), Affine(1, 0, 0, 0, -1, 3)))
    assert repr(empty) == "<Dem 'terrain': 3 × 3 samples, 1 m apart, no CRS, none, 36 bytes>"
    assert (picture_in(empty._repr_html_()) == 255).all()


def test_degrees() -> None:
    grid = Grid((3, 3), Affine(1 / 3600, 0, 7, 0, -1 / 1200, 46), CRS.from_epsg(4326))
    assert cards.extent_rows(grid)[1] == ("spacing", "0.000277778 × 0.000833333°")


def test_light_comes_from_the_north_west() -> None:
    rows, cols = np.mgrid[:20, :20].astype(np.float32)
    lit = {}
    for name, slope in {"north-west": rows + cols, "south-east": -rows - cols, "level": 0 * rows}.items():
        png = cards.relief(10 * slope, GRID)
        lit[name] = float(np.asarray(Image.open(io.BytesIO(png))).mean())
    assert lit["north-west"] > lit["level"] > lit["south-east"]
    large = Image.open(io.BytesIO(cards.relief(np.zeros((1000, 300), np.float32), GRID)))
    assert max(large.size) <= cards.SIDE


def test_views_and_layers_say_what_is_not_usual() -> None:
    view = orograph.View((0, 0, 100), (10, 0, 0), fov_y=30, width=64, height=48)
    assert repr(view) == "View(eye=(0.0, 0.0, 100.0), target=(10.0, 0.0, 0.0), fov_y=30, width=64, height=48)"
    assert eval(repr(view), {"View": orograph.View}) == view
    assert "64 × 48" in view._repr_html_()
    layer = orograph.Layer("rain.tif", colormap="viridis", opacity=0.5)
    assert repr(layer) == "Layer('rain.tif', opacity=0.5, colormap='viridis')"
    assert eval(repr(layer), {"Layer": orograph.Layer}) == layer


def test_meshes() -> None:
    mesh = Tessellation(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), stats={"method": "soar"})
    assert repr(mesh) == "<Tessellation soar: 1 triangles, 3 vertices, 84 bytes>"
    assert "soar" in mesh._repr_html_()


@pytest.mark.parametrize(("size", "text"), [(36, "36 bytes"), (8000, "8 kB"), (3.079e6, "3.08 MB"), (2e9, "2 GB")])
def test_amounts(size: float, text: str) -> None:
    assert cards.amount(size) == text
