"""``orograph build`` as a process: what it says, what it returns, and how it is interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

from orograph import store
from orograph.cli import cli
from orograph.cli.build import command


def write(path, heights, crs="EPSG:32611", **profile):
    rows, cols = heights.shape
    transform = Affine(30, 0, 500_000, 0, -30, 4_000_000) if crs != "EPSG:4326" else Affine(0.01, 0, 8, 0, -0.01, 47)
    options = {"driver": "GTiff", "height": rows, "width": cols, "count": 1, "dtype": heights.dtype, "crs": crs}
    with rasterio.open(path, "w", transform=transform, **options, **profile) as file:
        file.write(heights, 1)
    return path


def orograph(*args, **kwargs):
    line = [sys.executable, "-m", "orograph", *map(str, args)]
    return subprocess.run(line, capture_output=True, text=True, timeout=120, **kwargs)


HEIGHTS = np.add.outer(np.arange(300, dtype=np.float32), np.arange(200, dtype=np.float32)) / 7


def test_it_says_what_it_made(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS, nodata=0)
    ran = orograph("build", dem, "-o", tmp_path / "area.oro")
    assert ran.returncode == 0, ran.stderr
    for said in (
        "area.oro",
        "200 × 300 samples at 30 m",
        "UTM zone 11N",
        "2 levels, side 513",
        "0.1 to 71.1 m",
        "peak",
    ):
        assert said in ran.stdout
    with store.open(tmp_path / "area.oro") as terrain:
        expected = np.where(HEIGHTS == 0, np.nan, HEIGHTS)
        np.testing.assert_array_equal(terrain.read(0, 0, 300, 0, 200), expected)


def test_the_sides_of_chunks_and_shards(tmp_path, run):
    dem, out = write(tmp_path / "dem.tif", HEIGHTS), tmp_path / "a.oro"
    for sides, said in (
        (("--chunk", 100), "--chunk must be a power of two, at least 8, not 100."),
        (("--chunk", 1), "--chunk must be a power of two, at least 8, not 1."),
        (("--shard", 100), "--shard must be a power of two, at least --chunk (256), not 100."),
        (("--shard", 128), "not 128. Make --chunk smaller, or leave --shard out: it follows from --max-memory."),
    ):
        code, _, err = run("build", dem, "-o", out, *sides)
        assert code == 2 and said in err and not list(tmp_path.glob("a.oro*"))
    assert run("build", dem, "-o", out, "--shard", 128, "--chunk", 64)[0] == 0
    array = json.loads((out / "heights/0/height/zarr.json").read_text())
    assert array["chunk_grid"]["configuration"]["chunk_shape"] == [128, 128]
    assert array["codecs"][0]["configuration"]["chunk_shape"] == [64, 64]


def test_json(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    ran = orograph("build", dem, "-o", tmp_path / "area.oro", "--json", "--max-memory", "512MiB", "--jobs", 1)
    told = json.loads(ran.stdout)
    assert told["shape"] == [300, 200] and told["levels"] == 2 and told["side"] == 513
    assert told["crs"] == "EPSG:32611" and told["spacing_m"] == [30, 30] and told["valid_fraction"] == 1
    assert told["size_bytes"] == sum(p.stat().st_size for p in (tmp_path / "area.oro").rglob("*") if p.is_file())
    assert told["height_range"] == [0, pytest.approx(HEIGHTS.max())]
    if sys.platform != "win32":
        assert 50e6 < told["peak_memory_bytes"] < 512 << 20


def test_too_little_memory_is_said_beforehand(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    ran = orograph("build", dem, "-o", tmp_path / "area.oro", "--max-memory", "100MiB")
    assert ran.returncode == 0 and "100 MiB is less than a build needs" in ran.stderr


def test_degrees_become_metres(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS, crs="EPSG:4326")
    ran = CliRunner().invoke(command, [str(dem), "-o", str(tmp_path / "a.oro"), "--json"], obj={"quiet": True})
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["crs"] == "EPSG:32632"


def test_whether_the_source_is_kept(tmp_path):
    dem, area = write(tmp_path / "dem.tif", HEIGHTS * 90, crs="EPSG:4326"), tmp_path / "area.oro"
    runner, place = CliRunner(), ["measure", "pick", str(area), "--lonlat", "8.504,46.503"]
    ran = runner.invoke(cli, ["build", str(dem), "-o", str(area)], catch_exceptions=False)
    assert "resampled: " in ran.output and "m rms from the source's samples, at most" in ran.output
    assert "(resampled" not in runner.invoke(cli, place, catch_exceptions=False).output
    line = ["build", str(dem), "-o", str(area), "--overwrite", "--no-keep-source", "--json"]
    told = json.loads(runner.invoke(cli, ["--quiet", *line], catch_exceptions=False).stdout)
    assert told["keeps_source"] is False and told["resampled"]["largest"] > 0
    said = runner.invoke(cli, place, catch_exceptions=False).output
    assert f"(resampled, ± {told['resampled']['largest']:.3g} m)" in said


@pytest.mark.cases(1)
@pytest.mark.parametrize("flags", [[], ["--resume"]])
def test_a_store_that_is_there_is_not_touched(tmp_path, flags):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    other = write(tmp_path / "other.tif", HEIGHTS + 1)
    assert orograph("build", dem, "-o", tmp_path / "a.oro").returncode == 0
    ran = orograph("build", other, "-o", tmp_path / "a.oro", *flags)
    assert ran.returncode == 4 and "--overwrite" in ran.stderr and "Traceback" not in ran.stderr
    ran = orograph("build", other, "-o", tmp_path / "a.oro", "--overwrite")
    assert ran.returncode == 0
    assert store.open(tmp_path / "a.oro").height_range[0] == 1


def test_faults_of_the_command_line_and_of_the_input(tmp_path):
    assert orograph("build", "-o", tmp_path / "a.oro").returncode == 2
    ran = orograph("build", tmp_path / "none.tif", "-o", tmp_path / "a.oro")
    assert ran.returncode == 3 and "none.tif" in ran.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.stress
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGINT")
def test_ctrl_c_tells_how_to_resume(tmp_path):
    rng = np.random.default_rng(0)
    dem = write(tmp_path / "dem.tif", rng.random((6200, 6200), dtype=np.float32))
    line = [sys.executable, "-m", "orograph", "build", dem, "-o", tmp_path / "a.oro", "--jobs", "1"]
    process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("a.oro.partial/parts/*.part")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 130, said
    assert "--resume" in said and "interrupted" in said and "Traceback" not in said
    assert not (tmp_path / "a.oro").exists()
    ran = orograph("build", dem, "-o", tmp_path / "a.oro", "--resume")
    assert ran.returncode == 0 and "6200 × 6200" in ran.stdout
    with rasterio.open(dem) as file:
        np.testing.assert_array_equal(store.open(tmp_path / "a.oro").read(0, 0, 6200, 0, 6200), file.read(1))


@pytest.mark.cases(2)
@pytest.mark.parametrize("how", ["plain", "overwrite", "resume", "update"])
def test_what_an_interrupted_build_says_can_be_done(tmp_path, monkeypatch, how):
    """The same command with what it says is accepted, and finishes."""
    dem, out = write(tmp_path / "dem.tif", HEIGHTS), tmp_path / "a.oro"
    line = ["build", str(dem), "-o", str(out)]
    if how == "overwrite":
        orograph(*line)
    flags = [] if how == "plain" else [f"--{how}"]

    def stopped(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(sys.modules["orograph.store.build"], "_fill", stopped)
        said = CliRunner().invoke(cli, ["-q", *line, *flags]).stderr
    assert "The new store" in said if how in ("overwrite", "update") else str(out) in said
    if "with --resume" in said:
        flags = ["--resume", *(flags if "in place of --overwrite" not in said and flags != ["--resume"] else [])]
    ran = orograph(*line, *flags)
    assert ran.returncode == 0, ran.stderr
    assert store.open(out).grid.shape == (300, 200)


@pytest.mark.stress
def test_a_real_mosaic_within_its_memory(shared_data, tmp_path):
    tiles = sorted((shared_data / "california-3s-tiles").glob("N3[67]W11*.tif"))
    if not tiles:
        pytest.skip("california-3s-tiles is not in the shared data")
    ran = orograph("build", *tiles, "-o", tmp_path / "ca.oro", "--json", "--max-memory", "600MiB")
    told = json.loads(ran.stdout)
    assert told["peak_memory_bytes"] < 600 << 20
    low, high = told["height_range"]
    assert -90 < low < -80 and 4380 < high < 4421  # Badwater; Mount Whitney, as three seconds of arc see it
    assert store.open(tmp_path / "ca.oro").check() == []


def test_kinds_of_errors(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    told = [
        CliRunner().invoke(command, [str(dem), "-o", str(tmp_path / name), "--json", *flags], obj={"quiet": True})
        for name, flags in {"a": [], "b": ["--errors", "wedgie,exact"], "c": ["--errors", "none"]}.items()
    ]
    assert [json.loads(ran.stdout)["errors"] for ran in told] == [["exact"], ["exact", "wedgie"], []]
    ran = CliRunner().invoke(command, [str(dem), "-o", str(tmp_path / "d"), "--errors", "best"], obj={"quiet": True})
    assert ran.exit_code == 2 and "'best' is not one of exact, wedgie, midpoint, none" in ran.output


def test_what_methods_need_is_stored_ahead(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    given = [
        str(dem),
        "-o",
        str(tmp_path / "a"),
        "--for",
        "roam,error=wedgie",
        "--for",
        "soar,error=midpoint",
        "--json",
    ]
    ran = CliRunner().invoke(command, given, obj={"quiet": True})
    assert json.loads(ran.stdout)["errors"] == ["exact", "wedgie", "midpoint"]
    ran = CliRunner().invoke(command, [*given[:3], "--for", "sore", "--overwrite"], obj={"quiet": True})
    assert ran.exit_code != 0 and "no method 'sore'" in str(ran.exception)


@pytest.mark.stress
def test_tins_are_stored_ahead(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    given = [str(dem), "-o", str(tmp_path / "a"), "--for", "bdam,legs=8"]
    assert CliRunner().invoke(command, given, obj={"quiet": True}).exit_code == 0
    assert store.open(tmp_path / "a").has("tins", legs=8)
    again = CliRunner().invoke(command, [*given, "--for", "bdam", "--overwrite"], obj={"quiet": True})
    assert again.exit_code != 0 and "TINs of one kind" in str(again.exception)
    same = CliRunner().invoke(command, [*given[:3], "--resume", "--tins", "8"], obj={"quiet": True})
    assert same.exit_code == 0
    other = CliRunner().invoke(command, [*given[:3], "--resume"], obj={"quiet": True})
    assert other.exit_code != 0 and "TINs differ" in str(other.exception)


@pytest.mark.stress
def test_chunks_are_stored_ahead(tmp_path):
    dem = write(tmp_path / "dem.tif", HEIGHTS)
    given = [str(dem), "-o", str(tmp_path / "a"), "--for", "chunked-lod,cells=16,finest=0.5"]
    assert CliRunner().invoke(command, given, obj={"quiet": True}).exit_code == 0
    assert store.open(tmp_path / "a").has("chunked", cells=16, finest=0.5)
    again = CliRunner().invoke(command, [*given, "--for", "chunked-lod", "--overwrite"], obj={"quiet": True})
    assert again.exit_code != 0 and "chunks of one kind" in str(again.exception)
    assert CliRunner().invoke(command, [*given, "--resume"], obj={"quiet": True}).exit_code == 0
    other = CliRunner().invoke(command, [*given[:3], "--resume"], obj={"quiet": True})
    assert other.exit_code != 0 and "chunks differ" in str(other.exception)


def test_color_errors_are_stored_and_used(tmp_path, monkeypatch):
    from orograph.geovis.color_store import StoredColorErrors
    from orograph.lod.method import Resources
    from orograph.lod.registry import chosen
    from orograph.scene.methods import made

    dem = write(tmp_path / "dem.tif", HEIGHTS)
    drape = tmp_path / "ortho.tif"
    with rasterio.open(dem) as file:
        profile = {"crs": file.crs, "transform": file.transform, "dtype": "uint8", "nodata": None}
        size = file.width, file.height
    with rasterio.open(drape, "w", "GTiff", *size, 3, **profile) as file:
        file.write(np.random.default_rng(1).integers(0, 255, (3, size[1], size[0]), dtype=np.uint8))
    path = str(tmp_path / "a.oro")
    refused = CliRunner().invoke(command, [str(dem), "-o", path, "--drape", str(drape)], obj={"quiet": True})
    assert refused.exit_code != 0 and "`color_errors`" in str(refused.exception)
    given = [str(dem), "-o", path, "--color-errors", "--drape", str(drape), "--json"]
    ran = CliRunner().invoke(command, given, obj={"quiet": True})
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["color_errors"]["drape"]["name"] == "ortho.tif"
    with store.open(path) as terrain:
        choice = chosen("soar,color-tolerance=5")
        kept = made(choice, terrain, Resources(1 << 28, 1), str(drape)).resources.color
        assert isinstance(kept, StoredColorErrors)
        computed = made(choice, terrain, Resources(1 << 28, 1)).resources.color  # other colours
        assert computed is not None and not isinstance(computed, StoredColorErrors)


def test_damaged_files_are_named_or_left_out(run, hilly, tmp_path):
    bad = [tmp_path / "a.tif", tmp_path / "b.tif"]
    bad[0].write_bytes(b"no TIFF")
    said = ("build", hilly, *bad, "-o", tmp_path / "s.oro", "--errors", "none", "--quiet")
    code, _, err = run(*said)
    assert code == 3 and "2 of 3 files" in err and "a.tif" in err and "b.tif" in err and "--skip-damaged" in err
    code, out, err = run(*said, "--skip-damaged", "--json")
    assert code == 0, err
    assert [Path(text.partition(": ")[0]).name for text in json.loads(out)["skipped"]] == ["a.tif", "b.tif"]
