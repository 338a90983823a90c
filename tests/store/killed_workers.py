"""A cluster whose workers are killed at random moments."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading

import pytest

from orograph.errors import StoreError
from orograph.store import clusters
from orograph.store.workforce import workforce

KILLS = 40
"""Workers that are killed over a kind of work, at least."""


@contextlib.contextmanager
def killed(seed):
    """A cluster of two workers, of which one is killed after every random time; and how many were.

    Two kills of three wait until a task was done since the last one, so that work gets on however long workers take to
    start; the others come when they may.
    """
    pytest.importorskip("distributed")
    rng, kills, done, ended = random.Random(seed), [0], [0], threading.Event()
    hear = clusters._Round._hear

    def heard(self, found):
        done[0] += 1
        hear(self, found)

    def killer(client):
        while not ended.is_set():
            wanted = done[0] + (rng.random() < 2 / 3)
            while done[0] < wanted and not ended.wait(0.02):
                pass
            if ended.wait(rng.uniform(0.0, 1.0)):
                return
            pids = [nanny.pid for nanny in client.cluster.workers.values() if nanny.pid]
            if pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(rng.choice(pids), signal.SIGKILL)
                    kills[0] += 1

    with pytest.MonkeyPatch.context() as patch, workforce(2, None, 1, 4 << 30, 0) as client:
        patch.setattr(clusters._Round, "_hear", heard)
        thread = threading.Thread(target=killer, args=(client,))
        thread.start()
        try:
            yield client, kills
        finally:
            ended.set()
            thread.join()


def until_done(work):
    """Run it again as long as tasks are given up."""
    while True:
        try:
            return work()
        except StoreError as error:
            assert "given up" in str(error) or "cannot be reached" in str(error)
