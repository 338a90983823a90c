"""What a film sets for all of its frames."""

from __future__ import annotations

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.lighting.sun import passage
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.touring import Key, Tour
from orograph.touring.film import Film
from orograph.viewpoint import View


def test_contours_have_one_interval_for_all_of_a_film_and_labels_that_fade() -> None:
    """A dive from 60 km to 2 km: every frame by itself would have its own interval."""
    row, col = np.mgrid[:200, :200]
    grid = Grid((200, 200), Affine(50.0, 0, 500_000, 0, -50.0, 5_000_000), CRS.from_epsg(32632))
    terrain = in_memory(Dem((10.0 * row + 5.0 * np.sin(col / 9)).astype(np.float32), grid))
    target = (505_000.0, 4_995_000.0, 1000.0)
    keys = [Key(View((505_000.0, 4_995_000.0 - d / 2, 1000.0 + d), target), time=t) for t, d in ((0, 6e4), (4, 2e3))]
    film = Film(Tour(tuple(keys)), Scene.of(terrain, keys[0].view, contours=Contours()))
    found = {film.scene(n).annotations.contours for n in (0, len(film) // 2, len(film) - 1)}
    assert len(found) == 1
    (contours,) = found
    assert contours is not None and contours.fading and contours.interval is not None
    asked = Film(Tour(tuple(keys)), Scene.of(terrain, keys[0].view, contours=Contours(30.0)))
    assert asked.scene(0).annotations.contours.interval == 30.0  # type: ignore[union-attr]
    assert Film(Tour(tuple(keys)), Scene.of(terrain, keys[0].view)).scene(0).annotations.contours is None


def test_the_note_of_a_film_is_a_clock() -> None:
    row, col = np.mgrid[:40, :40]
    grid = Grid((40, 40), Affine(50.0, 0, 500_000, 0, -50.0, 5_000_000), CRS.from_epsg(32632))
    terrain = in_memory(Dem((10.0 * row + 5.0 * np.sin(col / 9)).astype(np.float32), grid))
    view = View((501_000.0, 4_997_000.0, 3000.0), (501_000.0, 4_999_000.0, 200.0))
    moving = Tour((Key(view, 0.0),), seconds=2, fps=2, passage=passage("2026-06-21T06:00+02:00..18:00"))
    film = Film(moving, Scene.of(terrain, view, relief=0.0))
    said = [film.scene(number).lighting.sun.words for number in film.numbers]
    assert [words.split(", sun")[0] for words in said] == [
        f"21 Jun 2026 {hour:02}:00 +02:00" for hour in (6, 9, 12, 15)
    ]
