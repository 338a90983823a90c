"""All products that follow from heights, made in every way of doing tasks: the same bytes as by one thread."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import rasterio
from test_clusters import client  # noqa: F401 (a fixture)
from test_clusters import written as geographic
from test_in_parts import files

from orograph import store
from orograph.geovis.color_store import store_colors
from orograph.lighting.bake import bake
from orograph.store.makers import MAKERS
from orograph.store.registry import KINDS

HOW = {
    "shard": 32, "chunk": 16, "jobs": 1, "errors": ("exact", "wedgie", "midpoint"), "tins": 8, "chunked": (32, 0),
    "quadtin": (2.0, "nearest"),
}  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A raster, and a store of it with all that a build makes, by one thread."""
    folder = tmp_path_factory.mktemp("products")
    dem = geographic(folder / "a.tif", shape=(250, 190))
    store.build(dem, folder / "whole", **HOW).close()
    return dem, folder / "whole"


def test_builds_make_all_kinds_but_those_put_in_later(whole):
    with store.open(whole[1]) as terrain:
        made = {name for name, kind in KINDS.items() if kind.of(terrain.record)}
    later = {name for name, kind in KINDS.items() if kind.later}
    assert made == set(MAKERS) and made | later | {"points"} == set(KINDS)


LONG = [pytest.param(way, marks=pytest.mark.stress) for way in ("threads", "workers", "parts, then threads")]


@pytest.mark.stress
@pytest.mark.parametrize("way", ["parts, then workers", *LONG])
def test_all_products_have_the_bytes_of_one_thread(whole, tmp_path, way, client):  # noqa: F811
    dem, expected = whole
    how = HOW | {"jobs": 3} if way == "threads" else HOW
    on = {"dask": client} if "workers" in way else {}
    if "parts" in way:
        for part in (3, 1, 2):
            store.build(dem, tmp_path / "s", part=(part, 3), **how)
        on["finish"] = True
    store.build(dem, tmp_path / "s", **how, **on).close()
    assert files(tmp_path / "s") == files(expected)


@pytest.fixture(scope="module")
def later(whole, tmp_path_factory):
    """What is put into complete stores: how, and the store of one thread."""
    target = tmp_path_factory.mktemp("later") / "one"
    shutil.copytree(whole[1], target)
    image = target.parent / "image.tif"
    with rasterio.open(whole[0]) as dem:
        profile = dem.profile | {"dtype": "uint8", "count": 3, "nodata": None}
        pattern = np.stack([np.indices(dem.shape).sum(0) * k % 251 for k in (1, 3, 7)]).astype(np.uint8)
    with rasterio.open(image, "w", **profile) as file:
        file.write(pattern)

    def put(into, **how):
        store_colors(into, image, max_memory=1 << 29, **how).close()
        bake(into, LIGHT, azimuths=4, **how).close()
        bake(into, "ambient-occlusion", azimuths=4, radius=300.0, **how).close()

    put(target, jobs=1)
    return put, target


LIGHT = ("sky-view-factor", "aperture")


@pytest.mark.stress
@pytest.mark.parametrize("way", ["workers", pytest.param("threads", marks=pytest.mark.stress)])
def test_what_is_put_in_later_has_the_bytes_of_one_thread(whole, later, tmp_path, way, client):  # noqa: F811
    put, expected = later
    shutil.copytree(whole[1], tmp_path / "s")
    put(tmp_path / "s", **({"jobs": 3} if way == "threads" else {"dask": client}))
    assert files(tmp_path / "s") == files(expected)
    with store.open(tmp_path / "s") as terrain:
        assert {name for name, kind in KINDS.items() if kind.later and kind.of(terrain.record)} == {"colors", "layers"}
