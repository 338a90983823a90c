"""A store on a Dask cluster: python build_on_dask.py SCHEDULER STORE FILE...

SCHEDULER is tcp://HOST:8786, or "local:N" for N processes of this machine.
"""

import sys

from distributed import Client, LocalCluster

import orograph


def main(scheduler: str, store: str, *files: str) -> None:
    where = scheduler
    if scheduler.startswith("local:"):
        where = LocalCluster(n_workers=int(scheduler.removeprefix("local:")), threads_per_worker=1)
    with Client(where) as client:
        print(orograph.build(list(files), store, dask=client, resume=True))


if __name__ == "__main__":  # workers start by importing this file
    main(*sys.argv[1:])
