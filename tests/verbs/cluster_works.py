"""A build, a bake and a film on a cluster (run as a script): WORK GROUND TARGET ADDRESS.

GROUND is a folder with ``dem.tif`` and a store of it, ``hills.oro``.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import orograph
from orograph import store
from orograph.lighting.context import Options

BUILD = {"shard": 64, "chunk": 16, "jobs": 1, "errors": ("exact", "midpoint"), "tins": 4, "progress": False}
NAMES, OPTIONS = ["sky-view-factor", "aperture"], Options(azimuths=8)
FILM = {"size": (240, 150), "orbit": True, "seconds": 4.0, "fps": 10, "progress": False}


def work(what, ground, target, address=None):
    """Do it, or go on with it, on a cluster or (``address`` None) by one thread."""
    ground, target = Path(ground), Path(target)
    on = {} if address is None else {"dask": address}
    if what == "build":
        store.build(str(ground / "dem.tif"), target, resume=True, **BUILD, **on).close()
    elif what == "bake":
        if not target.exists():
            shutil.copytree(ground / "hills.oro", target.with_suffix(".copy"))
            target.with_suffix(".copy").rename(target)
        orograph.bake(target, NAMES, OPTIONS, jobs=1, progress=False, **on).close()
    else:
        orograph.movie(ground / "hills.oro", target / "%03d.png", **FILM, **on)


if __name__ == "__main__":
    work(*sys.argv[1:])
