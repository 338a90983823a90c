"""Points of the compass, wherever a side is asked for."""

from __future__ import annotations

import pytest

import orograph
from orograph.errors import UsageError
from orograph.scene.bearings import bearing


@pytest.mark.parametrize(
    ("given", "degrees"),
    [("N", 0), ("e", 90), ("SSW", 202.5), ("north-west", 315), ("South East", 135), ("12.5", 12.5), (7, 7), (-90, -90)],
)
def test_points_of_the_compass(given, degrees):
    assert bearing(given) == degrees


@pytest.mark.parametrize("given", ["NNN", "", "up"])
def test_what_is_no_direction(given):
    with pytest.raises(UsageError, match="is not a direction"):
        bearing(given)


@pytest.mark.stress
def test_cameras_and_tours_take_them(run, hilly, tmp_path):
    terrain = orograph.terrain(hilly)
    camera = orograph.camera
    for make in (camera.whole, camera.around, camera.plan):
        assert make(terrain, azimuth="NE") == make(terrain, azimuth=45.0) != make(terrain)
    assert orograph.tour(terrain, still=True, azimuth="NE") == orograph.tour(terrain, still=True, azimuth=45.0)
    for name, side in (("a", "NE"), ("b", "45")):
        where = ("--from", side, "--size", "90x60", "--quiet")
        code, _, err = run("render", hilly, *where, "-o", tmp_path / f"{name}.npy.png", "--save-view", tmp_path / name)
        assert code == 0, err
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text()
    assert run("render", hilly, "--from", "upwards", "-o", tmp_path / "c.png")[0] == 2
