"""Builds with each codec compared with builds by another checkout, which may lack the codecs: processor and wall time.

    python bench/codec_builds.py OTHER/src DEM... [--max-error 0.1] [--rounds 4] [--heights]

OTHER is a checkout of another commit (``git worktree add OTHER COMMIT``). Two processes, one per checkout, build in
turn. The first round compiles kernels and does not count. Printed are the minimum and maximum seconds, and the median
ratio to the other checkout's build in the same round. With ``--heights``, stores have no errors and do not name their
files.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

CODECS = ("portable", "compact", "smallest", "progressive")

CHILD = """
import json, resource, sys, time
from orograph import store

def worked():
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)

for line in sys.stdin:
    job = json.loads(line)
    begun, before = time.perf_counter(), worked()
    store.build(job["files"], job["out"], progress=False, overwrite=True, **job["options"])
    print(json.dumps([worked() - before, time.perf_counter() - begun]), flush=True)
"""


def builder(sources: Path) -> subprocess.Popen[str]:
    """A process that builds with these sources."""
    environment = {**os.environ, "PYTHONPATH": str(sources.resolve())}
    command = [sys.executable, "-c", CHILD]
    return subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--max-error", default="0.1")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--heights", action="store_true")
    options = parser.parse_args()
    error = options.max_error if options.max_error == "auto" else float(options.max_error)
    plain = {"errors": (), "keep_source": False} if options.heights else {}
    other, here = builder(options.other), builder(Path(__file__).parents[1] / "src")
    works = [("other", other, plain)]
    works += [(codec, here, {**plain, "codec": codec, "max_error": error}) for codec in CODECS]
    took: dict[str, list[tuple[float, float]]] = {name: [] for name, _, _ in works}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(options.rounds + 1):
            for name, process, how in works:
                job = {"files": options.files, "out": f"{folder}/{name}.oro", "options": how}
                assert process.stdin is not None and process.stdout is not None
                print(json.dumps(job), file=process.stdin, flush=True)
                seconds = json.loads(process.stdout.readline())
                took[name] += [tuple(seconds)] if k else []
    print("| | processors, s | ratio | elapsed, s | ratio |\n|---|--:|--:|--:|--:|")
    for name in took:
        cells = [name]
        for which in range(2):
            one, base = ([each[which] for each in took[n]] for n in (name, "other"))
            ratio = statistics.median(a / b for a, b in zip(one, base, strict=True))
            cells += [f"{min(one):.1f} to {max(one):.1f}", f"{ratio:.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
