"""Many builds of one store that start at nearly the same time, some of them killed: what becomes of the store.

Builds run in forks of this process, which has everything compiled, so that a start costs what a build costs.
"""

from __future__ import annotations

import enum
import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from surfaces import rough, source

from orograph import store
from orograph.errors import StoreError

HEIGHTS = [rough((260, 240), seed, missing=0.01) for seed in (1, 2)]
SIZES = {"shard": 64, "chunk": 16}
SPREAD = 0.2
"""Seconds within which all start."""


class Start(enum.Enum):
    """What became of one."""

    DONE = 0
    REFUSED = 4
    KILLED = -signal.SIGALRM


def work(target: str, which: int, how: str, delay: float) -> int:
    """One start; its exit code."""
    time.sleep(delay)
    flags = {"resume": {"resume": True}, "overwrite": {"overwrite": True}, "plain": {}}[how]
    try:
        store.build(source(HEIGHTS[which]), target, jobs=1, **flags, **SIZES).close()
    except StoreError as error:
        said = str(error)
        known = ("Another process", "there already", "interrupted build", "into place", "sources or options differ",
                 "other sources")  # fmt: skip
        if any(words in said for words in known):
            return 4
        print(said, file=sys.stderr)
        return 1
    return 0


def rounds_of(folder: Path, starts: int, rounds: int, kills: bool, seed: int) -> Counter[Start]:
    """Race after race; each must leave a sound store of one of the inputs, or one that can be finished."""
    rng = random.Random(seed)
    for which, heights in enumerate(HEIGHTS):  # compiles, and says what is right
        store.build(source(heights), folder / f"right{which}", jobs=1, **SIZES).close()
    right = [_files(folder / f"right{which}") for which in range(2)]
    began = time.perf_counter()
    store.build(source(HEIGHTS[0]), folder / "timed", jobs=1, **SIZES).close()
    takes = time.perf_counter() - began
    assert threading.active_count() == 1  # or forks would not be safe
    done: Counter[Start] = Counter()
    for number in range(rounds):
        target = folder / f"raced{number}"
        pids = {}
        inputs = [0] * starts if number % 2 else [rng.randrange(2) for _ in range(starts)]
        for which in inputs:
            how = rng.choice(("plain", "plain", "resume", "overwrite"))
            delay = rng.uniform(0, SPREAD)
            after = delay + rng.uniform(0, 1.3 * takes) if kills and rng.random() < 0.8 else None
            pid = os.fork()
            if pid == 0:
                try:
                    if after is not None:
                        signal.setitimer(signal.ITIMER_REAL, after)  # unhandled, it ends the process on the spot
                    os._exit(work(str(target), which, how, delay))
                except BaseException as error:
                    print(repr(error), file=sys.stderr)
                    os._exit(1)
            pids[pid] = which, how
        codes = {}
        for _ in pids:
            pid, status = os.wait()
            codes[pid] = Start(os.waitstatus_to_exitcode(status))
        done.update(codes.values())
        _judge(target, pids, codes, right)
    return done


def _judge(target: Path, pids: dict[int, tuple], codes: dict[int, Start], right: list[dict[str, bytes]]) -> None:
    """Raise AssertionError unless what is there is one input's store, whole, or nothing that opens."""
    winners = [pids[pid] for pid, code in codes.items() if code is Start.DONE]
    if Start.KILLED not in codes.values():
        assert winners, codes
        plain = [how for _, how in winners if how == "plain"]
        assert len(plain) <= 1, winners
        if all(how != "overwrite" for _, how in winners):
            assert len({which for which, _ in winners}) == 1, winners  # the others resumed what was complete
    there = target if target.exists() else Path(f"{target}.replaced")  # killed between its two renames
    if (there / "zarr.json").exists():
        assert _files(there) in right, "a store that no single build makes"
        assert store.open(there).check() == []
    else:
        assert not winners, "a build was done and its store is gone"
    # Whatever is left, somebody who comes later gets their store.
    store.build(source(HEIGHTS[1]), target, overwrite=True, jobs=1, **SIZES).close()
    assert _files(target) == right[1]
    assert not [p.name for p in target.parent.iterdir() if target.name + "." in p.name]


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def without_locks() -> None:
    """Be on a system that has no file locks."""
    import fcntl

    def unsupported(fd: int, how: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    fcntl.flock = unsupported


def race(folder: Path, starts: int, rounds: int, kills: bool, seed: int, locks: bool = True) -> Counter[Start]:
    """``rounds_of`` in a process of its own, which has no threads."""
    script = [sys.executable, __file__, str(folder), *map(str, (starts, rounds, int(kills), seed, int(locks)))]
    ran = subprocess.run(script, capture_output=True, text=True, timeout=1800)
    assert ran.returncode == 0, f"seed {seed}: {ran.stdout}{ran.stderr}"
    return Counter({Start[name]: int(count) for name, count in (line.split() for line in ran.stdout.splitlines())})


if __name__ == "__main__":
    where, *numbers = sys.argv[1:]
    count, times, killed, seeded, locked = map(int, numbers)
    if not locked:
        without_locks()
    for kind, number in rounds_of(Path(where), count, times, bool(killed), seeded).items():
        print(kind.name, number)
