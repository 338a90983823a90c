"""Real ground for tests of the GPU's methods."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "store"))  # ``webserver``


@pytest.fixture(scope="session")
def real_ground(shared_data: Path) -> tuple[np.ndarray, np.ndarray]:
    """32 × 32 samples of the San Gabriel Mountains, 30 m apart, and the linear part of their geotransform."""
    import rasterio

    with rasterio.open(next((shared_data / "bigtujunga-srtm30m-utm").glob("*.tif"))) as file:
        heights = file.read(1, window=((208, 240), (308, 340))).astype(np.float32)
        t = file.transform
    return heights, np.array([[t.a, t.b], [t.d, t.e]])
