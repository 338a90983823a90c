"""The scripts of docs/clusters.md make stores."""

from __future__ import annotations

import os
import py_compile
import subprocess
import sys
from pathlib import Path

import pytest
from test_clusters import written
from test_in_parts import files

from orograph import store

SCRIPTS = Path(__file__).parents[2] / "docs/scripts"


def run(command, **variables):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(command, env={**os.environ, "PATH": path, **variables}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_slurm_array(tmp_path):
    dem = written(tmp_path / "a.tif")
    run([sys.executable, "-m", "orograph", "build", dem, "-o", tmp_path / "whole", "--max-memory", "3GiB"])
    for index in (3, 1, 2):
        task = {"SLURM_ARRAY_TASK_ID": str(index), "SLURM_ARRAY_TASK_COUNT": "3"}
        run(["bash", SCRIPTS / "build_array.sh", tmp_path / "s", dem], **task)
    run(["bash", SCRIPTS / "finish_array.sh", tmp_path / "s", dem])
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.slow
def test_a_dask_cluster(tmp_path):
    pytest.importorskip("distributed")
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole").close()
    run([sys.executable, SCRIPTS / "build_on_dask.py", "local:2", tmp_path / "s", dem])
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_the_script_for_kubernetes_is_python():
    py_compile.compile(str(SCRIPTS / "build_on_kubernetes.py"), doraise=True)
