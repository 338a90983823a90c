"""How threads share out the subtrees of a pass, without a lock: one takes them from the front, others from the back.

Who takes from the front can write to where the whole goes, since all before is its own; only what the others make is
moved, once. The state is a few counters, each on cache lines of its own, moved by atomic additions.

A *helper* may wake late, or never (the processor is busy): it enters through a gate, which is closed when there is
nothing more to take; who comes after that does nothing. So nobody waits for a thread that has not begun.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from orograph._numba import inlined, leaf

TAKEN, BACK, READY, GATE, DONE, INSIDE, SIZE = 0, 16, 32, 48, 64, 80, 96
"""Places in the state, 128 bytes apart (processors fetch lines by twos): how many things were taken, and of them from
the back; whether work may begin; helpers that came to the gate; that left; that were inside when it was closed."""

CLOSED = 1 << 32
"""Added to the gate when it is closed."""

SPINS = 1 << 14
"""Looks at the state (0.1 to 0.3 ms) of a thread that waits, before it goes to sleep or away."""


def begin() -> NDArray[np.int64]:
    """The state of a pass that begins; every pass has its own, since a helper may still look at the last one."""
    state = np.zeros(SIZE, np.int64)
    state[INSIDE] = -1
    return state


@intrinsic
def _add(typing, array, index, amount):

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), args[2], "seq_cst")

    return types.int64(array, types.int64, types.int64), generate


add: Any = _add
"""``add(array, index, amount)``: ``array[index] += amount`` as one step that no other thread can divide; what was there
before."""


@inlined
def enters(state):
    """Whether a helper comes in time; if so it must ``leave``."""
    return add(state, GATE, 1) < CLOSED


@inlined
def ready(state, number):
    """Helpers may begin, with a number (0 or more) that they need."""
    add(state, READY, number + 1)


@inlined
def wait_for(state):
    """Wait until it is said that helpers may begin; the number, or −1 if that took too long."""
    for _ in range(SPINS):
        number = add(state, READY, 0) - 1
        if number >= 0:
            return number
    return -1


@inlined
def leave(state):
    """A helper is done, and so is what it wrote."""
    add(state, DONE, 1)


@inlined
def left(state, count):
    """Whether, of ``count`` things to do, one is left for the caller, who must do it then."""
    return add(state, TAKEN, 1) < count


@inlined
def last(state, count):
    """The number of that thing, for those who take from the back (the one who takes from the front knows it)."""
    return count - 1 - add(state, BACK, 1)


@inlined
def stop(state, count):
    """Nobody is to take any more."""
    add(state, TAKEN, count)


@leaf
def _close(state, spins):
    if state[INSIDE] < 0:
        state[INSIDE] = add(state, GATE, CLOSED)
    while add(state, DONE, 0) != state[INSIDE]:
        spins -= 1
        if spins < 0:
            return False
    return True


def close(state: NDArray[np.int64]) -> None:
    """Close the gate and wait for the helpers that are inside."""
    while not _close(state, SPINS):
        time.sleep(1e-4)
