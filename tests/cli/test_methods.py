"""``orograph methods``, the manual's table, and a method that is added: every verb knows it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import toy
from PIL import Image

from orograph.lod import describe
from orograph.lod.options import described
from orograph.lod.registry import METHODS, chosen, method_of, register
from orograph.tessellation import Tessellation

SMALL = ("--size", "160x100", "--quiet")


@pytest.fixture
def grid(tmp_path):
    with toy.added(tmp_path) as method:
        yield method


def test_every_method_is_described(run):
    code, said, _ = run("methods")
    assert code == 0
    for name in METHODS:
        info = method_of(name).info
        assert name in said.splitlines() and info.name == name
        code, about, _ = run("methods", name)
        assert code == 0 and info.title in " ".join(about.split())
        for one in described(info.options):
            assert f"\n  {one.key}: " in about and one.help.split()[0] in about
            assert one.help.endswith(".")
        assert ("may have cracks" in about) is not info.conforming
    code, _, err = run("methods", "sore")
    assert code == 2 and "no method 'sore'" in err and "soar" in err


def test_the_table_of_the_manual():
    assert describe.BEGIN in describe.PAGE.read_text(encoding="utf-8")
    assert describe.markdown() in describe.PAGE.read_text(encoding="utf-8")
    for name in METHODS:
        assert (describe.PAGE.parent / f"{name}.md").exists(), name


def test_choices_are_read_as_they_are_written():
    for text in (
        "soar",
        "soar,error=wedgie,geomorph=yes",
        "roam,strips=none,back-facing=0.5",
        "triangle-patches,legs=8",
    ):
        choice = chosen(text)
        assert str(choice) == text and chosen(str(choice)) == choice
    assert chosen("soar,geomorph") == chosen("soar,geomorph=yes")
    roam = chosen("roam,objects=3:4:1.5+9:8:2,line-of-sight=1:2:30/4:5:60").options
    assert roam.objects == ((3, 4, 1.5), (9, 8, 2)) and roam.line_of_sight == (((1, 2, 30), (4, 5, 60)),)
    assert chosen("auto").info.name == "raycast" and chosen("auto", "gpu").info.name == "triangle-patches"


def test_names_are_taken_once(grid):
    with pytest.raises(Exception, match="regular-grid"):
        register(grid)


def test_a_method_that_is_added(run, hilly, tmp_path, grid):
    code, said, _ = run("methods", toy.NAME)
    assert code == 0 and "ratio: a number from 0.5 to 64 (pixels)  [default: 8]" in said
    code, said, err = run("compare", hilly, "--method", toy.NAME, "--method", "soar", "--json", "-", *SMALL)
    assert code == 0, err
    told = json.loads(said)["methods"]
    assert list(told) == [toy.NAME, "soar"] and told[toy.NAME]["triangles"] > 100
    assert told[toy.NAME]["conservative"] is False and told[toy.NAME]["largest"] > 0
    sizes = []
    for ratio in (2, 16):
        out = tmp_path / f"{ratio}.npz"
        code, said, err = run("tessellate", hilly, "-o", out, "--method", f"{toy.NAME},ratio={ratio}", *SMALL)
        assert code == 0 and f"{toy.NAME},ratio={ratio}: " in said, err
        sizes.append(len(Tessellation.load(out).triangles))
    assert sizes[0] > 3 * sizes[1]
    code, _, err = run("tessellate", hilly, "-o", tmp_path / "b.npz", "--method", toy.NAME, "--triangles", 9, "-q")
    assert code == 2 and "does not support the goal triangles" in err
    code, said, err = run("render", hilly, "-o", tmp_path / "a.png", "--method", toy.NAME, "--wireframe", *SMALL)
    assert code == 0 and f"{toy.NAME}: " in said, err
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (160, 100)
    code, _, err = run("tessellate", hilly, "-o", tmp_path / "b.npz", "--method", toy.NAME, "--conservative", "-q")
    assert code == 2 and "not promised" in err
    assert not (tmp_path / "b.npz").exists() and Path(tmp_path / "2.npz").exists()
