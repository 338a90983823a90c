"""What a film sets for all of its frames."""

from __future__ import annotations

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
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
