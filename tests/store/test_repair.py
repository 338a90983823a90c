"""A store is mended to the byte from its sources and from what of it is sound; what cannot be mended is said."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from click.testing import CliRunner
from surfaces import rough, source

from orograph import store
from orograph.cli import cli
from orograph.cli.wording import spoken
from orograph.errors import StoreError, UsageError
from orograph.lighting.bake import bake
from orograph.lighting.products import Options
from orograph.store.inputs import changes
from orograph.store.layout import array_specs
from orograph.store.repair import repair

HEIGHTS = rough((300, 280), 4, hole=True)
SIZES = {"shard": 128, "chunk": 32}


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def write(path, heights=HEIGHTS):
    with rasterio.open(
        path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1, dtype="float32",
        crs="EPSG:32611", transform=source(heights).grid.transform, nodata=np.nan,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a raster, and a store of it."""
    folder = tmp_path_factory.mktemp("made")
    write(folder / "dem.tif")
    store.build(folder / "dem.tif", folder / "s.oro", nodata="none", **SIZES).close()
    return folder


@pytest.fixture
def area(made, tmp_path):
    shutil.copytree(made / "s.oro", tmp_path / "s.oro")
    return tmp_path / "s.oro"


def damage(area, *keys):
    for key in keys:
        content = bytearray((area / key).read_bytes())
        content[len(content) // 3] ^= 4
        (area / key).write_bytes(content)


def keys_of(area):
    with store.open(area) as terrain:
        for spec in array_specs(terrain.record):
            yield from (spec.key((i, j)) for i in range(spec.shards[0]) for j in range(spec.shards[1]))


def test_every_kind_of_object_is_mended_alone(made, area):
    """One shard of each array, one coordinate, one of each metadata."""
    whole = files(made / "s.oro")
    seen, each = set(), []
    for key in (*keys_of(area), "heights/1/x/c/0", "tiles/0/zarr.json", "heights/0/height/zarr.json"):
        if key.partition("/c/")[0] not in seen:
            seen.add(key.partition("/c/")[0])
            each.append(key)
    for key in each:
        damage(area, key)
        assert [found.partition("[")[0] for found in repair(area)] == [key]
        assert files(area) == whole
    assert repair(area) == []


def test_all_at_once_and_swapped_and_gone(made, area):
    keys = list(keys_of(area))
    damage(area, *keys[::3], "mean/1/y/c/0")
    for key in keys[1::7]:
        (area / key).unlink()
    first, second = area / keys[2], area / keys[5]
    content = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(content)
    root = json.loads((area / "zarr.json").read_text())
    root["attributes"]["multiscales"] = {}
    (area / "zarr.json").write_text(json.dumps(root))
    broken = {*keys[::3], *keys[1::7], keys[2], keys[5], "mean/1/y/c/0", "zarr.json"}
    assert {key.partition("[")[0] for key in repair(area)} == broken
    assert files(area) == files(made / "s.oro")


def test_levels_are_mended_without_the_source(made, area):
    store.build(source(HEIGHTS), area, overwrite=True, **SIZES).close()
    whole = files(area)
    damage(area, "heights/1/height/c/0/0", "tiles/1/error/c/0/0", "diamonds/0/exact/c/0/0", "patches/1/exact/c/0/0")
    repair(area)
    assert files(area) == whole
    damage(area, "heights/0/height/c/0/0", "mean/1/height/c/0/0")
    with pytest.raises(StoreError, match=r"heights/0/height/c/0/0.*could not be repaired.*heights in memory"):
        repair(area)
    repair(area, source(HEIGHTS))
    assert files(area) == whole


@pytest.mark.parametrize("which", ["tile.tif", "tile.tif.msk", "outer.vrt"])
def test_of_what_an_input_is_made_of_a_change_is_said_too(area, tmp_path, which):
    """A part of a VRT of a VRT, its mask, the VRT itself: it is not the input's file that was changed."""
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK="NO"), rasterio.open(write(tmp_path / "tile.tif"), "r+") as file:
        file.write_mask(np.isfinite(HEIGHTS))
    rasterio.shutil.copy(tmp_path / "tile.tif", tmp_path / "inner.vrt", driver="VRT")
    (tmp_path / "outer.vrt").write_text((tmp_path / "inner.vrt").read_text().replace("tile.tif", "inner.vrt"))
    store.build(tmp_path / "outer.vrt", area, overwrite=True, **SIZES).close()
    record = store.open(area).record
    assert changes(record.inputs) == []
    assert [Path(f["path"]).name for f in record.inputs["files"]] == ["outer.vrt"]
    assert sorted(Path(f["path"]).name for f in record.inputs["beside"][0]) == ["inner.vrt", "tile.tif", "tile.tif.msk"]
    os.utime(tmp_path / which, ns=(1, 1))
    (told,) = changes(record.inputs)
    assert f"{tmp_path / which}" in told and told.endswith("was changed.")
    assert changes({"files": record.inputs["files"]}) == ([told] if which == "outer.vrt" else [])  # an older store's
    damage(area, "heights/0/height/c/0/0")
    other = HEIGHTS.copy()
    other[3, 3] += 1
    with rasterio.open(tmp_path / "tile.tif", "r+") as file:
        file.write(other, 1)
    told = CliRunner().invoke(cli, ["check", str(area)], standalone_mode=False)
    assert f"{tmp_path / 'tile.tif'} (of {tmp_path / 'outer.vrt'}) was changed." in told.output
    with pytest.raises(StoreError, match=r"tile\.tif \(of \S*outer\.vrt\) was changed"):
        repair(area)


