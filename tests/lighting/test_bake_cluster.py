"""Light baked by workers: the same bytes as by one process, whatever they hand on, and whatever was done before."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph import store
from orograph.errors import StoreError, UsageError
from orograph.geo.grid import Grid
from orograph.lighting.bake import bake
from orograph.lighting.bake_state import BakeState
from orograph.lighting.context import Options
from orograph.lighting.occlusion import ELSEWHERE
from orograph.store.source import ArraySource

SHAPE = (211, 347)


def ground() -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    h = 300 * np.sin(x / 11) * np.cos(y / 7) + 40 * np.sin(x / 2.3 + y / 3.1)
    h[60:95, 40:90] = np.nan
    return h.astype(np.float32)


def made(folder):
    grid = Grid(SHAPE, Affine(20, 0, 500_000, 0, -25, 4_000_000), CRS.from_epsg(32611))
    store.build(ArraySource(ground(), grid, "hills"), folder, errors=(), shard=64, chunk=32).close()
    return folder


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Workers:
    """Stands for a cluster: each task is done by a state of its own, which knows nothing but what lies in files."""

    def __init__(self, recipe, stop_after=None):
        self.recipe, self.left = recipe, stop_after

    def run(self, stage, progress):
        for spot in stage.tasks():
            own = BakeState(self.recipe).stage(stage.name, stage.number)
            if own.found(spot) is None:
                if self.left == 0:
                    raise StoreError("stopped")
                if self.left is not None:
                    self.left -= 1
                own.make(spot)
            found = stage.found(spot, proof=False)
            assert found is not None
            stage.add(spot, found)
        stage.finish()


@pytest.fixture
def by_workers(monkeypatch):
    """Bakes that are told to use workers do it with ``Workers``; what they are to do before they stop."""
    import contextlib

    from orograph.lighting import bake as module

    stop = [None]

    @contextlib.contextmanager
    def on_workers(recipe, *_):
        yield Workers(recipe, stop[0])

    monkeypatch.setattr(module, "on_workers", on_workers)
    return stop


CASES = {
    "swept": (["sky-view-factor", "aperture", "openness", "openness-negative", "horizon"], Options(azimuths=9)),
    "round": (["sky-view-horizontal", "ambient-occlusion"], Options(azimuths=5, curvature=True)),
    "radius": (["visible-sky", "sky-view-factor"], Options(azimuths=7, radius=700.0)),
    "sun": (["insolation", "sunshine"], Options(azimuths=8, more={"date": "2026-06-21"})),
    "walks": (["ambient-occlusion"], Options(azimuths=6, radius=300.0, more={"rho": "linear"})),
    "maps": (["ambient-occlusion"], Options(rays=8, radius=300.0, more={"method": "shadow-maps"})),
    "cones": (["ambient-occlusion"], Options(radius=300.0, more={"method": "cone-tracing", "cones": 8})),
    "rays": (["ambient-occlusion"], Options(rays=8, radius=300.0, more={"method": "rays", "seed": 3})),
}


@pytest.mark.cases(1)
@pytest.mark.parametrize("case", CASES)
def test_workers_make_what_one_process_makes(tmp_path, case, by_workers, request):
    names, options = CASES[case]
    if options.more.get("method") in ELSEWHERE:
        request.getfixturevalue("device")
    bake(made(tmp_path / "whole"), names, options, jobs=1).close()
    bake(made(tmp_path / "s"), names, options, workers=1).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.stress
def test_what_is_done_is_not_done_again(tmp_path, by_workers):
    names, options = CASES["swept"]
    bake(made(tmp_path / "whole"), names, options, jobs=1).close()
    target, runs = made(tmp_path / "s"), 0
    by_workers[0] = 61
    while True:
        runs += 1
        try:
            bake(target, names, options, workers=1).close()
            break
        except StoreError:
            with store.open(target) as terrain:
                assert terrain.layers == ()
    assert runs > 3
    assert files(target) == files(tmp_path / "whole")


@pytest.mark.stress
def test_on_a_real_cluster(tmp_path):
    pytest.importorskip("distributed")
    names, options = CASES["swept"][0][:2], Options(azimuths=5)
    bake(made(tmp_path / "whole"), names, options, jobs=1).close()
    bake(made(tmp_path / "s"), names, options, workers=2, progress=False).close()
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_what_workers_do_not_bake(tmp_path):
    target = made(tmp_path / "s")
    with pytest.raises(UsageError, match="exclude"):
        bake(target, "openness", workers=1, dask="tcp://127.0.0.1:1")
    with pytest.raises(UsageError, match="folders"):
        bake("memory://nowhere.oro", "openness", workers=1)
