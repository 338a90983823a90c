"""Views kept for a terrain."""

from __future__ import annotations

import json

import pytest
from affine import Affine

from orograph.errors import OutputError
from orograph.geo import Grid
from orograph.viewer.bookmarks import Bookmarks, config_folder
from orograph.viewpoint import View

GRID = Grid((100, 200), Affine(30, 0, 5e5, 0, -30, 5e6))
VIEW = View((5e5, 5e6, 3000.0), (5e5 + 100, 5e6, 1000.0), fov_y=33.0)


def test_views_are_kept_between_sessions(tmp_path):
    marks = Bookmarks(GRID, "N44 W072/x", tmp_path / "views")
    assert marks.slots == ()
    marks.keep("3", VIEW)
    again = Bookmarks(GRID, "N44 W072/x", tmp_path / "views")
    assert again.get("3") == VIEW
    assert again.slots == ("3",)
    assert "3" in again
    again.forget("3")
    assert Bookmarks(GRID, "N44 W072/x", tmp_path / "views").slots == ()
    assert again.path.parent == tmp_path / "views"  # no name of a terrain leads out of the folder


def test_the_file_is_views_as_render_takes_them(tmp_path):
    marks = Bookmarks(GRID, "dem", tmp_path)
    marks.keep("1", VIEW)
    assert View.from_dict(json.loads(marks.path.read_text())["1"]) == VIEW


def test_other_terrains_have_others(tmp_path):
    Bookmarks(GRID, "dem", tmp_path).keep("1", VIEW)
    assert Bookmarks(Grid((100, 201), GRID.transform), "dem", tmp_path).slots == ()


@pytest.mark.parametrize("text", ["nonsense", "[]", '{"1": {"eye": [1, 2]}}'])
def test_a_spoilt_file_is_reported_and_not_fatal(tmp_path, text):
    path = Bookmarks(GRID, "dem", tmp_path).path
    path.write_text(text)
    marks = Bookmarks(GRID, "dem", tmp_path)
    assert marks.slots == ()
    assert str(path) in marks.trouble or "target" in marks.trouble


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    marks = Bookmarks(GRID, "dem", tmp_path / "file" / "views")
    with pytest.raises(OutputError):
        marks.keep("1", VIEW)
    assert marks.get("1") == VIEW


def test_the_config_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("OROGRAPH_CONFIG", str(tmp_path))
    assert config_folder() == tmp_path
