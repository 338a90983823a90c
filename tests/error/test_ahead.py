"""What is compiled ahead of errors are the very kernels that a raster and a store need."""

import subprocess
import sys
import textwrap

SIGNATURES = """
    import numpy as np, orograph, tempfile
    from orograph.error import monotony, octaves, spheres
    from orograph.error.ahead import bound_a_hill
    from orograph.sample import jacksboro
    from orograph.store.opening import terrain as opened

    kernels = octaves.deviations, monotony.close, spheres.edge_spheres, spheres.square_spheres, octaves.overlap
    bound_a_hill("exact")
    of_hill = [k.signatures for k in kernels]
    assert all(of_hill), of_hill
    terrain = opened(jacksboro())
    terrain.derived("diamonds", error="exact")
    with tempfile.TemporaryDirectory() as folder:
        orograph.build(jacksboro(), folder + "/a.oro")
    assert of_hill == [k.signatures for k in kernels], [k.signatures for k in kernels]
"""


def test_what_the_hill_compiles_is_what_a_raster_and_a_store_need():
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(SIGNATURES)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
