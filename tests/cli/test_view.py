"""``orograph view`` where it cannot open a window: what is missing is said before any work (see tests/viewer, too)."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip("glfw")


def run(*words: str, **env: str) -> subprocess.CompletedProcess[str]:
    clean = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-m", "orograph", "view", *words], env={**clean, **env}, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a screen")
def test_no_screen():
    done = run("no-such-file.tif")
    assert done.returncode == 6
    assert "DISPLAY" in done.stderr
    assert "orograph doctor" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a screen")
def test_a_screen_that_does_not_answer():
    done = run("no-such-file.tif", DISPLAY=":9873")
    assert done.returncode == 6
    assert "cannot be used" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("--from", "20", "--lonlat", "1,2,3"),
        ("--disc", "120,30,20"),
        ("--light", "ao", "--light-at", "-72,44,900,400"),
        ("--light", "aperture", "--disc", "120,30,20,1"),
        ("--light", "raytraced", "--rays", "0"),
    ],
)
def test_contradictions_are_found_first(words: tuple[str, ...]):
    assert run("no-such-file.tif", *words).returncode == 2


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a screen")
def test_no_display_comes_before_the_file():
    """What is missing of the machine is said before what is wrong with the input."""
    assert "no-such-file" not in run("no-such-file.tif").stderr


def test_help():
    done = run("--help")
    assert done.returncode == 0
    for option in ("--screenshot", "--gpu-memory", "--memory", "--adapter", "--view", "--sun", "--tolerance", "--rays",
                   "--light-at", "--disc"):  # fmt: skip
        assert option in done.stdout
