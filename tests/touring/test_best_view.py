"""Best views: walls and ridges hide, the search finds what brute force finds, files and words."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import ReadError, UsageError
from orograph.raycast.caster import Caster
from orograph.touring import Tour
from orograph.touring.best_cameras import cameras
from orograph.touring.best_search import Search
from orograph.touring.best_target import AREA, TRACK, read_target

CELL = 10.0
NORTH, EAST = 0, 90


def terrain(heights: Any, tall: float = CELL) -> Any:
    heights = np.asarray(heights, np.float32)
    transform = Affine(CELL, 0, 500000, 0, -tall, 5000000)
    return orograph.terrain(heights, transform=transform, crs="EPSG:32632", progress=False)


def place(ground: Any, col: float, row: float) -> tuple[float, float]:
    x, y = ground.grid.xy(col, row)
    return float(x), float(y)


def polygon(ground: Any, *samples: tuple[float, float], kind: str = "Polygon") -> dict[str, Any]:
    line = [place(ground, *s) for s in samples]
    coordinates = [[*line, line[0]]] if kind == "Polygon" else line
    return {"type": kind, "coordinates": coordinates, "crs": {"properties": {"name": "EPSG:32632"}}}


def hills(side: int = 97, seed: int = 3) -> Any:
    heights = orograph.synth(size=side, seed=seed).heights[:side, :side] * 0.5
    if seed == 4:  # rectangular cells, missing data, a side that is not 2^n + 1
        heights[20:26, 50:64] = heights[44, 41] = np.nan
        return terrain(heights[:91], tall=14.0)
    return terrain(heights)


def azimuth(view: Any) -> float:
    (x, y, _), (u, v, _) = view.eye, view.target
    return math.degrees(math.atan2(x - u, y - v)) % 360


# ---- what is seen ----------------------------------------------------------------------------------------------------


@pytest.mark.stress
def test_a_wall_hides() -> None:
    heights = np.zeros((81, 81))
    heights[:, 50:52] = 100  # a wall east of the target, which stands at column 40
    ground = terrain(heights)
    point = [place(ground, 40, 40)]
    options: dict[str, Any] = {"distances": [300.0], "progress": False}
    low = orograph.best_view(ground, point, 1, azimuths=[90.0, 270.0], pitches=[15.0], **options)
    assert [azimuth(one.view) for one in low] == pytest.approx([270])
    assert low[0].visible == 1 and low.cameras == 2
    # The line from the east clears the wall's western top, 100 m high and 100 m away.
    just = math.degrees(math.atan(100 / 100))
    with pytest.raises(UsageError, match="sees anything"):
        orograph.best_view(ground, point, 1, azimuths=[90.0], pitches=[just - 0.1], **options)
    assert orograph.best_view(ground, point, 1, azimuths=[90.0], pitches=[just + 0.1], **options)[0].visible == 1


def test_a_ridge_hides_one_of_its_sides() -> None:
    across = np.abs(np.arange(121) - 60)
    ground = terrain(np.broadcast_to(600 - 6.0 * across, (121, 121)))
    west = polygon(ground, (30, 50), (58, 50), (58, 70), (30, 70))
    found = orograph.best_view(ground, west, 1, pitches=[10.0, 30.0], progress=False)
    assert azimuth(found[0].view) == pytest.approx(270, abs=5.1) and found[0].visible > 0.95
    with pytest.raises(UsageError, match="sees anything"):
        orograph.best_view(ground, west, azimuths=[90.0], pitches=[20.0], progress=False)
    both = polygon(ground, (30, 50), (90, 50), (90, 70), (30, 70))
    two = orograph.best_view(ground, both, 2, pitches=[25.0], distances=[700.0], progress=False)
    assert sorted(azimuth(one.view) > 180 for one in two) == [False, True]
    assert two.together == pytest.approx(two[0].gain + two[1].gain) and two.together > 1.5 * two[0].score


def test_a_plain_seen_from_a_known_place_has_the_score_of_the_formula() -> None:
    ground = terrain(np.zeros((101, 101)))
    found = orograph.best_view(ground, [place(ground, 50, 50)], 1, azimuths=[0.0], pitches=[30.0], distances=[1000.0],
                               fov=40.0, progress=False)  # fmt: skip
    # A point has at least a radius of 20 samples: it fits from 200 m / sin 20°; from here it is so much smaller.
    assert found[0].score == pytest.approx(200 / math.sin(math.radians(20)) / (1000 / math.cos(math.radians(30))))
    area = polygon(ground, (49, 49), (51, 49), (51, 51), (49, 51))
    steep = orograph.best_view(ground, area, 1, azimuths=[0.0], pitches=[30.0, 60.0], distances=[200.0], progress=False)
    assert steep[0].view.eye[2] == pytest.approx(200 * math.tan(math.radians(60)))
    assert steep[0].score == pytest.approx(
        math.sin(math.radians(60)), rel=1e-3
    )  # (as near as fits: only foreshortened)
    track = polygon(ground, (45, 50), (55, 50), kind="LineString")
    beside = orograph.best_view(ground, track, 1, azimuths=[0.0, 90.0], pitches=[10.0], progress=False)
    assert azimuth(beside[0].view) == pytest.approx(0)  # from its end a line is short


def test_the_sun_turns_the_view() -> None:
    across = np.abs(np.arange(121) - 60)
    ground = terrain(np.broadcast_to(600 - 6.0 * across, (121, 121)))
    both = polygon(ground, (30, 50), (90, 50), (90, 70), (30, 70))
    for sun in ((90, 20), (270, 20)):
        found = orograph.best_view(ground, both, 1, pitches=[20.0], sun=sun, progress=False)
        assert azimuth(found[0].view) == pytest.approx(sun[0], abs=15)


def test_what_lies_in_the_shadow_counts_half() -> None:
    heights = np.zeros((81, 81))
    heights[:, 50:52] = 100
    ground = terrain(heights)
    for altitude, score in ((44.0, 0.5), (46.0, 1.0)):  # the wall's top stands 45 degrees high
        found = orograph.best_view(ground, [place(ground, 40, 40)], 1, azimuths=[270.0], distances=[300.0],
                                   sun=(90, altitude), progress=False)  # fmt: skip
        assert found[0].score == pytest.approx(score)


# ---- brute force -----------------------------------------------------------------------------------------------------


def brute(ground: Any, target: Any, cams: Any) -> np.ndarray[Any, Any]:
    """(m, n): q of every piece from every camera, each by a ray of its own and the view's own projection."""
    rows, cols = ground.grid.shape
    caster = Caster.of(ground.read(0, 0, rows, 0, cols))
    col, row = ground.grid.index(target.points[:, 0], target.points[:, 1])
    out = np.zeros((len(cams), len(target.points)))
    for m in range(len(cams)):
        view = cams.view(m)
        pixel, depth = view.project(target.points)
        inside = (depth > 0) & (pixel >= 0).all(1) & (pixel[:, 0] <= view.width) & (pixel[:, 1] <= view.height)
        to = np.array(view.eye) - target.points
        far = np.linalg.norm(to, axis=1)
        ec, er = ground.grid.index(view.eye[0], view.eye[1])
        start = np.column_stack([col, row, target.points[:, 2] + 1e-3])
        ray = np.column_stack([ec - col, er - row, view.eye[2] - start[:, 2]])
        t, _ = caster.cast(start, ray, 0.0, 1.0)
        half = math.tan(math.radians(view.fov_y) / 2)
        fit = cams.radius / math.sin(math.atan(half * min(1, view.width / view.height)))
        cosine = (target.axis * to).sum(1) / far
        near = np.minimum(1, fit / far)
        q = np.where(target.kind == AREA, np.maximum(cosine, 0) * near**2,
                     np.where(target.kind == TRACK, np.sqrt(1 - cosine**2) * near, near))  # fmt: skip
        out[m] = q * inside * np.isnan(t)
    return out


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_it_finds_what_brute_force_finds(seed: int) -> None:
    ground = hills(seed=seed)
    shapes = [
        polygon(ground, (35, 30), (60, 38), (52, 60), (30, 55)),
        polygon(ground, (20, 20), (70, 25), (75, 70), kind="LineString"),
        {"type": "MultiPoint", "coordinates": [place(ground, 40, 70), place(ground, 66, 44)],
         "crs": {"properties": {"name": "EPSG:32632"}}},
    ]  # fmt: skip
    given = {"type": "GeometryCollection", "geometries": shapes, "crs": shapes[0]["crs"]}
    target = read_target(ground, given, 200)
    cams = cameras(ground, target, (400, 300), azimuths=36, pitches=(4, 8, 15, 30), above=(5.0, 60.0), fovs=(30, 50))
    q = brute(ground, target, cams)
    search = Search(ground, target, cams)
    found = search.views(3, 0.0)
    best = np.zeros(len(target.points))
    for one in found:
        gain = np.maximum(q - best, 0) @ target.weight
        # (A ray that touches an edge may fall to either side.)
        assert one.gain == pytest.approx(gain.max(), rel=1e-3)
        assert one.score == pytest.approx(float(q[one.camera] @ target.weight), rel=1e-3)
        best = np.maximum(best, q[one.camera])
    assert search.looks < 0.05 * len(cams) * len(target.points)


