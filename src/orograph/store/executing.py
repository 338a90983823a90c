"""How work on terrain is organised, for builds, baked light, films and pictures: stages of tasks, run by an executor.

A *stage* is all work of one kind: the heights, the samples of a lattice, the errors, the frames of a film. Its tasks
may run in any order, in any thread, process or machine, and more than once: each reads the sources and the results of
earlier stages, writes whole files (shards) that no other task writes, the same bytes every time, and stores beside them
what the rest of the work needs (``parts/``). Whoever finishes the stage combines the tasks' results and makes what no
single task could. Stages follow one another; tasks of one stage are independent.

An *executor* runs stages: ``Threads`` in this process, ``clusters.Cluster`` on the workers of a Dask cluster, and
``in_parts`` has those for job arrays, where independent processes do a share each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from orograph.progress import Progress
from orograph.store.digests import Spot
from orograph.store.layout import dumps
from orograph.store.places import HANDED
from orograph.store.shards import go_through
from orograph.store.terrain import Shape
from orograph.store.writer import ShardWriter

Found = TypeVar("Found")


class Stage(ABC, Generic[Found]):
    """Work of one kind. Its methods are safe from any thread, for different tasks.

    Attributes:
        name: of the kind. number: which of several stages of that kind. label: for the progress line.
        again: how to resume interrupted work.
        able: whether a process can do its tasks, asked there; None: all can.
    """

    name: ClassVar[str]
    number: int = 0
    label: str
    able: Callable[[], bool] | None = None
    again: ClassVar[str] = "What was done is kept: run the same again to go on."

    @property
    @abstractmethod
    def place(self) -> str:
        """Where its results are, for messages."""

    def hand_over(self) -> None:
        """Leave for other processes what their tasks need from this one, before any begins."""

    def remarks(self, found: Found) -> tuple[str, ...]:
        """What a task that was just done reports to the combining process: warnings."""
        return ()

    @abstractmethod
    def kept(self, spot: Spot) -> bool:
        """Whether a task was done before, without checking what it wrote."""

    @abstractmethod
    def tasks(self) -> Sequence[Spot]:
        """Its tasks, in the order in which they are best added up."""

    @abstractmethod
    def make(self, spot: Spot) -> Found:
        """Do a task: write its shards, store its result, and return that."""

    @abstractmethod
    def key(self, spot: Spot) -> str:
        """Where the result of a task is stored."""

    @abstractmethod
    def found(self, spot: Spot, proof: bool = True) -> Found | None:
        """The stored result of a task that was done before; None if it was not, or what it wrote is damaged.

        Args:
            proof: read everything that it wrote; otherwise only the ends of shards are compared with the stored result.
        """

    def renewed(self, spot: Spot) -> None:
        """Another process has just stored the result of a task, maybe in place of an older one."""

    @abstractmethod
    def add(self, spot: Spot, found: Found) -> None:
        """Combine a task's result with the others."""

    def finish(self) -> None:
        """Make what no task could, once all results are combined."""


KNOWN = f"{HANDED}/digests.json"
"""The digests that other processes need to read what earlier stages of a build wrote."""


class ShardStage(Stage[Found]):
    """Work over the shards of a store being built.

    Attributes:
        writer: of its shards.
    """

    writer: ShardWriter
    again = "What was done is kept: finish the build with `resume=True`."

    @property
    def place(self) -> str:
        return self.writer.storage.url

    def kept(self, spot: Spot) -> bool:
        return self.writer.storage.exists(self.key(spot))

    def renewed(self, spot: Spot) -> None:
        self.writer.storage.renewed(self.key(spot))

    def hand_over(self) -> None:
        self.writer.keep(KNOWN, dumps(self.writer.digests.to_json()))


class Executor(Protocol):
    """Runs stages.

    Attributes:
        here: threads of this process that run tasks; 0: other processes run them.
    """

    here: int

    def groups(self, stage: str, shape: Shape, shard: int) -> int:
        """Levels of the groups in which heights or errors are made (``groups.group_levels``); 0: shard by shard."""

    def run(self, stage: Stage[Any], progress: Progress) -> None:
        """Run the remaining tasks of a stage, combine all results and finish the stage."""


class Threads:
    """Threads of this process.

    Args:
        jobs: threads. resume: whether some tasks may already be done.
    """

    def __init__(self, jobs: int, resume: bool) -> None:
        self.jobs, self.resume, self.here = jobs, resume, jobs

    def groups(self, stage: str, shape: Shape, shard: int) -> int:
        return 0

    def run(self, stage: Stage[Any], progress: Progress) -> None:
        def do(spot: Spot) -> None:
            found = stage.found(spot) if self.resume else None
            stage.add(spot, stage.make(spot) if found is None else found)

        go_through(stage.label, stage.tasks(), do, self.jobs, progress, stage.finish)
