"""Verbs that are killed, interrupted, out of room, or started several at once: what is left, and how they end.

A trial is a fork of this process, which has no threads and everything compiled: it costs what the verb costs. Whatever
ends it, a result under its own name is the one before or the one after, whole; and the same line, run again (with
``--resume`` or ``--overwrite`` where the message says so), makes the bytes that a run makes which nothing ends.
"""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

Files = dict[str, bytes]
OURS = re.compile(r"^\.|\.partial$|\.replaced$")  # names that no result has
STOPS = {signal.SIGINT, signal.SIGTERM}
HARSH = re.compile(r"Traceback|fault of Orograph|Exception ignored|Error in sys|terminate called")


class Verb(NamedTuple):
    """A line whose results lie in the folder that it is run in.

    Attributes:
        given: puts into the folder what the verb works on there.
        in_place: the verb adds to a store: between, the store has to be sound, not as before or after.
        results: what is to be compared at the end, if it does not lie in the folder.
    """

    name: str
    line: list[str]
    given: Callable[[Path], object] = lambda folder: None
    in_place: bool = False
    results: Callable[[Path], Files] | None = None


class Ended(NamedTuple):
    """One run."""

    code: int
    said: str
    seconds: float
    late: float  # after the signal


class Broken(Exception):
    """A promise that was not kept."""


