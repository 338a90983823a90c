"""Patches over missing data: which holes are enclosed (by SciPy's labelling), and that patches are membranes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from orograph.geovis.missing import enclosed, fill, patches
from orograph.raycast.stack import HeightWindow


def reference(missing):
    """Missing samples whose eight-connected region does not reach the border."""
    labels, _ = ndimage.label(missing, np.ones((3, 3)))
    edge = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    return missing & ~np.isin(labels, edge)


def border(shape):
    out = np.zeros(shape, bool)
    out[[0, -1]] = out[:, [0, -1]] = True
    return out


def holed(seed, part, shape=(60, 70)):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = (3.0 * x - 2.0 * y + 100).astype(np.float32)
    heights[rng.random(shape) < part] = np.nan
    return heights


@pytest.mark.parametrize("part", [0.0, 0.05, 0.3, 0.45, 1.0])
def test_what_is_enclosed(part):
    heights = holed(1, part)
    np.testing.assert_array_equal(enclosed(heights, border(heights.shape)), reference(np.isnan(heights)))


def test_patches_of_a_plane_are_the_plane():
    heights = holed(2, 0.05)
    heights[20:31, 30:43] = np.nan
    holes = reference(np.isnan(heights))
    filled = fill(heights, holes)
    y, x = np.mgrid[:60, :70]
    plane = 3.0 * x - 2.0 * y + 100
    np.testing.assert_array_equal(filled[~holes], heights[~holes])
    assert np.isfinite(filled[holes]).all()
    assert np.abs(filled - plane)[holes].max() < 4.0  # a level step between samples is 3 and 2 metres; sags little


def test_patches_keep_between_their_rims_extremes():
    rng = np.random.default_rng(4)
    heights = rng.uniform(100, 900, (50, 50)).astype(np.float32)
    heights[10:40, 12:37] = np.nan
    filled = fill(heights, reference(np.isnan(heights)))
    rim = heights[9:41, 11:38]
    assert filled[10:40, 12:37].min() >= np.nanmin(rim) and filled[10:40, 12:37].max() <= np.nanmax(rim)


def test_a_patch_holds_its_holes_and_rims_only():
    heights = holed(3, 0.0)
    heights[20:25, 30:40] = np.nan
    heights[0:10, 0:10] = np.nan  # no hole: the terrain ends there
    made = patches((HeightWindow(0, 0, 0, heights),), heights.shape)
    assert made is not None
    expected = np.zeros(heights.shape, bool)
    expected[19:26, 29:41] = True
    np.testing.assert_array_equal(np.isfinite(made[0].heights), expected)
    rim = expected & np.isfinite(heights)
    np.testing.assert_array_equal(made[0].heights[rim], heights[rim])


def test_nothing_enclosed_is_no_patch():
    heights = holed(3, 0.0)
    assert patches((HeightWindow(0, 0, 0, heights),), heights.shape) is None
    heights[0:10, 0:10] = np.nan
    assert patches((HeightWindow(0, 0, 0, heights),), heights.shape) is None


@pytest.mark.parametrize("is_hole", [True, False])
def test_finer_windows_ask_those_around(is_hole):
    """A hole larger than the fine window is one if the coarse window says so."""
    fine = holed(0, 0.0, (129, 129))
    fine[40:90, (40 if is_hole else 0) : 90] = np.nan
    coarse = HeightWindow(1, 0, 0, fine[::2, ::2].copy())
    window = HeightWindow(0, 50, 50, fine[50:81, 50:81].copy())
    made = patches((coarse, window), fine.shape)
    if is_hole:
        assert made is not None and np.isfinite(made[1].heights).all() and np.isfinite(made[0].heights).any()
    else:
        assert made is None
