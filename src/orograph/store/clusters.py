"""Work on the workers of a Dask cluster, on this machine or on several that share a file system (or a bucket).

To Dask, a task is opaque and a few bytes: its stage and place (``worker_state`` is what workers do with it). Only this
process plans, holds the store's lock, merges the results of tasks, and publishes the store. It keeps a bounded number
of futures and releases each as soon as its task is done. Results lie in the store, so a lost worker loses nothing that
is done, and existing results are not made again. A task that fails, or whose workers die, is retried. One that fails
every time is given up and reported when all others are done.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import queue
import threading
import time
import uuid
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, TypeVar

from orograph.errors import DamagedChunkError, OrographError, ReadError, StoreError, UsageError
from orograph.progress import Progress, Task
from orograph.store.digests import Spot
from orograph.store.executing import Stage
from orograph.store.groups import group_levels
from orograph.store.terrain import Shape
from orograph.store.worker_state import Done, Recipe, do
from orograph.store.workforce import workforce

TRIES = 4
"""Attempts before a task is given up; before each of them, Dask itself moves tasks of dead workers several times."""

GIVEN_UP = 16
"""Number of given-up tasks after which no more are started: then the cause is not in the tasks."""

AHEAD = 2
"""Tasks in flight for each thread of the workers."""

EACH = 8
"""Minimum number of groups of heights or errors for each thread of the workers, if there are so many."""

T = TypeVar("T")

PAUSE = 0.5
"""Seconds before the recipe is sent to the workers again."""

COUNTING = 1.0
"""Seconds after which workers are counted again."""

SILENCE = 60.0
"""Seconds without a response from the scheduler after which the build ends."""


LOST = (OSError, AttributeError)
"""Errors that a Dask client raises when its scheduler is gone (it has none while it reconnects)."""


def answer(call: Callable[..., T], *args: Any, **options: Any) -> T:
    """Return the result of a call to the scheduler. Dask's own calls wait for ever if it is killed during one.

    Raises:
        TimeoutError: it does not answer within ``SILENCE``.
    """
    given = Future[T]()

    def ask() -> None:
        try:
            given.set_result(call(*args, **options))
        except BaseException as error:
            given.set_exception(error)

    threading.Thread(target=ask, daemon=True).start()
    return given.result(SILENCE)


def workers_of(client: Any) -> dict[str, int]:
    """Return the addresses of all current workers, and their threads.

    Raises:
        StoreError: the scheduler is gone.
    """
    try:
        return dict(answer(client.nthreads))
    except LOST as error:
        raise StoreError(
            "The scheduler of the cluster is gone.",
            remedy="Check that one is running and try again (a build with `resume=True`): what was done is kept.",
        ) from error


def threads_of(client: Any) -> int:
    """Return the number of threads of all current workers, at least 1.

    Raises:
        StoreError: the scheduler is gone.
    """
    return max(1, sum(workers_of(client).values()))


def levels_of(client: Any, shape: Shape, shard: int) -> int:
    """Return the levels of the groups of heights and errors."""
    return group_levels(shape, shard, EACH * threads_of(client))


@contextlib.contextmanager
def on_workers(
    recipe: Recipe, workers: int | None, dask: Any, jobs: int, max_memory: int, what: str
) -> Iterator[Cluster]:
    """Enter a cluster whose workers know a recipe.

    Args:
        workers, dask, jobs, max_memory: as for ``workforce``. what: the work, for messages: "A film".

    Raises:
        UsageError: as for ``workforce``.
    """
    check_workers(workers, dask, what)
    needed = recipe.base + recipe.memory
    with workforce(workers, dask, jobs, max_memory, needed) as client, Cluster(client, recipe) as cluster:
        yield cluster


def check_workers(workers: int | None, dask: Any, what: str, part: Any = None, finish: bool = False) -> None:
    """Raise UsageError if there are no workers, or work is shared in two ways (with workers, or in parts)."""
    if workers is not None and workers < 1:
        raise UsageError(f"{what} needs at least one worker, not {workers}.")
    ways = {"workers": workers, "dask": dask, "part": part, "finish": finish or None}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) > 1:
        raise UsageError(f"`{given[0]}` and `{given[1]}` exclude each other.")


class Cluster:
    """Runs stages on a cluster; its workers know the recipe within the ``with`` block.

    Args:
        client: Dask's. recipe: what workers get once. levels: of the groups of a build's heights and errors.

    Attributes:
        busy: seconds of work of each worker, by its name. moved: bytes of arrays that workers sent.
    """

    def __init__(self, client: Any, recipe: Recipe, levels: int = 0) -> None:
        self.client, self.recipe, self.ident = client, recipe, f"orograph-{uuid.uuid4().hex}"
        self.here, self.levels, self.busy, self.moved = 0, levels, defaultdict[str, float](float), 0
        self._counting = threading.Lock()

    def count(self, who: str, seconds: float, moved: int) -> None:
        """Count the work of a worker and the bytes that it sent; from any thread."""
        with self._counting:
            self.busy[who] += seconds
            self.moved += moved

    def imbalance(self) -> float:
        """Return the busiest worker's working time relative to the average: 1 if all are equal."""
        return max(self.busy.values(), default=0.0) * len(self.busy) / (sum(self.busy.values()) or 1.0) or 1.0

    def __enter__(self) -> Cluster:
        from orograph.store.dask_plugin import Telling

        for left in reversed(range(TRIES)):
            try:
                answer(self.client.register_plugin, Telling(self.ident, self.recipe), name=self.ident)
                break
            except LOST as error:  # a worker died while the recipe was sent; others may not have received it
                if not left:
                    raise StoreError(
                        f"The workers of the cluster cannot be reached: {error}.", remedy="Check that they are running."
                    ) from error
                time.sleep(PAUSE)
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            answer(self.client.unregister_worker_plugin, self.ident)

    def groups(self, stage: str, shape: Shape, shard: int) -> int:
        return self.levels

    def run(self, stage: Stage[Any], progress: Progress) -> None:
        """Run a stage, as all executors do.

        Raises:
            StoreError: tasks were given up, the scheduler is gone, or the workers' results are not visible here.
        """
        stage.hand_over()
        with progress.task(stage.label, total=len(stage.tasks())) as task:
            _Round(self, stage, progress, task).go()
            stage.finish()


