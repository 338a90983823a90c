"""Line integral convolution and pairs of datasets: against plain NumPy, analytic fields, and brute force."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.color import linear_to_srgb
from orograph.geovis.data.bivariate import CORNERS, pairs, shown_pair, square
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.lic import GRAIN, STEP, brightness
from orograph.geovis.data.painted import painted
from orograph.geovis.data.painting import shown
from orograph.geovis.data.patterns import _hash
from orograph.geovis.data.priority import Priority

UTM = "EPSG:32630"
PLACE = Affine(100, 0, 500_000, 0, -100, 5_600_000)


def noise(x, y):
    i, j = (np.floor(v / GRAIN).astype(np.int64).astype(np.uint32) for v in (x, y))
    return (_hash(i * np.uint32(0x9E3779B1) ^ _hash(j)).astype(np.float64) + 0.5) / 2.0**32


def plain(across, down, pace, steps):
    """Every texel's streak at once, in NumPy."""
    rows, cols = across.shape
    y, x = np.mgrid[:rows, :cols] + 0.5
    flows = (across != 0) | (down != 0)
    total, count, grains = noise(x, y), np.ones(x.shape), np.ones(x.shape)

    def flow(px, py, going):
        j, i = np.floor(px).astype(int), np.floor(py).astype(int)
        inside = going & (j >= 0) & (i >= 0) & (j < cols) & (i < rows)
        i, j = np.where(inside, i, 0), np.where(inside, j, 0)
        u, v = across[i, j] * pace[i, j], down[i, j] * pace[i, j]
        return u * inside, v * inside, inside & ((u != 0) | (v != 0))

    for sign in (1.0, -1.0):
        px, py, going = x.copy(), y.copy(), flows.copy()
        at = np.floor(px / GRAIN), np.floor(py / GRAIN)
        for _ in range(steps):
            u, v, _ = flow(px, py, going)
            inside = going & (np.floor(px) >= 0) & (np.floor(py) >= 0) & (np.floor(px) < cols) & (np.floor(py) < rows)
            u, v, going = flow(px + 0.5 * sign * u, py + 0.5 * sign * v, inside)
            px, py = px + sign * u * going, py + sign * v * going
            total += np.where(going, noise(px, py), 0)
            count += going
            now = np.floor(px / GRAIN), np.floor(py / GRAIN)
            grains += going & ((now[0] != at[0]) | (now[1] != at[1]))
            at = now
    return np.clip(0.5 + 0.3 * np.where(flows, (total / count - 0.5) * np.sqrt(12 * grains), 0), 0, 1)


def vortex(rows=60, cols=70):
    y, x = np.mgrid[:rows, :cols] + 0.5
    dx, dy = x - cols / 2, y - rows / 2
    size = np.hypot(dx, dy)
    return -dy / size, dx / size, size


@pytest.mark.stress
def test_the_kernel_is_what_plain_numpy_says():
    across, down, _ = vortex()
    across[:10, :20] = down[:10, :20] = 0
    pace = np.full(across.shape, STEP)
    np.testing.assert_allclose(brightness(across, down, pace, 12), plain(across, down, pace, 12), atol=1e-12)


def test_streaks_follow_the_flow():
    """Around a vortex brightness varies across circles, and hardly along them."""
    across, down, size = vortex(240, 240)
    found = brightness(across, down, np.full(across.shape, STEP), 24)
    gy, gx = np.gradient(found)
    ring = (size > 30) & (size < 100)
    along, out = (gx * across + gy * down)[ring], (-gx * down + gy * across)[ring]
    assert np.abs(out).mean() > 3 * np.abs(along).mean()
    assert found.std() > 0.15
    assert found.mean() == pytest.approx(0.5, abs=0.03)


def test_any_tile_of_it_is_the_same():
    across, down, _ = vortex(160, 180)
    pace = np.full(across.shape, STEP)
    whole = brightness(across, down, pace, 16)
    margin = 16
    for row, col in ((20, 30), (57, 91), (100, 140)):
        part = slice(row - margin, row + 30 + margin), slice(col - margin, col + 24 + margin)
        tile = brightness(across[part], down[part], pace[part], 16, (row - margin, col - margin))
        np.testing.assert_array_equal(tile[margin:-margin, margin:-margin], whole[row : row + 30, col : col + 24])


def written(path, bands):
    bands = np.asarray(bands, np.float32)
    with rasterio.open(
        path, "w", driver="GTiff", count=len(bands), height=bands.shape[1], width=bands.shape[2], dtype="float32",
        crs=UTM, transform=Affine(500, 0, 500_000, 0, -500, 5_600_000),
    ) as file:  # fmt: skip
        file.write(bands)
    return str(path)


def lag_of(streaks):
    """Texels along the rows after which brightness is half as alike."""
    centred = streaks - streaks.mean()
    whole = (centred**2).mean()
    alike = [(centred[:, k:] * centred[:, :-k]).mean() / whole for k in range(1, 80)]
    return int(np.argmax(np.array(alike) < 0.5)) + 1


