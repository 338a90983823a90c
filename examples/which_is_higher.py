"""Which of two floating things is higher, and by how much? The task of Tory et al. 2006 as stimuli.

Pairs of balloons float over the ground; each pair is drawn bare, and with each cue. A reader is told where in the
picture a balloon and the foot of its pole are, and measures its height by pixels, camera and map: where a drop line
ends, how many bands a pole has, where the middle of a shadow lies. Written are the pictures
(``OUT/pair-01-poles.png``…) and the truth (``OUT/truth.csv``); printed is how far readings are off, in metres and in
what a pixel is worth there, and how often the higher one is told.

    python examples/which_is_higher.py DEM -o OUT [--pairs 12] [--seed 1]
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np

import orograph
from orograph.measuring.ground import heights
from orograph.scene.contours import round_number

SIZE = (1200, 800)
CUES = ("none", "drops", "poles", "shadows")
BALLOON = 6.0
"""Pixels from a balloon's middle within which it hides its pole."""

BANDS = 4
"""Of a pole: its plates, at every fifth boundary, are not read."""


def stimulus(terrain: Any, rng: np.random.Generator) -> tuple[Any, list[tuple[float, float, float]]]:
    """A camera and a pair of balloons, easting, northing and metres above ground, the left one in the picture first."""
    west, south, east, north = terrain.grid.bounds()
    view = orograph.camera.around(terrain, SIZE, azimuth=rng.uniform(0, 360), pitch=rng.uniform(20, 40))
    longer = max(east - west, north - south)
    pair = [
        (west + u * (east - west), south + v * (north - south), float(rng.uniform(0.04, 0.12)) * longer)
        for u, v in rng.uniform(0.2, 0.8, (2, 2))
    ]
    return view, sorted(pair, key=lambda place: pixel(terrain, view, place, place[2])[0])


def ground_at(terrain: Any, place: tuple[float, float, float]) -> float:
    """The height of the ground below a balloon, as the map has it."""
    col, row = terrain.grid.index(np.array([place[0]]), np.array([place[1]]))
    return float(heights(terrain, col, row)[0])


def pixel(terrain: Any, view: Any, place: tuple[float, float, float], above: float) -> Any:
    """Where in the picture is what floats so high over a balloon's place."""
    xy, _ = view.project(np.array([[place[0], place[1], ground_at(terrain, place) + above]]))
    return xy[0]


def worth(terrain: Any, view: Any, place: tuple[float, float, float]) -> float:
    """Metres of height that a pixel is worth at a balloon."""
    return 1.0 / float(np.hypot(*(pixel(terrain, view, place, place[2]) - pixel(terrain, view, place, place[2] - 1))))


def draw(terrain: Any, view: Any, pair: list[tuple[float, float, float]], cue: str, step: float) -> Any:
    """The picture of a pair with a cue."""
    columns = dict(zip("xyz", np.array(pair).T)) | {"value": np.ones(2)}
    size = 0.018 * max(terrain.grid.shape) * max(terrain.grid.spacing)
    data = orograph.Dataset(columns, variable="value", above="z", size=size, range=(0.0, 1.0), colormap="magma")
    aids = None if cue == "none" else f"poles={step:g}" if cue == "poles" else cue
    return orograph.render(terrain, view, data=data, aids=aids, colormap="grey", samples=16)


def read(
    cue: str, terrain: Any, view: Any, pictures: dict[str, Any], place: tuple[float, float, float], step: float
) -> float | None:  # fmt: skip
    """Metres above ground of a balloon as a cue shows it; None: the cue is hidden by ground.

    Pixels that differ from the bare picture are the cue's. Of the foot of a drop line or pole, or the middle of a
    shadow, the picture's depth says where on the ground it is; the balloon is straight above it.
    """
    bare, aided = pictures["none"], pictures[cue]
    differs = np.abs(aided.pixels.astype(int) - bare.pixels).max(-1) > 12
    top, foot = pixel(terrain, view, place, place[2]), pixel(terrain, view, place, 0.0)
    rows, cols = np.nonzero(differs)
    beside = np.abs((cols + 0.5 - top[0]) - (foot[0] - top[0]) * (rows + 0.5 - top[1]) / (foot[1] - top[1]))
    reach = 0.9 * (foot[1] - top[1])
    own = (beside < (9 if cue == "shadows" else 4)) & (rows > top[1] - 9) & (rows < foot[1] + reach)
    if not own.any():
        return None
    if cue == "poles":
        return bands(aided.pixels, foot, top, step, horizon(terrain, view, place))
    if cue == "drops":
        row = rows[own].max()
        col = cols[own][rows[own] == row].mean()
    else:
        row, col = rows[own].mean(), cols[own].mean()
    there = bare.places()[round(row), round(col)]
    if not np.isfinite(there[0]):
        return None
    # The balloon's own middle is seen at ``top``; how high it must be to be seen there, straight above the foot:
    levels = np.linspace(0, 3 * place[2], 3000)
    line = np.column_stack([np.full(3000, there[0]), np.full(3000, there[1]), there[2] + levels])
    xy, _ = view.project(line)
    return float(levels[np.argmin(np.abs(xy[:, 1] - top[1]))])


