"""What is compiled ahead of the referee are the very kernels that a comparison needs."""

import subprocess
import sys
import textwrap

SIGNATURES = """
    import orograph
    from orograph.sample import jacksboro
    from orograph.verify import beyond, edges, pieces, spans, sweep
    from orograph.verify.ahead import judge_a_hill

    kernels = sweep.sweep, pieces.largest_on_pieces, beyond.look_beyond, edges.classify_edges, spans.bucket
    judge_a_hill()
    of_hill = [k.signatures for k in kernels]
    assert all(len(found) == 1 for found in of_hill), of_hill
    orograph.compare(jacksboro(), methods=["soar"], size=(320, 200), jobs=1)
    assert of_hill == [k.signatures for k in kernels], [k.signatures for k in kernels]
"""


def test_what_the_hill_compiles_is_what_a_comparison_needs():
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(SIGNATURES)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
