"""Eight numbers side by side: every operation beside NumPy's, to the bit."""

from __future__ import annotations

import operator

import numpy as np
import pytest

from orograph._lanes import (
    LANES,
    corners,
    counted,
    gather,
    least,
    load,
    most,
    real,
    size,
    some,
    spread,
    store,
    where,
    whole,
)
from orograph._numba import kernel

VALUES = np.array([0.0, -0.0, 1.5, -2.25, np.nan, np.inf, -np.inf, 3e300])
OTHERS = np.array([1.5, 0.0, 1.5, -7.0, 2.0, np.inf, 1.0, 1e-10])


@kernel
def arithmetic(x, y, out):
    a, b = load(x, 0), load(y, 0)
    store(out, 0, a + b)
    store(out, 8, a - b)
    store(out, 16, a * b)
    store(out, 24, a / b)
    store(out, 32, 2.0 - a)
    store(out, 40, a * 3)
    store(out, 48, spread(0.25) + counted())
    store(out, 56, size(a))


@kernel
def compared(x, y, out):
    a, b = load(x, 0), load(y, 0)
    store(out, 0, where(a < b, 1.0, 0.0))
    store(out, 8, where(a <= b, 1.0, 0.0))
    store(out, 16, where(a > b, 1.0, 0.0))
    store(out, 24, where(a >= b, 1.0, 0.0))
    store(out, 32, where(a == b, 1.0, 0.0))
    store(out, 40, where(~(a < b) & (a == a) | (b > 1.7), a, b))
    store(out, 48, least(a, b))
    store(out, 56, most(a, b))
    return some(a == 1.5), some(a == 7.0)


@kernel
def looked_up(pool, x, stride, out):
    i = whole(load(x, 0))
    a, b, c, d = corners(pool, i, stride)
    store(out, 0, a)
    store(out, 8, b)
    store(out, 16, c)
    store(out, 24, d)
    store(out, 32, gather(pool, i * 2 + 1))
    store(out, 40, real(i >> 1))
    store(out, 48, where((i & 1) == 0, 1.0, 0.0))


def test_arithmetic() -> None:
    out = np.empty(64)
    arithmetic(VALUES, OTHERS, out)
    with np.errstate(all="ignore"):
        expected = [VALUES + OTHERS, VALUES - OTHERS, VALUES * OTHERS, VALUES / OTHERS, 2.0 - VALUES, VALUES * 3]
    expected += [0.25 + np.arange(LANES), np.abs(VALUES)]
    assert_same(out, expected, signs=slice(0, 48))


def test_comparisons() -> None:
    out = np.empty(64)
    assert compared(VALUES, OTHERS, out) == (True, False)
    a, b = VALUES, OTHERS
    expected = [f(a, b) for f in (operator.lt, operator.le, operator.gt, operator.ge, operator.eq)]
    chosen = ~(a < b) & (a == a) | (b > 1.7)
    expected += [np.where(chosen, a, b), np.where(b < a, b, a), np.where(b > a, b, a)]
    assert_same(out, expected)


@pytest.mark.parametrize("stride", [1, 5, 16])
def test_samples(stride: int) -> None:
    pool = np.random.default_rng(1).normal(size=64).astype(np.float32)
    pool[7] = np.nan
    i = np.array([0, 7, 3, 30, 6, 2, 30, 11])
    out = np.empty(56)
    looked_up(pool, i + 0.75, stride, out)
    found = [pool[i], pool[i + 1], pool[i + stride], pool[i + stride + 1], pool[2 * i + 1], i >> 1, i % 2 == 0]
    assert_same(out, found)


def assert_same(out: np.ndarray, expected: list[np.ndarray], signs: slice = slice(0)) -> None:
    wanted = np.concatenate([np.asarray(e, np.float64) for e in expected])
    np.testing.assert_array_equal(out, wanted)
    valid = ~np.isnan(wanted[signs])
    np.testing.assert_array_equal(np.signbit(out[signs])[valid], np.signbit(wanted[signs])[valid])
