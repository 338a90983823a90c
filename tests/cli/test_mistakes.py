"""What users do wrong is told as theirs: the exit code, the words, and no traceback."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine


@pytest.mark.parametrize("verb", [["render", "-o", "a.png"], ["build", "-o", "a.oro"]])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--resolution", "1e9"], "coarser than the size of the terrain"),
        (["--resolution", "nan"], "nan is not a number"),
        (["--jobs", "100000"], "1<=x<=1024"),
        (["--spacing", "nan"], "nan is not a number"),
        (["--spacing", "inf"], "inf is too large"),
        (["--spacing", "1e300"], "1e+300 is too large"),
    ],
)
def test_numbers_that_make_no_sense(run, hilly, tmp_path, monkeypatch, verb, options, said):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(verb[0], hilly, *verb[1:], *options)
    assert code == 2 and said in err and "np.float64" not in err, err


@pytest.mark.parametrize(
    ("verb", "options"),
    [("movie", ["-o", "a.gif", "--orbit", "--to", "1e400"]), ("movie", ["-o", "a.gif", "--orbit", "--seconds", "1e99"]),
     ("render", ["-o", "a.png", "--relief", "1e308"]), ("render", ["-o", "a.png", "--exaggeration", "1e300"]),
     ("render", ["-o", "a.png", "--fov", "1e-300"]), ("render", ["-o", "a.png", "--light", "x" * 5000])],
)  # fmt: skip
def test_numbers_and_words_that_are_too_large(run, hilly, tmp_path, monkeypatch, verb, options):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(verb, hilly, *options)
    assert code == 2 and len(err) < 3000 and "Warning" not in err, err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "options", [["--fov", "nan"], ["--pitch", "nan"], ["--distance", "nan"], ["--lonlat", "nan,4,5"]]
)
def test_cameras_of_nan(run, hilly, tmp_path, options):
    code, _, err = run("render", hilly, "-o", tmp_path / "a.png", *options)
    assert code == 2 and "nan" in err and "np.float64" not in err, err


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000])
def test_json_nested_too_deeply(run, hilly, tmp_path, text):
    path = tmp_path / "deep.json"
    path.write_text(text)
    for options in (["render", hilly, "-o", tmp_path / "a.png", "--view", path],
                    ["measure", "area", hilly, "--geojson", path]):  # fmt: skip
        code, _, err = run(*options)
        assert code == 3 and "nested too deeply" in err and "deep.json" in err, err


def test_archives_without_a_raster(run, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("readme.txt", "hello")
    code, _, err = run("info", tmp_path / "a.zip")
    assert code == 3 and "archive" in err and "network" not in err, err


def test_links(run, tmp_path):
    (tmp_path / "a.tif").symlink_to(tmp_path / "b.tif")
    (tmp_path / "b.tif").symlink_to(tmp_path / "a.tif")
    (tmp_path / "c.tif").symlink_to(tmp_path / "gone.tif")
    assert "It is a link to itself" in run("info", tmp_path / "a.tif")[2]
    assert "gone.tif, which does not exist" in run("info", tmp_path / "c.tif")[2]
    assert "There is no such file" in run("info", tmp_path / "d.tif")[2]


def written(path, heights):
    rows, cols = heights.shape
    with rasterio.open(path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)
    return path


@pytest.mark.parametrize("shape", [(1, 50), (50, 1), (1, 1)])
def test_one_row_or_column_is_no_surface(run, tmp_path, shape):
    path = written(tmp_path / "a.tif", np.arange(shape[0] * shape[1]).reshape(shape))
    for options in (["render", path, "-o", tmp_path / "a.png"], ["build", path, "-o", tmp_path / "a.oro"],
                    ["light", path, "--product", "slope", "-o", tmp_path / "b.tif"],
                    ["tessellate", path, "-o", tmp_path / "a.npz"]):  # fmt: skip
        code, _, err = run(*options)
        assert code == 3 and "a surface needs at least two of each" in err, (options, err)
    code, out, _ = run("info", path)
    assert code == 0 and "a surface needs at least two of each" in out


def test_heights_beyond_any_body_are_missing(run, tmp_path):
    heights = np.full((40, 40), 100.0)
    heights[3, 3], heights[5, 5] = 1e20, -9e29
    code, out, err = run("info", written(tmp_path / "a.tif", heights))
    assert code == 0 and err == "" and "100 to 100 m" in out and "1e+20, undeclared" in out


@pytest.mark.parametrize(
    ("line", "said"),
    [(("best-view", "DEM", "--target", "a" * 5000, "-o", "v.json"), "File name too long"),
     (("info", "DEM", "--assume-crs", "\udcff"), "not UTF-8 text"),
     (("build", "DEM", "-o", "a.oro", "--resolution", "1e-308"), "The terrain would have inf × inf samples"),
     (("render", "DEM", "-o", "a.png", "--water", "1e308"), "A water level must be a height"),
     (("movie", "DEM", "--orbit", "--fps", "360", "-o", "a.gif"), "at most 100 frames a second"),
     (("info", "INTEGERS", "--nodata", "9" * 20), ""), (("info", "INTEGERS", "--nodata", "9" * 400), ""),
     (("info", "DEM", "--nodata", "9" * 400), "")],
)  # fmt: skip
def test_values_that_nobody_expects_are_no_fault_of_orograph(run, hilly, tmp_path, monkeypatch, line, said):
    monkeypatch.chdir(tmp_path)
    with rasterio.open(tmp_path / "whole.tif", "w", driver="GTiff", height=20, width=30, count=1, dtype="int16",
                       crs="EPSG:32611", transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(np.arange(600, dtype=np.int16).reshape(20, 30), 1)
    files = {"DEM": str(hilly), "INTEGERS": "whole.tif"}
    code, _, err = run(*(files.get(part, part) for part in line))
    assert code in (2, 3) if said else code == 0
    assert not [p for p in tmp_path.iterdir() if p.name.startswith("a.")]
    assert said in err and "fault" not in err and len(err) < 2300


def test_no_room_for_a_map(run, hilly, tmp_path, monkeypatch):
    import shutil

    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**9, 10**9 - 1000, 1000))
    code, _, err = run("light", hilly, "--product", "slope", "-o", tmp_path / "a.tif")
    assert code == 4 and "There is not enough room" in err and "TIFF" not in err, err
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_an_interrupt_while_something_is_collected():
    """Python cannot raise it there: it is raised a moment later, so that what is begun is cleaned up."""
    code = (
        "import os, signal, time\nfrom orograph.cli import stopping\nstopping.GRACE = 10\nstopping.guard()\n"
        "class Last:\n    def __del__(self):\n        os.kill(os.getpid(), signal.SIGINT)\n        time.sleep(0.1)\n"
        "last = Last()\ntry:\n    del last\n    time.sleep(8)\nexcept KeyboardInterrupt:\n    print('cleaned up')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (0, "cleaned up\n", "")


@pytest.mark.stress
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupts_while_a_kernel_makes_its_results():
    """Numba does not look for an exception there: without care one of these many crashes the interpreter."""
    code = """
