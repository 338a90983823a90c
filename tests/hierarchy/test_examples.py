"""The examples in the manual page and in the docstrings say what happens."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

from orograph import hierarchy
from orograph.hierarchy import kernels

PAGE = Path(__file__).parents[2] / "docs" / "hierarchy.md"


def test_manual_page() -> None:
    results = doctest.testfile(str(PAGE), module_relative=False, encoding="utf-8")
    assert results.attempted >= 6 and not results.failed
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(block.replace("@kernel", ""), {})  # compiled kernels need a file of their own to be cached beside


def test_docstrings() -> None:
    for module in (hierarchy, kernels):
        source = (module.__doc__ or "").replace("@kernel", "@(lambda f: f)")
        test = doctest.DocTestParser().get_doctest(source, {}, module.__name__, None, 0)
        assert test.examples
        assert not doctest.DocTestRunner().run(test).failed
