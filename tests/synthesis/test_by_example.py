"""``synth`` by example: the same file whatever the jobs, and in Python; what makes no sense is refused."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
import orograph.store.ways
from orograph.cli.synth import command
from orograph.errors import OrographError, UsageError
from orograph.geo.grid import Grid
from orograph.synthesis.terrain import ByExample


@pytest.fixture(scope="module")
def lidar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """48 × 61 samples, 1 × 2 m apart, whose makers want to be named."""
    path = tmp_path_factory.mktemp("lidar") / "lidar.tif"
    y, x = np.mgrid[:48, :61]
    rng = np.random.default_rng(1)
    heights = (200 + 9 * np.sin(x / 9) + 7 * np.cos(y / 7 + x / 20) + rng.normal(0, 0.2, x.shape)).astype(np.float32)
    profile = {"driver": "GTiff", "height": 48, "width": 61, "count": 1, "dtype": "float32", "crs": "EPSG:25832"}
    with rasterio.open(path, "w", **profile, transform=Affine(1, 0, 350_000, 0, -2, 5_700_000)) as file:
        file.write(heights, 1)
        file.update_tags(ATTRIBUTION="© The survey")
    return path


@pytest.mark.stress
def test_a_file_is_what_python_makes_whatever_the_jobs(lidar: Path, tmp_path: Path) -> None:
    made = orograph.synth(size=(700, 530), seed=4, exemplar=lidar, jitter=[0.5, 0.4], progress=False)
    assert isinstance(made, orograph.Dem)
    files = []
    for jobs in ("1", "3"):
        files.append(tmp_path / f"{jobs}.tif")
        said = ["-o", str(files[-1]), "--size", "700x530", "--seed", "4", "--exemplar", str(lidar), "-j", jobs]
        said += ["--jitter", "0.5,0.4"]
        ran = CliRunner().invoke(command, said, obj=None)
        assert ran.exit_code == 0, ran.output
        assert "1 × 2 m apart" in ran.output
    assert files[0].read_bytes() == files[1].read_bytes()
    read = orograph.read(files[0])
    np.testing.assert_array_equal(read.heights, made.heights)
    assert read.grid.crs == made.grid.crs and read.grid.transform == made.grid.transform
    assert (made.grid.transform.a, made.grid.transform.e, made.grid.crs.to_epsg()) == (1, -2, 25832)
    assert read.attribution == made.attribution == ("© The survey",)
    with rasterio.open(files[0]) as file:
        assert file.tags()["TIFFTAG_IMAGEDESCRIPTION"] == "synthetic terrain after lidar 4"


def test_windows_fit_and_an_example_may_be_in_memory(lidar: Path) -> None:
    dem = orograph.read(lidar)
    made = ByExample(dem, (5000, 7000), 2, jobs=1)
    whole = made.read(4000, 4040, 100, 170)
    np.testing.assert_array_equal(whole[11:23, 5:50], made.read(4011, 4023, 105, 150))
    again = orograph.synth(size=40, seed=2, exemplar=dem, jitter=(0.5, 0.1), progress=False)
    assert isinstance(again, orograph.Dem) and again.heights.shape == (40, 40)
    assert not np.array_equal(again.heights, made.read(0, 40, 0, 40))


@pytest.mark.stress
def test_a_store_is_what_the_file_is(lidar: Path, tmp_path: Path) -> None:
    path = tmp_path / "like.oro"
    said = ["-o", str(path), "--size", "700x530", "--seed", "4", "--exemplar", str(lidar), "--passes", "1,2,0"]
    for more in ([], ["--overwrite"]):
        ran = CliRunner().invoke(command, [*said, *more], obj=None)
        assert ran.exit_code == 0, ran.output
    assert CliRunner().invoke(command, said, obj=None).exit_code
    made = orograph.synth(size=(700, 530), seed=4, exemplar=lidar, passes=(1, 2, 0), progress=False)
    twice = orograph.synth(size=(700, 530), seed=4, exemplar=lidar, passes=2, progress=False)
    with orograph.terrain(path) as terrain:
        np.testing.assert_array_equal(terrain.read(0, 0, 700, 0, 530), made.heights)
        assert terrain.attribution == ("© The survey",)
    assert not np.array_equal(made.heights, twice.heights)


def test_a_fractal_store(tmp_path: Path) -> None:
    made = orograph.synth(size=(90, 70), seed=3, progress=False)
    orograph.synth(tmp_path / "hills.oro", size=(90, 70), seed=3, progress=False)
    with orograph.terrain(tmp_path / "hills.oro") as terrain:
        np.testing.assert_array_equal(terrain.read(0, 0, 90, 0, 70), made.heights)


KILLED = """
import os, signal, sys
import orograph, orograph.store.ways
from orograph.dem.synth import Synth
from orograph.synthesis.terrain import ByExample

orograph.store.ways.SHARDS = (512,)
lidar, store = sys.argv[1:]
how = {"exemplar": lidar} if lidar else {}
one, left = ByExample if lidar else Synth, 5
read = one.read

