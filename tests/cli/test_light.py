"""``orograph light``: what is in its files, what is said, what is refused, and that nothing broken is left."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rasterio
from pyproj import CRS

from orograph import store
from orograph.dem.mosaic import Mosaic
from orograph.geo.grid import Grid
from orograph.lighting.context import Context, Options
from orograph.lighting.products import compute, names, product
from orograph.store.lock import alone
from orograph.store.memory import MemoryTerrain
from orograph.store.storage import FolderStorage


def heights_of(path):
    with rasterio.open(path) as file:
        z = file.read(1)
        return np.where(z == file.nodata, np.nan, z)


def test_a_map_is_a_cog_on_the_terrains_grid_in_physical_units(run, hilly, tmp_path):
    out = tmp_path / "sky.tif"
    code, said, err = run("light", hilly, "--product", "sky-view-factor", "-o", out, "--azimuths", 8, "--quiet")
    assert code == 0 and err == "" and "sky-view-factor" in said and "70 × 90" in said
    with rasterio.open(out) as file, rasterio.open(hilly) as dem:
        assert (file.shape, file.transform, file.crs) == (dem.shape, dem.transform, dem.crs)
        assert file.dtypes == ("float32",) and np.isnan(file.nodata)
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.units == ("1",) and file.descriptions == ("sky-view-factor",)
        assert "Dozier" in file.tags(1)["description"] and file.tags()["azimuths"] == "8"
        got = file.read(1)
    with store.terrain(Mosaic.open(hilly)) as terrain:
        expected = compute(Context(terrain, Options(azimuths=8)), "sky-view-factor")[0]
    np.testing.assert_array_equal(got, expected)
    assert np.array_equal(np.isnan(got), np.isnan(heights_of(hilly)))
    assert [p.name for p in tmp_path.iterdir()] == ["sky.tif"]


def test_several_products_are_bands_of_one_file(run, hilly, tmp_path):
    out = tmp_path / "ground.tif"
    code, said, err = run(
        "light", hilly, "--product", "slope,normal", "--product", "aspect", "-o", out, "--json", "--quiet"
    )
    assert code == 0, err
    told = json.loads(said)
    assert [b["name"] for b in told["bands"]] == ["slope", "normal east", "normal north", "normal up", "aspect"]
    assert told["products"] == ["slope", "normal", "aspect"] and told["shape"] == [90, 70]
    with rasterio.open(out) as file:
        slope, east, north, up, aspect = file.read()
        assert file.units == ("degrees", "1", "1", "1", "degrees")
    ok = np.isfinite(aspect)
    np.testing.assert_allclose(np.degrees(np.arccos(up[ok])), slope[ok], atol=0.05)
    np.testing.assert_allclose(np.degrees(np.arctan2(east, north))[ok] % 360, aspect[ok] % 360, atol=0.05)


@pytest.mark.stress
def test_a_file_says_what_its_products_depend_on_and_nothing_else(run, hilly, tmp_path):
    """Of a map of a year's energy one must be able to tell which year; a slope has no sun."""
    common = {"software", "product", "terrain", "AREA_OR_POINT"}
    swept = {"azimuths": "5", "radius": "200 m", "curvature": "flat"}
    for given, expected in (
        (("slope,normal",), {}),
        (("visible-sky", "--azimuths", 5, "--radius", 200), swept),
        (("hillshade", "--sun", "100,20"), {"sun": "azimuth 100, altitude 20 degrees", "exaggeration": "1"}),
        (
            ("hillshade", "--sun", "2026-03-21T12:00-08:00"),
            {"sun": "azimuth 182.141, altitude 54.3441 degrees", "time": "2026-03-21T12:00:00-08:00",
             "exaggeration": "1"},
        ),
        (
            ("hillshade", "--light", "100,20", "--light", "9,8,7"),
            {"lights": "azimuth 100, altitude 20 degrees, weight 1; azimuth 9, altitude 8 degrees, weight 7",
             "exaggeration": "1"},
        ),
        (
            ("insolation", "--azimuths", 5, "--radius", 200, "--date", "2026-06", "--turbidity", 4, "--step", 60),
            {**swept, "date": "2026-06", "step": "60 minutes", "turbidity": "4"},
        ),
        (
            ("sunshine", "--azimuths", 5, "--radius", 200, "--date", "2026-06", "--step", 60),
            {**swept, "date": "2026-06", "step": "60 minutes"},
        ),
        (
            ("ambient-occlusion", "--azimuths", 5, "--radius", 200, "--rho", "linear", "--by", "rays", "--rays", 9),
            {**swept, "method": "rays", "rays": "9", "rho": "linear"},
        ),
    ):  # fmt: skip
        code, _, err = run("light", hilly, "--quiet", "--product", *given, "-o", tmp_path / "out.tif")
        assert code == 0, err
        with rasterio.open(tmp_path / "out.tif") as file:
            tags = file.tags()
        assert {k: v for k, v in tags.items() if k not in common} == expected and set(tags) >= common - {
            "AREA_OR_POINT"
        }
    several = ("--product", "aperture,shadow,slope,normal", "--azimuths", 5, "-o", tmp_path / "out.tif", "--quiet")
    assert run("light", hilly, *several)[0] == 0
    with rasterio.open(tmp_path / "out.tif") as file:
        assert file.descriptions == (
            "aperture east", "aperture north", "aperture up", "aperture radius", "shadow fraction", "shadow code",
            "slope", "normal east", "normal north", "normal up",
        )  # fmt: skip


