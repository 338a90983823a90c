"""``orograph bake`` and ``build --bake`` as people use them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from orograph import store
from orograph.errors import OutputError
from orograph.lighting.raster_resume import Checkpoint


@pytest.fixture
def built(run, hilly, tmp_path):
    path = tmp_path / "area.oro"
    assert run("build", hilly, "-o", path, "--errors", "none", "--quiet")[0] == 0
    return path


@pytest.mark.stress
def test_a_bake_says_what_it_did(run, built):
    given = ("bake", built, "--products", "sky-view-factor,aperture", "--azimuths", 6, "--quiet")
    code, said, err = run(*given)
    assert code == 0 and err == ""
    assert "sky-view-factor: 1 level, 8 bits (within 0.002)" in said and "4 bands of 16 bits" in said
    code, said, err = run(*given, "--json")
    told = json.loads(said)
    assert set(told["layers"]) == {"sky-view-factor", "aperture"}
    assert told["layers"]["aperture"]["options"]["azimuths"] == 6
    with store.open(built) as terrain:
        assert terrain.layer("sky-view-factor", azimuths=6).read(0, 0, 9, 0, 9).shape == (1, 9, 9)
    code, said, err = run("info", built)
    assert code == 0 and "aperture (16 bits; azimuths 6" in said and "sky-view-factor (8 bits; azimuths 6" in said


def test_a_bake_with_options_replaces(run, built):
    for radius in (100, 300):
        code, _, err = run(
            "bake", built, "--products", "ambient-occlusion", "--radius", radius, "--rho", "linear", "--bits", 16,
            "--azimuths", 4, "--quiet",
        )  # fmt: skip
        assert code == 0, err
        with store.open(built) as terrain:
            layer = terrain.layer("ambient-occlusion", radius=float(radius), rho="linear")
            assert layer.bands[0].bits == 16


@pytest.mark.stress
def test_a_bake_in_parts(run, built):
    given = ("bake", built, "--products", "visible-sky", "--azimuths", 4, "--radius", 300, "--quiet")
    code, said, err = run(*given, "--part", "1/2", "--json")  # there is one shard: it is the second part's
    assert code == 0 and err == ""
    told = json.loads(said)
    assert told.pop("seconds") >= 0 and told == {"path": str(built), "part": "1/2"}
    code, _, err = run(*given, "--finish")
    assert code == 4 and "Part 2 of 2 is missing" in err and "Run it again, then finish" in err
    code, said, err = run(*given, "--part", "2/2")
    assert code == 0 and "part 2/2 is baked" in said
    code, said, err = run(*given, "--finish")
    assert code == 0 and "visible-sky: 1 level" in said, err
    code, _, err = run("bake", built, "--products", "sky-view-factor", "--part", "1/2")
    assert code == 2 and "Horizons without a radius" in err and "--radius" in err and "--workers" in err
    code, _, err = run(*given, "--part", "1/2", "--workers", 2)
    assert code == 2 and "--workers and --part exclude each other" in err


def test_build_and_bake_in_one(run, hilly, tmp_path):
    path = tmp_path / "both.oro"
    code, said, err = run("build", hilly, "-o", path, "--bake", "visible-sky", "--json", "--quiet")
    assert code == 0, err
    assert json.loads(said)["layers"] == ["visible-sky"]
    with store.open(path) as terrain:
        low = np.nanmin(terrain.layer("visible-sky").read(0, 0, 90, 0, 70))
        assert 0.3 < low < 1 and terrain.check() == []


def test_a_disk_that_is_full_when_light_is_put_in_is_told_with_what_goes_on(run, hilly, tmp_path, monkeypatch):
    path = tmp_path / "full.oro"
    given = ("build", hilly, "-o", path, "--bake", "visible-sky", "--quiet")

    def full(self, *given):
        raise OutputError("What has been done cannot be kept.", remedy="Run the same again.")

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", full)
        code, _, err = run(*given)
    again = f"orograph bake {path} again with the same products"
    assert code == 4 and again in err and "same again" not in err
    assert run("bake", path, "--products", "visible-sky", "--quiet")[0] == 0
    with store.open(path) as terrain:
        assert terrain.check() == [] and terrain.layers == ("visible-sky",)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--products", "slope"), 2, ("orograph light",)),
        (("--products", "sky"), 2, ("no product",)),
        (("--products", "insolation"), 2, ("--date",)),
        (("--products", "aperture", "--radius", "-1"), 2, ("radius",)),
        (("--products", "visible-sky", "--rho", "linear"), 2, ("--rho has no effect", "ambient-occlusion")),
    ],
)
def test_wrong_commands(run, built, options, code, words):
    got, _, err = run("bake", built, *options)
    assert got == code and all(word in err for word in words), err
    with store.open(built) as terrain:
        assert terrain.layers == ()


def test_a_dem_is_no_store(run, hilly):
    code, _, err = run("bake", hilly, "--products", "visible-sky")
    assert code == 4 and "orograph build" in err


def test_wrong_products_are_refused_before_a_build(run, hilly, tmp_path):
    for wrong in ("slope", "insolation", "nothing"):
        code, _, err = run("build", hilly, "-o", tmp_path / "x.oro", "--bake", wrong)
        assert code == 2 and not list(tmp_path.glob("x.oro*")), err


@pytest.mark.stress
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_ctrl_c_leaves_the_store_as_it_was_and_the_command_goes_on(run, tmp_path):
    dem, path = tmp_path / "big.tif", tmp_path / "big.oro"
    assert run("synth", "-o", dem, "--size", 513, "--seed", 3, "--quiet")[0] == 0
    assert run("build", dem, "-o", path, "--errors", "none", "--quiet")[0] == 0
    given = [sys.executable, "-m", "orograph", "bake", str(path), "--products", "aperture", "--azimuths", "360", "-j1"]
    process = subprocess.Popen(given, stderr=subprocess.PIPE, text=True)
    partial = path / "layers/.partial"
    for _ in range(2000):
        time.sleep(0.02)
        if list(partial.glob("*.json")) and len(list(partial.glob("*.json"))) > 1:
            break
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "as it was" in err and "Traceback" not in err, err
    with store.open(path) as terrain:
        assert terrain.layers == () and terrain.check() == []
    assert subprocess.run(given, capture_output=True).returncode == 0
    with store.open(path) as terrain:
        assert terrain.layers == ("aperture",)
    assert not partial.exists()