def horizon(terrain: Any, view: Any, place: tuple[float, float, float]) -> float:
    """One by the distance, in parts of foot to balloon, of where verticals meet in the picture: the camera's alone."""
    foot, top, far = (pixel(terrain, view, place, k * place[2]) for k in (0, 1, 2))
    return float(2 * np.hypot(*(top - foot)) / np.hypot(*(far - foot)) - 1)


def bands(pixels: Any, foot: Any, top: Any, step: float, bent: float) -> float | None:
    """Metres by the bands of a pole from its foot to the balloon's middle: those that are whole, and of the last a part
    by how long the others are, which the camera foreshortens (``horizon``); None: none is seen whole."""
    along = np.linspace(0, 1, 2000)
    at = foot + along[:, None] * (top - foot)
    col, row = np.clip(np.floor(at).astype(int), 0, [SIZE[0] - 1, SIZE[1] - 1]).T
    color = pixels[row, col].astype(int)
    orange, dark = color[:, 0] - color[:, 2] > 70, color.max(1) < 90
    shade = np.where(orange, 1, np.where(dark, -1, 0))
    known = np.flatnonzero(shade)
    turn = shade[known[1:]] != shade[known[:-1]]
    changes = (along[known[1:]] + along[known[:-1]])[turn] / 2  # (between the last of one and the first of the other)
    changes = changes[changes < 1 - BALLOON / np.hypot(*(top - foot))]
    if not len(changes):
        return None
    last = changes[-1]
    return float(step * len(changes) * (1 - last * bent) / last / (1 - bent))


def main() -> None:
    parser = argparse.ArgumentParser(description="Stimuli: which of two floating things is higher, and by how much?")
    parser.add_argument("dem")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    terrain = orograph.terrain(given.dem)
    rows: list[dict[str, Any]] = []
    readings: dict[str, list[tuple[float, float, float]]] = {cue: [] for cue in CUES[1:]}
    answers: dict[str, list[bool]] = {cue: [] for cue in CUES[1:]}
    rng = np.random.default_rng(given.seed)
    for number in range(1, given.pairs + 1):
        view, pair = stimulus(terrain, rng)
        truth = [above for _, _, above in pair]
        row: dict[str, Any] = {"pair": number, "higher": "left" if truth[0] > truth[1] else "right",
                               "by_m": round(abs(truth[0] - truth[1]), 1)}  # fmt: skip
        step = round_number(max(truth) / BANDS)
        pictures = {cue: draw(terrain, view, pair, cue, step) for cue in CUES}
        for cue, picture in pictures.items():
            picture.save(given.out / f"pair-{number:02d}-{cue}.png")
        for cue in CUES[1:]:
            found = [read(cue, terrain, view, pictures, place, step) for place in pair]
            for place, one in zip(pair, found):
                if one is not None:
                    readings[cue].append((place[2], one, worth(terrain, view, place)))
            if None not in found:
                answers[cue].append((found[0] > found[1]) == (truth[0] > truth[1]))
        rows.append(row)
    with (given.out / "truth.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    print("cue      read  error: median     95 %  in pixels' worth: median  95 %  right")
    for cue, several in readings.items():
        true, found, pixel = np.array(several).T
        off = np.abs(found - true)
        print(
            f"{cue:8} {len(true):4} {np.median(off):12.1f} m {np.quantile(off, 0.95):6.1f} m "
            f"{np.median(off / pixel):24.2f} {np.quantile(off / pixel, 0.95):5.2f} {np.mean(answers[cue]):6.0%}"
        )


if __name__ == "__main__":
    main()
