"""Two clients of one store, or one film: one wins, and the other is told which process is at work."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import orograph
from orograph import store
from orograph.geo.grid import Grid
from orograph.store.source import ArraySource

pytestmark = pytest.mark.stress


@pytest.fixture
def terrain(tmp_path):
    y, x = np.mgrid[:300, :380]
    heights = (300 * np.sin(x / 21) * np.cos(y / 17) + 20 * np.sin(x / 2.3 + y / 3.1)).astype(np.float32)
    grid = Grid(heights.shape, Affine(20, 0, 500_000, 0, -20, 4_000_000), CRS.from_epsg(32611))
    store.build(ArraySource(heights, grid, "hills"), tmp_path / "hills.oro", shard=64, chunk=16, jobs=1).close()
    return tmp_path / "hills.oro"


@pytest.mark.parametrize("what", ["bake", "film"])
def test_of_two_clients_one_wins(terrain, tmp_path, what):
    """The second comes while the first is stopped in its middle, and is told who is at work."""
    own = tmp_path / "own"
    own.mkdir()
    shutil.copytree(terrain, own / "hills.oro")
    commands = {
        "bake": ["bake", str(own / "hills.oro"), "--products", "sky-view-factor", "--workers", "2"],
        "film": ["movie", str(own / "hills.oro"), "--orbit", "--size", "240x150", "-o", str(own / "f/%03d.png"),
                 "--workers", "2"],
    }  # fmt: skip
    command = [sys.executable, "-m", "orograph", "-q", *commands[what]]
    first = subprocess.Popen(command)
    while first.poll() is None and not [*own.glob(".*.lock"), *own.glob("f/.*.lock")]:
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)
    try:
        assert first.poll() is None
        second = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert second.returncode == 4 and str(first.pid) in second.stderr, second.stderr
    finally:
        first.send_signal(signal.SIGCONT)
    assert first.wait(300) == 0
    with orograph.open(own / "hills.oro") as found:
        assert found.check() == []