import signal, threading, time
from typing import NamedTuple
import numba, numpy as np
from orograph.cli import stopping

class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray

@numba.njit
def pair(count):
    return Pair(np.zeros(count), np.ones(count))

pair(3)
stopping.GRACE, caught, main = 1e9, 0, threading.main_thread().ident
stopping.guard()
ending = time.monotonic() + 2

def pester():
    while time.monotonic() < ending - 0.5:
        signal.pthread_kill(main, signal.SIGINT)
        time.sleep(2e-4)

def work():
    while time.monotonic() < ending:
        pair(3)

armed = False
def forgiving(signum, frame):
    if armed:
        stopping._raise(signum, frame)
signal.signal(signal.SIGINT, forgiving)
threading.Thread(target=pester, daemon=True).start()
while time.monotonic() < ending:
    try:
        armed = True
        work()
    except KeyboardInterrupt:
        armed = False
        caught += 1
print(caught)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and int(done.stdout) > 0, (done.returncode, done.stdout, done.stderr[-3000:])


@pytest.mark.cases(1)
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("seed", range(6))
def test_interrupts_at_any_time(hilly, tmp_path, seed):
    """From the import of the command line on: 130 (143 for SIGTERM) within a second, and the words for it."""
    rng = random.Random(seed)
    code = "import sys, runpy; sys.argv[1:] = sys.argv[1:]; import orograph\n" \
           "print('now', flush=True); runpy.run_module('orograph', run_name='__main__', alter_sys=True)"  # fmt: skip
    line = [sys.executable, "-c", code, "render", str(hilly), "-o", str(tmp_path / "a.png"), "--size", "3000x2000"]
    which = signal.SIGTERM if seed % 3 == 2 else signal.SIGINT
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "now\n"
        time.sleep(0.15 + rng.uniform(0, 2.5))
        if child.poll() is not None:
            return
        begun = time.perf_counter()
        child.send_signal(which)
        _, err = child.communicate(timeout=30)
        assert child.returncode == (143 if which == signal.SIGTERM else 130), (child.returncode, err)
        assert time.perf_counter() - begun < 2 and "interrupted" in err and "Traceback" not in err
    assert not (tmp_path / "a.png").exists()


def test_an_error_that_an_interrupt_became(monkeypatch, tmp_path):
    """Libraries turn KeyboardInterrupt into errors of their own; that is no fault of Orograph."""
    code = """
import os, signal, sys
from orograph import cli
def fail(*args, **kwargs):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        import time; time.sleep(5)
    except KeyboardInterrupt:
        raise RuntimeError("compiling failed") from None
cli.cli.main = fail
sys.argv = ["orograph", "info", "x"]
cli.main()
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 130 and "interrupted" in ran.stderr and "fault" not in ran.stderr, ran.stderr


@pytest.mark.stress
def test_a_codec_that_breaks_numcodecs(tmp_path: Path):
    """As zfpy does that was built for another NumPy: stores work, and doctor tells."""
    (tmp_path / "zfpy-1.0.1.dist-info").mkdir()
    (tmp_path / "zfpy-1.0.1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: zfpy\nVersion: 1.0.1\n")
    (tmp_path / "zfpy.py").write_text("raise ValueError('numpy.dtype size changed, may indicate incompatibility')\n")
    paths = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    env = {**os.environ, "PYTHONPATH": paths}
    dem = written(tmp_path / "a.tif", np.arange(2500.0).reshape(50, 50))

    def orograph(*args):
        line = [sys.executable, "-m", "orograph", *map(str, args)]
        return subprocess.run(line, capture_output=True, text=True, timeout=200, env=env)

    built = orograph("build", dem, "-o", tmp_path / "a.oro")
    assert built.returncode == 0, built.stderr
    assert orograph("info", tmp_path / "a.oro").returncode == 0
    assert "numpy.dtype size changed" in orograph("doctor").stdout