def test_the_horizon_has_a_band_per_azimuth(run, hilly, tmp_path):
    out = tmp_path / "horizon.tif"
    code, _, err = run("light", hilly, "--product", "horizon", "--azimuths", 4, "-o", out, "--quiet")
    assert code == 0, err
    with rasterio.open(out) as file:
        assert file.descriptions == ("horizon 0", "horizon 90", "horizon 180", "horizon 270")
        north = file.read(1)
    h = heights_of(hilly)
    row, col = 60, 20
    d = 30.0 * np.arange(1, row + 1)
    truth = np.degrees(np.arctan(np.nanmax((h[row - 1 :: -1, col] - h[row, col]) / d)))
    assert north[row, col] == pytest.approx(max(truth, 0), abs=1e-3)


def test_bytes_only_on_request_and_they_say_what_they_mean(run, hilly, tmp_path):
    whole, small = tmp_path / "a.tif", tmp_path / "b.tif"
    for out, more in ((whole, ()), (small, ("--byte",))):
        code, _, err = run("light", hilly, "--product", "hillshade", "-o", out, "--sun", "200,30", "--quiet", *more)
        assert code == 0, err
    with rasterio.open(whole) as a, rasterio.open(small) as b:
        assert b.dtypes == ("uint8",) and b.nodata == 0
        true, seen = a.read(1), b.read(1)
        assert np.array_equal(seen == 0, np.isnan(true))
        back = seen * b.scales[0] + b.offsets[0]
        assert np.nanmax(np.abs(np.where(seen > 0, back, np.nan) - true)) <= 0.5 / 254 + 1e-6
        assert seen[seen > 0].min() == 1 + round(254 * float(np.nanmin(true)))


def test_bytes_of_codes_vectors_and_degrees(run, hilly, tmp_path):
    whole, small = tmp_path / "a.tif", tmp_path / "b.tif"
    for out, more in ((whole, ()), (small, ("--byte",))):
        given = ("--product", "shadow,aperture", "--azimuths", 8, "--sun", "250,12", "--quiet", *more)
        code, _, err = run("light", hilly, *given, "-o", out)
        assert code == 0, err
    with rasterio.open(whole) as a, rasterio.open(small) as b:
        true, coded = a.read(), b.read()
        assert set(np.unique(coded[1])) == set(np.nan_to_num(np.unique(true[1]))) >= {0, 1, 3, 4}  # codes are codes
        assert b.units == ("1", "1", "1", "1", "1", "degrees")
        for k in (0, 2, 3, 4, 5):
            ok = coded[k] > 0
            assert np.array_equal(ok, np.isfinite(true[k]))
            again = coded[k] * b.scales[k] + b.offsets[k]
            assert np.abs(again - true[k])[ok].max() <= b.scales[k] / 2 + 1e-6


