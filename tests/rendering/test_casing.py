"""Contour lines are as legible in shadow as in light."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine

import orograph
from orograph.geovis.color import srgb_to_linear


def contrast(backend: str, azimuth: float, altitude: float) -> float:
    """The ratio of the lightest to the darkest parts of a slope that looks east, with lines on it."""
    heights = np.broadcast_to(np.linspace(640, 0, 65, dtype=np.float32), (65, 65)).copy()
    ground = orograph.terrain(heights, transform=Affine(20, 0, 500_000, 0, -20, 5_600_000), crs="EPSG:32630")
    view = orograph.camera.plan(ground, (240, 240))
    light = []
    for lines in (80, None):
        picture = orograph.render(
            ground, view, backend=backend, sun=(azimuth, altitude), contours=lines, samples=4, progress=False
        )
        inner = srgb_to_linear(picture.pixels[60:180, 60:180] / np.float32(255))
        light.append(inner @ [0.2126, 0.7152, 0.0722] + 0.05)
    low, high = np.quantile(light[0] / light[1], [0.02, 0.98])
    return float(high / low)


@pytest.mark.stress
@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_lines_in_shadow_have_the_contrast_of_lines_in_light(backend, request):
    if backend == "gpu":
        request.getfixturevalue("device")
    lit, shaded = contrast(backend, 90, 45), contrast(backend, 270, 8)
    assert lit > 1.6
    assert shaded > 0.8 * lit
