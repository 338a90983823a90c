"""Files of points that say what cannot be, or what is not meant, are refused or warned of; none gives other heights."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from orograph.dem.scattered import read_scattered
from orograph.errors import OrographError

PLACES = [(500000.5, 4000000.25, 1012.5), (500100.5, 4000000.25, 1020.5), (500000.5, 4000100.25, 1031.5)]


def written(path: Path, names: str, rows: list[str]) -> Path:
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


def commas(row: tuple[float, ...], mark: str) -> str:
    return mark.join(str(v).replace(".", ",") for v in row)


@pytest.mark.parametrize(
    ("names", "rows", "says"),
    [
        ("x,y,z", [commas(p, ",") for p in PLACES], "Line 2 has 6 fields.*semicolons"),
        ("x;y;z", [f"{x};{y};1,{int(z) % 1000:03}" for x, y, z in PLACES], "thousands separators"),
        ("x,y,z", [f"{x},{y},{z},7" for x, y, z in PLACES], "Line 2 has 4 fields"),
        ("x,y,z,z", [f"{x},{y},{z},7" for x, y, z in PLACES], "named 'z'"),
        ("x,y,elevation,z", [f"{x},{y},{z},7" for x, y, z in PLACES], "z, elevation.*height_column"),
        ("x,longitude,y,z", [f"{x},7,{y},{z}" for x, y, z in PLACES], "x and longitude"),
        ("x,latitude,z", [f"{x},{y},{z}" for x, y, z in PLACES], "do not say where"),
        ("x,y,z", [f"{x},{y},1_000" for x, y, z in PLACES], "no column with numbers"),
        ("x,y,z", ['"500000,4000000,3', "500100,4000000,4", '500100,4000100,5",1,2'], "quotation mark"),
        ("x,y,z", ['500000,4000000,3', '"500100,4000000,4', "500100,4000100,5"], "cannot be read"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(tmp_path: Path, names: str, rows: list[str], says: str) -> None:
    with pytest.raises(OrographError, match=says):
        read_scattered(written(tmp_path / "p.csv", names, rows))


@pytest.mark.parametrize(
    ("names", "z", "options", "sign", "says"),
    [
        ("x,y,depth", 1.0, {}, -1, "depths"),
        ("x,y,depth_m", 1.0, {"height_column": "depth_m"}, -1, "depths"),
        ("x,y,depth_m", 1.0, {"vertical_unit": "m"}, 1, "CRS"),
        ("x,y,z", 1.0, {"assume_crs": "EPSG:32611+5715"}, -1, "depths"),
        ("x,y,z_ft", 1.0, {}, 1, "metres"),
        ("x,y,z", 1.0, {}, 1, "no CRS"),
        ("x,y,z", 1.0, {"assume_crs": "EPSG:32611+5703", "assume_vertical": "EGM96"}, 1, "assume_vertical"),
    ],
)
def test_what_is_warned_of(
    tmp_path: Path, names: str, z: float, options: dict[str, str], sign: int, says: str
) -> None:  # fmt: skip
    points = read_scattered(written(tmp_path / "p.csv", names, [f"{x},{y},{h}" for x, y, h in PLACES]), **options)
    assert points.z.tolist() == [sign * h for *_, h in PLACES]
    assert any(says in text for text in points.warnings), points.warnings


def test_heights_that_are_none(tmp_path: Path) -> None:
    rows = [f"{x},{y},{z}" for x, y, z in PLACES] + ["500050,4000050,-9999", "500060,4000050,-3.4e38"]
    points = read_scattered(written(tmp_path / "p.csv", "x,y,z", rows))
    assert len(points) == 4
    assert any("1 are -9999" in text for text in points.warnings)
    assert any("1 lack a position or a height" in text for text in points.warnings)


def test_degrees_stay_degrees_whatever_is_assumed(tmp_path: Path) -> None:
    path = written(tmp_path / "p.csv", "longitude,latitude,z", ["7,46,1", "7.1,46,2", "7,46.1,3"])
    points = read_scattered(path, assume_crs="EPSG:32632")
    assert points.crs is not None and points.crs.is_geographic
    assert any("assume_crs" in text for text in points.warnings)


@pytest.mark.parametrize(
    ("at", "kind", "value", "says"),
    [
        (247, "<Q", 40, "behind its 40 points"),
        (247, "<Q", 90, "declares 90 points"),
        (147, "<d", 1.0, "header has z between"),
        (147, "<d", -0.01, "header has z between"),
        (155, "<d", 0.0, "header has x between"),
    ],
)
def test_a_header_of_las_that_contradicts_its_points(
    tmp_path: Path, at: int, kind: str, value: float, says: str
) -> None:  # fmt: skip
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.01] * 3, [500000, 4000000, 0]
    cloud, rng = laspy.LasData(header), np.random.default_rng(5)
    cloud.x, cloud.y, cloud.z = 500000 + rng.uniform(0, 99, 60), 4000000 + rng.uniform(0, 99, 60), rng.uniform(1, 9, 60)
    path = tmp_path / "p.las"
    cloud.write(path)
    assert len(read_scattered(path)) == 60
    altered = bytearray(path.read_bytes())
    struct.pack_into(kind, altered, at, value)
    path.write_bytes(altered)
    with pytest.raises(OrographError, match=says):
        read_scattered(path)
