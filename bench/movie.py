"""The cost of a movie frame on the CPU, compared with a single picture, by stage.

    python bench/movie.py [--data ../shared/data] [--frames 12] [--size 1280x720]

An orbit around an SRTM tile (all in view) and a low flight over it, with sun, shadows, sky and antialiasing. "alone": a
new renderer draws every frame, as ``orograph render`` does (without start-up). "film": one renderer draws all frames,
and the first is left out. The stages are the backend's own (``Picture.facts["seconds"]``), in ms, as medians.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from orograph.lighting.sun import Sun
from orograph.rendering.cpu.draw import draw, session
from orograph.scene.scene import Scene
from orograph.store.prepare import prepare
from orograph.touring import Tour, make
from orograph.touring.film import Film

STAGES = ("heights", "rays", "light", "color", "antialiasing")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--size", default="1280x720")
    given = parser.parse_args()
    tile = given.data / "n44w072-hgt" / "N44W072.hgt"
    if not tile.is_file():
        print(f"(the data is not at {given.data})")
        return
    size = tuple(int(v) for v in given.size.split("x"))
    terrain = prepare([str(tile)])
    grid = terrain.grid
    line = np.array([grid.xy(0.2 * grid.cols, 0.7 * grid.rows), grid.xy(0.8 * grid.cols, 0.4 * grid.rows)], float)
    tours: dict[str, Tour] = {
        "orbit": make.orbit(terrain, size, seconds=30.0),
        "low flight": make.flyover(terrain, size, line, height=800.0),
    }
    print(
        f"| tour, {given.size} | ms/frame | " + " | ".join(STAGES) + " |\n|---" * 1 + "|---" * (len(STAGES) + 1) + "|"
    )
    for name, tour in tours.items():
        base = Scene.of(terrain, tour.at(0.0), sun=Sun(315, 35), sky=True)
        kept = session()
        film = Film(tour, base, draw=kept)
        numbers = range(0, len(film), 1)[: given.frames + 1]
        film.picture(numbers[0])
        for label, painter in (("alone", draw), ("film", kept)):
            took: list[float] = []
            stages: dict[str, list[float]] = {stage: [] for stage in STAGES}
            for number in numbers[1:]:
                scene = film.scene(number)
                began = time.perf_counter()
                picture = painter(scene)
                took.append(time.perf_counter() - began)
                for stage in STAGES:
                    stages[stage].append(picture.facts["seconds"][stage])
            cells = [f"{1e3 * statistics.median(stages[stage]):.0f}" for stage in STAGES]
            print(f"| {name}, {label} | {1e3 * statistics.median(took):.0f} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
