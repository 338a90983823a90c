"""The scripts of docs/clusters.md make stores."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_clusters import written
from test_in_parts import files

from orograph import store
from orograph.store.workforce import CALM

SCRIPTS = Path(__file__).parents[2] / "docs/scripts"


def run(command, **variables):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(command, env={**os.environ, "PATH": path, **variables}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.stress
def test_a_slurm_array(tmp_path):
    dem = written(tmp_path / "a.tif")
    run([sys.executable, "-m", "orograph", "build", dem, "-o", tmp_path / "whole", "--max-memory", "3GiB"])
    for index in (3, 1, 2):
        task = {"SLURM_ARRAY_TASK_ID": str(index), "SLURM_ARRAY_TASK_COUNT": "3"}
        run(["bash", SCRIPTS / "build_array.sh", tmp_path / "s", dem], **task)
    run(["bash", SCRIPTS / "finish_array.sh", tmp_path / "s", dem])
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.stress
def test_light_by_a_slurm_array(tmp_path):
    dem = written(tmp_path / "a.tif")
    given = ["--products", "sky-view-factor", "--radius", "300", "--azimuths", "4"]
    for name in ("whole", "s"):
        store.build(dem, tmp_path / name, shard=64, chunk=32, errors=()).close()
    run([sys.executable, "-m", "orograph", "bake", tmp_path / "whole", *given])
    for index in (3, 1, 2):
        task = {"SLURM_ARRAY_TASK_ID": str(index), "SLURM_ARRAY_TASK_COUNT": "3"}
        run(["bash", SCRIPTS / "bake_array.sh", tmp_path / "s", *given], **task)
    run([sys.executable, "-m", "orograph", "bake", tmp_path / "s", *given, "--finish"])
    assert files(tmp_path / "s") == files(tmp_path / "whole")


@pytest.mark.stress
def test_a_dask_cluster(tmp_path):
    pytest.importorskip("distributed")
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole").close()
    run([sys.executable, SCRIPTS / "build_on_dask.py", "local:2", tmp_path / "s", dem])
    assert files(tmp_path / "s") == files(tmp_path / "whole")


def test_the_settings_are_those_of_clusters_of_this_machine():
    yaml = pytest.importorskip("yaml")
    told = yaml.safe_load((SCRIPTS / "calm.yaml").read_text())

    def flat(told, path=()):
        if not isinstance(told, dict):
            return {".".join(path): told}
        return {key: value for name, below in told.items() for key, value in flat(below, (*path, name)).items()}

    assert flat(told) == CALM


STAND_INS = {
    "coiled.py": """
from distributed import LocalCluster

class Cluster(LocalCluster):
    def __init__(self, name, n_workers, worker_cpu, worker_memory, worker_options, backend_options, spot_policy):
        assert worker_options == {"nthreads": worker_cpu} and backend_options == {"region": "eu-central-1"}
        super().__init__(n_workers=2, threads_per_worker=1)
""",
    "dask_kubernetes/operator.py": """
from distributed import LocalCluster

def make_cluster_spec(name, image, env):
    worker = {"name": "worker", "image": image, "args": ["dask-worker", "--name", "$(DASK_WORKER_NAME)"], "env": env}
    return {"kind": "DaskCluster", "metadata": {"name": name}, "spec": {"worker": {"spec": {"containers": [worker]}}}}

class KubeCluster(LocalCluster):
    def __init__(self, custom_cluster_spec):
        pod = custom_cluster_spec["spec"]["worker"]["spec"]
        (mount,) = pod["containers"][0]["volumeMounts"]
        assert [volume["name"] for volume in pod["volumes"]] == [mount["name"]]
        assert pod["volumes"][0]["persistentVolumeClaim"] == {"claimName": "claim"}
        super().__init__(n_workers=2, threads_per_worker=1)

    def scale(self, count):
        return super().scale(min(count, 2))
""",
}
"""What stands for packages that need a cloud: clusters of this machine, which look at what they are asked for."""


@pytest.mark.stress
@pytest.mark.parametrize("script", [("build_on_coiled.py", "eu-central-1"), ("build_on_kubernetes.py", "claim")])
def test_clusters_of_clouds(tmp_path, script):
    pytest.importorskip("distributed")
    dem = written(tmp_path / "a.tif")
    store.build(dem, tmp_path / "whole").close()
    for name, text in STAND_INS.items():
        (tmp_path / "packages" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "packages" / name).write_text(text)
    found = os.pathsep.join(filter(None, [str(tmp_path / "packages"), os.environ.get("PYTHONPATH")]))
    run([sys.executable, SCRIPTS / script[0], script[1], tmp_path / "s", dem], PYTHONPATH=found)
    assert files(tmp_path / "s") == files(tmp_path / "whole")
