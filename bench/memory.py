"""The peak memory of every verb with ``--max-memory``, compared with its limit.

    python bench/memory.py [--size 8193] [--allowed 512MiB] [--picture 4096x4096] [--cold] [--only VERB]...

Each verb reads a square synthetic terrain of ``--size`` samples a side in a separate process. Printed are its seconds,
its peak resident set, which includes the interpreter and its libraries, and that of the largest process it starts to
compile kernels. With ``--cold``, no kernel is compiled beforehand. *kept* means from an existing store. The memory of a
software driver counts too; with one, a picture by tiles is allowed at least 704 MiB.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio

from orograph.folders import parse_bytes

OROGRAPH = [sys.executable, "-m", "orograph", "--quiet"]


def write_image(dem: str, path: str) -> None:
    """Write a three-band image that covers a raster, strip by strip."""
    with rasterio.open(dem) as file:
        like = {**file.profile, "count": 3, "dtype": "uint8", "nodata": None, "compress": "deflate"}
        with rasterio.open(path, "w", **like) as image:
            for _, window in file.block_windows():
                image.write(np.repeat(file.read(window=window) % 256, 3, 0).astype(np.uint8), window=window)


def verbs(dem: str, store: str, work: Path, size: int, picture: str) -> dict[str, list[str]]:
    """The commands by name, without their limits."""
    large = ["render", store, "-o", str(work / "l.png"), "--size", picture]
    with rasterio.open(dem) as file:
        x, y = file.xy(size // 2, size // 2)
    return {
        "build": ["build", dem, "-o", str(work / "b.oro"), "--overwrite"],
        "render": ["render", dem, "-o", str(work / "a.png")],
        "render, kept": ["render", store, "-o", str(work / "a.png")],
        f"render {picture}, kept": large,
        f"render {picture}, image and depth": [
            *large,
            "--drape",
            str(work / "image.tif"),
            "--depth",
            str(work / "depth.tif"),
        ],
        f"render {picture}, gpu": [*large, "--backend", "gpu"],
        "light": ["light", store, "-o", str(work / "l.tif"), "--product", "sky-view-factor"],
        "bake": ["bake", store, "--products", "sky-view-factor"],
        "movie": ["movie", store, "-o", str(work / "m.mp4"), "--size", "320x180", "--orbit", "--seconds", "0.2"],
        "compare": ["compare", store, "--method", "soar"],
        "tessellate": ["tessellate", store, "-o", str(work / "m.npz")],
        "tin": ["tin", store, "-o", str(work / "t.npz"), "--max-error", "10"],
        "viewshed": [
            "measure",
            "viewshed",
            store,
            f"{x:.0f},{y:.0f}",
            "-o",
            str(work / "v.tif"),
            "--radius",
            "20000",
        ],
    }


class Peak(NamedTuple):
    code: int
    seconds: float
    mib: float
    compilers: float
    """MiB of the largest process that it started."""


def measured(command: list[str], cache: Path, kernels: Path | None) -> Peak:
    """Run one process with its own folder of compiled kernels."""
    began = time.perf_counter()
    own = {"OROGRAPH_CACHE": str(cache)} | ({"NUMBA_CACHE_DIR": str(kernels)} if kernels else {})
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(command, env=os.environ | own, stdout=subprocess.DEVNULL, stderr=errors)
        compilers, ended = 0.0, (0, 0, None)
        while not ended[0]:
            time.sleep(0.1)
            compilers = max([compilers, *map(largest, started_by(child.pid))])
            ended = os.wait4(child.pid, os.WNOHANG)
        child.returncode = os.waitstatus_to_exitcode(ended[1])
        if child.returncode:
            errors.seek(0)
            print(errors.read().decode(errors="replace").strip(), file=sys.stderr)
    assert ended[2] is not None
    return Peak(child.returncode, time.perf_counter() - began, ended[2].ru_maxrss / 1024, compilers)


def started_by(parent: int) -> list[int]:
    """The child processes of a process that still run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has just ended
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == parent:
                found.append(int(folder.name))
    return found


def largest(pid: int) -> float:
    """The peak memory of a process so far, MiB."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:")), 0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=8193)
    parser.add_argument("--allowed", default="512MiB")
    parser.add_argument("--picture", default="4096x4096")
    parser.add_argument("--cold", action="store_true", help="each verb compiles all its kernels")
    parser.add_argument("--only", action="append", metavar="VERB")
    given = parser.parse_args()
    allowed = parse_bytes(given.allowed) / 2**20
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        dem, store = str(work / "dem.tif"), str(work / "dem.oro")
        subprocess.run(
            [*OROGRAPH, "synth", "-o", dem, "--size", str(given.size)], check=True, stdout=subprocess.DEVNULL
        )
        subprocess.run([*OROGRAPH, "build", dem, "-o", store], check=True, stdout=subprocess.DEVNULL)
        write_image(dem, str(work / "image.tif"))
        print(f"{given.size}² samples")
        titles = "verb", "seconds", "peak, MiB", "allowed, MiB", "of what is allowed", "compilers, MiB"
        print(f"| {' | '.join(titles)} |", "|---" * len(titles) + "|", sep="\n")
        for name, command in verbs(dem, store, work, given.size, given.picture).items():
            if given.only and name.split(",")[0].split()[0] not in given.only:
                continue
            most = max(allowed, 704) if "gpu" in name else allowed
            limit = ["--max-memory", f"{most:.0f}MiB"]
            kernels = work / "kernels" / name.replace(" ", "_") if given.cold else None
            if kernels:
                kernels.mkdir(parents=True)
            run = measured([*OROGRAPH, *command, *limit], work / "cache", kernels)
            failed += run.code != 0
            print(
                f"| {name} | {run.seconds:.1f} | {run.mib:.0f} | {most:.0f} | {run.mib / most:.2f} "
                f"| {run.compilers:.0f} |" + f" failed ({run.code})" * bool(run.code),
                flush=True,
            )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
