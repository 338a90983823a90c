"""The memory to build a large store for a method, and a check that all numbers of workers write the same bytes.

    python bench/out_of_core.py SIZE --for chunked-lod|bdam|seamless-patches|quadtin [--jobs 1,2] [--allowed 512MiB]

A synthetic terrain of SIZE² samples goes into a store straight from its formula (``bench/synthetic.py``), for each
number of workers in a separate process. Printed are seconds, bytes, and two memory peaks: *anonymous*, which the
process needs, and *resident*, which also counts pages of scratch files that the system may reclaim. ``--for nothing``
is the same build without any method's data. Last comes a digest of all the store's files.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import tempfile
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from orograph import store
from orograph.dem.synth import Synth
from orograph.folders import parse_bytes
from synthetic import CELL, LEFT, SEED

NEEDS: dict[str, dict[str, Any]] = {
    "nothing": {"errors": ()},
    "seamless-patches": {},
    "bdam": {"errors": (), "tins": 16},
    "chunked-lod": {"errors": (), "chunked": (32, 0)},
    "quadtin": {"errors": (), "quadtin": (0, "nearest")},
}


def memory() -> tuple[int, int]:
    """Anonymous and resident bytes of this process."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    anonymous, resident = (int(status[name].split()[0]) << 10 for name in ("RssAnon", "VmRSS"))
    return anonymous, resident


def digest(place: Path) -> str:
    """Of the names and contents of all files of a store except its record, which contains the time."""
    found = hashlib.blake2b(digest_size=12)
    for path in sorted(p for p in place.rglob("*") if p.is_file() and p.name != "zarr.json"):
        found.update(str(path.relative_to(place)).encode() + hashlib.blake2b(path.read_bytes()).digest())
    return found.hexdigest()


def build(size: int, method: str, jobs: int, allowed: int, folder: Path, out: Connection) -> None:
    """Runs in a separate process: build and send (seconds, anonymous, resident, bytes, digest)."""
    place = folder / f"{method}-{jobs}.oro"
    peaks, done = [0, 0], threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            peaks[:] = map(max, peaks, memory())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    source = Synth((size, size), SEED, spacing=CELL)
    source.prepare()
    began = time.perf_counter()
    store.build(source, place, jobs=jobs, max_memory=allowed, progress=False, **NEEDS[method]).close()
    took = time.perf_counter() - began
    done.set()
    watcher.join()
    files = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
    out.send((took, *peaks, files, digest(place)))


def built(*arguments: Any) -> tuple[float, int, int, int, str]:
    """Run ``build`` in a new process."""
    mine, other = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=build, args=(*arguments, other))
    process.start()
    other.close()
    found: tuple[float, int, int, int, str] = mine.recv()
    process.join()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("size", type=int)
    parser.add_argument("--for", dest="methods", action="append", choices=list(NEEDS), required=True)
    parser.add_argument("--jobs", default="1,2")
    parser.add_argument("--allowed", default="512MiB")
    parser.add_argument("--folder", type=Path, help=f"of the stores; {LEFT >> 30} GiB should stay free there")
    given = parser.parse_args()
    samples = given.size**2
    print(
        "| for | workers | s | anonymous, MiB | bytes / sample | resident, MiB | bytes / sample of the store | digest |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|---|")
    for method in given.methods:
        for jobs in map(int, given.jobs.split(",")):
            with tempfile.TemporaryDirectory(dir=given.folder) as name:
                took, anonymous, resident, files, hashed = built(
                    given.size, method, jobs, parse_bytes(given.allowed), Path(name)
                )
            print(
                f"| {method} | {jobs} | {took:.0f} | {anonymous >> 20} | {anonymous / samples:.2f} | {resident >> 20} "
                f"| {files / samples:.2f} | `{hashed}` |", flush=True,
            )  # fmt: skip


if __name__ == "__main__":
    main()
