"""A second process compiles the kernels of light: the ones that pictures use, only where something is compiled."""

import subprocess
import sys
import textwrap

import pytest

from orograph.compiling import COMPILING
from orograph.rendering.cpu import ahead

SIGNATURES = """
    import orograph, numpy as np
    from orograph.rendering.cpu.ahead import color_a_hill
    from orograph.geovis.water import _flood
    from orograph.lighting.relief import _gradients
    from orograph.lighting.sweep_kernels import sweep_lines
    from orograph.lighting.sky import _add_sine
    from orograph.raycast.skyline import skylines
    from orograph.rendering.cpu.kernels import compose, incidence, paint
    from orograph.sample import jacksboro

    kernels = {LIGHT} | {_flood, _gradients, sweep_lines, skylines, incidence}
    color_a_hill({light!r})
    of_hill = [k.signatures for k in kernels]
    assert all(of_hill), of_hill
    orograph.render(jacksboro(), size=(160, 100), light={light!r}, samples=1)
    assert of_hill == [k.signatures for k in kernels]
"""


@pytest.mark.parametrize(("light", "own"), [("relief", "{_add_sine, compose}"), ("ao", "{paint}")])
def test_what_the_hill_compiles_is_what_a_picture_needs(light, own):
    code = textwrap.dedent(SIGNATURES).replace("{LIGHT}", own).replace("{light!r}", repr(light))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def started(monkeypatch):
    found = []
    monkeypatch.setattr(ahead, "_start", found.append)
    monkeypatch.setattr(ahead, "_worthwhile", lambda: True)
    return found


def test_the_first_kernel_starts_it_once(started):
    with ahead.while_compiling("ao"):
        assert started == []
        for _ in range(2):
            COMPILING.begin()
            COMPILING.end()
    assert started == ["ao"]


def test_without_a_kernel_nothing_is_started(started):
    before = list(COMPILING.changed)
    with pytest.raises(ValueError, match="x"), ahead.while_compiling("ao"):
        raise ValueError("x")
    COMPILING.begin()
    COMPILING.end()
    assert started == [] and COMPILING.changed == before


@pytest.mark.parametrize(
    ("executable", "wanted", "expected"),
    [
        ("/a/bin/python3.12", "1", True),
        ("/a/bin/python3.12", "0", False),
        ("/usr/bin/qgis", "1", False),
        (None, "1", False),
    ],
)
def test_only_python_itself_is_started(monkeypatch, executable, wanted, expected):
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setenv("OROGRAPH_COMPILE_AHEAD", wanted)
    monkeypatch.setattr(ahead, "_STARTED", [])
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1}, raising=False)
    assert ahead._worthwhile() is expected
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0}, raising=False)
    assert not ahead._worthwhile()