def test_the_sun_may_be_a_time(run, hilly, tmp_path):
    out = tmp_path / "noon.tif"
    code, said, err = run(
        "light", hilly, "--product", "hillshade", "--sun", "2026-06-21T12:00-08:00", "-o", out, "--json", "--quiet"
    )
    assert code == 0, err
    azimuth, altitude = json.loads(said)["sun"]
    assert 150 < azimuth < 210 and 75 < altitude < 79  # near noon at 36° north, 117° west, in June


def test_a_sun_that_has_set_is_told(run, hilly, tmp_path):
    night = ("--sun", "2026-06-21T00:00-07:00", "-o", tmp_path / "out.tif")
    for name, told in (("shadow", True), ("hillshade", True), ("hillshade", False)):
        given = night if told else (*night[2:], "--sun", "315,5")
        code, _, err = run("light", hilly, "--product", name, *given)
        assert code == 0 and ("below the horizon" in err) == told, err


def test_many_lights(run, hilly, tmp_path):
    out = tmp_path / "three.tif"
    lights = ("--light", "315,45,2", "--light", "225,30")
    code, _, err = run("light", hilly, "--product", "hillshade", *lights, "-o", out, "--quiet")
    assert code == 0, err
    each = []
    for sun in ("315,45", "225,30"):
        assert (
            run("light", hilly, "--product", "hillshade", "--sun", sun, "-o", tmp_path / "one.tif", "--quiet")[0] == 0
        )
        with rasterio.open(tmp_path / "one.tif") as file:
            each.append(file.read(1))
    with rasterio.open(out) as file:
        np.testing.assert_allclose(file.read(1), (2 * each[0] + each[1]) / 3, atol=1e-6)


def test_memory_jobs_and_a_store_change_no_bit(run, hilly, tmp_path):
    assert run("build", hilly, "-o", tmp_path / "hilly.oro", "--quiet")[0] == 0
    files = []
    for k, (path, more) in enumerate(
        [(hilly, ()), (hilly, ("--jobs", 1)), (tmp_path / "hilly.oro", ("--max-memory", "64MiB", "--jobs", 2))]
    ):
        files.append(tmp_path / f"{k}.tif")
        given = ("--product", "sky-view-factor,openness", "--azimuths", 7, "-o", files[-1], "--quiet")
        code, _, err = run("light", path, *given, *more)
        assert code == 0, err
    first, *others = (rasterio.open(f).read() for f in files)
    for other in others:
        np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--product", "sky"), "sky-view-factor"),
        (("--product", "slope", "-o", "out.png"), ".tif"),
        (("--product", "slope", "--radius", "-3"), "radius"),
        (("--product", "slope", "--sun", "noon"), "sun"),
        (("--product", "slope", "--light", "1,2"), "hillshade"),
        (("--product", "hillshade", "--light", "1"), "AZ,ALT"),
        (("--product", "hillshade", "--light", "315,145"), "altitude"),
        (("--product", "slope,aspect", "--radius", "300"), "--radius has no effect on slope, aspect"),
        (("--product", "openness", "--sun", "315,45"), "hillshade, shadow"),
        (("--product", "visible-sky", "--date", "2026"), "insolation"),
        (("--product", "insolation", "--date", "2026", "--rho", "linear"), "ambient-occlusion"),
        (("--product", "insolation"), "--date"),
        (("--product", "sunshine", "--date", "2026", "--turbidity", "4"), "insolation"),
        (("--product", "sun-hours"), "Did you mean sunshine"),
        (("--product", "horizon", "--refraction", "0.2"), "--curvature"),
        (("--product", "insolation", "--date", "2026-02-30"), "period"),
        (("--product", "insolation", "--date", "2026", "--turbidity", "nan"), "turbidity"),
        (("--product", "insolation", "--date", "2026", "--step", "0"), "step"),
        (("--product", "ambient-occlusion", "--rho", "linear"), "radius"),
        (("--product", "ambient-occlusion", "--by", "rays", "--curvature"), "curvature"),
        (("--product", "aperture", "--by", "cone-tracing"), "method"),
        (("--product", "hillshade", "--light", "315,45,-1"), "weights"),
        (("--product", "hillshade", "--light", "315,45,0"), "weights"),
        (("--product", "slope", "--azimuths", "2"), "azimuths"),
    ],
)
def test_nonsense_is_refused_before_work(run, hilly, tmp_path, args, says, monkeypatch):
    monkeypatch.chdir(tmp_path)
    args = args if "-o" in args else (*args, "-o", "out.tif")

    def work(*_, **__):
        raise AssertionError("the terrain was read")

    monkeypatch.setattr("orograph.store.prepare.prepare", work)
    code, _, err = run("light", hilly, *args)
    assert code == 2 and says in err and not list(tmp_path.iterdir())


