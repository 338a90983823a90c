"""The method that docs/methods/adding.md adds, taken from that page."""

from __future__ import annotations

import importlib.util
import re
import sys
from contextlib import contextmanager
from pathlib import Path

from orograph.lod.registry import METHODS, register

PAGE = Path(__file__).parents[2] / "docs/methods/adding.md"
NAME = "regular-grid"


@contextmanager
def added(folder):
    """The method, registered while the block runs (in place of one that follows the page in a checkout)."""
    source = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert source is not None
    path = folder / "regular_grid.py"
    path.write_text(source[1], encoding="utf-8")
    spec = importlib.util.spec_from_file_location("regular_grid", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["regular_grid"] = module
    spec.loader.exec_module(module)
    before = METHODS.pop(NAME, None)
    try:
        yield register(module.RegularGrid)
    finally:
        del METHODS[NAME], sys.modules["regular_grid"]
        if before is not None:
            METHODS[NAME] = before
