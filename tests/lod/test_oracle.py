"""The oracle against brute force over all diamonds, and as what conservative methods cannot beat by much."""

from __future__ import annotations

import numpy as np
import plain
import pytest
import rasterio
from test_top_down import true_errors

from orograph import verify
from orograph.errors import UsageError
from orograph.hierarchy import diamonds, fronts
from orograph.lod.oracle import oracle, oracles
from orograph.lod.soar import Soar
from orograph.lod.top_down import TopDown


def keeps(report: verify.Report, tolerance: float) -> bool:
    """Whether a mesh without defects keeps a tolerance at the samples in view: the oracle looks at nothing else."""
    return report.ok() and report.largest_at_samples <= tolerance * (1 + 1e-6)


def all_true_errors(p, camera):
    """(2^n + 1, 2^n + 1): the true error of every diamond."""
    found = np.zeros(p.z.shape)
    for level in range(2 * p.n):
        front = fronts.uniform(p.n, level)
        r, c = diamonds.of_triangle(*front.arrays)
        np.maximum.at(found, (r, c), true_errors(p, camera, front))
    return found


@pytest.mark.stress
def test_oracle_is_the_closure_of_the_true_errors():
    rng = np.random.default_rng(21)
    for _ in range(6):
        t = plain.terrain(plain.rough(rng, (17, 17)), angle=float(rng.uniform(0, 360)))
        p = plain.Plain(t)
        view = plain.random_view(rng, t)
        camera = plain.Camera(view)
        errors = all_true_errors(p, camera)
        for tolerance in (0.5, 2.0, 8.0):
            front = fronts.front_of(diamonds.closure(errors > tolerance))
            found = oracle(t, view, tolerance)
            assert found.stats["active"] == len(np.argwhere(diamonds.closure(errors > tolerance)))
            assert plain.triangles_of(found) <= p.triangle_set(front, np.ones(len(front), bool))
            assert keeps(verify.judge_mesh(found, t, view), tolerance)
            fewer = oracle(t, view, tolerance, prisms=True)
            assert plain.triangles_of(fewer) <= plain.triangles_of(found)
            assert keeps(verify.judge_mesh(fewer, t, view), tolerance)


@pytest.mark.parametrize("shape", [(40, 61), (30, 33)])
def test_oracle_keeps_the_promise_with_holes_and_squeezed_borders(shape):
    rng = np.random.default_rng(shape)
    for gaps in (0.0, 0.1):
        t = plain.terrain(plain.rough(rng, shape, gaps=gaps))
        for _ in range(8):
            view = plain.random_view(rng, t)
            tolerance = float(10 ** rng.uniform(-0.5, 1))
            for prisms in (False, True):
                report = verify.judge_mesh(oracle(t, view, tolerance, 1.5, prisms=prisms), t, view, exaggeration=1.5)
                assert keeps(report, tolerance), report


def test_engines_are_no_coarser_and_not_much_finer(shared_data):
    with rasterio.open(shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif") as file:
        t = plain.terrain(file.read(1)[:513, :513].astype(np.float32))
    rng = np.random.default_rng(22)
    soar, ahead = plain.refiner(Soar, t, metric="anisotropic"), plain.refiner(Soar, t)
    top_down = plain.refiner(TopDown, t, metric="localised", depth=64, near=0.0)
    counts = np.zeros(5)
    for _ in range(6):
        view = plain.random_view(rng, t, width=960, height=600)
        fewest, fewest_prisms = (len(oracle(t, view, 1.0, prisms=prisms).triangles) for prisms in (False, True))
        spheres, exact = (len(method.refine(view, tolerance=1.0).triangles) for method in (soar, top_down))
        assert fewest <= spheres
        # Forced splits do not look below accurate triangles, the closure does.
        # Methods keep the promise between samples, too; the oracle looks at samples.
        assert exact < 1.02 * fewest_prisms
        counts += fewest, spheres, exact, fewest_prisms, len(ahead.refine(view, tolerance=1.0).triangles)
    assert counts[1] < 1.2 * counts[0]
    assert counts[3] < counts[4] < 1.15 * counts[3]


def test_unusable_arguments_are_refused():
    t = plain.terrain(np.zeros((5, 5), np.float32))
    view = plain.random_view(np.random.default_rng(1), t)
    for tolerance in (0.0, -1.0, float("nan")):
        with pytest.raises(UsageError):
            oracle(t, view, tolerance)


def test_several_tolerances_at_once_are_the_same_as_one_by_one():
    rng = np.random.default_rng(31)
    t = plain.terrain(plain.rough(rng, (60, 65), gaps=0.05))
    for _ in range(5):
        view = plain.random_view(rng, t)
        tolerances = (0.5, 1.0, 3.0, 9.0)
        for tolerance, (spheres, prisms) in zip(tolerances, oracles(t, view, tolerances), strict=True):
            for found, how in ((spheres, False), (prisms, True)):
                alone = oracle(t, view, tolerance, prisms=how)
                assert plain.triangles_of(found) == plain.triangles_of(alone)
                assert found.stats["active"] == alone.stats["active"]
    with pytest.raises(UsageError, match="ascending"):
        next(oracles(t, view, (2.0, 1.0)))
