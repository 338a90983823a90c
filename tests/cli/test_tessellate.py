"""``orograph tessellate``: what is in the files, what is said, what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio

from orograph import store
from orograph.tessellation import Tessellation


def heights_of(path):
    with rasterio.open(path) as file:
        z = file.read(1)
        return np.where(z == file.nodata, np.nan, z)


def test_an_npz_holds_samples_and_triangles(run, hilly, tmp_path):
    out, truth = tmp_path / "mesh.npz", heights_of(hilly)
    code, said, err = run("tessellate", hilly, "-o", out, "--tolerance", 3, "--quiet")
    assert code == 0 and err == "" and len(said.splitlines()) == 1
    with np.load(out) as file:
        vertices, triangles, strip = file["vertices"], file["triangles"], file["strip"]
        stats = json.loads(str(file["stats"]))
    assert vertices.dtype == np.float64 and triangles.dtype == np.int32
    col, row = vertices[:, :2].astype(int).T
    np.testing.assert_array_equal(vertices[:, :2], np.stack([col, row], 1))
    np.testing.assert_array_equal(vertices[:, 2], truth[row, col])
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    # East is right and north, against the rows, up: counter-clockwise is negative in (col, row).
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    assert (area < 0).all()
    assert 0.97 * 89 * 69 < -area.sum() / 2 < 89 * 69  # all of it but the hole
    assert len(triangles) == stats["triangles"] and f"{len(triangles):,} triangles" in said and str(out) in said
    assert stats["method"] == "soar" and stats["tolerance"] == 3 and stats["conservative"] is True
    of_strip = {frozenset(t) for t in zip(strip, strip[1:], strip[2:]) if len(set(t)) == 3}
    assert of_strip == {frozenset(t) for t in triangles.tolist()}
    assert not list(tmp_path.glob(".*"))


def test_conservative_sets_the_options_that_promise(run, hilly, tmp_path):
    out = tmp_path / "m.npz"
    given = "tessellate", hilly, "-o", out, "--conservative", "--quiet", "--method"
    assert run(*given, "clipmap,n=63")[0] == 0
    with np.load(out) as file:
        assert json.loads(str(file["stats"]))["conservative"] is True
    code, _, err = run(*given, "clipmap,rings=printed")
    assert code == 2 and "not promised" in err


@pytest.mark.parametrize("method", ["quadtin", "hyperblock"])
@pytest.mark.parametrize("verb", ["tessellate", "render", "movie", "compare"])
def test_conservative_refuses_a_method_that_promises_nothing_where_samples_are_missing(
    run, hilly, tmp_path, verb, method
):
    out = (
        () if verb == "compare" else ("-o", tmp_path / {"tessellate": "m.npz", "movie": "%02d.png"}.get(verb, "m.png"))
    )
    code, _, err = run(verb, hilly, *out, "--conservative", "--method", method, "--quiet")
    assert code == 2 and "cannot be promised" in err and "samples are missing" in err
    assert not list(tmp_path.iterdir())


def test_conservative_refuses_a_view_whose_bound_is_more_than_the_tolerance(run, hilly, tmp_path):
    out = tmp_path / "m.npz"
    whole = hilly, "--bbox", "-117,35.9,-116.992,36.2"  # the west, where nothing is missing
    given = "tessellate", *whole, "-o", out, "--method", "quadtin", "--quiet"
    assert run(*given, "--conservative")[0] == 0
    out.unlink()
    code, _, err = run(*given, "--tolerance", 0.01, "--conservative")
    assert code == 2 and "a bound of" in err and "0.01" in err and not out.exists()
    assert run(*given, "--tolerance", 0.01)[0] == 0


@pytest.mark.parametrize("ending", ["ply", "obj", "glb"])
def test_other_programs_read_it(run, hilly, tmp_path, ending):
    trimesh = pytest.importorskip("trimesh")
    out = tmp_path / f"mesh.{ending}"
    code, said, _ = run("tessellate", hilly, "-o", out, "--triangles", 900, "--json", "--quiet")
    told = json.loads(said)
    assert code == 0 and 700 < told["triangles"] <= 900 and told["mesh"] == str(out) and told["crs"] == "EPSG:32611"
    mesh = trimesh.load(out, process=False, force="mesh")
    assert len(mesh.faces) == told["triangles"] and len(mesh.vertices) == told["vertices"]
    assert sorted(np.ptp(mesh.vertices, axis=0))[1:] == pytest.approx([69 * 30, 89 * 30], abs=0.1)


def test_the_referee_is_asked(run, hilly, tmp_path):
    code, said, _ = run("tessellate", hilly, "-o", tmp_path / "a.npz", "--check", "--tolerance", 2, "--quiet")
    assert code == 0 and "no defects" in said and "beside missing ground" in said
    code, said, _ = run("tessellate", hilly, "-o", tmp_path / "b.npz", "--check", "--tolerance", 2, "--json", "--quiet")
    report = json.loads(said)["report"]
    assert code == 0 and 0.5 < report["largest"] <= 2 and report["samples"] == 90 * 70 - 2


def test_the_referee_does_not_mind_morphs(run, hilly, tmp_path):
    arguments = (
        "-o",
        tmp_path / "a.npz",
        "--check",
        "--tolerance",
        2,
        "--method",
        "soar,geomorph=yes",
        "--json",
        "--quiet",
    )
    code, said, err = run("tessellate", hilly, *arguments)
    report = json.loads(said)["report"]
    assert code == 0 and not err and report["largest"] <= 2 and report["wrong_heights"] == 0
    # It is morphs that are measured: some vertex is on its way.
    mesh = Tessellation.load(tmp_path / "a.npz")
    still = run("tessellate", hilly, "-o", tmp_path / "b.npz", "--tolerance", 1, "--quiet")
    heights = {(c, r): z for c, r, z in Tessellation.load(tmp_path / "b.npz").vertices.tolist()}
    assert still[0] == 0 and any(heights.get((c, r), z) != z for c, r, z in mesh.vertices.tolist())


def test_a_broken_promise_is_a_fault(run, hilly, tmp_path, monkeypatch):
    """Half-way errors bound nothing; a method that swore by them is found out, and the exit code says so."""
    arguments = ("tessellate", hilly, "-o", tmp_path / "a.npz", "--check", "--method",
                 "soar,error=midpoint,metric=isotropic-published", "--tolerance", 1.5, "--from", 200, "--pitch", 10,
                 "--distance", 1800, "--fov", 70, "--quiet")  # fmt: skip
    code, said, _ = run(*arguments)
    assert code == 0 and "error:" in said
    monkeypatch.setattr("orograph.lod.method.Method.conservative", True)
    code, said, err = run(*arguments)
    assert code == 1 and "promised 1.5" in err and "error:" in said and (tmp_path / "a.npz").exists()


def test_a_budget_that_is_not_enough(run, hilly, tmp_path, monkeypatch):
    for method in ("soar", "top-down"):
        arguments = ("tessellate", hilly, "-o", tmp_path / "a.npz", "--triangles", 5, "--method", method, "--check")
        code, said, err = run(*arguments)
        made = Tessellation.load(tmp_path / "a.npz").stats
        assert code == 0 and "no defects" in said and made["within_budget"] is False and made["triangles"] > 5
        words = f"5 triangles are not enough for a sound mesh of this view by {method}: it has {made['triangles']:,}."
        assert words in err and err.count("warning") == 1
    monkeypatch.setattr("orograph.verify.report.Report.defects", {"holes": 3})
    code, _, err = run(*arguments, "--json")
    assert code == 0 and "not sound" in err and "fault" not in err


def test_cameras_and_methods(run, hilly, tmp_path):
    view = tmp_path / "view.json"
    assert run("render", hilly, "-o", tmp_path / "a.png", "--from", 45, "--pitch", 12, "--size", "320x200",
               "--save-view", view, "--quiet")[0] == 0  # fmt: skip
    sizes = {}
    for name, more in {
        "by file": ("--view", view), "by options": ("--from", 45, "--pitch", 12, "--size", "320x200"),
        "other": ("--from", 45, "--pitch", 60, "--size", "320x200"),
        "wedgie": ("--view", view, "--method", "soar,error=wedgie"),
        "isotropic": ("--view", view, "--method", "soar,metric=isotropic"),
        "tall": ("--view", view, "--exaggeration", 3),
        "colors": ("--view", view, "--method", "soar,color-tolerance=2"),
    }.items():  # fmt: skip
        out = tmp_path / "mesh.npz"
        assert run("tessellate", hilly, "-o", out, *more, "--quiet")[0] == 0
        sizes[name] = len(Tessellation.load(out).triangles)
    assert sizes["by file"] == sizes["by options"] != sizes["other"]
    for finer in ("wedgie", "isotropic", "tall", "colors"):
        assert sizes[finer] > sizes["by file"]


def test_culling(run, hilly, tmp_path):
    view = tmp_path / "view.json"
    view.write_text('{"eye": [501000, 3998600, 900], "target": [501000, 3999500, 600], "fov_y": 20, "width": 300, '
                    '"height": 200}')  # fmt: skip
    counts = []
    for more in ((), ("--method", "soar,cull=no"), ("--method", "soar,geomorph=yes")):
        assert run("tessellate", hilly, "-o", tmp_path / "m.npz", "--view", view, *more, "--quiet")[0] == 0
        counts.append(len(Tessellation.load(tmp_path / "m.npz").triangles))
    assert counts[0] < counts[1] and counts[0] < counts[2]


def test_a_store_gives_the_same_mesh(run, hilly, tmp_path):
    store.build([str(hilly)], tmp_path / "hilly.oro").close()
    for source, name in ((hilly, "a"), (tmp_path / "hilly.oro", "b")):
        assert run("tessellate", source, "-o", tmp_path / f"{name}.npz", "--quiet")[0] == 0
    a, b = (Tessellation.load(tmp_path / f"{n}.npz") for n in "ab")
    assert a.stats["triangles"] == pytest.approx(b.stats["triangles"], rel=0.15)  # a store's errors are rounded up
    code, _, err = run("tessellate", tmp_path / "hilly.oro", "-o", tmp_path / "hilly.oro" / "m.npz", "--quiet")
    assert code == 2 and "within" in err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("-o", "m.npz", "--tolerance", 1, "--triangles", 5), 2, ("one goal", "--triangles")),
        (("-o", "m.dwg"), 2, (".npz", ".glb")),
        (("-o", "m.stl"), 2, ("model for printing", "orograph tin")),
        (("-o", "no/m.npz"), 4, ("folder",)),
        (("-o", "m.npz", "--method", "top-down,geomorph=yes"), 2, ("no option 'geomorph'", "queue")),
        (("-o", "m.npz", "--method", "raycast"), 2, ("makes no triangles", "soar")),
        (("-o", "m.npz", "--method", "hybrid"), 2, ("hybrid", "makes no triangles", "soar")),
        (("-o", "m.npz", "--method", "soar,error=midpoint", "--conservative"), 2, ("not promised",)),
        (("-o", "m.npz", "--drape", "a.png"), 2, ("color-tolerance",)),
        (("-o", "m.npz", "--method", "soar,metric=euclid"), 2, ("euclid", "anisotropic")),
        (("-o", "m.npz", "--view", "none.json"), 3, ("none.json",)),
        (("-o", "m.npz", "--exaggeration", 0), 2, ("exaggeration",)),
        (("-o", "m.npz", "--from", 3, "--lonlat", "1,2,3"), 2, ("one camera",)),
    ],
)
def test_what_is_refused(run, hilly, tmp_path, monkeypatch, arguments, code, words):
    monkeypatch.chdir(tmp_path)
    got, said, err = run("tessellate", hilly, *arguments, "--quiet")
    assert got == code and said == "" and "Traceback" not in err
    for word in words:
        assert word in err
    assert not list(tmp_path.iterdir())


def test_a_view_of_nothing_makes_no_file(run, hilly, tmp_path):
    view = tmp_path / "view.json"
    view.write_text(json.dumps({"eye": [0, 0, 5000], "target": [0, 1, 9000], "up": [0, 0, 1], "fov_y": 40,
                                "width": 64, "height": 48, "near": 1, "far": 1e5}))  # fmt: skip
    code, _, err = run("tessellate", hilly, "-o", tmp_path / "m.ply", "--view", view, "--quiet")
    assert code == 5 and "Nothing of the terrain is in view" in err and not (tmp_path / "m.ply").exists()


def test_an_input_is_not_overwritten(run, hilly):
    code, _, err = run("tessellate", hilly, "-o", hilly, "--quiet")
    assert code == 2 and "overwrite the input" in err and hilly.exists()