def killing(self, *window):
    global left
    left -= 1
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    return read(self, *window)

one.read = killing
orograph.synth(store, size=(1100, 1030), seed=4, jobs=1, progress=False, **how)
"""


def files(store: Path) -> dict[str, bytes]:
    return {str(path.relative_to(store)): path.read_bytes() for path in store.rglob("*") if path.is_file()}


@pytest.mark.stress
@pytest.mark.parametrize("example", [True, pytest.param(False, marks=pytest.mark.stress)], ids=["example", "fractal"])
def test_a_killed_store_is_finished_to_the_same_bytes(
    lidar: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, example: bool
) -> None:
    killed, whole, begun = (tmp_path / name for name in ("killed.oro", "whole.oro", "killed.oro.partial"))
    ended = subprocess.run([sys.executable, "-c", KILLED, str(lidar) if example else "", str(killed)], env=os.environ)
    assert ended.returncode == -signal.SIGKILL and not killed.exists()
    made = {name: (begun / name).stat().st_mtime_ns for name in files(begun) if name.startswith("heights/0/")}
    assert any("/c/" in name for name in made), "nothing was kept of what was done"
    said = ["-o", str(killed), "--size", "1100x1030", "--seed", "4", *(("--exemplar", str(lidar)) if example else ())]
    for wrong in (["--seed", "5", "--resume"], ["--size", "1100x1031", "--resume"], ["--overwrite", "--resume"], []):
        ran = CliRunner().invoke(command, [*said, *wrong], obj=None)
        assert isinstance(ran.exception, OrographError) and begun.exists(), wrong
    ran = CliRunner().invoke(command, [*said, "--resume", "-j", "2"], obj=None)
    assert ran.exit_code == 0, ran.output
    kept = {name: at for name, at in made.items() if "/c/" in name}
    assert {name: (killed / name).stat().st_mtime_ns for name in kept} == kept, "what was done is done again"
    monkeypatch.setattr("orograph.store.ways.SHARDS", (512,))
    more = {"exemplar": lidar} if example else {}
    for _ in range(2):  # begins one; and finds it complete
        assert orograph.synth(whole, size=(1100, 1030), seed=4, resume=True, progress=False, **more) == whole
        assert files(killed) == files(whole)


def test_only_a_store_is_finished(tmp_path: Path) -> None:
    for output in (None, tmp_path / "a.tif"):
        with pytest.raises(UsageError, match="Only a store"):
            orograph.synth(output, size=40, resume=True, progress=False)


@pytest.mark.parametrize("name", ["spacing", "relief", "roughness"])
def test_what_the_example_says_itself_is_refused(lidar: Path, name: str) -> None:
    with pytest.raises(UsageError, match=name):
        orograph.synth(size=40, exemplar=lidar, progress=False, **{name: 2.0})


def test_what_makes_no_sense_is_refused(lidar: Path) -> None:
    with pytest.raises(UsageError, match="jitter"):
        orograph.synth(size=40, jitter=0.5)
    with pytest.raises(UsageError, match="passes"):
        orograph.synth(size=40, passes=1)
    for said in ({"jitter": 2.0}, {"passes": 3}, {"passes": 0.5}, {"passes": [1] * 9}):
        with pytest.raises(UsageError, match=next(iter(said))):
            orograph.synth(size=40, exemplar=lidar, progress=False, **said)
    holed = orograph.read(lidar).heights.copy()
    holed[3, 4] = np.nan
    grid = Grid(holed.shape, Affine(1, 0, 0, 0, -1, 0), orograph.read(lidar).grid.crs)
    with pytest.raises(UsageError, match="1 of its"):
        orograph.synth(size=40, exemplar=orograph.Dem(holed, grid), progress=False)
    ran = CliRunner().invoke(command, ["-o", str(lidar), "--exemplar", str(lidar), "--overwrite"], obj=None)
    assert isinstance(ran.exception, UsageError) and "overwrite" in str(ran.exception)


@pytest.mark.stress
def test_a_store_by_workers_or_in_parts_is_that_of_one_process(lidar: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    how: dict[str, Any] = {"size": (700, 1100), "seed": 4, "exemplar": lidar, "jitter": [0.5, 0.4], "progress": False}
    fractal: dict[str, Any] = {"size": (700, 600), "seed": 4, "progress": False}
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        for name, given in (("like", how), ("fractal", fractal)):
            whole = orograph.synth(tmp_path / f"{name}.oro", jobs=1, **given)
            by_dask = orograph.synth(tmp_path / f"{name}-dask.oro", dask=client, **given)
            assert isinstance(whole, Path) and isinstance(by_dask, Path)
            assert files(by_dask) == files(whole)
    parts = tmp_path / "parts.oro"
    for index in (2, 1):
        orograph.synth(parts, part=(index, 2), jobs=1, **how)
    orograph.synth(parts, finish=True, jobs=1, **how)
    assert files(parts) == files(tmp_path / "like.oro")
    with pytest.raises(UsageError, match="Only a store is made by several processes"):
        orograph.synth(tmp_path / "a.tif", workers=2, **fractal)
