"""Data on the GPU's pictures are those on the CPU's, painted and standing."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.transform import from_origin

import orograph
from orograph.gpu.device import Device


@pytest.mark.stress
def test_data_look_the_same_on_both_backends(device: Device) -> None:
    y, x = np.mgrid[:60, :80]
    heights = (100 * np.sin(x / 9) * np.cos(y / 7)).astype(np.float32)
    terrain = orograph.terrain(heights, transform=from_origin(500_000, 5_600_000, 30, 30), crs="EPSG:32630")
    members = np.random.default_rng(0).normal(x / 8, 0.3, (4, 60, 80)).astype(np.float32)
    line = [[500_300.0, 5_599_700.0, 180.0], [501_500.0, 5_599_000.0, 60.0], [502_000.0, 5_598_600.0, 220.0]]
    track = {
        "type": "Feature", "properties": {"v": 3.0}, "geometry": {"type": "LineString", "coordinates": line},
        "crs": {"type": "name", "properties": {"name": "EPSG:32630"}},
    }  # fmt: skip
    data = [
        orograph.Dataset(members, band="all", uncertainty="spread", style="segmented"),
        orograph.Dataset(members, band=1, style="bars", size=200.0),
        *(orograph.Dataset(track, variable="v", style=style, size=60.0) for style in ("tubes", "curtains")),
    ]
    view = orograph.camera.around(terrain, (320, 200), azimuth=200, pitch=35, distance=None)
    cpu, gpu = (orograph.render(terrain, view, data=data, backend=name, tolerance=0.1) for name in ("cpu", "gpu"))
    assert gpu.facts["backend"] == "gpu"
    off = np.abs(cpu.pixels.astype(int) - gpu.pixels.astype(int)).max(-1)
    assert off.mean() < 1
    assert (off > 40).mean() < 0.005
    both = np.isfinite(cpu.depth) & np.isfinite(gpu.depth)
    assert np.quantile(np.abs(cpu.depth - gpu.depth)[both], 0.99) < 2
