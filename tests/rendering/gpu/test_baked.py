"""Baked light: both renderers look it up and say so; what is gone of it is told, and not taken for an open sky."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from cielab import lab
from pyproj import CRS

import orograph
from orograph.errors import DamagedChunkError
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lighting.bake import bake
from orograph.store.source import ArraySource

SIDE = 130


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    y, x = np.mgrid[:SIDE, :SIDE] * 30.0
    z = (400 + 300 * np.sin(x / 500) * np.cos(y / 700)).astype(np.float32)
    path = tmp_path_factory.mktemp("baked") / "hills.oro"
    grid = Grid(z.shape, Affine(30, 0, 7e5, 0, -30, 5.3e6), CRS.from_epsg(32632))
    orograph.build(ArraySource(z, grid, "hills"), path).close()
    bake(path, ["aperture", "ambient-occlusion"]).close()
    return path


def told(path: Path, backend: str, **how: Any) -> str:
    """Where a picture's light came from."""
    with orograph.open(path) as terrain:
        facts = orograph.render(terrain, size=(96, 64), sun=(300, 25), samples=1, backend=backend, **how).facts
    assert facts["backend"] == "gpu" if backend == "gpu" else "shader" in facts
    return str(facts["light"] if backend == "gpu" else facts["shader"]["light"])


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_what_is_baked_is_used(device: Device, store: Path, backend: str) -> None:
    assert told(store, backend, light="aperture") == "baked aperture"
    assert told(store, backend, light="ao") == "baked ambient-occlusion"
    assert told(store, backend, light="raytraced", rays=4) == "4 rays"
    # Caps are of true heights: of stretched ones they are made for the picture.
    assert told(store, backend, light="aperture", exaggeration=2.0) == "swept aperture"


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_a_bake_that_was_interrupted_is_not_used(device: Device, store: Path, tmp_path: Path, backend: str) -> None:
    """What is being made lies beside the layers there are, which serve on; where there were none light is swept."""
    half = tmp_path / "half.oro"
    shutil.copytree(store, half)
    (half / "layers" / ".partial").mkdir()
    shutil.copytree(half / "layers" / "aperture" / "0", half / "layers" / ".partial" / "0")
    assert told(half, backend, light="aperture") == "baked aperture"
    bare = tmp_path / "bare.oro"
    with orograph.open(store) as terrain:
        source = ArraySource(terrain.read(0, 0, SIDE, 0, SIDE), terrain.grid, "hills")
    orograph.build(source, bare).close()
    shutil.copytree(store / "layers" / "aperture", bare / "layers" / "aperture")
    assert told(bare, backend, light="aperture") == "swept aperture"


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_a_layer_that_lacks_chunks_is_told(device: Device, store: Path, tmp_path: Path, backend: str) -> None:
    torn = tmp_path / "torn.oro"
    shutil.copytree(store, torn)
    for level in (torn / "layers" / "aperture").glob("[0-9]*"):
        shutil.rmtree(level / "up" / "c")
    with pytest.raises(DamagedChunkError, match=r"layers/aperture/\d/up.*not there.*orograph\.bake"):
        told(torn, backend, light="aperture")


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ground with relief at all scales, as real one has, with baked caps and shares of the sky."""
    side, rng = 400, np.random.default_rng(3)
    f = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    f[0, 0] = 1
    z = np.fft.irfft2((rng.normal(size=f.shape) + 1j * rng.normal(size=f.shape)) / f**1.8, (side, side))
    z = ((z - z.min()) / np.ptp(z) * 1500).astype(np.float32)
    path = tmp_path_factory.mktemp("rough") / "rough.oro"
    grid = Grid(z.shape, Affine(30, 0, 7e5, 0, -30, 5.3e6), CRS.from_epsg(32632))
    orograph.build(ArraySource(z, grid, "rough"), path).close()
    bake(path, ["aperture", "ambient-occlusion"]).close()
    return path


@pytest.mark.parametrize("light", ["aperture", "ao"])
@pytest.mark.parametrize("size", [(120, 80), (480, 320)])
def test_both_backends_show_the_same_light(device: Device, rough: Path, light: str, size: tuple[int, int]) -> None:
    """At whatever scale: slopes and caps of the same levels. With a fine mesh, for both to see the same ground; without
    the sun's shadows for ``ao``, whose edges are another matter."""
    made = []
    for backend in ("cpu", "gpu"):
        with orograph.open(rough) as terrain:
            drawn = orograph.render(
                terrain, size=size, sun=(300, 30), light=light, samples=1, tolerance=0.05, backend=backend,
                shadows=light == "aperture",
            )  # fmt: skip
        made.append(lab(np.asarray(drawn.pixels)[..., :3]))
    off = np.linalg.norm(made[0] - made[1], axis=-1)
    assert off.mean() < 0.1 and np.quantile(off, 0.99) < 1.0, (off.mean(), np.quantile(off, 0.99))
