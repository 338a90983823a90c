"""The largest memory of every verb that keeps to ``--max-memory``, beside what it was allowed.

    python bench/memory.py [--size 8193] [--allowed 512MiB] [--picture 4096x4096] [--only VERB]...

A synthetic terrain of so many samples a side is read by each verb in a process of its own; told are its seconds and its
peak resident set. A peak counts what the interpreter and its libraries take, and what compiling takes where kernels are
cold. ``kept``: from a store that is there.
Where a software driver draws, its memory counts too: there 704 MiB is the least that a picture by tiles is allowed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rasterio

from orograph.folders import parse_bytes

OROGRAPH = [sys.executable, "-m", "orograph", "--quiet"]


def write_image(dem: str, path: str) -> None:
    """Write an image of three bands that lies on a raster, by strips."""
    with rasterio.open(dem) as file:
        like = {**file.profile, "count": 3, "dtype": "uint8", "nodata": None, "compress": "deflate"}
        with rasterio.open(path, "w", **like) as image:
            for _, window in file.block_windows():
                image.write(np.repeat(file.read(window=window) % 256, 3, 0).astype(np.uint8), window=window)


def verbs(dem: str, store: str, work: Path, size: int, picture: str) -> dict[str, list[str]]:
    """The commands by name, each without its limit."""
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


def peak(command: list[str], cache: Path) -> tuple[int, float, float]:
    """(exit code, seconds, MiB) of one process."""
    began = time.perf_counter()
    child = subprocess.Popen(
        command, env={**os.environ, "OROGRAPH_CACHE": str(cache)}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    assert child.stderr is not None
    said = child.stderr.read().decode(errors="replace")
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        print(said.strip(), file=sys.stderr)
    return child.returncode, time.perf_counter() - began, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=8193)
    parser.add_argument("--allowed", default="512MiB")
    parser.add_argument("--picture", default="4096x4096")
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
        print("| verb | seconds | peak, MiB | allowed, MiB | of what is allowed |\n|---|---|---|---|---|")
        for name, command in verbs(dem, store, work, given.size, given.picture).items():
            if given.only and name.split(",")[0].split()[0] not in given.only:
                continue
            most = max(allowed, 704) if "gpu" in name else allowed
            limit = ["--max-memory", f"{most:.0f}MiB"]
            code, seconds, mib = peak([*OROGRAPH, *command, *limit], work / "cache")
            failed += code != 0
            print(
                f"| {name} | {seconds:.1f} | {mib:.0f} | {most:.0f} | {mib / most:.2f} |"
                + f" failed ({code})" * bool(code),
                flush=True,
            )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
