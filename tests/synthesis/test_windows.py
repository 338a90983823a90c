"""Windows by example: as the plain reference makes them, the same to the bit however they are made, and on the GPU."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import UsageError
from orograph.synthesis import reference
from orograph.synthesis.exemplar import Exemplar
from orograph.synthesis.kernels import raised
from orograph.synthesis.windows import Endless, Range


def ground(rows: int, cols: int, seed: int = 3) -> np.ndarray:
    """Rough ground with a valley, rectangular, not a power of two."""
    rng = np.random.default_rng(seed)
    noise = np.fft.rfft2(rng.standard_normal((rows, cols)))
    wave = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None, :])
    rough = np.fft.irfft2(noise / np.maximum(wave, 0.01) ** 1.6, (rows, cols))
    y, x = np.mgrid[:rows, :cols]
    return (100 + 8 * rough / rough.std() + 0.3 * np.abs(x - y)).astype(np.float32)


@pytest.fixture(scope="module")
def exemplar() -> Exemplar:
    return Exemplar.of(ground(57, 70), jobs=1)


@pytest.fixture(scope="module")
def endless(exemplar: Exemplar) -> Endless:
    return Endless(exemplar, 7)


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("window", "jitter", "kappa", "passes"),
    [
        (Range(-9, 20, -21, 10), None, 1, None),
        (Range(1000, 1001, 5, 40), None, 1, 2),
        (Range(3, 9, -70000, -69990), 1.0, 0, [2, 1, 2]),
    ],
)
def test_windows_are_those_of_the_reference(
    exemplar: Exemplar, window: Range, jitter: float | None, kappa: int, passes: int | list[int] | None
) -> None:
    endless = Endless(exemplar, 7, jitter=jitter, kappa=kappa, passes=passes)
    told = exemplar, endless.seed, endless.reach, kappa, endless.passes, window
    for level in (0, 1, exemplar.top):
        assert np.array_equal(endless.coordinates(window, level), reference.coordinates(*told, level))
    level = exemplar.top - 1
    assert np.array_equal(endless.heights(window, level), reference.heights(*told, level))


@given(st.integers(-500, 500), st.integers(-500, 500), st.integers(1, 20), st.integers(1, 20), st.integers(0, 4))
@settings(max_examples=25, deadline=None)
def test_a_window_is_the_same_wherever_it_begins(row: int, col: int, rows: int, cols: int, level: int) -> None:
    endless = Endless(_shared(), 1)
    part, whole = Range(row, row + rows, col, col + cols), Range(row - 13, row + 27, col - 8, col + 31)
    for read in (endless.coordinates, endless.heights):
        assert np.array_equal(read(part, level), read(whole, level)[part.within(whole)])


def _shared(kept: list[Exemplar] = []) -> Exemplar:  # noqa: B006 (made once for hypothesis)
    if not kept:
        kept.append(Exemplar.of(ground(57, 70), jobs=1))
    return kept[0]


def test_the_gpu_chooses_the_same_places_and_heights(endless: Endless, device) -> None:
    from orograph.synthesis.gpu import EndlessOnGpu

    gpu = EndlessOnGpu(endless, device)
    for window in (Range(-9, 30, -21, 20), Range(1001, 1002, 5, 40)):
        for level in (0, 2, endless.exemplar.top):
            assert np.array_equal(gpu.coordinates(window, level), endless.coordinates(window, level))
            assert np.array_equal(gpu.heights(window, level), endless.heights(window, level))


def test_one_piece_of_the_exemplar_comes_out_to_the_bit(exemplar: Exemplar) -> None:
    """Where the places of all levels are chosen from one piece, mirror images included, heights are the exemplar's."""
    rows, cols = exemplar.shape
    for level in range(1, exemplar.top + 1):
        step, above = exemplar.step(level), Range(-6, 40, -5, 30)
        window = Range(2 * above.row0 + 4, 2 * above.row1 - 5, 2 * above.col0 + 3, 2 * above.col1 - 4)
        coarse, chosen = (
            np.stack(np.meshgrid(17 + s * np.arange(*r[2:]), 4 + s * np.arange(*r[:2])), -1).astype(np.int32)
            for s, r in ((2 * step, above), (step, window))
        )
        out = np.empty(window.shape, np.int32)
        raised(
            reference.at(exemplar.stack[level - 1], coarse), above.row0, above.col0, chosen % [2 * cols, 2 * rows],
            window.row0, window.col0, exemplar.stack[level], exemplar.stack[level - 1], step, out,
        )  # fmt: skip
        assert np.array_equal(out, reference.at(exemplar.stack[level], chosen))


