"""Builds on a Dask cluster of this machine compared with threads: cost per task, and killed workers and clients.

    python bench/cluster.py [--data ../shared/data] [--kills 100] [--quick]

Threads and workers build California (40 tiles of 1201², in degrees) in turn, with the same number of processors;
starting the cluster and compiling are not counted. *Per task* is the extra time per task of a build of small shards on
the cluster. Memory is that of the process that builds. Then workers are killed at random moments (SIGKILL), ``--kills``
times in all, and builds with `--workers 2` are killed with all their processes. Every resulting store is compared with
the one that threads built.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from orograph import store
from orograph.errors import StoreError
from orograph.store.workforce import workforce

BIG = {"shard": 1024}
SMALL = {"shard": 128, "chunk": 64}
FEW = 9
"""Tiles of a build with small shards, at least 820 of them."""

KILLED = {"shard": 256, "chunk": 64}
OPTIONS: dict[str, Any] = {"jobs": 2, "progress": False}


def digest(folder: Path) -> str:
    """Of all files of a store and their names."""
    total = hashlib.blake2b()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        total.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[tuple[Any, Any]]:
    """A cluster of processes of one thread, and its client."""
    with workforce(workers, None, 1, workers << 31, 0) as client:
        yield client.cluster, client


def built(files: list[str], target: Path, **options: Any) -> float:
    """Build from scratch; seconds."""
    shutil.rmtree(target, ignore_errors=True)
    started = time.perf_counter()
    store.build(files, target, **{**OPTIONS, **options}).close()
    return time.perf_counter() - started


def beside_threads(files: list[str], folder: Path, rounds: int) -> None:
    """The same build by threads and by workers."""
    with cluster(2) as (_, client):
        for sizes in (BIG, SMALL):
            if sizes is SMALL:
                files = files[:FEW]
            built(files, folder / "threads", **sizes)
            built(files, folder / "workers", dask=client, **sizes)
            pairs = [
                (built(files, folder / "threads", **sizes), built(files, folder / "workers", dask=client, **sizes))
                for _ in range(rounds)
            ]
            threads, workers = (min(side) for side in zip(*pairs, strict=True))
            same = digest(folder / "threads") == digest(folder / "workers")
            with store.open(folder / "threads") as terrain:
                rows, cols = terrain.grid.shape
            tasks = -(-rows // sizes["shard"]) * -(-cols // sizes["shard"])
            print(
                f"shards of {sizes['shard']}², {tasks} of level 0: threads {threads:.1f} s, 2 workers {workers:.1f} s "
                f"(× {workers / threads:.2f}); {1000 * (workers - threads) / tasks:+.1f} ms a shard; "
                f"{'the same bytes' if same else 'OTHER BYTES'}",
                flush=True,
            )
        own = psutil.Process()
        before = own.memory_info().rss
        for _ in range(3):
            built(files, folder / "workers", dask=client, **SMALL)
        print(f"memory of the process that builds: {(own.memory_info().rss - before) / 2**20:+.0f} MiB in three builds")


def kill_workers(files: list[str], folder: Path, kills: int, seed: int) -> None:
    """Builds during which workers keep being killed."""
    rng, done, builds, resumed = random.Random(seed), 0, 0, 0
    wrong = 0
    with cluster(2) as (local, client):
        while done < kills:
            shutil.rmtree(folder / "killed", ignore_errors=True)
            stop = threading.Event()
            count = [0]

            def killer(stop: threading.Event = stop, count: list[int] = count, left: int = kills - done) -> None:
                while not stop.wait(rng.uniform(0.3, 3.0)) and count[0] < left:
                    pids = [nanny.pid for nanny in local.workers.values() if nanny.pid]
                    if pids:
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(rng.choice(pids), signal.SIGKILL)
                            count[0] += 1

            thread = threading.Thread(target=killer)
            thread.start()
            try:
                while True:
                    try:
                        again = {"resume": True, **OPTIONS, **KILLED}
                        store.build(files, folder / "killed", dask=client, **again).close()
                        break
                    except StoreError as error:
                        resumed += 1
                        print(f"  resumed after: {error}"[:300], flush=True)
            finally:
                stop.set()
                thread.join()
            done, builds = done + count[0], builds + 1
            print(f"  {done} kills, {builds} builds", flush=True)
            wrong += digest(folder / "killed") != digest(folder / "threads")
    print(f"{done} workers killed over {builds} builds ({resumed} resumed by hand): {wrong} of other bytes", flush=True)


def kill_clients(files: list[str], folder: Path, kills: int, seed: int) -> None:
    """Builds that are killed with their scheduler, after which the workers end too, and resumed until they finish."""
    rng, done, builds, wrong = random.Random(seed), 0, 0, 0
    code = (
        "import sys; from orograph import store\nif __name__ == '__main__':\n"
        f" store.build(sys.argv[2:], sys.argv[1], workers=2, resume=True, jobs=1, progress=False, **{KILLED!r})"
    )
    script = folder / "build_once.py"
    script.write_text(code)
    while done < kills:
        shutil.rmtree(folder / "killed", ignore_errors=True)
        while True:
            child = subprocess.Popen([sys.executable, str(script), str(folder / "killed"), *files])
            try:
                child.wait(rng.uniform(4, 12))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
                done += 1
                continue
            assert child.returncode == 0, child.returncode
            break
        builds += 1
        wrong += digest(folder / "killed") != digest(folder / "threads")
    print(f"{done} builds killed with their scheduler, {builds} got to the end: {wrong} of other bytes", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="two tiles, and two kills at most")
    given = parser.parse_args()
    files = sorted(map(str, (given.data / "california-3s-tiles").glob("*.hgt"))) or sorted(
        str(path) for path in (given.data / "california-3s-tiles").rglob("*.tif")
    )
    if not files:
        raise SystemExit(f"No tiles in {given.data / 'california-3s-tiles'}.")
    if given.quick:
        files, given.kills = files[:2], min(given.kills, 2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        beside_threads(files, folder, 1)
        built(files, folder / "threads", **KILLED)
        kill_workers(files, folder, given.kills, given.seed)
        kill_clients(files, folder, max(given.kills // 5, 1), given.seed)


if __name__ == "__main__":
    main()