def test_every_score_is_that_of_brute_force() -> None:
    ground = hills(seed=5)
    target = read_target(ground, polygon(ground, (35, 30), (60, 38), (52, 60), (30, 55)), 150)
    cams = cameras(ground, target, (400, 300), azimuths=12, pitches=(3, 10, 25))
    search = Search(ground, target, cams)
    for p in range(len(cams.place)):
        bound = search._bound(p, np.zeros(len(target.points)), np.ones(len(cams), bool))
        while search._done.get(p, 0) < len(target.points):
            before = bound.copy()
            search._look(p, np.zeros(len(target.points)), math.inf, bound)
            assert (bound <= before + 1e-12).all()  # bounds only come down
    ours = np.array([np.nan_to_num(search._seen(m)) @ target.weight for m in range(len(cams))])
    np.testing.assert_allclose(ours, brute(ground, target, cams) @ target.weight, atol=2e-3)


def test_any_number_of_jobs_gives_the_same() -> None:
    ground = hills()
    area = polygon(ground, (35, 30), (60, 38), (52, 60))
    one, four = (orograph.best_view(ground, area, 3, jobs=jobs, progress=False) for jobs in (1, 4))
    assert one == four


# ---- differing, options, errors --------------------------------------------------------------------------------------


def test_views_differ() -> None:
    ground = hills()
    found = orograph.best_view(ground, polygon(ground, (35, 30), (60, 38), (52, 60)), 4, apart=50, progress=False)
    ways = np.array([np.subtract(one.view.eye, one.view.target) for one in found])
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    cosines = (ways @ ways.T)[np.triu_indices(len(ways), 1)]
    assert len(found) == 4 and cosines.max() <= math.cos(math.radians(50)) + 1e-9
    gains = [one.gain for one in found]
    assert gains == sorted(gains, reverse=True)


