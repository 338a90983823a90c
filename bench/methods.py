"""All methods on the same views: what a store holds for them, the cost of making it, triangles and milliseconds.

    python bench/methods.py [DEM … | --size 1025] [--tolerance 1] [--method NAME]…

Bytes per sample are those of a store with what the method needs (``orograph build --for METHOD``) minus those of one
without; processor seconds, of all threads with kernels compiled, likewise. Triangles, milliseconds of a selection (the
median) and the largest error in pixels by the referee are means over the three usual views of ``orograph compare``, at
1280 × 720. Without a DEM, the terrain is synthetic (``orograph synth --seed 7``).
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import orograph
from orograph.lod.registry import METHODS


def processor() -> float:
    """The processor seconds of all child processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def built(dem: str, folder: Path, method: str | None) -> tuple[int, float]:
    """Bytes and processor seconds of a store of a DEM with what a method needs.

    The seconds are those of a second build, with kernels compiled.
    """
    command = [sys.executable, "-m", "orograph", "build", dem, "--quiet", "--jobs", "2", "--errors", "none"]
    took = 0.0
    for turn in range(2):
        store = folder / f"{method or 'none'}-{turn}.oro"
        began = processor()
        subprocess.run(
            [*command, "-o", str(store), *(["--for", method] if method else [])], check=True, capture_output=True
        )
        took = processor() - began
    return sum(path.stat().st_size for path in store.rglob("*") if path.is_file()), took


def table(dem: str, tolerance: float, folder: Path, methods: list[str]) -> None:
    terrain = orograph.terrain(dem)
    samples = terrain.grid.rows * terrain.grid.cols
    bare, bare_seconds = built(dem, folder, None)
    print(f"\n{Path(dem).name}: {terrain.grid.rows:,} × {terrain.grid.cols:,} samples, {tolerance:g} px\n")
    print(
        "| method | bytes / sample | build, processor s | triangles | ms | largest px |\n|---|---:|---:|---:|---:|---:|"
    )
    for name in methods:
        size, seconds = built(dem, folder, name)
        ((_, found),) = orograph.compare(terrain, methods=[name], tolerance=tolerance, progress=False).items()
        triangles = "-" if found.triangles is None else f"{found.triangles:,.0f}"
        largest = "-" if found.largest is None else f"{found.largest:.2f}"
        extra = max(size - bare, 0) / samples
        more = max(seconds - bare_seconds, 0)
        print(f"| {name} | {extra:.2f} | {more:.1f} | {triangles} | {found.ms:.1f} | {largest} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("dems", nargs="*")
    parser.add_argument("--size", type=int, default=1025)
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--method", dest="methods", action="append", metavar="NAME", help="default: all")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dems = given.dems
        if not dems:
            dems = [str(folder / "synthetic.tif")]
            orograph.synth(dems[0], size=given.size, seed=7, progress=False)
        for dem in dems:
            table(dem, given.tolerance, folder, given.methods or list(METHODS))


if __name__ == "__main__":
    main()
