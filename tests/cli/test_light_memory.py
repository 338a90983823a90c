"""What light takes, by the operating system's own account of a process: no more than --max-memory says."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

MIB = 1 << 20
PRODUCTS = "aperture,sky-view-factor"


def dem(path, rows, cols):
    import rasterio
    from rasterio.transform import Affine

    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    heights = 900 + 300 * np.sin(x / 31) * np.cos(y / 47) + 40 * np.sin(x / 3.3 + y / 2.1)
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="float32", crs="EPSG:32611",
        transform=Affine(30, 0, 4e5, 0, -30, 4e6), tiled=True,
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)
    return path


@pytest.fixture
def wide(tmp_path):
    """2100 × 2200 samples, of which canvases of five bands alone take 88 MiB; all kernels are compiled (LLVM takes
    as much)."""
    small = dem(tmp_path / "small.tif", 300, 310)
    peak("build", small, "-o", tmp_path / "small.oro", "--errors", "none", "--bake", PRODUCTS, "--max-memory", "400MiB")
    peak("light", small, "--product", PRODUCTS, "-o", tmp_path / "small-light.tif")
    return dem(tmp_path / "wide.tif", 2100, 2200)


def peak(*words) -> int:
    """MiB of the largest resident size of a run in a process of its own: the child of a small process, since a child
    of the tests' own begins with what they have taken."""
    between = "import resource as r, subprocess as s, sys; s.run(sys.argv[1:], check=True, stdout=s.DEVNULL); "
    told = subprocess.run(
        [
            sys.executable, "-c", between + "print(r.getrusage(r.RUSAGE_CHILDREN).ru_maxrss)",
            sys.executable, "-m", "orograph", "--quiet", *map(str, words),
        ],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return int(told.stdout) * 1024 // MIB


@pytest.mark.stress
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in KiB on Linux")
def test_light_stays_within_what_is_allowed(wide, tmp_path):
    """A build with a bake (406 MiB once, when shards were made whole), a bake, a map."""
    allowed, store = 400, tmp_path / "a.oro"
    within = ("--max-memory", f"{allowed}MiB", "--jobs", 2)
    assert peak("build", wide, "-o", store, "--errors", "none", "--bake", "aperture", *within) <= allowed
    few = ("--azimuths", 8, "--overwrite", "--products", PRODUCTS)
    assert peak("bake", store, *few, *within) <= allowed
    assert peak("light", store, "--product", PRODUCTS, "--azimuths", 8, "-o", tmp_path / "a.tif", *within) <= allowed
