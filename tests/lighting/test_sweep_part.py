"""Horizons of parts, with hulls handed on from part to part, are those of the whole raster, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from orograph.lighting.sweep import fold, horizons, ways
from orograph.lighting.sweep_part import Hulls, Part
from orograph.lighting.sweep_pass import Terms


def ground(shape, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    h = 300 * np.sin(x / 11) * np.cos(y / 7) + 40 * rng.random(shape) + 0.5 * x
    h[shape[0] // 3 : shape[0] // 2, shape[1] // 4 : shape[1] // 3] = np.nan
    return h.astype(np.float32)


def whole(heights, linear, azimuths, terms):
    out = np.full((len(azimuths), *heights.shape), np.nan, np.float32)

    def keep(block, first, last):
        for k, index in enumerate(block.azimuths):
            out[index, block.row0 + first : block.row0 + last, block.col0 : block.col1] = block.slopes[k, first:last]

    lowest, below, radius, curvature = terms
    fold(
        horizons(lambda a, b, c, d: heights[a:b, c:d], heights.shape, linear, azimuths, lowest=lowest, below=below,
                 radius=radius, curvature=curvature, jobs=1), keep, 1,
    )  # fmt: skip
    return out


def in_parts(heights, linear, azimuths, terms, size):
    """Part by part, each with nothing but what those in front of it handed on (as bytes would be: copies)."""
    out = np.full((len(azimuths), *heights.shape), np.nan, np.float32)
    order = []
    for way in ways(azimuths, linear, heights.shape):
        rows, cols = (-(-n // size) for n in heights.shape)
        along, across = (cols, rows) if way[0].by_columns else (rows, cols)
        steps = range(along)[::-1] if way[0].backward else range(along)
        before: dict[int, dict[int, Hulls]] = {}
        for s in steps:
            left: dict[int, dict[int, Hulls]] = {}
            for lane in range(across):
                i, j = (lane, s) if way[0].by_columns else (s, lane)
                window = (
                    i * size, min((i + 1) * size, heights.shape[0]), j * size, min((j + 1) * size, heights.shape[1])
                )  # fmt: skip
                part = Part(way, heights.shape, terms, window)

                def add(block, window=window):
                    r, c = block.row0 + window[0], block.col0 + window[2]
                    for k, index in enumerate(block.azimuths):
                        tall, wide = block.slopes.shape[1:]
                        out[index, r : r + tall, c : c + wide] = block.slopes[k]

                def read(a, b, c, d):
                    return heights[a:b, c:d].copy()

                def hulls(index, part=part, before=before):
                    return [before[lane][index] for lane in part.before(size) if lane in before]

                left[lane] = {
                    index: Hulls.unpacked(one.packed(index), index)
                    for index, one in part.sweep(read, hulls, add, 1, 64 << 20)
                }
                order.append((i, j))
            before = left
    return out


@pytest.mark.parametrize(
    "terms",
    [Terms(), Terms(-np.inf), Terms(0.0, True), Terms(0.0, False, None, 1e-5), Terms(0.0, False, 900.0),
     Terms(0.0, False, 210.0, 1e-6)],
)  # fmt: skip
@pytest.mark.parametrize("shape", [(150, 230), (1, 200), (210, 1)])
def test_parts_are_the_whole(terms, shape):
    heights = ground(shape)
    linear = np.array([[20.0, 0.0], [0.0, -30.0]])
    azimuths = np.array([0.0, 33.7, 45.0, 77.0, 90.0, 135.0, 171.0, 200.0, 270.0, 291.0, 315.0, 340.0])
    expected = whole(heights, linear, azimuths, terms)
    np.testing.assert_array_equal(in_parts(heights, linear, azimuths, terms, 64), expected)


def test_long_hulls_over_rotated_cells():
    """A sea on a round body, where every sample is on the hull, and an island that is seen from afar."""
    heights = np.zeros((300, 170), np.float32)
    heights[140:150, 80:90] = 900
    linear = np.array([[17.0, 6.0], [5.0, -21.0]])
    azimuths, terms = np.array([10.0, 100.0, 190.0, 280.0]), Terms(-np.inf, False, None, 1e-5)
    expected = whole(heights, linear, azimuths, terms)
    np.testing.assert_array_equal(in_parts(heights, linear, azimuths, terms, 32), expected)
