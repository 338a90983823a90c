"""The manual's pictures of focus and context, of scenarios in flight, and of panels.

    python bench/geovis_views.py FOLDER [focus] [flight] [panels]

The data and the terrain are those of ``geovis``: the temperature at noon over the west of Britain.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import orograph
from geovis import STRETCH, ground, members
from orograph.progress import SILENT
from orograph.rendering.backends import session
from orograph.scene.flying import Flight
from orograph.touring.film import Film
from orograph.touring.keys import Key
from orograph.touring.tour import Tour

WALES = [[[-5.0, 52.6], [-2.9, 52.6], [-2.9, 53.45], [-5.0, 53.45], [-5.0, 52.6]]]
ROUTE = [[-5.8, 52.3], [-4.0, 53.2], [-3.3, 54.6]]
"""Longitude and latitude."""


def shape(kind: str, coordinates: Any) -> dict[str, Any]:
    return {"type": kind, "coordinates": coordinates}


def focus() -> Image.Image:
    """A region, a corridor, a lens, and the surroundings of the eye."""
    terrain, data = ground(), members()
    near = 1.05 * orograph.camera.whole(terrain, (750, 525), exaggeration=STRETCH).distance
    chosen = (
        ("A region", "T-D-U-", orograph.Focus(shape("Polygon", WALES), "T+D+U+")),
        ("A corridor", "T+D-U-", orograph.Focus(shape("LineString", ROUTE), "T+D+U+", width=60_000, blend=20_000)),
        ("A lens", "T+D-U-", orograph.Focus("lens", "T-D+U-", at=(0.4, 0.55))),
        ("What is near", "T-D-U-", orograph.Focus("near", "T+D+U-", distance=near)),
    )
    return sheet([
        orograph.render(terrain, size=(750, 525), exaggeration=STRETCH, data=data, priority=priority, focus=where,
                        furniture=True, title=title, progress=False).pixels
        for title, priority, where in chosen
    ], 2)  # fmt: skip


def flight() -> Image.Image:
    """Frames of a film that climbs and then stays high above: approach, overflight, re-planning."""
    terrain = ground()
    size, keys = (480, 320), []
    for second, distance in ((0, 160_000), (10, 200_000), (20, 400_000), (30, 640_000), (90, 640_001)):
        view = orograph.camera.around(terrain, size, azimuth=200, pitch=35, distance=distance, exaggeration=STRETCH)
        keys.append(Key(view, float(second)))
    scenarios = Flight(3000, 8000, 1000, 8000)
    options = {"exaggeration": STRETCH, "data": members(), "flight": scenarios}
    film = Film.of(Tour(tuple(keys), fps=2.0, ease=False), terrain, size, options, draw=session(), fps=None, first=None,
                   last=None, progress=SILENT)  # fmt: skip
    return sheet([film.picture(2 * second).pixels for second in (2, 14, 18, 26, 29, 60)], 3)


def panels() -> Image.Image:
    """A map beside the relief, and the hours of a day."""
    terrain, data = ground(), members()
    hours = replace(data, uncertainty=None, time="2019-03-01", style="continuous")
    common: dict[str, Any] = {"exaggeration": STRETCH, "furniture": True, "progress": False}
    made = (
        orograph.render(terrain, size=(1300, 560), each="view", data=data, title="Noon in March 2019", **common),
        orograph.render(terrain, size=(1300, 900), each="time=2019-03-01", data=hours, title="1 March 2019", **common),
    )
    return sheet([picture.pixels for picture in made], 1)


def sheet(pictures: list[Any], columns: int) -> Image.Image:
    """Put pictures beside and below each other."""
    rows = [pictures[k : k + columns] for k in range(0, len(pictures), columns)]
    return Image.fromarray(np.concatenate([np.concatenate(row, 1) for row in rows]))


PICTURES = {"focus": focus, "flight": flight, "panels": panels}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, []])
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name in given.names or PICTURES:
        PICTURES[name]().save(given.folder / f"{name}.jpg", quality=88, optimize=True)
        print(given.folder / f"{name}.jpg", flush=True)


if __name__ == "__main__":
    main()