def files(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def frames(video: bytes) -> bytes:
    """How many frames of what size: x264 codes the same frames now one way, now another."""
    import io

    import av

    try:
        with av.open(io.BytesIO(video)) as film:
            return repr([(frame.width, frame.height) for frame in film.decode(video=0)]).encode()
    except (av.FFmpegError, OSError) as error:
        return f"no film: {error}".encode()


class Attack:
    """Trials of one verb.

    Args:
        home: an empty folder for all of them.
    """

    def __init__(self, verb: Verb, home: Path, rng: random.Random) -> None:
        self.verb, self.home, self.rng = verb, home, rng
        self.counts: Counter[str] = Counter()
        self.said: Counter[str] = Counter()
        self.found: list[str] = []
        first = self.folder("reference")
        self.before = files(first)
        for _ in range(2):  # compiles; and is deterministic, or nothing can be compared
            shutil.rmtree(first.parent)
            first = self.folder("reference")
            ended = self.run(first, [])
            if ended.code:
                raise Broken(f"{verb.name} does not run: {ended.said}")
            self.after, held = self.results(first), getattr(self, "after", None)
            if held is not None and held != self.after:
                raise Broken(f"{verb.name} makes other bytes the second time")
        self.takes = ended.seconds
        self.sizes = {"out": sum(map(len, files(first).values())) - sum(map(len, self.before.values())),
                      "cache": sum(map(len, files(first.parent / "cache").values())), "tmp": 1 << 20}  # fmt: skip
        self.largest = max([len(data) for data in files(first).values()] + [4096])
        self.cached = set(files(first.parent / "cache"))
        shutil.rmtree(first.parent)

    def folder(self, name: str) -> Path:
        """A new folder to run in; beside it are ``cache`` and ``tmp``."""
        root = self.home / name
        for part in ("out", "cache", "tmp"):
            (root / part).mkdir(parents=True)
        self.verb.given(root / "out")
        return root / "out"

    def results(self, folder: Path) -> Files:
        found = files(folder) | (self.verb.results(folder) if self.verb.results else {})
        return {name: frames(data) if name.endswith(".mp4") else data for name, data in found.items()}

    # One run

    def begin(self, folder: Path, more: list[str], limit: int = 0, number: int = 0) -> int:
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        pid = os.fork()
        if pid:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
            return pid
        with contextlib.suppress(BaseException):
            os.chdir(folder)
            out = os.open(folder.parent / f"said{number}", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            os.environ.update(TMPDIR=str(folder.parent / "tmp"), OROGRAPH_CACHE=str(folder.parent / "cache"))
            tempfile.tempdir = None
            from orograph.cli import main, stopping

            for which in STOPS:
                signal.signal(which, lambda number, frame: stopping.end(stopping.CODES[signal.Signals(number)]))
            signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)  # from here on it is the command line
            if limit:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            sys.argv = ["orograph", "-q", *self.verb.line, *more]
            try:
                main()
            except SystemExit as stop:
                sys.stdout.flush()
                os._exit(stop.code if isinstance(stop.code, int) else 1)
        os._exit(99)

    def end(self, pid: int, folder: Path, after: float = 60.0, how: int = 0, number: int = 0) -> Ended:
        """Wait for a run, which gets the signal ``how`` after so many seconds (and is killed after a minute)."""
        began, sent = time.monotonic(), 0.0
        while True:
            done, status = os.waitpid(pid, os.WNOHANG)
            now = time.monotonic()
            if done:
                break
            if how and not sent and now - began >= after:
                os.kill(pid, how)
                sent = time.monotonic()
            if now - began > 60:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                raise Broken(f"did not end in a minute: {self.heard(folder, number)}")
            time.sleep(0.001)
        code = os.waitstatus_to_exitcode(status)
        ended = Ended(code, self.heard(folder, number), now - began, now - sent if sent else 0.0)
        if HARSH.search(ended.said) or code in (1, 99) or (code < 0 and -code != how):
            raise Broken(f"rc {code}: {ended.said}")
        if ended.said and code:
            self.said[re.sub(r"\d+(\.\d+)?", "N", ended.said.replace(str(folder.parent), ""))] += 1
        return ended

    def heard(self, folder: Path, number: int) -> str:
        with contextlib.suppress(OSError):
            return (folder.parent / f"said{number}").read_text(errors="replace").strip()
        return ""

    def run(self, folder: Path, more: list[str], **how: int) -> Ended:
        return self.end(self.begin(folder, more, **how), folder)

    # What is there

    def judge(self, folder: Path) -> None:
        """What lies under a result's name is the one before, or the one after, whole."""
        if self.verb.in_place:
            return
        if self.verb.results is not None:
            now = self.verb.results(folder)
            if "zarr.json" in now and now != {name: data for name, data in self.after.items() if name in now}:
                raise Broken("a store at a URL has its root, and is not whole")
        now = files(folder)
        shown = {name: data for name, data in now.items() if not any(OURS.search(p) for p in Path(name).parts)}
        stores = {name.split("/")[0] for name in shown if ".oro/" in name}
        for store in stores:
            part = {n: d for n, d in shown.items() if n.startswith(store + "/")}
            whole = [
                {n: d for n, d in these.items() if n.startswith(store + "/")} for these in (self.before, self.after)
            ]
            if part not in whole:
                raise Broken(f"{store} is neither that before nor that after ({len(part)} files)")
        for name, data in shown.items():
            data = frames(data) if name.endswith(".mp4") else data
            if name.split("/")[0] not in stores and data not in (self.before.get(name), self.after.get(name)):
                raise Broken(f"{name} is neither that before nor that after ({len(data)} bytes)")

    def finish(self, folder: Path) -> None:
        """The same line again makes what it should, and nothing is left of what was broken off."""
        ended = self.run(folder, [])
        for flag in ("--resume", "--overwrite"):
            if ended.code and flag in ended.said:
                if flag == "--overwrite" and self.results(folder) == self.after:
                    break  # it was complete already
                ended = self.run(folder, [flag])
        else:
            if ended.code:
                raise Broken(f"cannot be finished: rc {ended.code}: {ended.said}")
        now = self.results(folder)
        if now != self.after:
            other = [n for n in sorted(now.keys() | self.after.keys()) if now.get(n) != self.after.get(n)]
            raise Broken(f"finished, and other than it should be: {other[:8]} ({ended.said})")
        left = [n for n in files(folder.parent / "cache") if n not in self.cached]
        left += [f"tmp/{p.name}" for p in (folder.parent / "tmp").iterdir()]
        if left:
            self.counts["left in cache or tmp"] += 1
            self.said[f"left: {sorted(re.sub('[0-9]+', 'N', n) for n in left)[:6]}"] += 1

    # The attacks

    def trial(self, kind: str, work: Callable[[Path], object]) -> None:
        name = f"{kind}{sum(self.counts.values())}"
        folder = self.folder(name)
        self.counts[kind] += 1
        try:
            work(folder)
        except Broken as error:
            kept = self.home.parent / "broken" / f"{self.verb.name}-{name}"
            self.found.append(f"{self.verb.name} {kind}: {error} [{kept}]")
            shutil.copytree(folder.parent, kept, dirs_exist_ok=True, symlinks=True)
        shutil.rmtree(folder.parent, ignore_errors=True)

    def kills(self, folder: Path) -> None:
        for _ in range(self.rng.choice((1, 1, 2, 3))):
            more = ["--resume"] if (folder.parent / "resume").exists() else []
            ended = self.end(self.begin(folder, more), folder, self.rng.uniform(0, 1.15 * self.takes), signal.SIGKILL)
            self.judge(folder)
            self.counts["killed"] += ended.code == -signal.SIGKILL
            if ended.code == 0:
                break
            if ended.code == 4 and "--resume" in ended.said:
                (folder.parent / "resume").touch()
        self.finish(folder)

    def signals(self, folder: Path) -> None:
        how = self.rng.choice((signal.SIGINT, signal.SIGINT, signal.SIGTERM))
        ended = self.end(self.begin(folder, []), folder, self.rng.uniform(0, 1.15 * self.takes), how)
        self.judge(folder)
        if ended.code == 0 or not ended.late:
            self.counts["signals too late"] += 1
        elif ended.code != (143 if how == signal.SIGTERM else 130):
            raise Broken(f"rc {ended.code} after signal {how}: {ended.said}")
        else:
            self.counts["interrupted"] += 1
        if ended.late > 1.2:
            raise Broken(f"{ended.late:.2f} s after signal {how} (rc {ended.code})")
        self.finish(folder)

    def room(self, folder: Path) -> None:
        which = self.rng.choice(("out", "out", "out", "cache", "tmp"))
        disk = folder.parent / which
        size = max(4096, int(self.rng.uniform(0, 1.2) * self.sizes[which]))
        with small_disk(disk, size):
            if which == "out":
                with contextlib.suppress(OSError):
                    self.verb.given(folder)
                if files(folder) != self.before:
                    self.counts["no room to begin"] += 1
                    return
            ended = self.run(folder, [])
            self.judge(folder)
            self.counts[f"full: {which}"] += ended.code != 0
            if ended.code not in (0, 4):
                raise Broken(f"rc {ended.code} on a full disk ({which}): {ended.said}")
            subprocess.run(["mount", "-o", "remount,size=200m", disk], check=True)
            self.finish(folder)

    def limits(self, folder: Path) -> None:
        limit = int(2 ** self.rng.uniform(9, 1 + self.largest.bit_length()))
        ended = self.run(folder, [], limit=limit)
        self.judge(folder)
        self.counts["limited"] += ended.code != 0
        if ended.code not in (0, 4):
            raise Broken(f"rc {ended.code} with files of {limit} bytes: {ended.said}")
        self.finish(folder)

    def races(self, folder: Path) -> None:
        kill = self.rng.random() < 0.3
        pids = []
        for number in range(self.rng.randint(2, 4)):
            pids.append(self.begin(folder, [], number=number))
            self.counts["starts"] += 1
            time.sleep(self.rng.uniform(0, 0.2) * self.rng.random())
        ends = []
        for number, pid in enumerate(pids):
            dies = kill and number == 0
            ends.append(self.end(pid, folder, self.rng.uniform(0, self.takes), signal.SIGKILL * dies, number))
        self.judge(folder)
        codes = [ended.code for ended in ends]
        if any(code not in (0, 4, -signal.SIGKILL) for code in codes):
            raise Broken(f"codes {codes}: {[ended.said for ended in ends if ended.code]}")
        if not kill and 0 not in codes:
            raise Broken(f"nobody made it: {[ended.said for ended in ends]}")
        if 0 in codes and not kill and self.results(folder) != self.after:
            now = self.results(folder)
            other = [n for n in sorted(now.keys() | self.after.keys()) if now.get(n) != self.after.get(n)]
            raise Broken(f"codes {codes}, and other than it should be: {other[:8]}")
        self.counts["refused starts"] += codes.count(4)
        self.finish(folder)


@contextlib.contextmanager
def small_disk(at: Path, size: int) -> Iterator[None]:
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={-(-size // 4096) * 4}k", "tmpfs", at], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", at], check=True)


KINDS = ("kills", "signals", "room", "limits", "races")


def attack(verbs: list[Verb], home: Path, trials: int, seed: int, kinds: tuple[str, ...] = KINDS,
           tell: Callable[[str], object] = lambda text: None) -> tuple[Counter[str], list[str]]:  # fmt: skip
    """So many trials of every kind for every verb: what was done, and what is broken."""
    total, found = Counter[str](), []
    for verb in verbs:
        try:
            one = Attack(verb, home / verb.name, random.Random(f"{seed} {verb.name}"))
        except Broken as error:
            found.append(str(error))
            tell(f"!! {verb.name}: {error}")
            continue
        for kind in kinds:
            for _ in range(trials):
                one.trial(kind, getattr(one, kind))
        total.update(one.counts)
        found += one.found
        tell(f"{verb.name}: {one.takes:.2f} s, {dict(one.counts)}")
        for text, count in one.said.most_common():
            tell(f"   {count} × {text[:600]}")
        for text in one.found:
            tell(f"!! {text[:1500]}")
    return total, found
