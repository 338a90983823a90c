"""A picture drawn from a store is the one drawn from its raster, to the byte: both go by the same rounded errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orograph import store
from orograph.gpu.device import Device
from orograph.lod.method import Goal
from orograph.lod.registry import method_of
from orograph.rendering.gpu.draw import draw
from orograph.scene.camera import around
from orograph.scene.scene import Scene
from orograph.store.prepare import prepare
from orograph.viewpoint import Camera

SETS = {
    "bigtujunga": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "rainier": "osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif",
}
SIZE = (320, 200)


@pytest.fixture(scope="module", params=sorted(SETS))
def both(request: pytest.FixtureRequest, shared_data: Path, tmp_path_factory: pytest.TempPathFactory):
    path = shared_data / SETS[request.param]
    if not path.exists():
        pytest.skip(f"{path} is not there")
    url = tmp_path_factory.mktemp("stored") / "s.oro"
    store.build([str(path)], url).close()
    return prepare([str(path)]), prepare([str(url)])


def _view(terrain):
    reach = min(terrain.grid.shape) * float(np.mean(terrain.grid.spacing))
    return around(terrain, SIZE, azimuth=200, pitch=18, distance=0.2 * reach)


@pytest.mark.stress
def test_the_gpu_draws_the_same_picture(device: Device, both) -> None:
    view = _view(both[0])
    ours, theirs = (draw(Scene.of(t, view, sky=True, tolerance=1.0), device=device) for t in both)
    assert ours.facts["patches"] == theirs.facts["patches"]
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)


@pytest.mark.parametrize("method", ["soar", "stateless"])
def test_methods_make_the_same_mesh(both, method: str) -> None:
    meshes = []
    for terrain in both:
        camera = Camera.over(terrain.grid, _view(terrain))
        meshes.append(method_of(method)(terrain).select(camera, Goal(tolerance=4.0)).tessellation())
    np.testing.assert_array_equal(*(m.triangles for m in meshes))
    np.testing.assert_array_equal(*(m.vertices for m in meshes))
