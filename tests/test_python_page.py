"""The page on Python: its examples run, in order, and what it says of results holds."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orograph

PAGE = Path(__file__).parents[1] / "docs/python.md"


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_its_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("matplotlib", "xarray", "rioxarray"):
        pytest.importorskip(name)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        for number, block in enumerate(blocks()):
            exec(compile(block, f"{PAGE.name}, example {number + 1}", "exec"), names)
    told = re.search(r"^dem  # (<Dem .*>)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert told is not None and repr(names["dem"]) == told[1]
    assert names["pixels"].shape == (200, 320, 3) and (tmp_path / "map.png").stat().st_size > 10_000
    assert names["mesh"].stats["report"]["largest"] <= 2
    place = names["found"].isel(x=160, y=150)
    hit = orograph.measure.pick(names["terrain"], names["view"], (160.5, 150.5))
    assert hit is not None
    np.testing.assert_allclose([place.easting, place.northing], hit.point, atol=0.05)
    assert len(list(tmp_path.glob("frames*.png"))) == 4


def test_it_names_every_function() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in dir(orograph):
        if name[0].islower():
            assert re.search(rf"`{name}`|orograph\.{name}\b", text), name
