"""A store built from a store: from itself it gets what it lacks, elsewhere it is copied; the bytes of a new build."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer
from test_updating import objects, tile

import orograph
from orograph.errors import OrographError, ReadError, StoreError, UsageError
from orograph.progress import Progress, Task
from orograph.store.adding import ASKED

PLACE: dict[str, Any] = {"transform": Affine(10, 0, 500_000, 0, -10, 4_000_000), "crs": "EPSG:32611"}
SHARDS: dict[str, Any] = {"shard": 64, "chunk": 32, "progress": False}


@pytest.fixture(scope="module")
def heights() -> np.ndarray:
    rng = np.random.default_rng(7)
    found = (100 + rng.normal(0, 3, (170, 150)).cumsum(0)).clip(1, 199).astype(np.float32)
    found[40:50, 60:90] = np.nan
    return found


def built(heights: np.ndarray, place: Path, **options: Any) -> Path:
    orograph.build(heights, place, **PLACE, **SHARDS, **options).close()
    return place


def samples(store: Path) -> dict[str, str]:
    """Digests of its shards."""
    return {key: digest for key, digest in objects(store).items() if not key.endswith("zarr.json")}


NEEDS = [
    {"tins": 8}, {"quadtin": (0, "nearest")}, {"chunked": (16, 0)}, {"errors": "wedgie"},
    {"tins": 4, "chunked": (16, 0, True), "errors": ("exact", "wedgie")},
]  # fmt: skip


@pytest.mark.cases(3)
@pytest.mark.parametrize("needs", NEEDS, ids=lambda needs: "-".join(needs))
def test_what_is_added_is_what_a_new_build_makes(heights: np.ndarray, needs: dict[str, Any], tmp_path: Path) -> None:
    place = built(heights, tmp_path / "a.oro")
    before = samples(place)
    orograph.build(place, place, progress=False, **needs).close()
    assert before.items() <= samples(place).items()
    whole = {**needs, "errors": ("exact", *np.atleast_1d(needs.get("errors", ())))}
    assert objects(place) == objects(built(heights, tmp_path / "b.oro", **whole))
    assert not (place / "parts").exists()
    written = (place / "zarr.json").stat().st_mtime_ns
    with orograph.open(place) as terrain:
        orograph.build(terrain, terrain.url, progress=False, **needs).close()  # nothing is lacking
    assert (place / "zarr.json").stat().st_mtime_ns == written


class Stopped(Exception):
    """As if the process were killed."""


class Stops(Progress):
    """Stops at the nth step of a task."""

    def __init__(self, what: str, steps: int) -> None:
        self.what, self.steps = what, steps

    def task(self, what: str, total: float | None = None) -> Task:
        return self.Counted(self) if what == self.what else Task()

    class Counted(Task):
        def __init__(self, stops: Stops) -> None:
            self.stops = stops

        def advance(self, *_: Any, **__: Any) -> None:
            self.stops.steps -= 1
            if self.stops.steps < 0:
                raise Stopped


@pytest.mark.parametrize("again", [{"tins": 4}, {"tins": 8}], ids=["the same", "another"])
def test_an_interrupted_run_leaves_the_store_and_goes_on(
    heights: np.ndarray, again: dict[str, Any], tmp_path: Path
) -> None:
    place = built(heights, tmp_path / "a.oro")
    before = (place / "zarr.json").read_bytes()
    with pytest.raises(Stopped):
        orograph.build(place, place, tins=4, progress=Stops("Making TINs", 2))
    assert (place / ASKED).exists() and (place / "zarr.json").read_bytes() == before
    with orograph.open(place) as terrain:
        assert np.array_equal(terrain.read(0, 0, 170, 0, 150), heights, equal_nan=True)
    orograph.build(place, place, progress=False, **again).close()
    assert objects(place) == objects(built(heights, tmp_path / "b.oro", **again))


def test_what_cannot_be_added(heights: np.ndarray, tmp_path: Path) -> None:
    place = built(heights, tmp_path / "a.oro", tins=4)
    before = objects(place)
    for options, words in (
        ({"tins": 8}, "`tins` of 4, not of 8.*overwrite"), ({"max_error": 0.1}, "A store is there already"),
        ({"workers": 2, "chunked": (16, 0)}, "A cluster cannot add"), ({"crs": "EPSG:32610"}, "already built"),
        ({"keep": 3, "chunked": (16, 0)}, "keep"),
    ):  # fmt: skip
        with pytest.raises(OrographError, match=words):
            orograph.build(place, place, progress=False, **options)
    assert objects(place) == before


def test_a_store_that_is_updated_goes_on_being_updated(tmp_path: Path) -> None:
    files = [tile(tmp_path, 0, j, 0) for j in range(3)]
    place = tmp_path / "a.oro"
    orograph.build(files, place, update=True, **SHARDS).close()
    orograph.build(place, place, tins=4, errors="exact,midpoint", progress=False).close()
    needs: dict[str, Any] = {"tins": 4, "errors": ("exact", "midpoint")}
    orograph.build(files, tmp_path / "b.oro", **needs, **SHARDS).close()
    assert objects(place) == objects(tmp_path / "b.oro")
    tile(tmp_path, 0, 2, 1)
    orograph.build(files, place, update=True, **needs, **SHARDS).close()
    orograph.build(files, tmp_path / "b.oro", overwrite=True, **needs, **SHARDS).close()
    assert objects(place) == objects(tmp_path / "b.oro")


@pytest.mark.stress
def test_a_copy_of_a_store_and_of_a_part(heights: np.ndarray, tmp_path: Path) -> None:
    place = built(heights, tmp_path / "a.oro")
    orograph.build(str(place), tmp_path / "b.oro", tins=4, **SHARDS).close()
    assert objects(tmp_path / "b.oro") == objects(built(heights, tmp_path / "c.oro", tins=4))
    with orograph.build([place], tmp_path / "d.oro", max_error=0.05, codec="compact", **SHARDS) as small:
        assert np.nanmax(np.abs(small.read(0, 0, 170, 0, 150) - heights)) <= 0.05 * (1 + 1e-6)
    to_degrees = Transformer.from_crs("EPSG:32611", 4326, always_xy=True)
    west, south, east, north = to_degrees.transform_bounds(500_000, 3_998_310, 501_490, 4_000_000)
    half = (west, south, (west + east) / 2, north)
    with orograph.build(place, tmp_path / "e.oro", bbox=half, **SHARDS) as part:
        assert part.grid.rows >= 165 and part.grid.cols < 90
    with pytest.raises(ReadError, match="This is a store: give it alone"):
        orograph.build([place, place], tmp_path / "f.oro", progress=False)
    with pytest.raises(UsageError, match="`crs` cannot be used with a store"):
        orograph.build(place, tmp_path / "f.oro", crs="EPSG:32610", progress=False)


def test_a_copy_says_that_it_lacks_the_original_samples(tmp_path: Path) -> None:
    path = tmp_path / "degrees.tif"
    x = np.arange(60)
    with rasterio.open(path, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32", crs="EPSG:4326",
                       transform=Affine(1 / 1200, 0, -84, 0, -1 / 1200, 36)) as file:  # fmt: skip
        file.write(np.float32(np.add.outer(x, 2 * x)), 1)
    orograph.build(path, tmp_path / "a.oro", progress=False).close()
    for name, area in (("b.oro", None), ("c.oro", (-84.0, 35.96, -83.97, 36.0))):
        with pytest.warns(UserWarning, match="are not copied, only the heights of its surface"):
            orograph.build(tmp_path / "a.oro", tmp_path / name, bbox=area).close()
    with orograph.build(tmp_path / "a.oro", tmp_path / "a.oro", tins=4, progress=False) as itself:
        assert itself.samples is not None


def test_another_process_at_work_is_respected(heights: np.ndarray, tmp_path: Path) -> None:
    from orograph.store.addresses import storage_at
    from orograph.store.lock import alone

    place = built(heights, tmp_path / "a.oro")
    with alone(storage_at(place), "baking light into this store"), pytest.raises(StoreError, match="baking light"):
        orograph.build(place, place, tins=4, progress=False)
