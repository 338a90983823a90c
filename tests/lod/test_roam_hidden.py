"""ROAM where nearly all that is in view is hidden or turned away, over real ground: what is saved, and what stays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import plain
import pytest
import rasterio

from orograph.lod.roam import Roam
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import View

VALLEYS = [
    ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", 1101, 357, 30.0, 156.29),
    ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", 683, 222, 2.0, 287.88),
    ("lsd-topo/gabilan.tif", 182, 593, 2.0, 2.91),
    ("lsd-topo/Mandakini.tif", 240, 276, 2.0, 45.26),
    ("sainthelens-usgsdem/SainteHelens.dem", 253, 95, 10.0, 121.41),
]
"""A file, the place of the eye (column, row, metres above ground), and where it looks, degrees from north."""


def valley(folder, name, col, row, above, azimuth) -> tuple[MemoryTerrain, View]:
    with rasterio.open(folder / name) as file:
        z = file.read(1).astype(np.float32)
        if file.nodata is not None:
            z[z == np.float32(file.nodata)] = np.nan
        t = plain.terrain(z, cell=abs(file.transform.a))
    x, y = (float(v) for v in t.grid.xy(col, row))
    height, turn = float(z[row, col]) + above, math.radians(azimuth)
    target = x + 1000 * math.sin(turn), y + 1000 * math.cos(turn), height + 50
    return t, View((x, y, height), target, fov_y=50, width=1280, height=720)


def on_screen(view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels from the middle of the picture, right and up, and depth, of points (x, y, z)."""
    eye, camera = np.array(view.eye), plain.Camera(view)
    at = (points - eye) @ camera.axes.T
    depth = at @ np.array([0.0, 0.0, math.copysign(1.0, (np.array(view.target) - eye) @ camera.axes[2])])
    return camera.focal * at[:, :2] / depth[:, None], depth


def in_view(t: MemoryTerrain, view: View, count: int) -> tuple[np.ndarray, ...]:
    """(column, row, height) of points of the surface in the picture's frame, and whether each can be seen, by lines."""
    rng = np.random.default_rng(1)
    z = t.heights.astype(float)
    col, row = rng.uniform(0, z.shape[1] - 1, 300 * count), rng.uniform(0, z.shape[0] - 1, 300 * count)
    # Half of them near the eye, where most of what is seen lies.
    eye = [float(v) for v in t.grid.index(*view.eye[:2])]
    near = np.exp(rng.uniform(0, np.log(200), (300 * count, 1))) * _turned(rng.uniform(0, 2 * np.pi, 300 * count))
    near = (near + eye)[((near + eye) > 0).all(1) & ((near + eye) < np.array(z.shape[::-1]) - 1).all(1)]
    picked = []
    for c, r in ((col, row), near.T):
        h = plain.surface(z, c, r)
        pixels, depth = on_screen(view, np.stack([*t.grid.xy(c, r), h], 1))
        inside = (depth > 1) & (np.abs(pixels) < (view.width / 2, view.height / 2)).all(1) & np.isfinite(h)
        picked.append(np.stack([c, r, h], 1)[inside][:count])
    points = np.concatenate(picked)
    s = np.linspace(0, 1, 2500)[:-4]
    line = np.array([*eye, view.eye[2]]) + s[:, None] * (points[:, None] - np.array([*eye, view.eye[2]]))
    c, r, h = np.moveaxis(line, 2, 0)
    on = (c >= 0) & (c <= z.shape[1] - 1) & (r >= 0) & (r <= z.shape[0] - 1)
    ground = np.where(on, plain.surface(z, c.clip(0, z.shape[1] - 1), r.clip(0, z.shape[0] - 1)), -np.inf)
    return points, ~(ground > h).any(1), np.arange(len(points)) < len(picked[0])


def _turned(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], 1)


@pytest.mark.cases(1)
@pytest.mark.parametrize("place", VALLEYS)
def test_the_mesh_halves_where_most_is_hidden_and_keeps_its_promise_where_it_is_seen(shared_data, place):
    t, view = valley(shared_data, *place)
    points, seen, anywhere = in_view(t, view, 600)
    assert (~seen[anywhere]).mean() >= 0.9 and seen.sum() > 60
    usual = plain.refiner(Roam, t).refine(view, tolerance=1.0)
    found = plain.refiner(Roam, t, occluded=0.0).refine(view, tolerance=1.0)
    assert len(found.triangles) <= 0.5 * len(usual.triangles)
    col, row, height = points[seen].T
    x, y = t.grid.xy(col, row)
    truth, _ = on_screen(view, np.stack([x, y, height], 1))
    mesh, depth = on_screen(view, np.stack([x, y, plain.on_mesh(found, col, row)], 1))
    assert (np.linalg.norm(mesh - truth, axis=1) <= 1.0 + 1e-3).all() and (depth > 0).all()
    # It is coarser than that where nothing is seen: else there was nothing to save.
    col, row, height = points[~seen].T
    x, y = t.grid.xy(col, row)
    truth, _ = on_screen(view, np.stack([x, y, height], 1))
    mesh, _ = on_screen(view, np.stack([x, y, plain.on_mesh(found, col, row)], 1))
    assert (np.linalg.norm(mesh - truth, axis=1) > 2.0).any()


def test_a_flight_ends_in_the_mesh_that_is_made_from_scratch(shared_data):
    """What is hidden changes with every step."""
    t, view = valley(shared_data, *VALLEYS[4])
    options = {"occluded": 0.0, "back_facing": 0.0}
    carried, changed = plain.refiner(Roam, t, **options), 0
    before: set | None = None
    for k in range(8):
        x, y, z = view.eye
        moved = replace(
            view, eye=(x + 60 * k, y - 30 * k, z + 15 * k), target=(view.target[0] + 15 * k, *view.target[1:])
        )
        now = plain.triangles_of(carried.refine(moved, tolerance=1.0))
        assert now == plain.triangles_of(plain.refiner(Roam, t, **options).refine(moved, tolerance=1.0))
        changed, before = changed + len(now - (before or now)), now
    assert changed > 1000
