"""``orograph doctor``: what it finds is there, and what is missing has a remedy."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import pytest
from click.testing import CliRunner

from orograph.cli import doctor
from orograph.gpu import device as gpu


@pytest.fixture
def runner() -> Iterator[CliRunner]:
    yield CliRunner()


def test_it_tells_the_same_in_words_and_as_json(runner: CliRunner) -> None:
    facts = json.loads(runner.invoke(doctor.command, ["--json"]).output)
    words = runner.invoke(doctor.command, []).output
    assert facts["cache_limit_gib"] == 20 and "of at most 20 GiB (OROGRAPH_CACHE_SIZE)" in words
    assert facts["cache"] in words and facts["python"] == ".".join(map(str, sys.version_info[:3]))
    for adapter in facts["adapters"]:
        assert adapter["name"] in words
    assert sum(a["used"] for a in facts["adapters"]) <= 1
    assert not any(a["used"] and a["backend"] == "OpenGL" for a in facts["adapters"])


def test_no_adapter_has_a_remedy(runner: CliRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "adapters", list)
    ran = runner.invoke(doctor.command, [])
    assert ran.exit_code == 0 and "mesa-vulkan-drivers" in ran.output


def test_a_missing_library_has_a_remedy(runner: CliRunner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orograph.verbs.doctor.EXTRAS", {"view": ("no-such-library",)})
    ran = runner.invoke(doctor.command, [])
    assert ran.exit_code == 0 and "no-such-library (missing)" in ran.output
    assert "pip install 'orograph[view]'" in ran.output
