"""What grows around holes is what SciPy's dilation gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from orograph.rendering.gpu.surface.void_fill import _grown


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (40, 33)])
@pytest.mark.parametrize("times", [1, 2, 5])
def test_growth_is_scipys_dilation(shape, times):
    there = np.random.default_rng(times).random(shape) > 0.93
    assert np.array_equal(_grown(there, times), binary_dilation(there, iterations=times))
