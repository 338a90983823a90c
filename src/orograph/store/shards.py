"""What all that write a store shard by shard have in common: they go through the shards.

One task makes one shard, and nobody else writes it; what comes of the tasks does not depend on their number or order.
An error or Ctrl-C cancels what has not begun (``parallel.map_ordered``), and what is done is kept by those who do it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from orograph.parallel import map_ordered
from orograph.progress import Progress
from orograph.store.digests import Spot


def go_through(
    label: str,
    spots: Sequence[Spot],
    run: Callable[[Spot], object],
    jobs: int,
    progress: Progress,
    last: Callable[[], object] | None = None,
) -> None:
    """Do the tasks of all shards.

    Args:
        label: what is done, for the progress line.
        spots: the shards' (row, col).
        run: does one, in one of ``jobs`` threads.
        last: what is left to do when all are done, under the same label.
    """
    with progress.task(label, total=len(spots)) as task:
        for _ in map_ordered(run, spots, jobs):
            task.advance()
        if last is not None:
            last()
