"""What many inputs cost: a mosaic of so many tiny tiles of one projected CRS, made once, is opened, and built.

    python bench/inputs.py FOLDER [COLUMNS ROWS]        makes the tiles (200 × 130 of 32² samples) and times them

Told are seconds, the most files that were open at once, and the process's peak memory.
"""

from __future__ import annotations

import resource
import sys
import threading
import time
from pathlib import Path

import numpy as np

SIDE = 32


def make(folder: Path, across: int, down: int) -> list[str]:
    """The tiles' paths; those that are not there are written."""
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


class OpenFiles:
    """The most file descriptors that this process has had open while this ran."""

    def __enter__(self) -> OpenFiles:
        self.most, self._end = 0, threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    def _look(self) -> None:
        while not self._end.wait(0.05):
            self.most = max(self.most, len(list(Path("/proc/self/fd").iterdir())))

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def timed(label: str, work: object) -> object:
    """Do it, and tell what it took."""
    began, cpu = time.perf_counter(), time.process_time()
    with OpenFiles() as files:
        made = work()  # type: ignore[operator]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    print(
        f"{label:28} {seconds:7.1f} s ({cpu:6.1f} s of processor), {files.most} files open, {peak} MiB at most",
        flush=True,
    )
    return made


def main() -> None:
    from orograph.dem.mosaic import Mosaic
    from orograph.store.build import build
    from orograph.verbs.manifest import manifest

    folder = Path(sys.argv[1])
    across, down = map(int, sys.argv[2:4] or (200, 130))
    files = make(folder / "tiles", across, down)
    listed = folder / "tiles.manifest.geojsonl"
    timed("manifest", lambda: manifest(files, listed, progress=False))
    timed("manifest again", lambda: manifest(files, listed, progress=False))
    timed("opening the manifest", lambda: Mosaic.open(listed))
    timed("build of the manifest", lambda: build(listed, folder / "b.oro", overwrite=True, errors=(), progress=False))
    mosaic = timed("opening", lambda: Mosaic.open(files))
    timed("fingerprint", lambda: mosaic.fingerprint())
    timed("build", lambda: build(files, folder / "a.oro", overwrite=True, errors=(), progress=False))


if __name__ == "__main__":
    main()