def test_seeds_differ_and_pieces_are_coherent(exemplar: Exemplar) -> None:
    window = Range(0, 96, 0, 96)
    one, other = (Endless(exemplar, seed).coordinates(window) for seed in (1, 2))
    assert (one != other).any(-1).mean() > 0.9
    assert (np.diff(one[..., 0], axis=1) == 1).mean() > 0.4  # chance: 1 in 140


def test_heights_are_like_the_exemplars(exemplar: Exemplar, endless: Endless) -> None:
    """Its slopes come out as steep as they are: the terrain is no average of pieces, and has no steps between them."""
    own = ground(57, 70).astype(np.float64)
    made = endless.metres(endless.heights(Range(0, 200, 0, 200))).astype(np.float64)
    for axis in (0, 1):
        a, b = (np.abs(np.diff(h, axis=axis)).ravel() for h in (own, made))
        assert np.quantile(b, 0.5) == pytest.approx(np.quantile(a, 0.5), rel=0.2)
        assert np.quantile(b, 0.99) == pytest.approx(np.quantile(a, 0.99), rel=0.25)
    assert own.min() - 10 < made.min() < made.max() < own.max() + 10


def test_the_stack_smooths_as_the_binomial_filter_does() -> None:
    heights = ground(40, 50).astype(np.float64)
    exemplar = Exemplar.of(heights, jobs=1)
    wide = np.pad(heights, 2, mode="symmetric")
    weights = np.array([1, 4, 6, 4, 1]) / 16
    down = sum(w * wide[k : k + 40] for k, w in enumerate(weights))
    both = sum(w * down[:, k : k + 50] for k, w in enumerate(weights))
    found = exemplar.base + exemplar.quantum * exemplar.stack[-2]
    assert np.abs(found - both).max() <= 2 * exemplar.quantum
    assert np.abs(exemplar.base + exemplar.quantum * exemplar.stack[-1] - heights).max() <= exemplar.quantum / 2


def test_similar_places_look_alike_and_lie_apart(exemplar: Exemplar) -> None:
    """Beside the best of all places by brute force: not always that one, but near to it."""
    level = exemplar.top
    features, similar = exemplar.features[level].astype(np.int64), exemplar.similar[level]
    rows, cols = features.shape
    wide = np.pad(features, 2, mode="symmetric")
    hoods = np.lib.stride_tricks.sliding_window_view(wide, (5, 5)).reshape(rows, cols, 25)
    apart = max(2, min(rows, cols) // 20)
    y, x = np.mgrid[:rows, :cols]
    u, v = similar[..., 0], similar[..., 1]
    assert (np.maximum(abs(u - x), abs(v - y)) >= apart).all()
    assert ((u >= 2) & (u < cols - 2) & (v >= 2) & (v < rows - 2)).all()
    found = ((hoods - hoods[v, u]) ** 2).sum(-1)
    ratios = []
    for r in range(0, rows, 7):
        for c in range(0, cols, 7):
            distance = ((hoods[2:-2, 2:-2] - hoods[r, c]) ** 2).sum(-1)
            distance[np.maximum(abs(x - c), abs(y - r))[2:-2, 2:-2] < apart] = 1 << 60
            assert found[r, c] >= distance.min()
            ratios.append(found[r, c] / distance.min())
    assert np.median(ratios) < 1.5
    anywhere = ((hoods - hoods[::-1, ::-1]) ** 2).sum(-1)
    assert np.median(found) < 0.3 * np.median(anywhere)


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        (np.zeros((20, 90), np.float32), "at least 32"),
        (np.zeros((40, 90), np.float32), "Level ground"),
        (np.where(np.eye(40), np.nan, ground(40, 40)), "40 of its 1,600"),
        (np.zeros((3000, 3000), np.float32), "at most"),
    ],
)
def test_what_is_no_example_is_refused(heights: np.ndarray, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Exemplar.of(heights, "x.tif")


@pytest.mark.parametrize("jitter", [-0.1, 1.5, [], [0.1] * 40, [2.0]])
def test_jitter_out_of_range_is_refused(exemplar: Exemplar, jitter: object) -> None:
    with pytest.raises(UsageError, match="jitter"):
        Endless(exemplar, jitter=jitter)  # type: ignore[arg-type]
