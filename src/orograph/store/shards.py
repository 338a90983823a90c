"""The common part of writing a store shard by shard: running tasks over shards.

One task makes one shard, and no other task writes it; results do not depend on the number or order of tasks. An error
or Ctrl-C cancels tasks that have not begun (``parallel.map_ordered``), and finished tasks have stored their results.
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
    """Run the tasks of all shards.

    Args:
        label: for the progress line.
        spots: the shards' (row, col).
        run: runs one, in one of ``jobs`` threads.
        last: runs after all are done, under the same label.
    """
    with progress.task(label, total=len(spots)) as task:
        for _ in map_ordered(run, spots, jobs):
            task.advance()
        if last is not None:
            last()