def test_the_input_is_not_overwritten(run, hilly):
    code, _, err = run("light", hilly, "--product", "slope", "-o", hilly)
    assert code == 2 and "overwrite" in err


def test_a_folder_that_is_not_there(run, hilly, tmp_path):
    code, _, err = run("light", hilly, "--product", "slope", "-o", tmp_path / "no" / "a.tif")
    assert code == 4 and "folder" in err


@pytest.mark.cases(1)
@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_leaves_what_was_there(tmp_path, how, code):
    dem, out = tmp_path / "big.tif", tmp_path / "out.tif"
    z = np.random.default_rng(0).normal(size=(1500, 1500)).cumsum(0).astype(np.float32)
    profile = {"driver": "GTiff", "height": 1500, "width": 1500, "count": 1, "dtype": "float32", "crs": "EPSG:32611"}
    with rasterio.open(dem, "w", **profile, transform=rasterio.Affine(30, 0, 5e5, 0, -30, 4e6)) as file:
        file.write(z, 1)
    out.write_bytes(b"before")
    command = [sys.executable, "-m", "orograph", "light", str(dem), "--product", "horizon", "--azimuths", "90"]
    with subprocess.Popen([*command, "-o", str(out)], stderr=subprocess.PIPE) as process:
        end = time.monotonic() + 60
        while not list(tmp_path.glob(".out.tif*")) and time.monotonic() < end and process.poll() is None:
            time.sleep(0.02)
        time.sleep(0.3)
        process.send_signal(how)
        _, err = process.communicate(timeout=60)
    assert process.returncode == code and b"interrupted" in err
    assert out.read_bytes() == b"before" and sorted(p.name for p in tmp_path.iterdir()) == ["big.tif", "out.tif"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
@pytest.mark.parametrize("name", ["slope", "normal"])
def test_a_file_that_may_not_grow(hilly, tmp_path, name):
    """GDAL's TIFF library, left to meet the limit, writes lines of its own to the process's stderr."""
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (20480, 20480));"
        "from orograph.cli import main; main(sys.argv[1:])"
    )
    out = tmp_path / "out.tif"
    given = ["light", str(hilly), "--product", name, "-o", str(out), "--quiet"]
    ran = subprocess.run([sys.executable, "-c", code, *given], capture_output=True, text=True)
    assert ran.returncode == 4 and len(ran.stderr.splitlines()) == 1, ran.stderr
    assert "out.tif" in ran.stderr and "larger than 0.02 MB" in ran.stderr and "ulimit -f" in ran.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == []


