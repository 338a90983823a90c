"""What libraries are kept from loading is loaded where it is needed after all."""

from __future__ import annotations

import subprocess
import sys

import pytest

START = "import sys; from orograph._spared import spare_imports; spare_imports(); import pyproj.transformer; "


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", START + code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_pyproj_loads_nothing_that_talks_to_servers() -> None:
    found = run("print([one for one in ('urllib.request', 'importlib.metadata', 'email') if one in sys.modules])")
    assert found == "[]"


@pytest.mark.parametrize(
    ("code", "shown"),
    [
        ("pyproj.show_versions()", "PROJ"),
        ("from pyproj.sync import get_transform_grid_list as found; print(found.__module__)", "pyproj.sync"),
        ("print(pyproj.transformer._download_resource_file.__module__)", "orograph._spared"),
        (
            "import tempfile; made = tempfile.mkdtemp(); "
            "call = pyproj.transformer._download_resource_file; "
            "url = 'file://' + made + '/none'\n"
            "try: call(file_url=url, short_name='none', directory=made, sha256=None)\n"
            "except OSError as error: print(type(error).__name__, sys.modules['pyproj.sync'].__file__)",
            "sync.py",
        ),
    ],
    ids=["versions", "another name", "a stand-in", "a download"],
)
def test_what_pyproj_does_without_is_loaded_when_it_is_called(code: str, shown: str) -> None:
    assert shown in run(code)


def test_other_modules_see_what_libraries_do_not() -> None:
    assert run("import scipy.linalg, cffi; print('both')") == "both"
