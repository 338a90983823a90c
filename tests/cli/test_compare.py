"""``orograph compare``: the table, its JSON, the sheet, flights; and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio
import toy
from affine import Affine
from PIL import Image

from orograph.errors import ReadError, UsageError
from orograph.lod.method import Goal
from orograph.lod.registry import METHODS, method_of
from orograph.progress import SILENT
from orograph.rendering.comparison import Panel, columns, panel_view, sheet, usual_views
from orograph.store.prepare import prepare
from orograph.verbs.compare import _contenders, load_views

SMALL = ("--size", "240x160", "--quiet")
EYE = {"eye": [500_900, 3_997_500, 1400], "target": [501_000, 3_999_000, 500], "width": 240, "height": 160}


def of(*methods):
    """The options that choose methods."""
    return tuple(word for method in methods for word in ("--method", method))


@pytest.mark.stress
def test_the_table_and_its_json(run, hilly, tmp_path):
    out = tmp_path / "table.json"
    methods = ["soar", "soar,metric=isotropic", "soar,metric=isotropic-published", "top-down", "raycast"]
    code, said, err = run("compare", hilly, *of(*methods), "--json", out, *SMALL)
    assert code == 0 and err == ""
    told = json.loads(out.read_text())
    assert list(told["methods"]) == methods
    assert list(told["views"]) == ["overview", "low oblique", "straight down"] and told["tolerance"] == 1
    rays = told["methods"].pop("raycast")
    assert rays["triangles"] is rays["largest"] is rays["largest_at_samples"] is None and rays["ms"] > 0
    assert rays["kept"] and rays["judged"] == 3 and 0 <= rays["largest_in_picture"] <= 1
    shown = next(line.split() for line in said.splitlines() if line.startswith("raycast "))
    assert shown[-4:] == [f"{rays['largest_in_picture']:.3f}", f"{rays['mismatches']:,}", "0", "yes"]
    for words in ("at samples", "on surface", "in picture", "wrong"):
        assert words in said
    for label, m in told["methods"].items():
        assert m["frames"] == m["judged"] == 3 and m["triangles"] > 100 and m["ms"] > 0 and m["mtri_per_s"] > 0
        assert m["defects"] == {} and m["changes"] is None and m["tiles_read"] > 0
        assert m["conservative"] is (label != "soar,metric=isotropic-published")
        assert m["kept"] is (None if label == "soar,metric=isotropic-published" else True)
        assert m["largest_in_picture"] is m["mismatches"] is m["farthest"] is None
        assert 0.1 < m["rms"] < m["largest_at_samples"] <= m["largest"] and (m["largest"] <= 1) == (m["kept"] is True)
        line = next(line for line in said.splitlines() if line.startswith(label + " "))
        for shown in (
            f"{m['triangles']:,.0f}",
            f"{m['largest_at_samples']:.3f}",
            f"{m['rms']:.3f}",
            f"{m['largest']:.3f}",
        ):
            assert shown in line
        assert line.split()[-1] == ("yes" if m["conservative"] else "no")
    assert told["methods"]["soar"]["triangles"] < told["methods"]["soar,metric=isotropic"]["triangles"]
    assert "\x1b" not in said  # no colours on a pipe


def test_the_overview_is_the_default_camera_of_tessellate(run, hilly, tmp_path):
    size = ("--size", "160x90", "--quiet")
    code, said, err = run("compare", hilly, *of("soar"), "--json", "-", *size)
    assert code == 0, err
    code, mesh, err = run("tessellate", hilly, "-o", tmp_path / "m.npz", "--json", *size)
    assert code == 0, err
    assert json.loads(said)["views"]["overview"] == json.loads(mesh)["view"]


@pytest.fixture
def one_more(tmp_path):
    """A method is added to all."""
    with toy.added(tmp_path):
        yield


@pytest.mark.stress
def test_every_method_keeps_its_promise(run, hilly, one_more):
    code, said, _ = run("compare", hilly, "--tolerance", 2, "--json", "-", *SMALL)
    told = json.loads(said)
    assert code == 0 and list(told["methods"]) == list(METHODS)
    for name, m in told["methods"].items():
        info = method_of(name).info
        if name in ("quadtin", "hyperblock") or not info.conservative(info.options()):
            assert not m["conservative"] and m["kept"] is None  # (QuadTINs promise nothing where samples are missing.)
        else:
            assert m["conservative"] and m["kept"]
            assert all(m[what] is None or m[what] <= 2 for what in ("largest", "largest_in_picture"))
    both = told["methods"]["hybrid"]  # its patches and its rays
    assert 0 < both["largest"] <= 2 and 0 <= both["largest_in_picture"] <= 2 and both["triangles"] is None
    assert both["judged"] == 3


def test_a_budget(run, hilly):
    code, said, _ = run("compare", hilly, *of("soar", "top-down"), "--triangles", 700, "--json", "-", *SMALL)
    told = json.loads(said)
    assert code == 0 and told["triangles"] == 700 and "tolerance" not in told
    for m in told["methods"].values():
        assert 500 < m["triangles"] <= 700 and m["largest"] <= m["tolerance"]


def test_a_budget_that_is_not_enough(run, hilly):
    code, said, err = run("compare", hilly, *of("soar", "stateless"), "--triangles", 5, *SMALL[:2])
    assert code == 0 and "promised" not in err and said.count(" no") >= 2
    for name in ("soar", "stateless"):
        assert f"5 triangles are not enough for a sound mesh of this view by {name}: it has " in err


def test_no_promise_is_broken_by_a_budget_without_one(run, hilly, monkeypatch):
    monkeypatch.setattr("orograph.verify.report.Report.defects", {"holes": 3})
    arguments = ("compare", hilly, *of("soar"), *SMALL)
    code, said, err = run(*arguments, "--triangles", 5)
    assert code == 0 and "BROKEN" not in said and "soar: 9 holes" in said and err == ""
    assert run(*arguments)[0] == 1


@pytest.mark.stress
def test_all_that_can_reach_a_budget(run, hilly, one_more):
    code, said, err = run("compare", hilly, "--methods", "all", *of("soar,error=wedgie"), "--triangles", 900,
                          "--json", "-", *SMALL[:2])  # fmt: skip
    told = json.loads(said)
    able = [name for name in METHODS if "triangles" in method_of(name).info.goals]
    assert code == 0 and list(told["methods"]) == [*able, "soar,error=wedgie"]
    for name in {"raycast", toy.NAME, *METHODS} - set(able):
        assert f"{name} does not support the goal triangles and is left out" in err


def test_a_list_of_methods_is_each_of_them(run, hilly):
    code, said, _ = run("compare", hilly, "--methods", "soar,stateless", "--json", "-", "-q", *SMALL[:2])
    assert code == 0 and list(json.loads(said)["methods"]) == ["soar", "stateless"]
    assert run("compare", hilly, "--methods", "soar,no-such", *SMALL[:2])[0] == 2


def test_a_flight(run, hilly, tmp_path):
    path = tmp_path / "flight.json"
    slow = {"time": 0.5, **EYE, "eye": [500_930, 3_997_560, 1390]}
    path.write_text(json.dumps({"fps": 20, "keys": [{"time": 0, **EYE}, slow]}))
    code, said, _ = run("compare", hilly, "--flight", path, *of("soar"), "--judged", 3, "--json", "-", "-q")
    m = json.loads(said)["methods"]["soar"]
    assert code == 0 and m["frames"] == 10 and m["judged"] == 3 and 0 < m["changes"] < 0.2
    path.write_text(json.dumps({"fps": 20, "seconds": 0.3, "keys": [{"time": 0, **EYE}]}))
    code, said, _ = run("compare", hilly, "--flight", path, *of("soar"), "-q")
    assert code == 0 and "change/frame" in said and "0.00 %" in said and "errors over 6 of 6 frames" in said


@pytest.mark.stress
def test_the_sheet(run, hilly, tmp_path):
    out = tmp_path / "sheet.png"
    code, _, _ = run("compare", hilly, *of("soar", "top-down", "soar,metric=isotropic"), "--picture", out, *SMALL)
    assert code == 0
    with Image.open(out) as image:
        assert image.width == 1600 and 400 < image.height < 800
        pixels = np.asarray(image.convert("L"))
    panels = [pixels[:, k * 520 : k * 520 + 520] for k in range(3)]
    for panel in panels:
        assert (panel < 120).mean() > 0.01  # lines
        assert (panel[60:150] < 120).any()  # words
    assert not np.array_equal(panels[0][150:], panels[2][150:])


def test_a_method_that_cannot_be_measured_leaves_the_others(run, hilly, tmp_path, monkeypatch):
    def no_room(self):
        raise UsageError("It takes 9 GiB.", remedy="Allow more memory.")

    monkeypatch.setattr("orograph.lod.quadtin.QuadTin._check_room", no_room)
    out = tmp_path / "sheet.png"
    code, said, err = run("compare", hilly, *of("quadtin", "soar"), "--json", "-", "--picture", out, *SMALL[:2])
    told = json.loads(said)
    assert code == 0 and list(told["methods"]) == ["soar"] and out.is_file()
    assert told["left_out"] == {"quadtin": "It takes 9 GiB. Allow more memory."}
    assert "quadtin is left out: It takes 9 GiB." in err
    for methods in (of("quadtin"), of("quadtin", "hyperblock")):
        code, said, err = run("compare", hilly, *methods, *SMALL)
        assert code == 2 and "It takes 9 GiB" in err and said == ""


@pytest.mark.stress
def test_the_sheet_has_room_for_all(hilly):
    terrain = prepare([str(hilly)])
    view = usual_views(terrain)["overview"]
    for count, across in ((1, 1), (2, 2), (3, 3), (4, 2), (5, 2), (6, 2), (7, 3)):
        assert columns(count) == across
        small = panel_view(view, count)
        assert across * small.width <= (1000 if count == 1 else 1600) - 60 < across * small.width + across * 26
        assert small.height / small.width == pytest.approx(720 / 1280, rel=0.01)
    one = sheet(terrain, panel_view(view, 5), [Panel("a", None, ("b",))] * 5, title="T", note="N" * 500)
    assert one.shape[1] == 1600 and one.dtype == np.uint8  # and a sixth, of the terrain itself


def test_the_sheet_shows_the_image_whose_colors_count(hilly):
    terrain = prepare([str(hilly)])
    panels = [Panel("a", None, ("b",))]
    view = panel_view(usual_views(terrain)["overview"], 1)
    plain = sheet(terrain, view, panels, title="", note="").astype(int)
    red = sheet(terrain, view, panels, title="", note="", drape=np.full((4, 4, 3), (255, 0, 0), np.uint8)).astype(int)
    changed = (plain != red).any(axis=2)
    assert changed.mean() > 0.1 and (red[changed][:, 0] > red[changed][:, 1:].max(axis=1) + 20).mean() > 0.95


def test_usual_views_see_the_ground(hilly):
    terrain = prepare([str(hilly)])
    for exaggeration in (1.0, 4.0):
        for name, view in usual_views(terrain, (160, 90), exaggeration).items():
            rows, cols = np.mgrid[:90, :70].reshape(2, -1)
            x, y = terrain.grid.xy(cols, rows)
            heights = terrain.read(0, 0, 90, 0, 70).ravel()
            pixels, depth = view.project(np.stack([x, y, heights], -1), exaggeration)
            seen = (pixels > 0).all(1) & (pixels < [160, 90]).all(1) & (depth > 0)
            assert seen.mean() > 0.1, name
            col, row = (float(v) for v in terrain.grid.index(*view.eye[:2]))
            if 0 <= col < 70 and 0 <= row < 90:
                assert view.eye[2] > np.nanmax(heights) or view.eye[2] > heights.reshape(90, 70)[int(row), int(col)]


def test_views_from_a_file(run, hilly, tmp_path):
    path = tmp_path / "views.json"
    path.write_text(json.dumps([{"name": "near", **EYE}, EYE]))
    assert list(load_views(str(path))) == ["near", "2"]
    code, said, _ = run("compare", hilly, "--views", path, *of("soar"), "-q")
    assert code == 0 and "near, 2" in said
    path.write_text(json.dumps([EYE, {"eye": [1, 2, 3]}]))
    with pytest.raises(UsageError, match=r"View 2: .*target"):
        load_views(str(path))
    path.write_text(json.dumps([{"name": "a", **EYE}, {"name": "a", **EYE}]))
    with pytest.raises(UsageError, match="Two views"):
        load_views(str(path))
    for text, words in (("{}", "list"), ("[]", "at least one"), ("[", "not JSON")):
        path.write_text(text)
        with pytest.raises(ReadError, match=words):
            load_views(str(path))


def test_a_broken_promise_is_said_loudly(run, hilly, monkeypatch):
    monkeypatch.setattr("orograph.lod.method.Method.conservative", True)
    code, said, err = run("compare", hilly, *of("soar,metric=isotropic-published"), *SMALL)
    assert code == 1 and "BROKEN" in said and "soar,metric=isotropic-published" in err


def test_conservative_leaves_out_what_promises_nothing():
    given = [str(choice) for choice in _contenders(["all"], True, Goal(1.0), SILENT)]
    assert "clipmap,rings=promise" in given and "soar" in given and "cdlod" not in given


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (of("sore"), 2, ("sore", "soar")),
        (of("soar,metric=euclid"), 2, ("euclid",)),
        ((*of("soar", "threshold-spheres,metric=wedgie"), "--views", "none.json"), 2, ("not 'wedgie'",)),
        ((*of("raycast"), "--triangles", 9), 2, ("does not support the goal triangles", "tolerance")),
        ((*of("soar,error=midpoint"), "--conservative"), 2, ("not promised", "orograph methods soar")),
        (("--views", "a.json", "--flight", "b.json"), 2, ("not both",)),
        (("--judged", 3), 2, ("--flight",)),
        (("--flight", "none.json"), 3, ("none.json",)),
        (("--tolerance", 1, "--triangles", 9), 2, ("one goal",)),
        (("--picture", "a.xyz"), 2, (".png",)),
        ((*of("raycast"), "--picture", "a.png"), 2, ("rays make none",)),
        (("--json", "no/a.json"), 4, ("folder",)),
        (("--json", "a.png", "--picture", "a.png"), 2, ("same file",)),
    ],
)
def test_what_is_refused(run, hilly, tmp_path, monkeypatch, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    got, said, err = run("compare", hilly, *arguments, "--quiet")
    assert got == code and said == "" and "Traceback" not in err
    for word in words:
        assert word in err
    assert not list(tmp_path.iterdir())


def test_a_raster_without_a_surface(run, tmp_path):
    """One sample: no view of it, and said so before one is looked for."""
    with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", height=1, width=1, count=1, dtype="float32",
                       crs="EPSG:32611", transform=Affine(30, 0, 500_000, 0, -30, 4_000_000)) as file:  # fmt: skip
        file.write(np.full((1, 1, 1), 5.0, np.float32))
    got, said, err = run("compare", tmp_path / "one.tif", "--quiet")
    assert got == 3 and said == "" and "at least two of each" in err
