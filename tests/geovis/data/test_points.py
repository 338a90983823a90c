"""Points with values: those that lie nowhere."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.points import read_points
from orograph.scene.theming import themed


def test_a_point_beyond_the_poles_is_left_out_without_a_warning(tmp_path: Path) -> None:
    place = from_origin(500_000, 5_600_000, 100, 100)
    terrain = orograph.terrain(np.zeros((40, 50), np.float32), transform=place, crs="EPSG:32630")
    file = tmp_path / "p.csv"
    file.write_text("lon,lat,value\n-2.98,50.54,1\n-2.98,-118.2,2\n-2.97,50.53,3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_points(Dataset(str(file)), terrain.grid)
    assert found.values.tolist() == [1, 3]


def test_points_without_attributes_have_one_colour_and_a_name() -> None:
    ground = orograph.terrain(np.zeros((40, 50), np.float32), spacing=10.0)
    x, y = ground.grid.xy(np.array([5.0, 20.0]), np.array([8.0, 12.0]))
    made = orograph.Dataset({"x": x, "y": y}, name="Huts", colormap={"Huts": "#d55e00"})
    things = themed({"data": made}, ground, (200, 150)).things
    assert things is not None and len(things) == 2
    assert [name for name, _ in things.legend.classes] == ["Huts"] and not things.legend.scales
    np.testing.assert_allclose(things.rgb, things.rgb[:1].repeat(2, 0))
    assert things.rgb[0, 0] > things.rgb[0, 2]


def test_names_have_colours_but_no_sizes() -> None:
    ground = orograph.terrain(np.zeros((30, 40), np.float32), spacing=10.0)
    x, y = ground.grid.xy(np.array([5.0, 20.0, 30.0]), np.array([8.0, 12.0, 20.0]))
    table = {"x": x, "y": y, "kind": ["auto", "manual", "auto"]}

    def placed(**how: Any) -> Any:
        things = themed({"data": Dataset(how.pop("source", table), **how)}, ground, (200, 150)).things
        assert things is not None
        return things

    things = placed(variable="kind", style="spheres")
    assert len(set(things.radius)) == 1 and things.legend.entries[0] == ("kind", None)
    rain = placed(source={**table, "rain": [380.0, 450.0, 560.0]}, variable="rain", style="bars")
    assert "sizes begin at 38" in rain.legend.note and rain.height.max() > 10 * rain.height.min()
    with pytest.raises(UsageError, match="None of the classes"):
        placed(variable="kind", colormap={"automatic": "red"})


@pytest.mark.parametrize("style", ["spheres", "bars", "tubes"])
def test_without_priority_what_stands_has_the_colours_of_classes(style: str) -> None:
    ground = orograph.terrain(np.zeros((40, 90), np.float32), spacing=10.0)
    x, y = ground.grid.xy(np.linspace(3, 80, 30), np.full(30, 20.0))
    values = [float(v) for v in np.linspace(0, 60, 30) ** 2]
    shape: Any = {"x": x, "y": y, "v": values}
    if style == "tubes":
        ends = [[[float(a), float(b)], [float(a), float(b) + 50]] for a, b in zip(x, y)]
        lines = ({"type": "LineString", "coordinates": line} for line in ends)
        features = [{"type": "Feature", "geometry": g, "properties": {"v": v}} for g, v in zip(lines, values)]
        shape = {"type": "FeatureCollection", "features": features}
    data = Dataset(shape, variable="v", style=style, classes=3)

    def colors(**how: Any) -> tuple[int, int]:
        things = themed({"data": data, **how}, ground, (200, 150)).things
        assert things is not None
        return len(np.unique(things.rgb, axis=0)), len(np.unique(things.legend.scales[0].colors, axis=0))

    assert colors(priority="T+D-U-") == (3, 3)
    assert min(colors()) > 20 < min(colors(priority="T+D+U-"))


PLACE = from_origin(500_000, 5_600_000, 100, 100)


def refusal(table: str, path: Path, **how: Any) -> str:
    terrain = orograph.terrain(np.zeros((40, 50), np.float32), transform=PLACE, crs="EPSG:32630")
    path.write_text(table)
    with pytest.raises(ReadError) as raised:
        read_points(Dataset(str(path), **how), terrain.grid)
    return str(raised.value)


def test_it_says_why_no_point_is_left(tmp_path: Path) -> None:
    away = refusal("lon,lat,v\n9,40,1\n10,41,2\n", tmp_path / "away.csv")
    assert "they lie within 9 to 10, 40 to 41 in WGS 84" in away and "500000 to 505000" in away
    swapped = refusal("lon,lat,v\n50.54,-2.98,1\n50.53,-2.97,2\n", tmp_path / "swapped.csv")
    assert "seem to be exchanged" in swapped and "exchanged" not in away
    bare = refusal("lon,lat,v,w\n-2.98,50.54,,1\n", tmp_path / "bare.csv", variable="v")
    assert "has a place and a number as v" in bare


def test_a_point_whose_uncertainty_is_unknown_is_not_drawn_as_certain() -> None:
    ground = orograph.terrain(np.zeros((40, 50), np.float32), spacing=10.0)
    x, y = ground.grid.xy(np.array([5.0, 20.0, 30.0]), np.array([8.0, 12.0, 20.0]))
    table = {"x": x, "y": y, "v": [2.0, 2.0, 2.0], "sd": [0.0, np.nan, 1.0]}
    made = Dataset(table, variable="v", uncertainty="sd", range=(0, 4))
    things = themed({"data": made.but(style="spheres")}, ground, (200, 150)).things
    assert things is not None and things.sigma is not None
    unknown = np.isnan(things.sigma)
    least, most = (things.rgb[things.sigma == sigma] for sigma in (0, 1))
    assert unknown.sum() == 1
    np.testing.assert_array_equal(things.rgb[unknown], most)
    assert (things.rgb[unknown] > least).any()
    bars = themed({"data": made.but(style="bars"), "priority": "U+"}, ground, (200, 150)).things
    assert bars is not None and len(bars) == 3 + 2 * 3 and np.isfinite(bars.height).all()


def test_a_decimal_comma_is_read_where_it_is_quoted_and_texts_keep_theirs(tmp_path: Path) -> None:
    terrain = orograph.terrain(np.zeros((40, 50), np.float32), transform=PLACE, crs="EPSG:32630")
    file = tmp_path / "p.csv"
    file.write_text('lon,lat,v,place\n"-2,98","50,54","1,5","Bay, north"\n"-2,97","50,53","2,25","Bay, south"\n')
    found = read_points(Dataset(str(file), variable="v"), terrain.grid)
    assert found.values.tolist() == [1.5, 2.25]
    file.write_text("lon;lat;place\n-2,98;50,54;Bay, north\n-2,97;50,53;Bay, south\n")
    assert read_points(Dataset(str(file), variable="place"), terrain.grid).classes == ("Bay, north", "Bay, south")
