"""Type checkers find nothing wrong, and nothing unknown, in a user's script that calls every public function."""

from __future__ import annotations

import ast
import inspect
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import orograph
from orograph.scene.parts import OPTIONS
from orograph.store.given import READING

SCRIPT = Path(__file__).with_name("script.py")
SOURCE = Path(orograph.__file__).parents[1]


def test_the_script_uses_all_that_is_public():
    used = {
        node.attr for node in ast.walk(ast.parse(SCRIPT.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "orograph"
    }  # fmt: skip
    imported = {"Dem", "Grid", "Picture", "Terrain", "View"}
    of_results = {"Tessellation", "Tour", "Uncertainty"}
    assert set(dir(orograph)) == used | imported | of_results


def test_checkers_know_the_options_that_there_are():
    from orograph.scene.typed import SceneOptions
    from orograph.store.typed import Reading

    assert tuple(Reading.__annotations__) == READING
    assert set(SceneOptions.__annotations__) == {*OPTIONS, *READING}
    given = {name: getattr(kind, "__forward_arg__", kind) for name, kind in SceneOptions.__annotations__.items()}
    for name, one in OPTIONS.items():
        words = set(one.annotation.split(" | "))
        if given[name] != "Any" and words <= {"bool", "int", "float", "str", "None"}:
            assert words <= set(given[name].split(" | ")) | ({"int"} if "Amount" in given[name] else set()), name


def test_overloads_have_the_options_that_there_are():
    from orograph.fetching.api import Fetching, fetch
    from orograph.verbs.synth import Synthesis, synth

    for function, options, said in ((synth, Synthesis, {"output"}), (fetch, Fetching, {"area", "product", "output"})):
        parameters = inspect.signature(function).parameters
        written = {name: kind.__forward_arg__ for name, kind in options.__annotations__.items()}
        assert written == {name: one.annotation for name, one in parameters.items() if name not in said}


@pytest.mark.stress
def test_mypy(tmp_path):
    pytest.importorskip("mypy")
    ran = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=", SCRIPT,
         f"--cache-dir={tmp_path}"],
        capture_output=True, text=True, env={**os.environ, "MYPYPATH": str(SOURCE)},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr


@pytest.mark.stress
def test_pyright(tmp_path):
    pyright = os.environ.get("PYRIGHT") or shutil.which("pyright")
    if pyright is None:
        pytest.skip("pyright is not installed (pip install pyright, or PYRIGHT=its path)")
    shutil.copy(SCRIPT, tmp_path)
    settings = {
        "typeCheckingMode": "strict",
        "reportUnnecessaryTypeIgnoreComment": True,
        "enableTypeIgnoreComments": False,
        "include": [SCRIPT.name],
        "extraPaths": [str(SOURCE)],
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    ran = subprocess.run(
        [pyright, "--pythonpath", sys.executable, "--outputjson"], capture_output=True, text=True, cwd=tmp_path
    )
    found = [
        f"{one['range']['start']['line'] + 1}: {one['message']}" for one in json.loads(ran.stdout)["generalDiagnostics"]
    ]
    assert not found, "\n".join(found)
