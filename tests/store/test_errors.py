"""Errors of diamonds in memory and in a store: the same to the bit once quantised, whatever the shards and threads."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from surfaces import grid_of, rough, source

from orograph import store
from orograph.error import KINDS
from orograph.error.diamonds import diamonds
from orograph.error.encode import Encoder
from orograph.errors import StoreError, UsageError
from orograph.store.diamond_table import DIAMONDS
from orograph.store.diamonds import NESTED, gather, surface
from orograph.store.levels import subsample

HEIGHTS = rough((700, 530), 2, missing=0.001, hole=True)


def memory(heights):
    return store.MemoryTerrain(heights, grid_of(heights.shape), "rough")


def whole(terrain, kind, level):
    rows, cols = terrain.diamond_shape(level)
    return terrain.derived("diamonds", error=kind).read(level, 0, rows, 0, cols)


def quantised(heights, terrain, kind):
    """What a store should hold, made in memory: errors rounded up, spheres around rounded spheres."""
    record, plain = terrain.record, memory(heights)
    ground = surface(plain.grid, plain.tiles(0).minimum, plain.height_range[0])
    parts = diamonds(
        lambda a, b, c, d: heights[a:b, c:d],
        subsample(heights, NESTED),
        ground,
        (kind,),
        rounding=Encoder({}, DIAMONDS.of(record).radius),
        jobs=1,
    )
    errors, radii = gather(heights.shape, parts, kind)
    table = DIAMONDS.of(record).errors[kind].table
    return [table[np.searchsorted(table, e)] for e in errors], radii


def same_as_memory(heights, terrain):
    for kind in terrain.errors:
        errors, radii = quantised(heights, terrain, kind)
        for level in range(terrain.levels):
            ours = whole(terrain, kind, level)
            np.testing.assert_array_equal(ours[0], errors[level])
            empty = radii[level] < 0
            np.testing.assert_array_equal(ours[1] < 0, empty)
            np.testing.assert_array_equal(ours[1][~empty], radii[level][~empty])


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    path = tmp_path_factory.mktemp("errors") / "s"
    return store.build(source(HEIGHTS), path, shard=64, chunk=16, errors=KINDS).url


def test_a_store_holds_what_is_made_in_memory(built):
    with store.open(built) as terrain:
        assert terrain.errors == KINDS and terrain.levels == 3
        same_as_memory(HEIGHTS, terrain)
        assert terrain.check() == []


@settings(deadline=None, max_examples=8)
@given(st.integers(1, 300), st.integers(1, 300), st.sampled_from([(32, 8), (64, 64), (256, 32)]), st.integers(1, 3))
def test_any_shape_any_shards_any_threads(tmp_path_factory, rows, cols, sizes, jobs):
    heights = rough((rows, cols), rows, 0.01)
    url = tmp_path_factory.mktemp("any") / "s"
    with store.build(source(heights), url, shard=sizes[0], chunk=sizes[1], jobs=jobs) as terrain:
        assert terrain.errors == ("exact",)
        same_as_memory(heights, terrain)


@pytest.mark.stress
@settings(deadline=None, max_examples=40)
@given(st.data())
def test_any_window(built, data):
    with store.open(built) as terrain:
        level = data.draw(st.integers(0, terrain.levels - 1))
        rows, cols = terrain.diamond_shape(level)
        r0, c0 = data.draw(st.integers(0, rows)), data.draw(st.integers(0, cols))
        r1, c1 = data.draw(st.integers(r0, rows)), data.draw(st.integers(c0, cols))
        for ours, all_of_it in zip(
            terrain.derived("diamonds", error="exact").read(level, r0, r1, c0, c1),
            whole(terrain, "exact", level),
            strict=True,
        ):
            np.testing.assert_array_equal(ours, all_of_it[r0:r1, c0:c1])


def test_levels_hold_octaves(built):
    """Each vertex of the square has its diamond in one entry, errors fall from parents to children across levels."""
    terrain = memory(HEIGHTS)
    errors = [whole(terrain, "exact", level)[0] for level in range(terrain.levels)]
    top = terrain.levels - 1
    assert errors[top].shape == (257, 257) and errors[0].shape == HEIGHTS.shape
    for level in range(top):
        assert not errors[level][::2, ::2].any()
    for (row, col), children in {
        (512, 512): [(256, 512), (512, 256)],  # octave 9, a square one: edges of its own octave
        (256, 512): [(128, 384), (384, 640)],  # an edge one: squares of the octave below
        (4, 8): [(2, 6), (2, 10), (6, 6)],  # from the top level to the next
        (2, 4): [(1, 3), (3, 5)],
    }.items():

        def at(r, c):
            level = min(((r | c) & -(r | c)).bit_length() - 1, top)
            return errors[level][r >> level, c >> level]

        assert all(at(row, col) >= at(*child) for child in children)
    assert not errors[top][::256, ::256].any()


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (1, 9), (3, 1), (3, 3), (2, 5), (257, 257), (258, 30)])
@pytest.mark.parametrize("missing", [0.0, 1.0])
def test_small_and_empty_rasters(tmp_path, shape, missing):
    heights = np.full(shape, np.nan, np.float32) if missing else rough(shape)
    terrain = store.build(source(heights), tmp_path / "s", errors=KINDS)
    same_as_memory(heights, terrain)
    if missing or min(shape) == 1:
        for level in range(terrain.levels):
            errors, radii = whole(terrain, "exact", level)
            i, j = np.indices(errors.shape)
            here = ((i | j) & 1).astype(bool)
            here[:: len(here) - 1, :: len(here) - 1] &= level < terrain.levels - 1  # the square's corners
            assert not errors.any() and (radii[here] < 0).all()


def test_a_rotated_grid_has_longer_spheres():
    from affine import Affine

    from orograph.geo.grid import Grid

    heights = rough((65, 65))
    straight = store.MemoryTerrain(heights, Grid((65, 65), Affine.scale(30, -30)), "a")
    rotated = store.MemoryTerrain(heights, Grid((65, 65), Affine.rotation(30) @ Affine.scale(30, -30)), "b")
    longer = store.MemoryTerrain(heights, Grid((65, 65), Affine.scale(60, -60)), "c")
    a, b, c = (whole(t, "exact", 0) for t in (straight, rotated, longer))
    np.testing.assert_allclose(a[1], b[1], rtol=1e-6)
    np.testing.assert_array_equal(a[0], b[0])
    assert (c[1][1::2] > a[1][1::2]).all()


def test_kinds_share_their_spheres():
    terrain = memory(rough((70, 90)))
    assert whole(terrain, "exact", 0)[1].base is whole(terrain, "wedgie", 0)[1].base
    with pytest.raises(ValueError, match="read-only"):
        whole(terrain, "exact", 0)[0][1, 1] = 0


def test_what_is_not_there_is_said(tmp_path, built):
    terrain = store.build(source(HEIGHTS[:90, :90]), tmp_path / "none", errors=())
    assert not (tmp_path / "none/diamonds").exists() and terrain.check() == []
    with pytest.raises(StoreError, match=r"no exact errors.*errors=.*'exact'.*overwrite=True"):
        terrain.derived("diamonds", error="exact").read(0, 0, 1, 0, 1)
    only = store.build(source(HEIGHTS[:90, :90]), tmp_path / "one", errors=["midpoint"])
    with pytest.raises(StoreError, match=r"no wedgie errors.*errors=\('midpoint', 'wedgie'\)"):
        only.derived("diamonds", error="wedgie").read(0, 0, 1, 0, 1)
    for terrain in (memory(HEIGHTS), store.open(built)):
        with pytest.raises(UsageError, match="no error called"):
            terrain.derived("diamonds", error="worst").read(0, 0, 1, 0, 1)
        with pytest.raises(UsageError, match="not inside"):
            terrain.derived("diamonds", error="exact").read(0, 0, 701, 0, 1)
    with pytest.raises(UsageError, match="kinds exact, wedgie, midpoint, not exact, best"):
        store.build(source(HEIGHTS), tmp_path / "x", errors=("exact", "best"))


def test_other_errors_are_another_build(tmp_path):
    part = HEIGHTS[:90, :90]
    store.build(source(part), tmp_path / "s")
    with pytest.raises(StoreError, match="other sources or options"):
        store.build(source(part), tmp_path / "s", resume=True, errors=KINDS)


def test_an_older_store_is_to_be_built_again(tmp_path):
    store.build(source(HEIGHTS[:50, :50]), tmp_path / "s")
    root = tmp_path / "s/zarr.json"
    document = json.loads(root.read_text())
    document["attributes"]["orograph"]["format"] = 1
    root.write_text(json.dumps(document))
    with pytest.raises(StoreError, match=r"format 1.*orograph\.build\(.*overwrite=True"):
        store.open(tmp_path / "s")


def test_a_damaged_chunk_of_errors_is_named(tmp_path):
    terrain = store.build(source(HEIGHTS[:200, :200]), tmp_path / "s", shard=64, chunk=16)
    shard = tmp_path / "s/diamonds/0/exact/c/1/1"
    content = bytearray(shard.read_bytes())
    content[10] ^= 255
    shard.write_bytes(content)
    assert terrain.check() == ["diamonds/0/exact/c/1/1[0,0]"]


def test_zarr_reads_the_codes(built):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(built, mode="r")
    with store.open(built) as terrain:
        for level in range(terrain.levels):
            array = group[f"diamonds/{level}/wedgie"]
            errors = DIAMONDS.of(terrain.record).errors["wedgie"].table[array[:]]
            np.testing.assert_array_equal(errors, whole(terrain, "wedgie", level)[0])
            assert array.attrs["code"] == DIAMONDS.of(terrain.record).errors["wedgie"].to_json()


def test_levels_that_have_no_patches_are_no_damage(built):
    """Patches of 16 segments a leg begin with octave 4; below there is nothing, stored or not."""
    from orograph.store.patches import patch_errors, stored_levels

    with store.open(built) as terrain:
        assert list(stored_levels(HEIGHTS.shape)) == [2] and terrain.check() == []
        for level in range(terrain.levels):
            rows, cols = terrain.diamond_shape(level)
            found = terrain.derived("patches", error="exact", legs=16).read(level, 1, rows, 2, cols)
            assert found.shape == (rows - 1, cols - 2) and found.dtype == np.float32
            assert found.any() == (level == 2)
        np.testing.assert_array_equal(
            terrain.derived("patches", error="exact", legs=16).read(2, 0, 257, 0, 257),
            patch_errors(terrain, "exact", 16)[2],
        )
