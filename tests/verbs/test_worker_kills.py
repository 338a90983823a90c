"""Light and films whose workers are killed at random moments, again and again, have the same bytes in the end."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from killed_workers import KILLS, killed, until_done
from pyproj import CRS

import orograph
from orograph import store
from orograph.geo.grid import Grid
from orograph.lighting.context import Options
from orograph.store.source import ArraySource

pytestmark = pytest.mark.stress


@pytest.fixture
def terrain(tmp_path):
    y, x = np.mgrid[:500, :640]
    heights = (300 * np.sin(x / 21) * np.cos(y / 17) + 20 * np.sin(x / 2.3 + y / 3.1)).astype(np.float32)
    heights[90:140, 200:300] = np.nan
    grid = Grid(heights.shape, Affine(20, 0, 500_000, 0, -20, 4_000_000), CRS.from_epsg(32611))
    store.build(ArraySource(heights, grid, "hills"), tmp_path / "hills.oro", shard=64, chunk=16, jobs=1).close()
    return tmp_path / "hills.oro"


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_bake(terrain, tmp_path):
    names, options = ["sky-view-factor", "aperture"], Options(azimuths=8)
    shutil.copytree(terrain, tmp_path / "whole.oro")
    orograph.bake(tmp_path / "whole.oro", names, options, jobs=1, progress=False).close()
    expected = files(tmp_path / "whole.oro")
    with killed(7) as (client, kills):
        for trial in range(40):
            target = tmp_path / f"{trial}.oro"
            shutil.copytree(terrain, target)
            until_done(lambda at=target: orograph.bake(at, names, options, dask=client, progress=False).close())
            assert files(target) == expected
            shutil.rmtree(target)
            if kills[0] >= KILLS:
                break
    print(f"{kills[0]} kills, {trial + 1} times from beginning to end")
    assert kills[0] >= KILLS


def test_a_film(terrain, tmp_path):
    how = {"size": (320, 200), "orbit": True, "seconds": 4.0, "fps": 10, "progress": False}
    orograph.movie(terrain, tmp_path / "whole" / "%03d.png", **how)
    expected = files(tmp_path / "whole")
    with killed(8) as (client, kills):
        for trial in range(40):
            out = tmp_path / f"{trial}"
            until_done(lambda at=out: orograph.movie(terrain, at / "%03d.png", dask=client, **how))
            assert files(out) == expected
            if kills[0] >= KILLS:
                break
    print(f"{kills[0]} kills, {trial + 1} times from beginning to end")
    assert kills[0] >= KILLS


def test_tasks_of_processes_that_are_killed(tmp_path):
    """Whatever a process was at when it was killed, another one goes on to the same bytes."""
    script = Path(__file__).with_name("killing_tasks.py")
    ran = subprocess.run([sys.executable, str(script), str(tmp_path), "120"], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert {line.split()[0]: int(line.split()[1]) for line in ran.stdout.splitlines()} == {"bake": 120, "film": 120}