def test_steps_are_metres_on_the_surface(tmp_path):
    """On a slope of 60° a streak is, seen from above, half as long as on flat ground."""
    u = np.full((32, 40), 5.0)
    path = written(tmp_path / "w.tif", [u, 0 * u])
    flat = orograph.terrain(np.zeros((160, 200), np.float32), transform=PLACE, crs=UTM)
    rising = np.tile(np.arange(200) * 100 * np.sqrt(3), (160, 1)).astype(np.float32)
    steep = orograph.terrain(rising, transform=PLACE, crs=UTM)
    from orograph.scene.theming import _heights

    lags = []
    for terrain in (flat, steep):
        given = Dataset(path, band="1+2", style="lic", size=6000.0)
        found = shown(given, terrain.grid, 400, Priority(), lambda over, t=terrain: _heights(t, over))
        np.testing.assert_allclose(found.values, 5, rtol=1e-5)
        lags.append(lag_of(found.streaks))
    assert lags[0] / lags[1] == pytest.approx(2, rel=0.25)


@pytest.mark.stress
def test_where_there_is_no_flow_there_is_no_streak(tmp_path):
    u = np.full((32, 40), 5.0)
    u[:, :20] = np.nan
    terrain = orograph.terrain(np.zeros((160, 200), np.float32), transform=PLACE, crs=UTM)
    given = Dataset(written(tmp_path / "w.tif", [u, 0 * u]), band="1+2", style="lic")
    view = orograph.camera.plan(terrain, (300, 240))
    one = orograph.render(terrain, view, data=given, light="none").pixels
    two = orograph.render(terrain, view, data=given.but(style="arrows", opacity=0), light="none").pixels
    off = np.abs(one.astype(int) - two).max(-1)[20:-20]
    assert off[:, 20:120].max() == 0
    assert off[:, 180:280].std() > 10
    with pytest.raises(UsageError, match="to the east and to the north"):
        orograph.render(terrain, view, data=given.but(band=1))


def test_a_pair_has_the_colour_of_both_its_classes(tmp_path):
    terrain = orograph.terrain(np.zeros((160, 200), np.float32), transform=PLACE, crs=UTM)
    a, b = np.tile(np.arange(40.0), (32, 1)), np.tile(np.arange(32.0)[:, None], (1, 40))
    path = written(tmp_path / "p.tif", [a, b])
    given = Dataset(path, band="1+2", style="bivariate", classes=3, breaks="equal", range=None)
    ((first, second),) = pairs((given,))
    found = shown_pair(first.but(range=(0, 39)), second.but(range=(0, 31)), terrain.grid, 400)
    layer = painted(found)
    with rasterio.open(layer.path) as file:
        image = file.read().transpose(1, 2, 0)
    colors = np.rint(linear_to_srgb(square(3, 3)) * 255)
    for i, row in ((0, 30), (1, 160), (2, 300)):
        for j, col in ((0, 30), (1, 200), (2, 370)):
            assert np.abs(image[row, col, :3] - colors[i, j]).max() <= 1, (i, j)
    for corner, wanted in zip((colors[0, 0], colors[0, -1], colors[-1, 0], colors[-1, -1]), CORNERS):
        assert "#" + "".join(f"{int(v):02x}" for v in corner) == wanted
    (key,) = layer.key.squares
    assert key.across_edges == pytest.approx((0, 13, 26, 39))
    picture = orograph.render(
        terrain, orograph.camera.plan(terrain, (500, 400)), furniture=True,
        data=[Dataset(path, band=k, style="bivariate") for k in (1, 2)],
    )  # fmt: skip
    assert "in 3 classes" in picture.facts["description"]


def test_what_is_no_pair_is_told():
    array = np.zeros((4, 4))
    with pytest.raises(UsageError, match="needs two variables"):
        pairs((Dataset(array, style="bivariate"),))
    three = pairs((Dataset(array, style="bivariate"), Dataset(array), Dataset(array, style="bivariate")))
    assert [isinstance(one, tuple) for one in three] == [False, True]
    grid = orograph.terrain(np.zeros((16, 20), np.float32), transform=PLACE, crs=UTM).grid
    with pytest.raises(UsageError, match="cannot also show"):
        shown_pair(Dataset(array, style="bivariate", uncertainty=Uncertainty("spread")), Dataset(array), grid, 64)


def test_colours_of_pairs_are_told_apart():
    """Neighbours in the square differ, to normal eyes and to those without red or green cones (Viénot et al. 1999)."""
    rgb = square(3, 3).reshape(-1, 3).astype(np.float64)
    protan = np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]])
    deutan = np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]])
    for eyes in (np.eye(3), protan, deutan):
        seen = np.clip(rgb @ eyes.T, 0, 1) ** (1 / 2.2)
        away = np.linalg.norm(seen[:, None] - seen[None], axis=-1) + np.eye(9)
        assert away.min() > 0.08