def test_one_process_at_a_time_makes_a_map_that_is_kept(run, hilly, tmp_path):
    """Two would write the same files beside it, and the first one done would remove them."""
    out = tmp_path / "out.tif"
    given = ("light", hilly, "--product", "sky-view-factor", "--azimuths", 4, "--quiet", "-o", out)
    with alone(FolderStorage(out), "making this map"):
        code, _, err = run(*given, "--resume")
        assert code == 4 and "Another process is making this map" in err
        assert run(*given)[0] == 0  # which keeps nothing on the way
    assert run(*given, "--resume")[0] == 0
    assert [p.name for p in tmp_path.iterdir() if "out.tif" in p.name] == ["out.tif"]


@pytest.mark.parametrize(
    "name", ["sky-view-factor", "openness", "horizon", "ambient-occlusion", "aperture,visible-sky,sky-view-factor"]
)
def test_resume_goes_on_after_the_last_pass_to_the_same_bytes(run, hilly, tmp_path, monkeypatch, name):
    from orograph.lighting.raster_resume import Checkpoint
    from orograph.lighting.sweep_pass import Pass

    whole, out = tmp_path / "whole.tif", tmp_path / "out.tif"
    given = ("--product", name, "--azimuths", 12, "--quiet", "--resume")
    assert run("light", hilly, *given, "-o", whole)[0] == 0
    save, passes = Checkpoint.save, []

    def interrupted(self, *args):
        if len(passes) == 2:
            raise KeyboardInterrupt
        passes.append(len(args[2]))
        save(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", interrupted)
        code, _, err = run("light", hilly, *given, "-o", out)
    assert code == 130 and "run the same again" in err and not out.exists() and (tmp_path / "out.tif.partial").is_dir()
    swept, begin = [], Pass.begin
    with monkeypatch.context() as patch:
        patch.setattr(Pass, "begin", lambda self, *how: swept.append(len(self.lines)) or begin(self, *how))
        code, _, err = run("light", hilly, *given, "-o", out)
    assert code == 0, err
    assert len(swept) == 2 and sum(swept) == 12 - passes[-1]  # two of four passes were left
    assert out.read_bytes() == whole.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.tif", "whole.tif"]


def test_resume_keeps_windows_of_walks(run, hilly, tmp_path, monkeypatch):
    from orograph.lighting import occlusion
    from orograph.lighting.raster_resume import Checkpoint

    monkeypatch.setattr(occlusion, "_BLOCK", 16)
    monkeypatch.setattr(occlusion, "_WIDTH", 16)
    whole, out = tmp_path / "whole.tif", tmp_path / "out.tif"
    given = ("--product", "ambient-occlusion", "--radius", 300, "--azimuths", 6, "--jobs", 1, "--quiet", "--resume")
    assert run("light", hilly, *given, "-o", whole)[0] == 0
    window, made = Checkpoint.window, []

    def counted(self, key, row, col, make):
        def counting():
            if len(made) == 11:
                raise KeyboardInterrupt
            made.append((row, col))
            return make()

        return window(self, key, row, col, counting)

    monkeypatch.setattr(Checkpoint, "window", counted)
    code, _, err = run("light", hilly, *given, "-o", out)
    assert code == 130 and "run the same again" in err and len(made) == 11
    cut = next((tmp_path / "out.tif.partial").glob("*.npy"))
    cut.write_bytes(cut.read_bytes()[:-4])
    before, made[:] = set(made), []
    monkeypatch.setattr(Checkpoint, "window", lambda *a: made.append(a[2:4]) or window(*a))
    assert run("light", hilly, *given, "-o", out)[0] == 0
    assert len(made) == 30 and len(before) == 11
    assert out.read_bytes() == whole.read_bytes()


def test_several_products_share_a_sweep(run, hilly, tmp_path, monkeypatch):
    """One pass over the terrain for all that sweep alike, and the same values as each alone."""
    from orograph.lighting.sweep_pass import Pass

    swept, begin = [], Pass.begin
    monkeypatch.setattr(Pass, "begin", lambda self, *how: swept.append(len(self.lines)) or begin(self, *how))
    alone, count = [], []
    for name in ("visible-sky", "sky-view-factor", "aperture", "openness"):
        swept.clear()
        code, _, err = run("light", hilly, "--product", name, "--azimuths", 8, "-o", tmp_path / "one.tif", "--quiet")
        assert code == 0, err
        count.append(sum(swept))
        with rasterio.open(tmp_path / "one.tif") as file:
            alone.append(file.read())
    assert count == [8, 8, 8, 8]
    swept.clear()
    names = "visible-sky,sky-view-factor,aperture,openness"
    code, _, err = run("light", hilly, "--product", names, "--azimuths", 8, "-o", tmp_path / "all.tif", "--quiet")
    assert code == 0 and sum(swept) == 16, err  # openness looks below the horizon
    with rasterio.open(tmp_path / "all.tif") as file:
        np.testing.assert_array_equal(file.read(), np.concatenate(alone))


def test_resume_refuses_other_work_and_damage(run, hilly, tmp_path, monkeypatch):
    from orograph.lighting.raster_resume import Checkpoint

    out = tmp_path / "out.tif"
    given = ("light", hilly, "--product", "visible-sky", "--resume", "--quiet", "-o", out)
    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "remove", lambda self: None)
        assert run(*given)[0] == 0
    code, _, err = run(*given, "--azimuths", 7)
    assert code == 4 and "another map" in err
    folder = tmp_path / "out.tif.partial"
    values = next(folder.glob("*.f32"))
    values.write_bytes(values.read_bytes()[:-4])
    code, _, err = run(*given)
    assert code == 4 and "Delete that folder" in err
    code, _, err = run(*(a for a in given if a != "--resume"))
    assert code == 0 and folder.is_dir()  # left alone


