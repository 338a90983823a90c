"""Odd rasters in odd views: every method's mesh is without defects and keeps its tolerance, whatever the shape."""

from __future__ import annotations

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.lod.restricted_quadtree import RestrictedQuadtree
from orograph.lod.smart import Smart
from orograph.lod.stateless import Stateless
from orograph.lod.threshold_spheres import ThresholdSpheres
from orograph.lod.top_down import TopDown


def odd_terrain(rng: np.random.Generator):
    """Any shape from 2 × 2 on, with patches, single samples and corners missing; turned, stretched cells."""
    shape = tuple(int(v) for v in rng.integers(2, 80, 2))
    z = plain.rough(rng, shape, amplitude=float(rng.choice([5, 80, 800])), gaps=float(rng.choice([0, 0, 0.02, 0.4])))
    if rng.random() < 0.3:
        z[tuple(int(rng.integers(side)) for side in shape)] = np.nan
    if rng.random() < 0.2:
        z[-3:, -3:] = np.nan
    if np.isnan(z).all():
        z[:] = 0.0
    return plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 3])))


@pytest.mark.cases(1)
@pytest.mark.parametrize("seed", range(4))
def test_promise_and_no_defect(seed):
    rng = np.random.default_rng(seed)
    for _ in range(15):
        t = odd_terrain(rng)
        exaggeration = float(rng.choice([0.5, 1, 3]))
        methods = [
            plain.refiner(TopDown, t, exaggeration=exaggeration),
            plain.refiner(TopDown, t, exaggeration=exaggeration, metric="localised", depth=int(rng.integers(9))),
            plain.refiner(Stateless, t, exaggeration=exaggeration, cull=bool(rng.integers(2))),
            plain.refiner(ThresholdSpheres, t, exaggeration=exaggeration),
            plain.refiner(RestrictedQuadtree, t, exaggeration=exaggeration),
            plain.refiner(RestrictedQuadtree, t, exaggeration=exaggeration, triangulation="restricted"),
            plain.refiner(Smart, t, exaggeration=exaggeration, cells=16),
        ]
        for _ in range(2):
            near, far = float(rng.choice([0, 0, 50])), float(rng.choice([np.inf, np.inf, 3000]))
            view = plain.random_view(rng, t, near=near, far=far)
            if rng.random() < 0.3:  # a tile of the picture: its frustum lies to one side
                view = view.tile(int(rng.integers(0, 200)), int(rng.integers(0, 120)), 100, 70)
            tolerance = float(10 ** rng.uniform(-1.5, 1.2))
            for method in methods:
                mesh = method.refine(view, tolerance=tolerance)
                report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
                assert report.ok(tolerance), (method.info.name, method.metric.name, t.grid.shape, report)


@pytest.mark.parametrize("shape", [(643, 1197), (68, 41), (67, 90)])
def test_ground_at_a_squeezed_corner_is_covered(shape):
    """There a coarse triangle covers ground that none of its descendants does."""
    rng = np.random.default_rng(shape)
    t = plain.terrain(plain.rough(rng, shape, amplitude=400))
    x, y = t.grid.xy(shape[1] - 1, shape[0] - 1)
    view = plain.View((float(x) + 500, float(y) - 500, 3000.0), (float(x) - 2000, float(y) + 2000, 0.0), fov_y=70.0)
    for tolerance in (2.0, 8.0, 32.0, 128.0):
        for kind in (TopDown, Stateless, ThresholdSpheres, RestrictedQuadtree, Smart):
            method = plain.refiner(kind, t)
            report = verify.judge_mesh(method.refine(view, tolerance=tolerance), t, view)
            assert report.ok(tolerance), (method.info.name, report)
