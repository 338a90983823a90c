"""What is compiled in the background is what the other verbs need."""

import os
import subprocess
import sys
import textwrap

import pytest

from orograph.verbs.ahead import steps

CODE = """
    import sys
    from orograph.compiling import COMPILING
    from orograph.verbs.ahead import compile_verbs
    from orograph.cli import cli

    compile_verbs()
    before = COMPILING.seconds
    dem, out = sys.argv[1:]
    for words in (["build", dem, "-o", out + "/a.oro"], ["tessellate", dem, "--tolerance", "2", "-o", out + "/m.npz"],
                  ["render", dem, "--backend", "gpu", "-o", out + "/g.png"],
                  ["tin", dem, "--max-error", "9", "-o", out + "/t.ply"],
                  ["light", dem, "--product", "sky-view-factor", "-o", out + "/s.tif"],
                  ["render", out + "/a.oro", "--projection", "plan", "--contours", "auto", "-o", out + "/c.png"]):
        cli.main(args=["-q", *words], standalone_mode=False)
        print(words[0], COMPILING.seconds - before)
    assert COMPILING.seconds - before < 5
"""


def test_every_step_works(tmp_path, device):
    for step in steps(tmp_path):
        step()
    assert (tmp_path / "hill.oro").is_dir()


@pytest.mark.stress
def test_the_other_verbs_find_their_kernels(tmp_path, shared_data):
    dem = shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif"
    (tmp_path / "cache").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(CODE), str(dem), str(tmp_path)], capture_output=True, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
