"""The GPU's methods of ambient occlusion where users meet them: on the command line and in ``orograph.lighting``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

from orograph import lighting
from orograph.cli import cli
from orograph.gpu.device import NoAdapterError


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    y, x = np.mgrid[:40, :50]
    h = (60 * np.exp(-((x - 25) ** 2 + (y - 20) ** 2) / 60) + 200 + 80 * (x > 40)).astype(np.float32)
    path = tmp_path_factory.mktemp("gpu") / "dem.tif"
    how = {"driver": "GTiff", "width": 50, "height": 40, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    with rasterio.open(path, "w", transform=Affine(10, 0, 5e5, 0, -10, 5e6), **how) as file:
        file.write(h, 1)
    return path


@pytest.mark.parametrize("method", ["shadow-maps", "cone-tracing"])
def test_by_command_and_by_call(device: object, dem: Path, tmp_path: Path, method: str):
    out = tmp_path / "ao.tif"
    words = ["light", str(dem), "--product", "ambient-occlusion", "--radius", "200", "--by", method]
    done = CliRunner().invoke(cli, [*words, "--rays", "64", "--cones", "24", "-o", str(out)])
    assert done.exit_code == 0, done.output
    with rasterio.open(out) as file:
        made, heights = file.read(1), rasterio.open(dem).read(1)
    called = lighting.make(heights, "ambient-occlusion", cell=10.0, radius=200.0, method=method, rays=64, cones=24)
    np.testing.assert_allclose(made, called, atol=2e-3)
    known = lighting.make(heights, "ambient-occlusion", cell=10.0, radius=200.0)
    assert known.min() < 0.8 and np.abs(made - known).mean() < 0.02


@pytest.mark.parametrize("method", ["shadow-maps", "cone-tracing"])
def test_without_an_adapter_the_remedy_is_said(dem: Path, tmp_path: Path, method: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("orograph.gpu.device.adapters", list)
    words = ["light", str(dem), "--product", "ambient-occlusion", "--by", method, "-o", str(tmp_path / "x.tif")]
    done = CliRunner().invoke(cli, words)
    assert isinstance(done.exception, NoAdapterError) or done.exit_code == NoAdapterError.exit_code
    assert not (tmp_path / "x.tif").exists()
    with pytest.raises(NoAdapterError, match="mesa-vulkan-drivers"):
        lighting.make(np.zeros((9, 9)), "ambient-occlusion", cell=10.0, method=method)
