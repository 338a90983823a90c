"""Writes ``src/orograph/kernels.txt``: the kernels that each kind of work needs, recorded from runs on small hills.

    python bench/kernels.py [--check] [WORK...]

Run it after a change to a kernel's arguments or to what a verb calls. ``--check`` only reports differences. Each kind
of work runs in a process of its own, which shows the kernels that it loads.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine

import orograph
from orograph._needed import PACKAGE, Kernel, lines, written

SIDE = 300
"""Samples along a side of the hill: more than one tile."""

REST = "rest"
"""Less common work, whose kernels belong to none of the others."""

BY_CHANCE = {"orograph.lod.soar_join"}
"""Modules of kernels that run if a thread was free to help: once they are in the list, they stay there."""


def write_hills(folder: Path) -> None:
    """Write hills in three forms.

    A hill with a hole and level ground: as whole metres in degrees, as fractions of metres in metres, and as a store.
    """
    x = np.linspace(-2, 2, SIDE)
    heights = 900 * np.exp(-np.add.outer(x * x, x * x)) + 20 * np.sin(9 * np.add.outer(x, -x))
    heights[40:60, 200:240] = heights[50, 220]
    heights[200:220, 40:60] = -32768
    shape: dict[str, Any] = {"driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "nodata": -32768}
    degrees, metres = folder / "degrees.tif", folder / "metres.tif"
    for path, dtype, crs, transform in (
        (degrees, "int16", "EPSG:4326", Affine(1 / 1200, 0, -84, 0, -1 / 1200, 36)),
        (metres, "float32", "EPSG:32617", Affine(90, 0, 300000, 0, -90, 4000000)),
    ):
        with rasterio.open(path, "w", dtype=dtype, crs=crs, transform=transform, **shape) as file:
            file.write(heights.astype(dtype), 1)
    orograph.build(metres, folder / "hill.oro", progress=False)


def works(folder: Path) -> dict[str, Callable[[], Any]]:
    """Typical work in a folder of hills, by the names that ``expect`` knows."""
    degrees, metres, store, size = folder / "degrees.tif", folder / "metres.tif", folder / "hill.oro", (640, 360)
    line = np.array([[310000.0, 3990000.0], [322000.0, 3979000.0]])
    corners = np.vstack([line, [[310500.0, 3979500.0]]])
    measure = orograph.measure

    def each(work: Callable[[Path], Any], *paths: Path) -> Callable[[], Any]:
        return lambda: [work(path) for path in paths]

    def errors() -> None:
        orograph.terrain(metres).derived("diamonds", error="exact")

    def on_gpu(path: Path) -> None:
        orograph.render(path, size=size, backend="gpu", progress=False)

    def rest() -> None:
        for path in (metres, store):
            terrain = orograph.terrain(path)
            measure.profile(terrain, line)
            measure.area(terrain, [corners])
            on_gpu(path)
        orograph.render(store, "plan", size=size, contours="auto", silhouettes=True, progress=False)
        orograph.light(metres, "sky-view-factor", progress=False)

    def viewshed(path: Path) -> None:
        measure.viewshed(orograph.terrain(path), line[0], radius=2000.0).values()

    return {
        "render": each(lambda path: orograph.render(path, size=size, furniture=True, progress=False), degrees, metres),
        "ao": lambda: orograph.render(degrees, size=size, light="ao", progress=False),
        "mesh": lambda: orograph.render(metres, size=size, method="soar", progress=False),
        "build": each(lambda path: orograph.build(path, folder / "another.oro", progress=False), degrees),
        "errors": errors,
        "tessellate": each(lambda path: orograph.tessellate(path, tolerance=2, progress=False), metres, store),
        "tin": lambda: orograph.tin(metres, max_error=5, progress=False),
        "compare": lambda: orograph.compare(metres, methods=["soar"], size=size, progress=False),
        "viewshed": each(viewshed, metres, store),
        REST: rest,
    }


def loaded() -> Iterator[tuple[Kernel, int]]:
    """The kernels that this process has called, with the bytes of their machine code."""
    seen = set()
    for module in [m for name, m in sys.modules.items() if name.startswith("orograph.")]:
        for found in list(vars(module).values()):
            kernel = vars(found).get("alone") if type(found).__name__ == "Linked" else found
            if type(kernel).__name__ != "CPUDispatcher" or kernel in seen:
                continue
            seen.add(kernel)
            function = kernel.py_func
            if not function.__module__.startswith("orograph."):
                continue
            for types in kernel.overloads:
                try:
                    text = written(types)
                except ValueError as error:
                    print(f"left out: {function.__module__}.{function.__qualname__}: {error}", file=sys.stderr)
                    continue
                yield Kernel(function.__module__, function.__qualname__, text), _bytes(kernel, types)


def _bytes(kernel: Any, types: tuple[Any, ...]) -> int:
    file = kernel._cache._cache_file
    name = file._load_index()[kernel._cache._index_key(types, kernel.targetctx.codegen())]
    return Path(file._data_path(name)).stat().st_size


def _do(work: str, folder: str) -> list[tuple[Kernel, int]]:
    works(Path(folder))[work]()
    return list(loaded())


def found(wanted: list[str]) -> dict[Kernel, tuple[set[str], int]]:
    """The kernels of these kinds of work: who needs them, and their size."""
    table: dict[Kernel, tuple[set[str], int]] = {}
    with tempfile.TemporaryDirectory() as folder:
        write_hills(Path(folder))
        for work in wanted:
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:  # which loads only what it calls
                for kernel, size in pool.submit(_do, work, folder).result():
                    table.setdefault(kernel, (set(), size))[0].add(work)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if the file differs")
    parser.add_argument("work", nargs="*")
    given = parser.parse_args()
    wanted = given.work or list(works(Path()))
    table = found(wanted)
    if given.check:
        differ = 0
        for work in set(wanted) - {REST}:
            real = {kernel for kernel, (tags, _) in table.items() if work in tags}
            listed = {kernel for tags, kernel in lines() if work in tags}
            for sign, kernels in (("+", real - listed), ("-", listed - real)):
                for kernel in kernels:
                    if kernel.module not in BY_CHANCE:
                        print(sign, work, kernel)
                        differ = 1
        raise SystemExit(differ)
    for tags, kernel in lines():
        if kernel.module in BY_CHANCE:
            table.setdefault(kernel, (set(), 0))[0].update(tags)
    rows = sorted(table.items(), key=lambda row: (-row[1][1], row[0]))
    text = "".join(f"{' '.join(sorted(tags - {REST}))}: {kernel}\n" for kernel, (tags, _) in rows)
    (PACKAGE / "kernels.txt").write_text(text)
    print(f"{len(rows)} kernels")


if __name__ == "__main__":
    main()