@pytest.mark.stress
def test_it_is_known_which_products_an_option_changes(hilly):
    """Each option against the products themselves: changed bits where it is said to matter, the same elsewhere."""
    from orograph.lighting.maps import USERS

    heights = heights_of(hilly)[:40, :40].astype(np.float32)
    with rasterio.open(hilly) as file:
        grid = Grid(heights.shape, file.transform, CRS.from_user_input(file.crs))
    terrain = MemoryTerrain(heights, grid, "hilly")
    base = {"azimuths": 6, "rays": 4, "curvature": True, "radius": 200.0, "sun": (315.0, 12.0)}
    common = {"date": "2026-06-21", "step": 60.0}
    other = {
        "azimuths": 9, "radius": 90.0, "curvature": False, "sun": (100.0, 20.0), "lights": ((100.0, 20.0, 1.0),),
        "exaggeration": 2.0, "turbidity": 5.0, "step": 30.0, "date": "2026-12-21",
    }  # fmt: skip
    fields = Options.__dataclass_fields__

    def made(name, **change):
        given = {**base, **common, **change}
        if name == "ambient-occlusion":
            given["curvature"] = False  # walks know none
        more = {k: v for k, v in given.items() if k not in fields}
        return compute(Context(terrain, Options(**{k: v for k, v in given.items() if k in fields}, more=more)), name)

    for name in names():
        plain = made(name)
        for option, value in other.items():
            if (name, option) in {("ambient-occlusion", "curvature")}:
                continue
            changed = made(name, **{option: value})
            same = plain.shape == changed.shape and np.array_equal(plain, changed, equal_nan=True)
            assert same == (name not in USERS[option]), (name, option)


def test_every_product_has_its_names_and_units():
    for name in names():
        found = product(name)
        assert found.name == name and found.unit and found.doc and found.bands(Options())