class _Round:
    """One pass over all tasks of a stage."""

    def __init__(self, cluster: Cluster, stage: Stage[Any], progress: Progress, task: Task) -> None:
        self.client, self.stage, self.ident, self.task = cluster.client, stage, cluster.ident, task
        self.busy, self.progress, self.heard_of = cluster.busy, progress, set[str]()
        self.todo: Iterator[Spot] = iter(stage.tasks())
        self.again: list[Spot] = []
        self.pending: dict[Any, Spot] = {}
        self.done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.begun: Counter[Spot] = Counter()
        self.given_up: dict[Spot, BaseException | str] = {}
        self.any_done = False
        self.heard, self.counted, self.threads = time.monotonic(), -math.inf, 1
        self.able: dict[str, bool] = {}

    def go(self) -> None:
        """Run the pass."""
        try:
            while self._fill():
                try:
                    future = self.done.get(timeout=1.0)
                except queue.Empty:
                    self._listen()
                    continue
                self._take(future)
        finally:
            for future in self.pending:
                with contextlib.suppress(Exception):
                    future.cancel()
        if self.given_up:
            raise self._failed()

    def _fill(self) -> bool:
        """Start tasks while there is room; return whether any are running."""
        if time.monotonic() - self.counted > COUNTING:  # a request to the scheduler, which takes some milliseconds
            self.threads, self.counted = self._threads(), time.monotonic()
        room = AHEAD * self.threads - len(self.pending)
        if len(self.given_up) < GIVEN_UP:
            for spot in itertools.islice(self._next(), max(room, 0)):
                self.begun[spot] += 1
                future = self.client.submit(
                    do, self.ident, self.stage.name, self.stage.number, spot, pure=False,
                    workers=[who for who, able in self.able.items() if able] or None,
                    key=f"{self.ident}-{self.stage.name}-{self.stage.number}-{spot[0]}-{spot[1]}-{self.begun[spot]}",
                )  # fmt: skip
                self.pending[future] = spot
                future.add_done_callback(self.done.put)
        return bool(self.pending)

    def _threads(self) -> int:
        """Threads of the workers that can do the stage's tasks, at least 1.

        Raises:
            StoreError: the scheduler is gone, or none of them can.
        """
        there = workers_of(self.client)
        if self.stage.able is not None:
            new = [who for who in there if who not in self.able]
            found = answer(self.client.run, self.stage.able, workers=new, on_error="return") if new else {}
            self.able = {who: found.get(who, self.able.get(who)) is True for who in there}
            there = {who: threads for who, threads in there.items() if self.able[who]}
            if self.able and not there:
                raise StoreError(
                    "No worker of the cluster has what these tasks need (a GPU).", path=self.stage.place,
                    remedy="Start workers on machines that have it.",
                )  # fmt: skip
        return max(1, sum(there.values()))

    def _next(self) -> Iterator[Spot]:
        while self.again:
            yield self.again.pop()
        yield from self.todo

    def _take(self, future: Any) -> None:
        """Add the result of a task, or schedule a retry."""
        spot = self.pending.pop(future, None)
        if spot is None:
            return
        why = self._failure(spot, future)
        future.release()
        if why is None:
            found = self.stage.found(spot, proof=False)
            if found is not None:
                self.stage.add(spot, found)
                self.task.advance()
                self.any_done = True
                return
            why = "the building process cannot see the worker's result"
        if self.begun[spot] < TRIES and not isinstance(why, UsageError):
            self.again.append(spot)
            self.task.note(f"tried again: {_said(why)}")
        else:
            self.given_up[spot] = why
        self._listen()

    def _failure(self, spot: Spot, future: Any) -> BaseException | str | None:
        """Why a task failed; None if it did not."""
        try:
            if future.status != "finished":
                return (future.exception(timeout=10) if future.status == "error" else None) or "it was cancelled"
            done: Done = future.result(timeout=10)
            if done.seconds:
                self.stage.renewed(spot)
            self._hear(done)
            return done.failed
        except Exception as failure:  # the scheduler is gone with its state, or the worker is
            return failure

    def _hear(self, done: Done) -> None:
        """Count the work that a worker reports for a task, and pass on new results."""
        self.busy[done.who] += done.seconds
        for remark in done.remarks:
            if remark not in self.heard_of:
                self.heard_of.add(remark)
                self.progress.warn(remark)

    def _listen(self) -> None:
        """Detect that the scheduler or every worker is gone."""
        if self.client.status == "running":
            with contextlib.suppress(*LOST):
                if not answer(self.client.nthreads):
                    self.task.note("waiting for workers")
                self.heard = time.monotonic()
                return
        if self.client.status == "closed" or time.monotonic() - self.heard > SILENCE:
            raise StoreError(
                "The scheduler of the cluster is gone.", path=self.stage.place,
                remedy=self.stage.again,
            )  # fmt: skip

    def _failed(self) -> OrographError:
        """Return the error that lists the tasks given up, and why: if all have one cause in the input, that."""
        again = self.stage.again if self.any_done else ""
        causes = {str(why): why for why in self.given_up.values()}
        if len(causes) == 1:
            (cause,) = causes.values()
            if isinstance(cause, ReadError | DamagedChunkError):
                cause.remedy = f"{cause.remedy} {again}".strip()
                return cause
        bad_input = all(isinstance(why, ReadError) for why in causes.values())
        left = len(self.stage.tasks()) - sum(1 for _ in self.begun)
        reasons = [
            f"{self.stage.key(spot).removesuffix('.part')}: {_said(why).rstrip('.')}"
            for spot, why in list(self.given_up.items())[:4]
        ]
        count, more = len(self.given_up), len(self.given_up) - len(reasons)
        others = f" and {more} more" if more > 0 else ""
        never = f" {left} tasks were not begun." if left else ""
        tasks, each = ("1 task", "was given up after") if count == 1 else (f"{count} tasks", "were each given up after")
        return (ReadError if bad_input else StoreError)(
            f"{tasks} of {self.stage.label!r} {each} {TRIES} tries: "
            f"{'; '.join(reasons)}{others}.{never}", path=self.stage.place,
            remedy=f"Fix the cause. {again}".strip(),
        )  # fmt: skip


def _said(why: BaseException | str) -> str:
    text = str(why) if isinstance(why, OrographError | str) else f"{type(why).__name__}: {why}"
    return " ".join(text.split())[:300]
