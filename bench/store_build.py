"""Building a store compared with making a Cloud Optimised GeoTIFF with overviews of the same file, on the same threads.

    python bench/store_build.py [DEM.tif | --size 8193] [--threads 2] [--rounds 3]

Each run is a process of its own, timed from start to end; rounds alternate, and the best counts. Both use ZSTD at level
1; the COG has bilinear overviews and 512² blocks. The store holds more: every level twice (nested samples, box means),
error bounds, checksums; "build" also has the errors and spheres of all diamonds, which "heights" leaves out. Peak
memory is the process's largest resident set.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMON = """
import sys, rasterio
from pathlib import Path
source, target, threads = sys.argv[1:]
"""
PEAK = """
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")))
"""
RUNS = {
    "GDAL COG driver": COMMON
    + """
from rasterio.shutil import copy
with rasterio.Env(GDAL_CACHEMAX=256 << 20):
    copy(source, target, driver="COG", COMPRESS="ZSTD", LEVEL="1", PREDICTOR="YES", NUM_THREADS=threads,
         BIGTIFF="IF_SAFER", OVERVIEW_RESAMPLING="BILINEAR")
"""
    + PEAK,
    "rio cogeo": COMMON
    + """
from rio_cogeo.cogeo import cog_translate
from rio_cogeo.profiles import cog_profiles
profile = cog_profiles.get("zstd")
profile.update(predictor=3, zstd_level=1, BIGTIFF="IF_SAFER")
cog_translate(source, target, profile, quiet=True, in_memory=False, overview_resampling="bilinear",
              config={"GDAL_NUM_THREADS": threads, "GDAL_CACHEMAX": 256 << 20})
"""
    + PEAK,
    "orograph heights": COMMON
    + """
from orograph import store
store.build(source, target, jobs=int(threads), errors=())
"""
    + PEAK,
    "orograph build": COMMON
    + """
from orograph import store
store.build(source, target, jobs=int(threads))
"""
    + PEAK,
}


def run(code: str, source: str, target: Path, threads: int) -> tuple[float, float]:
    """Seconds and MB of one process."""
    started = time.perf_counter()
    line = [sys.executable, "-c", code, source, str(target), str(threads)]
    ran = subprocess.run(line, capture_output=True, text=True, check=True)
    return time.perf_counter() - started, int(ran.stdout.split()[-1]) / 1024


def synthetic(size: int, path: Path) -> Path:
    """A tiled float32 GeoTIFF of fractal terrain."""
    line = [sys.executable, "-m", "orograph", "synth", "-o", str(path), "--size", str(size), "--seed", "7"]
    subprocess.run(line, check=True, capture_output=True)
    return path


def bytes_of(path: Path) -> int:
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dem", nargs="?")
    parser.add_argument("--size", type=int, default=8193)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = args.dem or str(synthetic(args.size, folder / "dem.tif"))
        best: dict[str, tuple[float, float]] = {}
        sizes: dict[str, int] = {}
        for turn in range(args.rounds):
            for what, code in RUNS.items():
                target = folder / f"{what.replace(' ', '-')}-{turn}"
                seconds, megabytes = run(code, source, target, args.threads)
                best[what] = min(best.get(what, (1e9, 0.0)), (seconds, megabytes))
                sizes[what] = bytes_of(target)
        raw = Path(source).stat().st_size
        print(f"{source} ({raw / 1e6:.0f} MB), {args.threads} threads, best of {args.rounds}")
        for what, (seconds, megabytes) in best.items():
            print(f"{what:18}{seconds:8.2f} s {megabytes:8.0f} MiB peak {sizes[what] / 1e6:8.0f} MB on disk")
        peer = min(seconds for what, (seconds, _) in best.items() if not what.startswith("orograph"))
        for what in ("orograph heights", "orograph build"):
            print(f"{what}: {best[what][0] / peer:.2f} times the faster COG")


if __name__ == "__main__":
    main()
