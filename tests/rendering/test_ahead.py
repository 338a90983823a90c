"""What is compiled ahead of a picture are the very kernels that it needs."""

import subprocess
import sys
import textwrap

import pytest

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
