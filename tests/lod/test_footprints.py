"""Blocks that patches may cover, against NumPy: any patches, any camera, squeezed ones, heights that are not there."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.lod.patches.footprints import MARGIN, Screen, footprints
from orograph.lod.patches.shape import INSTANCE, STEPS
from orograph.viewpoint import View

GRID = Grid((900, 1400), Affine(30, 0, 5e5, 0, -30, 4e6))


def plain(instances, spans, legs, last, screen):
    """What ``footprints`` finds, all patches at once."""
    omega, step = instances["omega"], instances["step"].astype(np.int64)
    places = []  # rows and columns of four corners, the last two the same unless squeezed: (4, k)
    for axis, name in enumerate(("row", "col")):
        apex = instances[name].astype(np.int64)
        ends = [apex + (legs * STEPS[omega, e, axis].astype(np.int64) << step) for e in range(2)]
        places.append(np.stack([apex, *ends, ends[1]]))
    squeezed = (places[0].max(0) > last[0]) | (places[1].max(0) > last[1])
    for place, end, which in zip(places, last, ([0, 0, 1, 1], [0, 1, 0, 1]), strict=True):
        some = np.minimum(place[:, squeezed], end)
        place[:, squeezed] = np.stack([some.min(0), some.max(0)])[which]
    up = spans.astype(np.float64).T[:, None]
    with np.errstate(all="ignore"):
        x, y, w = ((a * places[1] + b * places[0] + d + c * up).reshape(8, -1) for a, b, c, d in screen.rows)
        anywhere = ~(w.min(0) > screen.nearest) | ~np.isfinite(spans).all(1)
        x, y = x / w, y / w
        edges = np.stack([x.min(0) - MARGIN, y.min(0) - MARGIN, x.max(0) + MARGIN, y.max(0) + MARGIN]) / screen.side
        most = np.array([*screen.shape[::-1], *screen.shape[::-1]])[:, None]
        found = np.clip(np.nan_to_num(np.floor(edges) + np.array([[0], [0], [1], [1]])), 0, most).astype(np.int64).T
    found[anywhere] = 0, 0, *screen.shape[::-1]
    return found


@pytest.mark.parametrize("projection", ["perspective", "plan"])
def test_blocks_are_those_found_in_numpy(projection) -> None:
    rng, legs = np.random.default_rng(3), 16
    kinds = np.zeros(3, int)
    for _ in range(60):
        instances = np.zeros(400, INSTANCE)
        instances["step"] = rng.integers(0, 6, 400)
        for name, n in (("row", GRID.rows), ("col", GRID.cols)):
            instances[name] = rng.integers(0, n, 400)
        instances["omega"] = rng.integers(0, 8, 400)
        spans = np.sort(rng.uniform(0, 900, (400, 2)), 1).astype(np.float32)
        spans[rng.random(400) < 0.05] = np.nan
        (x, u), (y, v) = GRID.xy(rng.uniform(-0.2, 1.2, 2) * GRID.cols, rng.uniform(-0.2, 1.2, 2) * GRID.rows)
        width, height = (int(n) for n in rng.integers(1, 2000, 2))
        view = View((x, y, rng.uniform(300, 9000)), (u, v, 0), width=width, height=height, projection=projection)
        screen = Screen.of(view, GRID, float(rng.choice([1.0, 4.0])), int(rng.choice([32, 64, 128])))
        found = footprints(instances, spans, legs, (GRID.rows - 1, GRID.cols - 1), screen)
        np.testing.assert_array_equal(found, plain(instances, spans, legs, (GRID.rows - 1, GRID.cols - 1), screen))
        whole, empty = (found == [0, 0, *screen.shape[::-1]]).all(1), (found[:, :2] >= found[:, 2:]).any(1)
        kinds += whole.sum(), empty.sum(), (~whole & ~empty).sum()
    assert (kinds > 500).all()
