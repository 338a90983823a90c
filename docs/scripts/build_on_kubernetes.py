"""A store on Dask workers in Kubernetes: python build_on_kubernetes.py CLAIM STORE FILE...

The operator of dask-kubernetes is installed in the cluster (helm install dask/dask-kubernetes-operator). CLAIM is a
PersistentVolumeClaim that many pods may write to; it is mounted at /shared, where STORE and the files are. This runs in
a pod that has it, too, since the process that builds looks at what workers wrote.
"""

import sys

from dask_kubernetes.operator import KubeCluster, make_cluster_spec
from distributed import Client

import orograph

IMAGE = "ghcr.io/dask/dask:latest"  # the same Python and Dask as here
WORKERS = 32


def main(claim: str, store: str, *files: str) -> None:
    spec = make_cluster_spec(name="orograph", image=IMAGE, env={"EXTRA_PIP_PACKAGES": "orograph[cluster]"})
    pod = spec["spec"]["worker"]["spec"]
    pod["volumes"] = [{"name": "shared", "persistentVolumeClaim": {"claimName": claim}}]
    worker = pod["containers"][0]
    worker["volumeMounts"] = [{"name": "shared", "mountPath": "/shared"}]
    worker["resources"] = {"requests": {"cpu": "1", "memory": "3Gi"}, "limits": {"memory": "3Gi"}}
    worker["args"] += ["--nthreads", "1", "--memory-limit", "3GiB"]
    with KubeCluster(custom_cluster_spec=spec) as cluster, Client(cluster) as client:
        cluster.scale(WORKERS)
        print(orograph.build(list(files), store, dask=client, resume=True))


if __name__ == "__main__":
    main(*sys.argv[1:])
