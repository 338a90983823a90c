"""Run all benchmarks one after the other, each in its own process. Print their tables, or what one lacks.

    python bench/every.py [--quick] [--data ../shared/data] [NAME...]

``--quick`` runs the benchmarks of the summary in docs/benchmarks.md in a small form: in less than ten minutes on two
cores, half of it for compiling in a fresh clone. It shows the tables and that they can be made; the numbers are those
of small terrains and few rounds. The other benchmarks have a small form too, and run if they are named. One that
exceeds its time there is stopped and reported. The exit code is 1 if one fails, but not if one lacks something.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
LONGEST = 90
"""Seconds that a benchmark may take in its quick form."""

HGT = "n44w072-hgt/N44W072.hgt"


@dataclass(frozen=True)
class Bench:
    """A benchmark.

    Attributes:
        quick: its options in the quick form.
        summary: whether the summary in docs/benchmarks.md gives its result.
        data: whether it takes ``--data``.
        path: its argument, a path in the open data.
        modules, programs: what it needs installed.
        gpu: whether it draws on a GPU (a software adapter counts).
        least: the part of the open data that it needs at least.
    """

    quick: str
    summary: bool = False
    data: bool = False
    path: str | None = None
    modules: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()
    gpu: bool = False
    least: str | None = None


BENCHES = {
    "aperture": Bench("--size 64 --rounds 1 --cost"),
    "batches": Bench("--frames 4", data=True, gpu=True, least="lsd-topo/gabilan.tif"),
    "bdam": Bench("--part table --count 2 --terrain bigtujunga", data=True, least="bigtujunga-srtm30m-utm"),
    "budgets": Bench("--size 1025 --frames 10 --ms 5 --no-best"),
    "cluster": Bench("--quick", data=True, modules=("distributed",), least="california-3s-tiles"),
    "cluster_plan": Bench("--tiles 4", data=True, least="california-3s-tiles"),
    "codec": Bench("--quick", data=True, least="n44w072-hgt/N44W072.hgt"),
    "embree": Bench("--size 513 --repeat 1", summary=True, data=True, modules=("embreex",)),
    "errors": Bench("--size 1025 --rounds 1"),
    "geovis": Bench("--quick"),
    "horizon": Bench("--size 512 --azimuths 8", summary=True),
    "imagery": Bench("--side 2048 --frames 12 --size 320x180", path=HGT, gpu=True),
    "layouts": Bench("--size 1025 --frames 10"),
    "measure": Bench("--size 513 --radius 5000"),
    "memory": Bench(
        "--size 1025 --picture 512x512 --only build --only render --only light --only movie --only compare"
    ),
    "methods": Bench("--size 65"),
    "mosaic": Bench("--size 1025 --tiles 4", summary=True, data=True, least="california-3s-tiles"),
    "movie": Bench("--frames 3 --size 320x180", data=True, least=HGT),
    "occlusion": Bench("--size 32 --radius 300 --only sweep"),
    "promise": Bench(
        "--views 1 --terrain bigtujunga --method soar",
        summary=True,
        data=True,
        least="bigtujunga-srtm30m-utm",
    ),
    "raster": Bench("--size 401 --repeat 1", data=True),
    "render": Bench("--runs 1 --size 1025", summary=True, data=True),
    "roam": Bench("--size 1025 --frames 8"),
    "shimmer": Bench("--terrain noise --size 160x90 --frames 3", data=True, gpu=True),
    "soar": Bench("--size 1025 --rounds 3", summary=True, programs=("g++",)),
    "store_build": Bench("--size 1025 --rounds 1", summary=True, modules=("rio_cogeo",)),
    "store_read": Bench("--size 1025", summary=True, modules=("zarr", "tensorstore")),
    "threshold_spheres": Bench("--size 1025 --frames 8"),
    "tin": Bench(
        "--size 513 --max-error 5", summary=True, modules=("pydelatin", "meshoptimizer", "fast_simplification")
    ),
    "triangle_patches": Bench("--part select", data=True),
    "view": Bench(
        f"--frames 12 --size 320x180 --terrain {{data}}/{HGT}", data=True, gpu=True, least="california-3s-tiles"
    ),
    "window": Bench("--runs 1", path=HGT, modules=("rendercanvas", "imgui_bundle"), programs=("Xvfb",), gpu=True),
}


def lacks(bench: Bench, data: Path) -> str | None:
    """What a benchmark needs and this machine lacks; None if nothing."""
    for name in bench.modules:
        if importlib.util.find_spec(name) is None:
            return f"the Python module {name}"
    for name in bench.programs:
        if shutil.which(name) is None:
            return f"the program {name}"
    for path in filter(None, (bench.path, bench.least)):
        if not (data / path).exists():
            return f"{path} of the open data (looked for at {data})"
    if bench.gpu and importlib.util.find_spec("wgpu") is None:
        return "the Python module wgpu"
    if bench.gpu:
        from orograph.gpu.device import NoAdapterError, choose

        try:
            choose()
        except NoAdapterError as error:
            return f"a GPU ({error})"
    return None


def run(name: str, bench: Bench, quick: bool, data: Path) -> bool:
    """Run one; return whether it succeeded."""
    command = [sys.executable, str(HERE / f"{name}.py")]
    command += [str(data / bench.path)] if bench.path else []
    command += ["--data", str(data)] if bench.data else []
    command += bench.quick.format(data=data).split() if quick else []
    child = subprocess.Popen(command, start_new_session=True)
    try:
        code = child.wait(LONGEST if quick else None)
    except subprocess.TimeoutExpired:
        print(f"{name}: stopped after {LONGEST} s, which is as long as it may take here", flush=True)
        code = 0
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    if code:
        print(f"{name}: failed ({code})", flush=True)
    return code == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument(
        "--quick", action="store_true", help="small forms of those in the summary, less than ten minutes in all"
    )
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data")
    given = parser.parse_args()
    if unknown := set(given.names) - set(BENCHES):
        parser.error(f"there is no benchmark {', '.join(sorted(unknown))}; there are {', '.join(BENCHES)}")
    failed = []
    names = given.names or [name for name in BENCHES if BENCHES[name].summary or not given.quick]
    for name in names:
        print(f"== {name}", flush=True)
        lacking = lacks(BENCHES[name], given.data)
        if lacking is not None:
            print(f"{name}: left out, it lacks {lacking}", flush=True)
            continue
        began = time.perf_counter()
        if not run(name, BENCHES[name], given.quick, given.data):
            failed.append(name)
        print(f"({time.perf_counter() - began:.0f} s)", flush=True)
    if others := [name for name in BENCHES if name not in names and not given.names]:
        print(
            f"Left out of the short form, for the summary does not give them (name one to run it): {', '.join(others)}"
        )
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
