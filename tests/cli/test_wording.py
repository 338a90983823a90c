"""The library speaks of Python's names, the command line of its options: one notation, one translation."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import numpy as np
import pytest

import orograph
from orograph.cli import VERBS
from orograph.cli.wording import flags_of, spoken
from orograph.errors import OrographError

SOURCES = Path(orograph.__file__).parent

OPTION = re.compile(r"(?<![\w-])--[a-z]")
WORD = re.compile(r"--[a-z-]+")
"""All of a string: a word of a command line that is put together, and no message."""


@cache
def messages() -> tuple[tuple[str, str], ...]:
    """Every string in the library but docstrings, with where it is; what is filled in is X."""
    return tuple(found())


def found() -> Iterator[tuple[str, str]]:
    for path in SOURCES.rglob("*.py"):
        if "cli" in path.relative_to(SOURCES).parts or path == SOURCES / "scene/wording.py":
            continue
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        inner = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in nodes:
            if id(node) in alone or id(node) in inner:
                continue
            if isinstance(node, ast.JoinedStr):
                text = "".join(str(v.value) if isinstance(v, ast.Constant) else "X" for v in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                text = node.value
            else:
                continue
            yield text, f"{path.relative_to(SOURCES)}:{node.lineno}"


def test_no_message_of_the_library_names_an_option_of_the_command_line() -> None:
    named = [(where, text) for text, where in messages() if OPTION.search(text) and not WORD.fullmatch(text)]
    built = [(where, text) for where, text in named if not where.startswith("viewer/touring")]
    assert built == []


def test_what_is_in_backticks_is_an_option_of_some_verb() -> None:
    known = {
        name
        for verb in VERBS
        for name in flags_of(importlib.import_module(f"orograph.cli.{verb.replace('-', '_')}").command)
    }
    found = 0
    for text, where in messages():
        for code in re.findall("`([^`]+)`", text):
            if code.startswith("{"):
                continue  # a format
            call = ast.parse(f"f({code})", mode="eval").body
            assert isinstance(call, ast.Call)
            if any(not isinstance(arg, ast.Name) for arg in call.args):
                continue  # a function of the package
            for name in [*(ast.unparse(arg) for arg in call.args), *(str(one.arg) for one in call.keywords)]:
                if "X" not in name and name[0].islower():
                    assert name in known, (where, text)
                    found += 1
    assert found > 60


@pytest.mark.parametrize(
    ("python", "words"),
    [
        ("`tolerance`", "--tolerance"),
        ("Give `spacing=30`, or `assume_crs='EPSG:4326'`.", "Give --spacing 30, or --assume-crs EPSG:4326."),
        ("`overwrite=True` `shadows=False` `water=None`", "--overwrite --no-shadows --water none"),
        ("`size=(64, 48)`", "--size 64x48"),
        ("`lamps`, `layers`", "--light-at, --drape"),
        ("`spacing=METRES`", "--spacing METRES"),
        ("`orograph.bake(store, ['openness'], overwrite=True)`", "orograph bake STORE --products openness --overwrite"),
        ("`orograph.build(['a b.tif', 'c.tif'], 'd.oro')`", "orograph build 'a b.tif' c.tif -o d.oro"),
        ("`orograph.build(..., errors=('exact', 'wedgie'))`", "orograph build --errors exact,wedgie"),
        ("`orograph.store.repair.repair`", "orograph build --repair"),
        ("`no Python at all`", "`no Python at all`"),
        ("nothing", "nothing"),
    ],
)
def test_python_as_the_command_line_has_it(python: str, words: str) -> None:
    assert spoken(python) == words


def test_options_are_called_as_the_verb_calls_them() -> None:
    @click.command()
    @click.option("--from", "azimuth")
    @click.option("--memory", "max_memory")
    def verb() -> None: ...

    assert spoken("`azimuth`, `max_memory`, `jobs`", flags_of(verb)) == "--from, --memory, --jobs"


@pytest.fixture
def nowhere(tmp_path: Path) -> Path:
    """Heights on degrees that name no CRS, in a file."""
    import rasterio
    from affine import Affine

    path = tmp_path / "dem.tif"
    with rasterio.open(path, "w", driver="GTiff", height=20, width=30, count=1, dtype="float32",
                       transform=Affine(0.001, 0, 8.0, 0, -0.001, 47.0)) as file:  # fmt: skip
        file.write(np.add.outer(np.arange(20), np.arange(30)).astype(np.float32), 1)
    return path


def test_the_same_error_in_python_and_on_the_command_line(run, nowhere, tmp_path) -> None:  # type: ignore[no-untyped-def]
    picture = tmp_path / "a.png"
    cases = [
        ({}, (), '`assume_crs="EPSG:4326"`', "--assume-crs EPSG:4326"),
        ({"wireframe": True}, ("--wireframe",), '`method="soar"`', "--method soar"),
        ({"lamps": [(8, 47, 1, 1)]}, ("--light-at", "8,47,1,1"), "not support `lamps`", "not support --light-at"),
        ({"discs": [(1, 2, 3)]}, ("--disc", "1,2,3"), "does not support `discs`", "does not support --disc"),
        (
            {"method": "soar", "triangles": 9, "tolerance": 1.0},
            ("--method", "soar", "--triangles", "9", "--tolerance", "1"),
            "`tolerance` or `triangles`", "--tolerance or --triangles",
        ),
    ]  # fmt: skip
    for options, words, python, shell in cases:
        with pytest.raises(OrographError) as error:
            orograph.render(nowhere, size=(64, 48), **options)
        assert python in str(error.value) and "--" not in str(error.value)
        code, _, said = run("render", nowhere, "-o", picture, "--size", "64x48", "--quiet", *words)
        assert code == error.value.exit_code and shell in said and "`" not in said, said


def test_warnings_speak_so_too(run, nowhere, tmp_path) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = run("info", nowhere)
    assert code == 0 and "--assume-crs EPSG:4326" in out and "`" not in out
    assert run("methods", "soar")[1].count("--method soar,key=value") == 1


@pytest.mark.parametrize(
    ("verb", "given", "meant"),
    [("render", "--legend", "--furniture"), ("render", "--scale-bar", "--furniture"), ("movie", "--cmap", "--colormap"),
     ("render", "--overlay", "--drape"), ("build", "--threads", "--jobs"), ("render", "--dpi", "--size"),
     ("render", "--extent", "--bbox"), ("tin", "--tolerance", "--max-error"), ("best-view", "--lonlat", "--target"),
     ("movie", "--duration", "--seconds"), ("light", "--azimuth", "--sun AZIMUTH,ALTITUDE")],
)  # fmt: skip
def test_names_from_elsewhere_are_led_to_ours(run, verb, given, meant):
    code, _, words = run(verb, "dem.tif", given)
    assert code == 2
    assert f"Did you mean '{meant}'?" in words


def test_a_name_that_may_mean_several_is_led_to_all(run):
    words = run("render", "dem.tif", "--azimuth", "300")[2]
    assert "(Did you mean one of: '--from', '--sun AZIMUTH,ALTITUDE'?)" in words


def test_a_slip_is_still_led_to_the_nearest(run):
    assert "--furniture" in run("render", "dem.tif", "--furnitur")[2]
