"""A series in the window has one scale and one set of breaks, whatever time is shown."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from affine import Affine
from pyproj import CRS

pytest.importorskip("imgui_bundle")

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.scales import class_breaks
from orograph.store import terrain as in_memory
from orograph.viewer.data import ShownData


@pytest.mark.parametrize("breaks", ["quantiles", "jenks"])
@pytest.mark.parametrize("span", [None, (0.0, 30.0)])
def test_classes_keep_their_breaks_while_time_passes(breaks, span):
    grid = Grid((20, 30), Affine(100, 0, 500_000, 0, -100, 5_000_000), CRS.from_epsg(32633))
    terrain = in_memory(Dem(np.zeros(grid.shape, np.float32), grid))
    values = np.random.default_rng(5).gamma(2, 4, (4, *grid.shape)) + 5 * np.arange(4)[:, None, None]
    x, y = grid.xy(np.arange(30.0), np.zeros(30))[0], grid.xy(np.zeros(20), np.arange(20.0))[1]
    when = np.arange("2020-01-01", "2020-01-05", dtype="M8[D]").astype("M8[ns]")
    source = xr.DataArray(values.astype(np.float32), coords={"time": when, "y": y, "x": x}, dims=("time", "y", "x"),
                          attrs={"crs": grid.crs.to_wkt()})  # fmt: skip
    data = Dataset(source, name="Rain", breaks=breaks, classes=4, range=span)
    shown, scales = ShownData((data,), Priority.parse("T+D-U-"), grid), set()
    for time in (*shown.times, "2020-01-02T12:00"):
        shown.choose(time)
        (one,) = shown.current(terrain)
        scales.add((one.range, one.breaks))
    (((low, high), found),) = scales
    assert span in (None, (low, high))
    inside = values[(values >= low) & (values <= high)]
    assert found == pytest.approx((low, *class_breaks(inside, 4, breaks, low, high), high), rel=1e-4)
