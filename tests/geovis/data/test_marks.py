"""Signs of uncertainty on upright faces: areas against geometry, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.standing import Kind
from orograph.geovis.data.standing_marks import LEAST, LINES, MORE, WIDEST, Face, marks_on
from orograph.scene.theming import themed

PLACE = Affine(50, 0, 500_000, 0, -50, 5_600_000)
PITCH, STRETCH = 80.0, 4.0


def face(u: float, columns: int = 90, rows: int = 30) -> Face:
    """A face 900 m long that bends in its middle, and 60 m high."""
    x = np.linspace(0, 900, columns + 1)
    line = np.stack([np.minimum(x, 450), np.maximum(x - 450, 0)], 1)
    column, row = (v.ravel() for v in np.meshgrid(np.arange(columns), np.arange(rows)))
    low, doubt = 100 + 60 * row / rows, np.full(columns * rows, u)
    return Face(line[:-1], line[1:], column, low, low + 60 / rows, doubt, column + 1000.0 * row)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.full((41, 60), 100, np.float32), transform=PLACE, crs="EPSG:32630")


@pytest.mark.parametrize("u", [0.0, 0.4, 1.0])
def test_triangles_are_equilateral_in_the_picture_and_as_large_as_their_uncertainty(u):
    found = marks_on(face(u), "glyphs", PITCH, STRETCH)
    inner = found.layer == 2
    wide = np.hypot(*(found.end - found.start).T)
    area = (wide * (found.top - found.low) * STRETCH)[inner]
    radius = PITCH * (LEAST + MORE * u)
    count = (900 // PITCH) * (60 // (PITCH / STRETCH))
    assert area.sum() == pytest.approx(count * np.sqrt(27) / 4 * radius**2)
    tall = (found.top[inner].reshape(int(count), -1).max(1) - found.low[inner].reshape(int(count), -1).min(1)) * STRETCH
    np.testing.assert_allclose(tall, 1.5 * radius)
    behind = set(found.values.tolist())
    assert len(behind) == count and behind <= set(face(u).values.tolist())


@pytest.mark.parametrize("u", [0.0, 0.5, 1.0])
def test_hatching_covers_its_share_of_the_face(u):
    found = marks_on(face(u), "hatching", PITCH, STRETCH)
    area = np.hypot(*(found.end - found.start).T) * (found.top - found.low)
    lines = 900 // (PITCH / LINES)
    assert area.sum() == pytest.approx(lines * 60 * PITCH / LINES * WIDEST * u)
    assert area.sum() / (900 * 60) == pytest.approx(WIDEST * u, rel=0.03)


def test_layers_lie_before_the_face_on_the_side_asked_for():
    found = marks_on(face(0.7), "glyphs", PITCH, STRETCH)
    for gap in (0.5, -0.5):
        start, _ = found.before(gap)
        along = found.start[:, 1] == 0  # (the first half goes east: its left is north)
        np.testing.assert_allclose((start - found.start)[along], np.outer(found.layer[along] * gap, (0, 1)), atol=1e-9)


def section(ground: orograph.Terrain, style: str, sign: str | None, priority: str = "T+D+U-"):
    rng = np.random.default_rng(3)
    levels = xr.DataArray(
        rng.normal(10, 2, (4, 5, 12, 16)) * np.linspace(0.2, 2, 5)[None, :, None, None],
        dims=("member", "height", "y", "x"),
        coords={
            "height": ("height", [150.0, 300, 400, 600, 700], {"units": "m", "standard_name": "height"}),
            "x": 500_000 + (np.arange(16) + 0.5) * 190, "y": 5_600_000 - (np.arange(12) + 0.5) * 175,
        },
    )  # fmt: skip
    data = Dataset(levels, style=style, member="all", uncertainty=Uncertainty("spread", style=sign))
    return themed({"data": data, "priority": priority}, ground, (300, 200)).things


@pytest.mark.parametrize("style", ["curtains", "walls"])
def test_prioritised_uncertainty_has_signs_of_its_own_on_sections(ground, style):
    pytest.importorskip("rioxarray")
    kind = Kind.SECTION if style == "curtains" else Kind.PANEL
    pale, plain = section(ground, style, None), section(ground, style, "none")
    signed = section(ground, style, None, "T+D+U+")
    assert len(pale) == len(plain) and (pale.rgb != plain.rgb).any()
    assert len(signed) > len(plain)
    assert (signed.kind == kind).sum() - (plain.kind == kind).sum() == len(signed) - len(plain)
    assert [words for words, _ in signed.legend.swatches]
    assert section(ground, style, "hatching").legend.swatches[0][1].shape == (32, 32, 3)
    assert len(section(ground, style, "glyphs", "T+D+U+")) == len(signed)


def test_curtains_along_lines_have_signs_of_their_own(ground):
    line = {
        "type": "Feature", "properties": {"speed": 5.0, "sd": 2.0},
        "geometry": {"type": "LineString", "coordinates": [[500_200.0, 5_599_800.0], [502_600.0, 5_598_200.0]]},
    }  # fmt: skip
    source = {"type": "FeatureCollection", "crs": {"properties": {"name": "EPSG:32630"}}, "features": [line]}
    pictures = []
    for sign in ("none", "glyphs", "hatching"):
        doubt = Uncertainty("sd", style=sign, range=(0.0, 2.0))
        data = Dataset(source, variable="speed", style="curtains", size=300.0, range=(0.0, 10.0), uncertainty=doubt)
        view = orograph.camera.around(ground, (300, 200), pitch=20.0)
        pictures.append(orograph.render(ground, view, data=data, progress=False).pixels.astype(int))
    plain, glyphs, hatched = pictures
    red = (glyphs[..., 0] > 120) & (glyphs[..., 1] < 90) & (glyphs[..., 2] < 110)
    assert red.sum() > 50
    assert not ((plain[..., 0] > 120) & (plain[..., 1] < 90) & (plain[..., 2] < 110)).any()
    changed = (plain != hatched).any(-1)
    assert changed.any() and hatched[changed].mean() < plain[changed].mean()


@pytest.mark.parametrize(
    ("style", "sign", "words"),
    [
        ("curtains", "errorbars", "nothing along which a bar could stand.*glyphs, hatching"),
        ("walls", "blur", "walls cannot be shown by blur.*glyphs, hatching"),
    ],
)
def test_signs_that_sections_have_no_place_for_are_refused(ground, style, sign, words):
    pytest.importorskip("rioxarray")
    with pytest.raises(UsageError, match=words):
        section(ground, style, sign)


@pytest.mark.parametrize("style", ["bars", "cones", "spheres", "discs", "flags"])
@pytest.mark.parametrize("sign", ["glyphs", "hatching", "noise", "blur", "transparency", "errorbars"])
def test_signs_that_things_cannot_show_are_refused(ground, style, sign):
    table = {"x": [500_500.0, 501_500.0], "y": [5_599_000.0, 5_598_900.0], "v": [1.0, 2.0], "sd": [0.1, 0.5]}
    data = Dataset(table, variable="v", style=style, uncertainty=Uncertainty("sd", style=sign))
    if sign == "errorbars" and style in ("bars", "cones"):
        assert themed({"data": data}, ground, (300, 200)).things is not None
        return
    with pytest.raises(UsageError, match=f"{style} cannot be shown by {sign}.*whiteness"):
        themed({"data": data}, ground, (300, 200))