def test_where_nothing_can_be_added_the_best_of_the_rest_follow() -> None:
    ground = terrain(np.zeros((81, 81)))
    found = orograph.best_view(ground, [place(ground, 40, 40)], 3, progress=False)
    assert [one.gain for one in found] == pytest.approx([1, 0, 0]) and found.together == 1
    assert all(one.score == 1 for one in found)


def test_more_ground_than_memory_is_taken_from_a_coarser_level(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = hills(side=521)
    area = polygon(ground, (200, 200), (300, 210), (290, 300), (210, 280))
    options: dict[str, Any] = {"azimuths": 24, "distances": [1500.0], "progress": False}
    exact = orograph.best_view(ground, area, 1, **options)
    monkeypatch.setattr("orograph.touring.best_search.EXACT_SAMPLES", 60000)
    coarse = orograph.best_view(ground, area, 1, **options)
    assert (exact.level, coarse.level) == (0, 1)
    assert coarse[0].score == pytest.approx(exact[0].score, rel=0.1)


def test_heights_above_the_ground() -> None:
    ground = hills()
    found = orograph.best_view(
        ground, [place(ground, 48, 48)], 1, heights=[2.0, 30.0], distances=[250.0], progress=False
    )
    eye = found[0].view.eye
    col, row = ground.grid.index(eye[0], eye[1])
    above = eye[2] - Caster.of(ground.read(0, 0, *ground.grid.shape[:1], 0, ground.grid.cols)).surface(col, row)
    assert min(abs(above - 2), abs(above - 30)) < 1e-3


def test_it_says_what_is_wrong(tmp_path: Path) -> None:
    ground = hills()
    here = [place(ground, 48, 48)]
    with pytest.raises(UsageError, match="No part of the target lies on"):
        orograph.best_view(ground, [(0.0, 0.0)], progress=False)
    with pytest.raises(UsageError, match="above the ground"):
        orograph.best_view(ground, here, pitches=[-60.0], distances=[300.0], progress=False)
    with pytest.raises(ReadError, match="empty"):
        orograph.best_view(ground, {"type": "FeatureCollection", "features": []}, progress=False)
    with pytest.raises(UsageError, match="empty"):
        orograph.best_view(ground, np.zeros((0, 2)), progress=False)
    with pytest.raises(ReadError, match="cannot be read"):
        orograph.best_view(ground, tmp_path / "none.geojson", progress=False)
    for wrong in ({"k": 0}, {"apart": -1}, {"fov": 0}, {"azimuths": 0}, {"distances": [-1]}, {"pitches": [90]},
                  {"target_height": -1}, {"clearance": -1}):  # fmt: skip
        with pytest.raises(UsageError):
            orograph.best_view(ground, here, progress=False, **wrong)
    with pytest.warns(UserWarning, match="50 % of the target"):
        orograph.best_view(ground, [*here, (0.0, 0.0)], 1)


def test_pairs_of_arrays_are_places() -> None:
    ground = hills()
    places = np.array([place(ground, 40, 40), place(ground, 50, 55), place(ground, 60, 40)])
    one = orograph.best_view(ground, places, 1, progress=False)
    assert one == orograph.best_view(ground, (places[:, 0], places[:, 1]), 1, progress=False)
    assert one.pieces == 3 and len(one[0].geometries) == 3


def test_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ground = hills()
    orograph.export(ground, "dem.tif", progress=False)
    Path("target.geojson").write_text(json.dumps(polygon(ground, (35, 30), (60, 38), (52, 60))))
    line = ["best-view", "dem.tif", "--target", "target.geojson", "-k", "2", "-o", "views.json", "--tour", "tour.json",
            "--size", "160x100"]  # fmt: skip
    ran = CliRunner().invoke(cli, line, catch_exceptions=False)
    assert ran.exit_code == 0 and "views-1.json  score" in ran.output
    views = json.loads(Path("views.json").read_text())
    assert len(views) == 2 and views[0]["score"] >= views[1]["gain"] and views[0]["geometries"][0] > 0.5
    for i, one in enumerate(views):
        assert orograph.View.load(f"views-{i + 1}.json") == orograph.View.from_dict(one["view"])
    tour = Tour.load("tour.json")
    assert tour.at(tour.duration / 2).target == pytest.approx(views[0]["view"]["target"])
    assert len(tour.keys) == 2 and tour.at(0.0) == orograph.View.load("views-1.json")
    with pytest.raises(UsageError, match="overwrite the target"):
        CliRunner().invoke(cli, [*line[:-2], "-o", "target.geojson"], catch_exceptions=False)
