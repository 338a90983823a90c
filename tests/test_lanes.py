"""Numbers side by side: every operation beside NumPy's, to the bit."""

from __future__ import annotations

import operator

import numpy as np
import pytest

from orograph._lanes import (
    LANES,
    corners,
    counted,
    first_of,
    gather,
    largest_of,
    least,
    load,
    most,
    one_of,
    real,
    scatter,
    size,
    some,
    spread,
    store,
    sum_of,
    where,
    whole,
)
from orograph._lanes32 import (
    count_of,
    float_bits,
    gather32,
    lane,
    least_unsigned,
    lengths32,
    load32,
    marked,
    marked_before,
    picked32,
    quotients32,
    shifted_in,
    shifted_right,
    spread32,
    store32,
    store_before,
    transpose32,
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


@kernel
def scattered(pool, places, out):
    i = load(places, 0)
    scatter(out, i, gather(pool, i + 1))


def test_scattered_elements_of_64_bits() -> None:
    pool, places = np.linspace(0.1, 4.1, 41), np.array([33, 2, 7, 7, 0, 12, 39, 5])
    out = np.zeros(41)
    scattered(pool, places, out)
    expected = np.zeros(41)
    expected[places] = pool[places + 1]
    assert_same(out, [expected])


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


@kernel
def whole_numbers(x, y, pool, words, out):
    a, b = load32(x, 0), load32(y, 0)
    found = a
    found += b
    store32(out, 0, found)
    store32(out, 16, a - b)
    store32(out, 32, a * b)
    store32(out, 48, 7 - a)
    store32(out, 64, (a & 255) | (b << 3))
    store32(out, 80, (a ^ b) >> 5)
    store32(out, 96, shifted_right(a, 5))
    store32(out, 112, shifted_right(a, b & 31) + (spread32(1) << (b & 31)))
    store32(out, 128, where((a < b) & ~(a == 3), a, b))
    store32(out, 144, least_unsigned(a, 4095))
    store32(out, 160, gather32(pool, b & 31))
    store32(out, 176, gather32(words, b & 31))
    store32(out, 192, shifted_in(5, a))
    store32(out, 208, marked_before(a < 0))
    store32(out, 224, float_bits(b))
    store32(out, 240, where(marked(0b1010000000000101), a, 0))
    store32(out, 256, picked32(words, 3, b & 15))
    store32(out, 272, lengths32(a))
    store32(out, 288, lengths32(shifted_right(a, b & 31)))
    return count_of(a < 0), lane(a, 15), some(a == 3)


def test_sixteen_whole_numbers() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(-(2**31), 2**31, (2, 16)).astype(np.int32)
    a[:4], b[:3] = [3, -(2**31), 2**31 - 1, 0], [3, 1, -1]
    pool, words = rng.integers(-(2**31), 2**31, 32).astype(np.int32), rng.integers(0, 2**16, 32).astype(np.uint16)
    out, bits, low = np.empty(304, np.int32), a.view(np.uint32), b & 31
    assert whole_numbers(a, b, pool, words, out) == ((a < 0).sum(), a[15], True)
    before = np.concatenate([[0], np.cumsum(a < 0)[:-1]])
    right = ((bits >> low.astype(np.uint32)) + (np.uint32(1) << low.astype(np.uint32))).view(np.int32)
    chosen = [(0b1010000000000101 >> k) & 1 for k in range(16)]
    expected = [a + b, a - b, a * b, 7 - a, (a & 255) | (b << 3), (a ^ b) >> 5, (bits >> np.uint32(5)).view(np.int32)]
    expected += [right, np.where((a < b) & (a != 3), a, b), np.minimum(bits, 4095), pool[low], words[low]]
    expected += [np.concatenate([[5], a[:-1]]), before, b.astype(np.float32).view(np.int32), a * np.array(chosen)]
    shifted = bits >> low.astype(np.uint32)
    expected += [words[3 + (b & 15)], *([int(v).bit_length() for v in some] for some in (bits, shifted))]
    np.testing.assert_array_equal(out.reshape(19, 16), np.array([np.asarray(e).astype(np.int32) for e in expected]))


@kernel
def divided(x, y, out):
    for k in range(0, x.size, 16):
        store32(out, k, quotients32(load32(x, k), load32(y, k)))


def test_whole_quotients() -> None:
    """All below 2^20: of numbers next to multiples of the divisor, where floats are off by one, and others."""
    rng = np.random.default_rng(3)
    divisor = np.repeat(np.concatenate([np.arange(1, 4097), rng.integers(1, 2**16, 4096)]), 16)
    most = np.minimum(divisor << 20, 2**32) - 1
    number = np.minimum((rng.random(divisor.size) * most).astype(np.int64) // divisor * divisor, most)
    number = np.clip(number + rng.integers(-1, 2, number.size), 0, most)
    number[::16], number[1::16] = most[::16], divisor[1::16] - 1
    out = np.empty(number.size, np.int32)
    divided(number.astype(np.uint32).view(np.int32), divisor.astype(np.int32), out)
    np.testing.assert_array_equal(out, number // divisor)


@kernel
def packed(x, marks, words):
    store_before(words, 20, load32(x, 0), marked(marks))


def test_words_of_marked_lanes_end_before_a_place() -> None:
    rng = np.random.default_rng(4)
    for marks in (0, 1, 0x8000, 0xFFFF, *rng.integers(0, 2**16, 60)):
        x, words = rng.integers(-(2**31), 2**31, 16).astype(np.int32), np.full(24, 7, np.uint16)
        packed(x, int(marks), words)
        chosen = x[[int(marks) >> k & 1 == 1 for k in range(16)]].astype(np.uint16)
        np.testing.assert_array_equal(words[20 - chosen.size :], [*chosen, 7, 7, 7, 7])
        assert (words[:4] == 7).all()


@kernel
def across(square, out):
    transpose32(square, 3, 17, out, 2, 20)


def test_lanes_lie_side_by_side() -> None:
    square, out = np.random.default_rng(2).integers(-(2**31), 2**31, 275).astype(np.int32), np.zeros(322, np.int32)
    across(square, out)
    np.testing.assert_array_equal(out[2:].reshape(16, 20)[:, :16], square[3:].reshape(16, 17)[:, :16].T)
    assert not out[:2].any() and not out[2:].reshape(16, 20)[:, 16:].any()


def assert_same(out: np.ndarray, expected: list[np.ndarray], signs: slice = slice(0)) -> None:
    wanted = np.concatenate([np.asarray(e, np.float64) for e in expected])
    np.testing.assert_array_equal(out, wanted)
    valid = ~np.isnan(wanted[signs])
    np.testing.assert_array_equal(np.signbit(out[signs])[valid], np.signbit(wanted[signs])[valid])


@kernel
def joined(x, singles, marks, out):
    a = load(x, 0)
    store(out, 0, load(singles, 3))
    return largest_of(a), sum_of(a), one_of(a, 5), one_of(load(marks, 0), 2), first_of(load(marks, 0) == 1)


def test_all_lanes_are_joined_into_one() -> None:
    rng = np.random.default_rng(1)
    singles, out = rng.normal(size=(4, 5)).astype(np.float32), np.empty(8)
    for first in range(8):
        x, marks = rng.normal(0, 10.0 ** rng.integers(-9, 9, 8)), np.arange(8) + 1 - first
        largest, total, sixth, third, found = joined(x, singles, marks, out)
        halves = x[:4] + x[4:]
        assert total == (halves[0] + halves[2]) + (halves[1] + halves[3])
        assert (largest, sixth, third, found) == (x.max(), x[5], 3 - first, first)
        assert (out == singles.ravel()[3:11]).all()
