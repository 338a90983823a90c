"""Builds a store over and over, each time killed at a random moment, until one build gets to its end (run as a script).

Arguments: folder, seed. After every kill it makes sure that nothing opens; it prints how often it had to kill. Builds
run in forks of this process, which has no threads and everything compiled: a trial costs what a build costs.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from surfaces import rough, source

from orograph import store
from orograph.errors import StoreError

HEIGHTS = rough((420, 350), 11, missing=0.01, hole=True)
TRIALS = 4
SIZES = {"shard": 64, "chunk": 16}


def forked(work: Callable[[], object], kill_after: float | None = None) -> int:
    """Run ``work`` in a child, killed after so many seconds; its exit status, negative for a signal."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            os._exit(1)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def main(folder: Path, seed: int) -> None:
    rng = random.Random(seed)
    whole = folder / "whole"
    store.build(source(HEIGHTS[:100]), folder / "warm", jobs=1, **SIZES)
    takes = 1e9  # the shortest of three: a busy machine must not make kills come after the end
    for target in (whole, folder / "timed1", folder / "timed2"):
        started = time.perf_counter()
        assert forked(lambda target=target: store.build(source(HEIGHTS), target, jobs=2, **SIZES)) == 0
        takes = min(takes, time.perf_counter() - started)
    for trial in range(TRIALS):
        target = folder / f"killed{trial}"
        kills = 0
        for attempt in range(40):
            resume = kills > 0
            status = forked(
                lambda target=target, resume=resume: store.build(
                    source(HEIGHTS), target, jobs=2, resume=resume, **SIZES
                ),
                kill_after=rng.uniform(0, 1.1 * takes),
            )
            if status == 0 and kills == 0 and attempt < 30:  # too late to kill: begin again, and kill sooner
                takes *= 0.7
                shutil.rmtree(target)
                continue
            if status == 0:
                break
            assert status == -signal.SIGKILL, status
            kills += 1
            if not (target / "zarr.json").exists():
                try:
                    store.open(target)
                    raise AssertionError("an incomplete store opened")
                except StoreError:
                    pass
        else:
            assert forked(lambda target=target: store.build(source(HEIGHTS), target, resume=True, **SIZES)) == 0
        print(trial, kills)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
