"""Baked light: what is in the store is the product, averaged as it says, within the error it states, for any Zarr tool;
an interrupted bake leaves the store as it was and goes on to the same bytes."""

from __future__ import annotations

import errno
import os
import threading
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
import zarr

from orograph import store
from orograph.errors import DamagedChunkError, OutputError, StoreError, UsageError
from orograph.lighting.arrays import context_of
from orograph.lighting.bake import BAKED, PARTIAL, bake
from orograph.lighting.context import Options
from orograph.lighting.products import compute, names
from orograph.store.layers import LAYERS, LayerBand
from orograph.store.storage import FolderStorage

CELL = np.diag([20.0, -20.0])
SHAPE = (211, 347)
SIZES = {"shard": 64, "chunk": 32}
FEW = Options(azimuths=5)


def ground() -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    h = 300 * np.sin(x / 11) * np.cos(y / 7) + 40 * np.sin(x / 2.3 + y / 3.1)
    h[60:95, 40:90] = np.nan
    return h.astype(np.float32)


def made(folder, **options):
    from affine import Affine

    from orograph.geo.grid import Grid
    from orograph.store.source import ArraySource

    grid = Grid(SHAPE, Affine(20, 0, 500_000, 0, -20, 4_000_000), options.pop("crs", None))
    return store.build(ArraySource(ground(), grid, "hills"), folder, errors=(), **SIZES, **options)


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def blocks(values, level):
    """(…, rows, cols) → (…, R, C, block) of 2^level × 2^level samples, NaN beyond the border."""
    size = 1 << level
    rows, cols = (-(-n // size) * size for n in values.shape[-2:])
    pad = np.full((*values.shape[:-2], rows, cols), np.nan)
    pad[..., : values.shape[-2], : values.shape[-1]] = values
    cut = pad.reshape(*values.shape[:-2], rows // size, size, cols // size, size)
    return np.moveaxis(cut, -3, -2).reshape(*values.shape[:-2], rows // size, cols // size, -1)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("baked") / "area.oro"
    made(folder, crs=None)
    bake(folder, ["sky-view-factor", "aperture", "horizon", "openness"], FEW)
    return folder


def whole(layer, level):
    rows, cols = layer.shape(level)
    return layer.read(level, 0, rows, 0, cols)


@pytest.mark.parametrize("bits", [8, 16])
def test_codes_are_within_the_error_they_state(bits):
    band = LayerBand("a", "degrees", -3.0, 17.0, bits)
    values = np.random.default_rng(0).uniform(-3, 17, (50, 60)).astype(np.float32)
    values[0, :4] = np.nan, -3, 17, 99
    again = band.decode(band.encode(values))
    assert band.encode(values).dtype == f"uint{bits}" and (band.encode(values)[0, :2] == (0, 1)).all()
    assert np.isnan(again[0, 0]) and again[0, 1] == -3 and again[0, 2] == again[0, 3] == 17
    off = np.abs(again - values)[1:]
    assert 0.9 * band.error < off.max() <= band.error * 1.01 and band.error == 20 / (2**bits - 2) / 2


@pytest.mark.parametrize("name", ["sky-view-factor", "horizon", "openness"])
def test_levels_are_means_of_the_product(path, name):
    exact = compute(context_of(ground(), CELL, FEW), name).astype(np.float64)
    with store.open(path) as terrain:
        layer = terrain.layer(name)
        for level in range(terrain.levels):
            cut = blocks(exact, level)
            with np.errstate(invalid="ignore"):
                known = np.isfinite(cut).sum(-1)
                mean = np.where(known > 0, np.nansum(cut, -1) / np.maximum(known, 1), np.nan)
            got = whole(layer, level)
            assert got.shape == (len(layer.bands), *terrain.mean_shape(level))
            np.testing.assert_array_equal(np.isnan(got), np.isnan(mean))
            assert np.nanmax(np.abs(got - mean)) <= layer.bands[0].error * 1.01


def test_apertures_are_averaged_as_areas_and_vectors(path):
    exact = compute(context_of(ground(), CELL, FEW), "aperture").astype(np.float64)
    radius = np.radians(exact[3])
    with store.open(path) as terrain:
        layer = terrain.layer("aperture")
        for level in range(terrain.levels):
            moments = blocks(exact[:3] * np.sin(radius) ** 2, level)
            areas = blocks((1 - np.cos(radius))[None], level)[0]
            known = np.isfinite(areas).sum(-1)
            got = whole(layer, level)
            np.testing.assert_array_equal(np.isnan(got[3]), known == 0)
            ok = known > 0
            vector = np.nansum(moments, -1)[:, ok]
            vector /= np.linalg.norm(vector, axis=0)
            r = np.degrees(np.arccos(1 - np.nansum(areas, -1)[ok] / known[ok]))
            assert np.abs(got[:3][:, ok] - vector).max() < 2 * layer.bands[0].error
            assert np.abs(got[3][ok] - r).max() < 2 * layer.bands[3].error


def test_any_zarr_tool_reads_physical_units(path):
    with store.open(path) as terrain:
        layer = terrain.layer("aperture")
        for level in (0, terrain.levels - 1):
            level_of = xr.open_zarr(path, group=f"layers/aperture/{level}", consolidated=False)
            for k, band in enumerate(layer.bands):
                np.testing.assert_allclose(level_of[band.name].values, whole(layer, level)[k], atol=1e-5)
            assert level_of.radius.attrs["units"] == "degrees"
            assert level_of.radius.attrs["quantisation_error"] == pytest.approx(90 / 65534 / 2)
            assert level_of.x.size == layer.shape(level)[1] and level_of.x.values[0] == 500_000 + 10 * 2**level
        root = zarr.open_group(path, mode="r")
        assert root["layers/aperture/0/radius"].dtype == np.uint16
        assert "mean" in root["layers/sky-view-factor"].attrs["averaging"]
        assert root["layers/sky-view-factor"].attrs["made_with"]["azimuths"] == 5
        assert terrain.layers == ("aperture", "horizon", "openness", "sky-view-factor")
        codes = layer.codes(0, 10, 20, 30, 50)
        assert codes.dtype == np.uint16 and codes.shape == (4, 10, 20)
        np.testing.assert_array_equal(codes[3], root["layers/aperture/0/radius"][10:20, 30:50])


def test_the_same_bytes_whatever_the_threads_memory_and_company(path, tmp_path):
    for jobs, memory in ((1, 1 << 30), (3, 64 << 20)):
        folder = tmp_path / f"{jobs}"
        made(folder)
        bake(folder, ["openness", "horizon"], FEW, jobs=jobs, max_memory=memory)
        bake(folder, ["aperture"], FEW, jobs=jobs, max_memory=memory)
        bake(folder, ["sky-view-factor"], FEW, jobs=jobs, max_memory=memory)
        assert files(folder) == files(path)


class Stop(BaseException):
    """Stands for the end of the process."""


@pytest.mark.cases(3)
@pytest.mark.parametrize("seed", range(6))
def test_stopped_at_any_write(tmp_path, monkeypatch, path, seed):
    folder = tmp_path / "s"
    made(folder)
    bake(folder, ["sky-view-factor"], Options(azimuths=3), bits=16)
    before = files(folder)
    put, count = FolderStorage.put, [0]
    after = int(np.random.default_rng(seed).integers(1, 380))
    lock = threading.Lock()

    def stop(self, key, parts):
        with lock:
            count[0] += 1
            if count[0] > after:
                raise Stop
        put(self, key, parts)

    given = ["sky-view-factor", "aperture", "horizon", "openness"]
    with monkeypatch.context() as patch:
        patch.setattr(FolderStorage, "put", stop)
        with pytest.raises(Stop):
            bake(folder, given, FEW, jobs=1 + seed % 2)
    with store.open(folder) as terrain:  # the old layers, or none, but nothing false
        if terrain.layers:
            assert terrain.layers == ("sky-view-factor",) and terrain.layer("sky-view-factor").options["azimuths"] == 3
            assert {k: v for k, v in files(folder).items() if not k.startswith(PARTIAL)} == before
        assert terrain.check() == []
    with pytest.raises(StoreError, match=r"Another bake.*`overwrite=True`"):
        bake(folder, ["openness"], Options(azimuths=7))
    bake(folder, given, FEW, jobs=2)
    assert files(folder) == files(path)


def test_a_sweep_that_is_interrupted_goes_on(tmp_path, monkeypatch, path):
    from orograph.lighting.raster_resume import Checkpoint
    from orograph.lighting.sweep_pass import Pass

    folder = tmp_path / "s"
    made(folder)
    given = ["sky-view-factor", "aperture", "horizon", "openness"]
    save, passes = Checkpoint.save, []

    def interrupted(self, key, canvases, azimuths):
        if len(passes) == 2:
            raise KeyboardInterrupt
        passes.append(len(list(azimuths)))
        save(self, key, canvases, azimuths)

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", interrupted)
        with pytest.raises(KeyboardInterrupt):
            bake(folder, given, FEW)
    swept, begin = [], Pass.begin
    monkeypatch.setattr(Pass, "begin", lambda self, *how: swept.append(len(self.lines)) or begin(self, *how))
    bake(folder, given, FEW)
    assert sum(swept) == 2 * 5 - passes[-1]
    assert files(folder) == files(path)


def test_a_full_disk_is_told_without_advice_that_bake_has_not(tmp_path, monkeypatch):
    folder = tmp_path / "s"
    made(folder)

    def full(fd):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OutputError, match=r"cannot be kept: No space left on device.*the disk has space") as told:
            bake(folder, ["sky-view-factor"], FEW)
    assert "resume" not in str(told.value)


def test_what_is_there_is_left_and_what_differs_is_replaced(tmp_path):
    folder = tmp_path / "s"
    made(folder)
    bake(folder, ["ambient-occlusion"], Options(azimuths=4, radius=200.0))
    first = {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}
    bake(folder, ["ambient-occlusion"], Options(azimuths=4, radius=200.0))
    assert first == {p: p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}
    with store.open(folder) as terrain:
        assert terrain.layer("ambient-occlusion", radius=200.0, rho="step").options["method"] == "horizon"
        with pytest.raises(StoreError, match=r"made with radius 200.0, not 600.0.*orograph\.bake"):
            terrain.layer("ambient-occlusion", radius=600.0)
        with pytest.raises(StoreError, match=r"radius 200.0, not unlimited"):
            terrain.layer("ambient-occlusion", radius=None)
        with pytest.raises(UsageError, match="azimuths"):
            terrain.layer("ambient-occlusion", color=1)
        with pytest.raises(StoreError, match=r"no layer 'aperture'; it has ambient-occlusion.*orograph\.bake"):
            terrain.layer("aperture")
        old = terrain.layer("ambient-occlusion").read(0, 0, 50, 0, 50)
    bake(folder, ["ambient-occlusion"], Options(azimuths=4, radius=80.0, more={"rho": "linear"}))
    with store.open(folder) as terrain:
        layer = terrain.layer("ambient-occlusion", radius=80.0, rho="linear")
        assert not np.array_equal(layer.read(0, 0, 50, 0, 50), old)
        assert terrain.check() == []
    assert sorted(p.name for p in (folder / "layers").iterdir()) == ["ambient-occlusion", "zarr.json"]


def test_damage_and_other_heights_are_noticed(tmp_path):
    folder = tmp_path / "s"
    made(folder)
    bake(folder, ["visible-sky"], FEW)
    shard = folder / "layers/visible-sky/0/visible-sky/c/1/1"
    data = bytearray(shard.read_bytes())
    data[5] ^= 1
    shard.write_bytes(data)
    with store.open(folder) as terrain:
        with pytest.raises(DamagedChunkError, match="layers/visible-sky/0"):
            terrain.layer("visible-sky").read(0, 0, 200, 0, 200)
        assert terrain.check() == ["layers/visible-sky/0/visible-sky/c/1/1[0,0]"]
    bake(folder, ["visible-sky"], FEW, overwrite=True)
    with store.open(folder) as terrain:
        assert terrain.check() == []
        there = LAYERS.of(terrain.record)
        there["visible-sky"] = replace(there["visible-sky"], source="others")
        with pytest.raises(StoreError, match="other heights"):
            terrain.layer("visible-sky")


def test_a_bake_at_a_url(path):
    url = "memory://bake-test/area.oro"
    from affine import Affine

    from orograph.geo.grid import Grid
    from orograph.store.source import ArraySource

    grid = Grid(SHAPE, Affine(20, 0, 500_000, 0, -20, 4_000_000), None)
    store.build(ArraySource(ground(), grid, "hills"), url, errors=(), **SIZES)
    bake(url, ["sky-view-factor"], Options(azimuths=3))
    bake(url, ["sky-view-factor", "aperture"], FEW)
    with store.open(url) as terrain, store.open(path) as folder:
        for name in ("sky-view-factor", "aperture"):
            for level in range(terrain.levels):
                np.testing.assert_array_equal(whole(terrain.layer(name), level), whole(folder.layer(name), level))
        assert terrain.check() == []


def test_what_cannot_be_baked_is_refused(tmp_path):
    folder = tmp_path / "s"
    made(folder)
    assert set(BAKED) < set(names())
    for name, word in (("slope", "orograph light"), ("shadow", "orograph light"), ("sky", "no product")):
        with pytest.raises(UsageError, match=word):
            bake(folder, [name])
    with pytest.raises(UsageError, match="bits"):
        bake(folder, ["visible-sky"], bits=12)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="function"):
        bake(folder, ["ambient-occlusion"], Options(radius=50.0, more={"rho": lambda length: length / 50}))
    with pytest.raises(StoreError, match="no such store"):
        bake(tmp_path / "nowhere", ["visible-sky"])
    with store.open(folder) as terrain:
        assert terrain.layers == () and terrain.check() == []
