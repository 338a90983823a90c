"""First runs of verbs on a machine: seconds of the whole verb, and in them the seconds waiting for kernels.

    python bench/first.py [--processor]

One verb runs after the other on the sample of ``orograph demo``, in a copy of the package whose kernels nobody has
compiled. ``--processor``: processor seconds of all processes of a verb instead of those of the whole verb, for busy
machines.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import orograph
from orograph.cli.progress import COMPILING_KERNELS

VERBS = {
    "demo": ["demo", "-o", "."],
    "build": ["build", "DEM", "-o", "a.oro"],
    "tessellate": ["tessellate", "DEM", "-o", "a.npz"],
    "tin": ["tin", "DEM", "-o", "t.npz", "--max-error", "5"],
    "light, sky-view-factor": ["light", "DEM", "-o", "l.tif", "--product", "sky-view-factor"],
    "render, soar": ["render", "DEM", "-o", "r.png", "--method", "soar"],
    "compare, soar": ["compare", "DEM", "--method", "soar"],
}


def ran(command: list[str], folder: Path) -> tuple[float, float, float]:
    """Seconds of a verb, those waiting for kernels, and processor seconds."""
    own = {"PYTHONPATH": str(folder), "OROGRAPH_CACHE": str(folder / "cache")}
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "orograph", *command], cwd=folder, env=os.environ | own, capture_output=True, text=True
    )
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(done.stderr)
    waited = re.findall(rf"{COMPILING_KERNELS}\s+([\d.]+) s", done.stderr)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, sum(map(float, waited)), processor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processor", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package = Path(orograph.__file__).parent
        shutil.copytree(package, folder / "orograph", ignore=shutil.ignore_patterns("*.nbi", "*.nbc"))
        print(f"| verb | {'processor ' * given.processor}seconds | waiting for kernels |\n|---|---|---|")
        for verb, command in VERBS.items():
            seconds, waited, processor = ran([one.replace("DEM", "jacksboro.tif") for one in command], folder)
            print(f"| {verb} | {processor if given.processor else seconds:.1f} | {waited:.1f} |", flush=True)


if __name__ == "__main__":
    main()
