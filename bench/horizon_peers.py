"""The time that peers take for a sky-view factor: topocalc (Dozier 2022) and rvt-py (Zakšek et al. 2011).

``horizon.py`` runs this under an interpreter that has them: ``PYTHON horizon_peers.py HEIGHTS.npy CELL AZIMUTHS
PIXELS``. It also needs NumPy. Prints one line of JSON: processor seconds by name, or the reason why there are none.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version

import numpy as np


def seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    path, cell, azimuths, pixels = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    heights = np.load(path)
    found: dict[str, object] = {}
    try:
        from topocalc.viewf import viewf
    except ImportError as error:
        found["topocalc"] = str(error)
    else:
        viewf(heights[:64, :64].astype(np.float64), cell, nangles=azimuths)
        taken = seconds(lambda: viewf(heights.astype(np.float64), cell, nangles=azimuths))
        found["topocalc"] = {"seconds": taken, "version": version("topocalc")}
    try:
        import rvt.vis
    except ImportError as error:
        found["rvt-py"] = str(error)
    else:
        rvt.vis.sky_view_factor(heights[:64, :64], cell, svf_n_dir=azimuths, svf_r_max=10)
        taken = seconds(lambda: rvt.vis.sky_view_factor(heights, cell, svf_n_dir=azimuths, svf_r_max=pixels))
        found["rvt-py"] = {"seconds": taken, "version": version("rvt-py")}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
