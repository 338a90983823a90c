"""The cost of many inputs: a mosaic of many tiny tiles in one projected CRS is opened and built.

    python bench/inputs.py FOLDER [COLUMNS ROWS]        makes the tiles (200 × 130 of 32² samples) and times all steps

Existing tiles are reused. Printed are seconds, the most files that all processes had open at once, and the peak memory
of this process and of the largest of the others.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

SIDE = 32


def make(folder: Path, across: int, down: int) -> list[str]:
    """The tiles' paths; missing tiles are written."""
    import rasterio
    from affine import Affine

    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for i in range(down):
        for j in range(across):
            path = folder / f"t{i:04}_{j:04}.tif"
            made.append(str(path))
            if path.exists():
                continue
            rows = np.arange(i * SIDE, (i + 1) * SIDE)[:, None]
            cols = np.arange(j * SIDE, (j + 1) * SIDE)
            heights = (1000 + 400 * np.sin(rows / 97) * np.cos(cols / 131)).astype(np.int16)
            place = Affine(30, 0, 500_000 + 30 * SIDE * j, 0, -30, 5_000_000 - 30 * SIDE * i)
            with rasterio.open(
                path, "w", driver="GTiff", width=SIDE, height=SIDE, count=1, dtype="int16", nodata=-32768,
                crs="EPSG:32632", transform=place,
            ) as file:  # fmt: skip
                file.write(heights, 1)
    return made


class Watch:
    """Records the most open files and the peak memory while it runs.

    Files are those of this process and its children; memory (MiB) is that of this process, and of the largest child.
    """

    def __enter__(self) -> Watch:
        self.files, self.own, self.others, self._end = 0, 0, 0, threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    def _look(self) -> None:
        own = psutil.Process()
        while not self._end.wait(0.2):
            with contextlib.suppress(psutil.NoSuchProcess):
                others = own.children(recursive=True)
                self.files = max(self.files, sum(each.num_fds() for each in (own, *others)))
                self.own = max(self.own, own.memory_info().rss >> 20)
                self.others = max([self.others, *(each.memory_info().rss >> 20 for each in others)])

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def spent() -> float:
    """Processor seconds of this process and of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def timed(label: str, work: Callable[[], object]) -> None:
    """Run a step and report its cost."""
    began, cpu, own = time.perf_counter(), spent(), time.process_time()
    with Watch() as seen:
        work()
    seconds, cpu, own = time.perf_counter() - began, spent() - cpu, time.process_time() - own
    print(
        f"{label:24} {seconds:6.1f} s, {cpu:6.1f} s of processors, {own:6.1f} of them this process's; {seen.files} "
        f"files open, {seen.own} and {seen.others} MiB at most",
        flush=True,
    )


def steps(files: list[str], folder: Path) -> dict[str, Callable[[], object]]:
    """The timed steps, by name."""
    from orograph.dem.mosaic import Mosaic
    from orograph.store.build import build
    from orograph.verbs.manifest import manifest

    listed = folder / "tiles.manifest.geojsonl"
    how: dict[str, Any] = {"overwrite": True, "errors": (), "progress": False}
    return {
        "opening": lambda: Mosaic.open(files),
        "build": lambda: build(files, folder / "a.oro", **how),
        "build, two workers": lambda: build(files, folder / "c.oro", workers=2, max_memory="3GiB", **how),
        "manifest": lambda: manifest(files, listed, progress=False),
        "manifest again": lambda: manifest(files, listed, progress=False),
        "opening the manifest": lambda: Mosaic.open(listed),
        "build of the manifest": lambda: build(listed, folder / "b.oro", **how),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("columns", type=int, nargs="?", default=200)
    parser.add_argument("rows", type=int, nargs="?", default=130)
    parser.add_argument("--only", action="append", help="a step, by its name; may be repeated")
    given = parser.parse_args()
    files = make(given.folder / "tiles", given.columns, given.rows)
    for name, work in steps(files, given.folder).items():
        if given.only is None or name in given.only:
            timed(name, work)


if __name__ == "__main__":
    main()
