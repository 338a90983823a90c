"""A store in a bucket by Dask workers of Coiled: python build_on_coiled.py REGION STORE FILE...

STORE and the files lie in buckets (s3://…) of that region. Coiled brings the packages of this environment, and its
credentials for the cloud, to the workers. This process plans and adds up: it is best run in the region, too.
"""

import sys

import coiled
from distributed import Client

import orograph

WORKERS = 64


def main(region: str, store: str, *files: str) -> None:
    with (
        coiled.Cluster(
            name="orograph", n_workers=WORKERS, worker_cpu=1, worker_memory="4 GiB", worker_options={"nthreads": 1},
            backend_options={"region": region}, spot_policy="spot_with_fallback",
        ) as cluster,
        Client(cluster) as client,
    ):  # fmt: skip
        print(orograph.build(list(files), store, dask=client, resume=True))


if __name__ == "__main__":
    main(*sys.argv[1:])