def test_a_source_that_is_gone_or_another_is_said(made, area, tmp_path):
    write(tmp_path / "dem.tif")
    store.build(tmp_path / "dem.tif", area, overwrite=True, **SIZES).close()
    whole = files(area)
    damage(area, "heights/0/height/c/0/0")
    (tmp_path / "dem.tif").rename(tmp_path / "moved.tif")
    with pytest.raises(
        StoreError, match=r"dem\.tif is gone.*orograph\.build\(\[\S*dem\.tif\'\], \S*s\.oro\', overwrite=True\)"
    ):
        repair(area)
    other = HEIGHTS.copy()
    other[3, 3] += 1
    write(tmp_path / "dem.tif", other)
    with pytest.raises(StoreError, match=r"dem\.tif was changed.*other data than it held"):
        repair(area)
    assert files(area).keys() == whole.keys() and store.open(area).check()[0].startswith("heights/0/height/c/0/0")
    write(tmp_path / "dem.tif")  # touched, and the same
    os.utime(tmp_path / "dem.tif", ns=(1, 1))
    repair(area)
    assert files(area) == whole


def test_layers_are_baked_again_and_the_rest_is_mended(area):
    bake(area, ["visible-sky"], Options(azimuths=4)).close()
    whole = files(area)
    damage(area, "layers/visible-sky/0/visible-sky/c/0/0", "heights/0/height/c/0/0")
    with pytest.raises(StoreError, match=r"layers/visible-sky/0.*orograph\.bake\(\S*s\.oro\', \[\'visible-sky\'\]"):
        repair(area)
    assert [key.partition("/")[0] for key in store.open(area).check()] == ["layers"]
    bake(area, ["visible-sky"], Options(azimuths=4), overwrite=True).close()
    assert files(area) == whole


def test_on_the_command_line(made, area):
    def run(*words):
        return CliRunner().invoke(cli, ["-q", *map(str, words)])

    told = run("check", area)
    assert told.exit_code == 0 and "sound" in told.output
    assert json.loads(run("check", area, "--json").output) | {"shards": 0} == {
        "path": str(area), "sound": True, "shards": 0, "damaged": [], "changed": []
    }  # fmt: skip
    damage(area, "heights/0/height/c/0/0")
    (area / "heights/0/x/c/0").unlink()
    told = run("check", area)
    assert isinstance(told.exception, StoreError) and f"orograph build -o {area} --repair" in str(told.exception)
    assert "heights/0/x/c/0: the file is not there" in told.output and "heights/0/height/c/0/0[" in told.output
    told = run("check", area, "--json")
    assert told.exit_code == 4
    assert [found["key"].partition("[")[0] for found in json.loads(told.output)["damaged"]] == [
        "heights/0/height/c/0/0", "heights/0/x/c/0"
    ]  # fmt: skip
    told = run("build", "-o", area, "--repair")
    assert told.exit_code == 0 and told.output.count("mended") == 2 and "sound again" in told.output
    assert files(area) == files(made / "s.oro")
    assert "nothing was damaged" in run("build", made / "dem.tif", "-o", area, "--repair").output
    for more in (["--overwrite"], ["--resume"], ["--bake", "visible-sky"], ["--crs", "EPSG:32612"]):
        told = run("build", "-o", area, "--repair", *more)
        assert isinstance(told.exception, UsageError) and f"cannot be combined with {more[0]}" in str(told.exception)
    assert run("build", "-o", area).exit_code == 2


def test_an_older_store_is_refused_with_the_command_that_rebuilds_it(area):
    root = json.loads((area / "zarr.json").read_text())
    root["attributes"]["orograph"] = {"format": 2}
    (area / "zarr.json").write_text(json.dumps(root))
    again = rf"format 2, and this version reads format 4.*orograph\.build\(dem, '{area}', overwrite=True\)"
    for use in (store.open, repair, lambda path: bake(path, ["visible-sky"])):
        with pytest.raises(StoreError, match=again):
            use(area)


def test_what_may_be_secret_is_not_kept():
    from orograph.store.inputs import state_of
    from orograph.store.layout import rebuild

    said = state_of("https://me:word@example.org/dem.tif?X-Amz-Signature=abc")
    assert said["path"] == "https://example.org/dem.tif"
    inputs = {"files": [{"path": "/a b.tif"}], "options": {"assume_crs": "EPSG:4326"}}
    again = rebuild({"inputs": inputs}, "s.oro")
    assert again.endswith("`orograph.build(['/a b.tif'], 's.oro', assume_crs='EPSG:4326', overwrite=True)`.")
    assert spoken(again).endswith("orograph build '/a b.tif' -o s.oro --assume-crs EPSG:4326 --overwrite.")


def test_a_crs_whose_text_changes_when_it_is_read_again(made, tmp_path):
    """PROJ's text of EPSG:3857 loses its ensemble: what was made of the record differed from what was written."""
    path = tmp_path / "w.oro"
    store.build(made / "dem.tif", path, crs="EPSG:3857", **SIZES).close()
    whole = files(path)
    for key in ("mean/1/spatial_ref/zarr.json", "heights/0/zarr.json", "source/0/spatial_ref/zarr.json"):
        damage(path, key)
        assert repair(path) == [key]
    assert files(path) == whole
    store.build(made / "dem.tif", path, crs="EPSG:3857", resume=True, **SIZES).close()
    assert files(path) == whole
    path.rename(tmp_path / "w.oro.partial")  # killed before its last rename
    store.build(made / "dem.tif", path, crs="EPSG:3857", resume=True, **SIZES).close()
    assert files(path) == whole
