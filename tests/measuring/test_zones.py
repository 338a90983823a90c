"""Zonal statistics against plain masks and NumPy, planes whose true slope is known, and files of all kinds."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from closed_forms import RECTANGULAR, ROTATED, SQUARE, rough, terrain_of
from pyproj import Transformer

from orograph import measure
from orograph.cli import cli
from orograph.errors import ReadError, UsageError
from orograph.lighting.normal import gradient
from orograph.measuring import zones
from orograph.progress import Progress

RING = np.array([(3.2, 4.1), (30.7, 6.3), (26.2, 33.4), (11.9, 21.0)])
HOLE = np.array([(14.3, 10.2), (20.1, 11.3), (17.7, 16.9)])


def inside(ring, shape):
    """Samples in a ring, edge by edge (even–odd)."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    found = np.zeros(shape, bool)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0)):
        crosses = (y0 <= y) != (y1 <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            found ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return found


def on_grid(terrain, ring):
    return np.stack(terrain.grid.xy(*ring.T), -1)


def feature(terrain, rings, **properties):
    places = measure.Places(terrain)
    shape = [[*(at := places.lonlat(on_grid(terrain, ring)).tolist()), at[0]] for ring in rings]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": shape}}


def collection(*features):
    return {"type": "FeatureCollection", "features": list(features)}


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("tile", [8, 256])
def test_statistics_are_those_of_a_plain_mask(transform, holes, tile, monkeypatch):
    monkeypatch.setattr(zones, "TILE", tile)
    terrain = terrain_of(rough((40, 50), holes=holes), transform)
    (found,) = measure.areas(terrain, [on_grid(terrain, one) for one in (RING, HOLE)], steeper_than=20)
    heights = terrain.read(0, 0, 40, 0, 50).astype(np.float64)
    mask = inside(RING, heights.shape) & ~inside(HOLE, heights.shape)
    z = heights[mask & ~np.isnan(heights)]
    east, north = gradient(heights, terrain.grid.linear)
    slope = np.degrees(np.arctan(np.hypot(east.astype(float), north)))[mask & ~np.isnan(heights)]
    assert (found.samples, found.known) == (mask.sum(), len(z))
    assert (found.lowest, found.highest) == (z.min(), z.max())
    assert (found.mean, found.std) == pytest.approx((z.mean(), z.std()), rel=1e-12)
    assert found.slope_mean == pytest.approx(slope.mean(), rel=1e-6)
    assert (found.slope_median, found.slope_90) == pytest.approx(np.quantile(slope, [0.5, 0.9]), rel=1e-6)
    assert found.steeper == (slope > 20).mean()


def test_slopes_are_true_where_the_projection_stretches():
    """Web Mercator at 60° north shows ground twice as long as it is, so true slopes are steeper than on its grid."""
    to = Transformer.from_crs(4326, 3857, always_xy=True)
    x, y = to.transform(10.0, 60.0)
    rise = np.broadcast_to(15.0 * np.arange(50), (40, 50)).astype(np.float32)  # half a metre for each of the grid
    terrain = terrain_of(rise, Affine(30, 0, x, 0, -30, y), "EPSG:3857")
    (found,) = measure.areas(terrain, on_grid(terrain, RING))
    sine = math.sin(math.radians(to.transform(*on_grid(terrain, RING).mean(0), direction="INVERSE")[1]))
    scale = math.sqrt((1 - 0.00669437999014 * sine**2) / (1 - sine**2))  # a / (N cos φ): along a parallel of WGS 84
    assert scale == pytest.approx(2, abs=0.02)
    assert found.slope_median == pytest.approx(math.degrees(math.atan(0.5 * scale)), abs=0.02)
    assert found.slope_90 == pytest.approx(found.slope_median, abs=0.02) and found.steeper == 1.0


def test_a_row_for_each_polygon_in_all_files(tmp_path):
    terrain = terrain_of(rough((40, 50)), SQUARE, "EPSG:32611")
    far = feature(terrain, [RING + 1000], name="far")
    both = {
        "type": "Feature",
        "id": 7,
        "properties": None,
        "geometry": {
            "type": "MultiPolygon",
            "coordinates": [
                feature(terrain, [RING[[0, 1, 3]]])["geometry"]["coordinates"],
                feature(terrain, [RING[[1, 2, 3]]])["geometry"]["coordinates"],
            ],
        },
    }
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [0, 0]}}
    warned: list[str] = []

    class Heard(Progress):
        def warn(self, text):
            warned.append(text)

    given = collection(feature(terrain, [RING], Name="mine", use="wood"), point, both, far)
    found = measure.areas(terrain, given, level=500, progress=Heard())
    assert [one.name for one in found] == ["mine", "7", "far"] and "far" in warned[0]
    assert found[2].area is None and "lies" in found[2].problem and found[2].mean is None
    for name in ("surface", "plan", "mean_height", "above", "below"):  # (the parts make up the whole)
        assert getattr(found[1].area, name) == pytest.approx(getattr(found[0].area, name), rel=1e-7)
    assert found[1].samples == pytest.approx(found[0].samples, abs=2)
    paths = [found.save(tmp_path / f"zones{ending}") for ending in (".csv", ".json", ".geojson")]
    with paths[0].open() as file:
        rows = list(csv.DictReader(file))
    assert (
        rows[0]["use"] == "wood"
        and float(rows[0]["slope_90_deg"]) == found[0].slope_90
        and rows[2]["mean_height_m"] == ""
    )
    assert json.loads(paths[1].read_text())[0]["steeper_share"] == found[0].steeper
    shapes = json.loads(paths[2].read_text())["features"]
    assert shapes[0]["geometry"] == given["features"][0]["geometry"] and shapes[1]["properties"]["name"] == "7"
    assert list(found.to_dataframe()["name"]) == ["mine", "7", "far"]


@pytest.mark.parametrize(("given", "how", "words"), [
    (collection(), {}, "no polygon"), ({"type": "Polygon", "coordinates": 3}, {}, "no list of coordinates"),
    (None, {"steeper_than": 95}, "from 0 to 90"),
])  # fmt: skip
def test_mistakes(given, how, words):
    terrain = terrain_of(rough((20, 20)), SQUARE, "EPSG:32611")
    with pytest.raises((UsageError, ReadError), match=words):
        measure.areas(terrain, given or collection(), **how)
    with pytest.raises(UsageError, match="lies"):
        measure.areas(terrain, collection(feature(terrain, [RING + 1000])))
    with pytest.raises(UsageError, match=r"\.csv, \.geojson or \.json"):
        measure.areas(terrain, on_grid(terrain, RING / 3)).save("zones.xls")


def test_the_command_line_measures_each(tmp_path):
    import orograph

    terrain = terrain_of(rough((40, 50)), SQUARE, "EPSG:32611")
    dem = orograph.export(terrain, tmp_path / "dem.tif")
    path = tmp_path / "zones.geojson"
    path.write_text(json.dumps(collection(feature(terrain, [RING], name="A"), feature(terrain, [HOLE], name="B"))))
    out = tmp_path / "out.csv"
    done = CliRunner().invoke(cli, ["measure", "area", str(dem), "--geojson", str(path), "-o", str(out), "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)["areas"]
    assert [row["name"] for row in told] == ["A", "B"] and len(out.read_text().splitlines()) == 3
    plain = CliRunner().invoke(cli, ["measure", "area", str(dem), "--geojson", str(path), "--steeper-than", "12"])
    assert "above 12°" in plain.output and "90th percentile" in plain.output
