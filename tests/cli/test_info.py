"""``orograph info``: its JSON against known facts, its warnings against files made to deserve them."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS, Geod, Transformer

import orograph
from orograph.cli import cli
from orograph.cli.memory import megabytes
from orograph.cli.options import parse_bytes
from orograph.dem import Source
from orograph.dem import statistics as statistics_module
from orograph.dem.statistics import statistics
from orograph.errors import UsageError
from orograph.verbs.info_text import _crs_line

KEYS = {
    "kind",
    "path",
    "crs",
    "transform",
    "shape",
    "points",
    "bounds",
    "lonlat",
    "spacing_m",
    "height_range",
    "height_range_exact",
    "valid_fraction",
    "dtype",
    "nodata",
    "vertical_datum",
    "attribution",
    "version",
    "versions",
    "errors",
    "colors",
    "layers",
    "parts",
    "resampled",
    "codec",
    "keeps_source",
    "levels",
    "side",
    "size_bytes",
    "warnings",
}
UTM = Affine(30, 0, 500000, 0, -30, 4000000)


def info(*args: object) -> Any:
    result = CliRunner().invoke(cli, ["--quiet", "info", "--json", *map(str, args)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def write(path: Path, numbers: np.ndarray, **profile: Any) -> Path:
    bands = numbers if numbers.ndim == 3 else numbers[None]
    count, height, width = bands.shape
    base = {"driver": "GTiff", "height": height, "width": width, "count": count, "dtype": bands.dtype, "transform": UTM}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", **{**base, "crs": "EPSG:32611", **profile}) as dataset:
            dataset.write(bands)
    return path


def hills(rows: int = 80, cols: int = 90, low: float = 200, high: float = 900) -> np.ndarray:
    y, x = np.mgrid[:rows, :cols]
    waves = np.sin(x / 9.0) * np.cos(y / 7.0) + 0.1 * np.sin(x * y / 50)
    return (low + (waves - waves.min()) / np.ptp(waves) * (high - low)).astype(np.float32)


def test_a_geographic_tile(shared_data: Path) -> None:
    path = shared_data / "n44w072-hgt" / "N44W072.hgt"
    found = info(path)
    assert set(found) == KEYS
    dx = Geod(ellps="WGS84").line_length([-71.5 - 0.5 / 1200, -71.5 + 0.5 / 1200], [44.5, 44.5])
    dy = Geod(ellps="WGS84").line_length([-71.5, -71.5], [44.5 - 0.5 / 1200, 44.5 + 0.5 / 1200])
    assert found["spacing_m"] == [pytest.approx(dx, rel=1e-7), pytest.approx(dy, rel=1e-7)]
    third = 1 / 1200
    assert found["transform"] == pytest.approx([third, 0, -72 - third / 2, 0, -third, 45 + third / 2], abs=1e-12)
    for key, value in {
        "kind": "dem",
        "crs": "EPSG:4326",
        "shape": [1201, 1201],
        "height_range": [115, 1908],
        "height_range_exact": True,
        "valid_fraction": 1,
        "dtype": "int16",
        "nodata": -32768,
        "vertical_datum": "EGM96 height",
        "levels": 4,
        "side": 2049,
        "size_bytes": 2884802,
        "warnings": [],
    }.items():
        assert found[key] == value, key


def test_voids_and_several_paths(shared_data: Path) -> None:
    everest = shared_data / "osgearth-srtm90m-volcano-voids" / "mt_everest_90m.tif"
    first, second = info(everest, shared_data / "n44w072-hgt" / "N44W072.hgt")
    with rasterio.open(everest) as dataset:
        truth = dataset.read(1, masked=True)
    assert first["valid_fraction"] == truth.count() / truth.size
    assert first["height_range"] == [truth.min(), truth.max()] and second["kind"] == "dem"


def test_of_an_area_only_its_samples_are_told(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "n44w072-hgt" / "N44W072.hgt"
    with rasterio.open(path) as dataset:
        heights, transform = dataset.read(1), dataset.transform
    third = 1 / 1200  # samples of the box's border are within
    rows, cols = slice(840, 961), slice(120, 241)
    found = info(path, "--bbox", "-71.9,44.2,-71.8,44.3")
    assert found["kind"] == "dem" and set(found) == KEYS and found["shape"] == [121, 121]
    west, south = transform.c + 120 * third, transform.f - 961 * third
    assert found["transform"] == pytest.approx([third, 0, west, 0, -third, south + 121 * third], abs=1e-9)
    assert found["height_range"] == [heights[rows, cols].min(), heights[rows, cols].max()]
    assert found["valid_fraction"] == 1

    clip = tmp_path / "half.geojson"
    corners = [[-71.9003, 44.1997], [-71.7998, 44.1997], [-71.9003, 44.3002], [-71.9003, 44.1997]]
    clip.write_text(json.dumps({"type": "Polygon", "coordinates": [corners]}))
    half = info(path, "--clip", clip)
    assert half["shape"] == [121, 121] and half["valid_fraction"] == 120 * 121 / 2 / 121**2
    assert "missing outside the polygons" in CliRunner().invoke(cli, ["info", str(path), "--clip", str(clip)]).output


def test_of_a_store_an_area_is_told_as_terrain(tmp_path: Path) -> None:
    path, store = write(tmp_path / "a.tif", hills()), str(tmp_path / "a.oro")
    assert CliRunner().invoke(cli, ["--quiet", "build", str(path), "-o", store]).exit_code == 0
    with rasterio.open(path) as dataset:
        place = Transformer.from_crs(dataset.crs, 4326, always_xy=True)
    west, south = place.transform(500000 + 30 * 20.6, 4000000 - 30 * 50.4)
    east, north = place.transform(500000 + 30 * 40.4, 4000000 - 30 * 30.6)
    of_file, of_store = (info(p, "--bbox", f"{west},{south},{east},{north}") for p in (path, store))
    assert of_store["shape"] == of_file["shape"] and of_store["transform"] == pytest.approx(of_file["transform"])
    assert of_store["height_range"] == of_file["height_range"]
    assert of_store["kind"] == "terrain" and set(of_store) == KEYS


def test_a_crs_that_a_file_leaves_unnamed_has_the_name_of_its_code() -> None:
    unnamed = CRS(CRS.from_epsg(26710).to_wkt("WKT1_GDAL").replace("NAD27 / UTM zone 10N", "unnamed"))
    assert unnamed.name == "unnamed"
    assert _crs_line({"_crs": unnamed, "crs": "EPSG:26710"}) == "EPSG:26710 (NAD27 / UTM zone 10N)"


def test_small_files_are_not_nothing() -> None:
    assert [megabytes(n) for n in (17_000, 2_500_000)] == ["17.0 kB", "2.5 MB"]


def test_an_area_beside_the_file_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills())
    reach = r"No sample lies within 1, 2, 3, 4: it reaches from -117, 36.12 to -116.97, 36.14"
    with pytest.raises(UsageError, match=reach):
        CliRunner().invoke(cli, ["info", str(path), "--bbox", "1,2,3,4"], catch_exceptions=False, standalone_mode=False)


def test_feet_crs_spacing_is_in_metres(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(), crs="EPSG:2225", transform=Affine(10, 0, 6e6, 0, -10, 2e6))
    found = info(path)
    assert found["spacing_m"] == pytest.approx([12000 / 3937] * 2)
    assert any("Its CRS is in feet" in w for w in found["warnings"])
    assert not any("Its CRS is in feet" in w for w in info(path, "--vertical-unit", "us-ft")["warnings"])


@pytest.mark.parametrize("function", [orograph.read, orograph.terrain])
def test_undeclared_feet_are_warned_of_wherever_heights_are_read(tmp_path: Path, function: Any) -> None:
    path = write(tmp_path / "a.tif", hills(), crs="EPSG:2225", transform=Affine(10, 0, 6e6, 0, -10, 2e6))
    with pytest.warns(UserWarning, match="Its CRS is in feet"):
        function(path)
    for unit in ("us-ft", "m"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            function(path, vertical_unit=unit)


def test_numbers_that_json_lacks_are_null(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((3, 4), np.nan, np.float32), nodata=np.nan, crs=None)
    found = info(path)
    assert found["height_range"] == [None, None] and found["nodata"] is None and found["crs"] is None
    assert found["valid_fraction"] == 0 and "None of its samples is valid." in found["warnings"]


CLEAN = hills()


@pytest.mark.parametrize(
    "numbers,profile,args,says",
    [
        (np.where(CLEAN < 250, -32768, CLEAN).astype(np.int16), {}, [], "--nodata -32768"),
        (np.where(CLEAN < 250, -9999, CLEAN), {}, [], "--nodata -9999"),
        (np.where(CLEAN < 250, np.float32(-1e37), CLEAN), {}, [], "-1e+37"),
        (np.where(CLEAN < 250, 65535, CLEAN).astype(np.uint16), {}, [], "--nodata 65535"),
        (CLEAN * 100, {}, [], "higher than Mount Everest"),
        (CLEAN - 12000, {}, [], "deeper than any ocean"),
        (CLEAN, {"crs": None}, [], "no CRS"),
        (CLEAN, {"crs": None, "transform": Affine(0.001, 0, 7, 0, -0.001, 46)}, [], "look like degrees"),
        (CLEAN, {"crs": "EPSG:3857"}, [], "Web Mercator"),
        (np.full((9, 9), 5, np.float32), {}, [], "All its valid heights are 5 m"),
        (np.where(CLEAN < 600, np.nan, CLEAN), {}, [], "of its samples are missing"),
        ((CLEAN / 10).astype(np.uint8), {}, [], "8 bits"),
        (np.stack([(CLEAN / 10).astype(np.uint8)] * 3), {}, [], "looks like a picture"),
        (CLEAN / 111_320, {"transform": Affine(1000, 0, 0, 0, -1000, 0)}, [], "kilometres or degrees"),
        (np.tile(np.linspace(-118, -117, 90, dtype=np.float32), (80, 1)), {}, [], "longitudes or latitudes"),
        (CLEAN + 1737400, {"crs": "IAU_2015:30110"}, [], "look like radii"),
        (CLEAN, {"transform": Affine(0.1, 0, 0, 0, -0.1, 0)}, [], "steeper than any landscape"),
        (CLEAN, {"crs": "EPSG:4326", "transform": Affine(30, 0, 5e5, 0, -30, 4e6)}, [], "the CRS is wrong"),
        (CLEAN, {"crs": "EPSG:4326", "transform": Affine(1, 0, 150, 0, -1, 60)}, [], "across 180° E"),
    ],
)
def test_what_is_suspicious_is_said(
    tmp_path: Path, numbers: np.ndarray, profile: dict[str, Any], args: list[str], says: str
) -> None:
    found = info(write(tmp_path / "a.tif", numbers, **profile), *args)
    assert sum(says in w for w in found["warnings"]) == 1, found["warnings"]


@pytest.mark.parametrize(
    "name",
    [
        "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
        "lsd-topo/gabilan.tif",
        "winnipeg-1s-isce3/winnipeg_dem.tif",
        "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
        "terra-vinschgau/elev_vinschgau.tif",
        "qgis-training/dem1.tif",
        "fortbragg-1m-dem-ortho/elevation_2016.tif",
        "gironde-demcompare/reduced_Gironde.tif",
        "sainthelens-usgsdem/SainteHelens.dem",
    ],
)
def test_sound_dems_raise_no_suspicion(shared_data: Path, name: str) -> None:
    assert info(shared_data / name)["warnings"] == []


@pytest.mark.parametrize(
    "name,says",
    [
        ("planets-isis-small/vest64_dtm_specialpixels_downsampled.cub", "look like radii"),
        ("gironde-demcompare/dem_cm_centimetres.tif", "--vertical-unit cm"),
        ("whitney-usgs-topo-map/whitney_rgb_z15_epsg3857.tif", "looks like a picture"),
        ("glosea4-ensemble/members_surface_temperature_K.tif", "'temperature'"),
        ("nasty-gdal/sstgeo.tif", "longitudes or latitudes"),
        ("nasty-gdal/rotated_pole.nc", "'Celsius'"),
        ("spdatalarge-zion-nz-ecuador/zion_nlcd2011.tif", "colour table"),
        ("egm96-grid/egm96_15.gtx", "geoid grid"),
    ],
)
def test_real_files_that_deserve_a_warning(shared_data: Path, name: str, says: str) -> None:
    assert any(says in w for w in info(shared_data / name)["warnings"])


def test_geoids_and_plains_are_not_in_kilometres(shared_data: Path, tmp_path: Path) -> None:
    for path in (
        shared_data / "egm96-grid" / "egm96_15.gtx",
        shared_data / "swiss-alps-geoids" / "us_nga_egm2008_1_clipAlps.tif",
        write(tmp_path / "plain.tif", hills(low=310, high=318), transform=Affine(1000, 0, 5e5, 0, -1000, 4e6)),
        write(tmp_path / "ground.tif", hills(low=-30, high=30), transform=Affine(50000, 0, 0, 0, -50000, 0), crs=None),
    ):
        assert not any("kilometres" in w for w in info(path)["warnings"]), path
    described = write(tmp_path / "a.tif", hills(low=-30, high=30))
    with rasterio.open(described, "r+") as dataset:
        dataset.set_band_description(1, "geoid_undulation")
    assert any("geoid grid" in w for w in info(described)["warnings"])


def test_very_large_rasters_are_sampled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "sparse.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=60000,
        width=50000,
        count=1,
        dtype="int16",
        crs="EPSG:32611",
        transform=UTM,
        tiled=True,
        sparse_ok=True,
        compress="deflate",
        bigtiff="yes",
    ) as dataset:
        dataset.write(np.full((1, 256, 256), 700, np.int16), window=rasterio.windows.Window(0, 0, 256, 256))
    found = info(path)
    assert found["height_range_exact"] is False and found["height_range"] == [0, 700]
    monkeypatch.setattr(statistics_module, "EXACT", 1000)
    small = write(tmp_path / "small.tif", hills(1500, 1400), tiled=True)
    with Source.open(small) as source:
        sampled, exact = statistics(source, 30.0), statistics(source, 30.0, exact=True)
    assert not sampled.exact and exact.exact
    assert (exact.low, exact.high) == (200, 900) and 200 <= sampled.low < 300 and 800 < sampled.high <= 900


def test_statistics_do_not_depend_on_blocks_or_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = hills(301, 207)
    numbers[10:60, 20:90] = np.nan
    monkeypatch.setattr(statistics_module, "_STRIP", 2048)
    for i, layout in enumerate(({}, {"tiled": True, "blockxsize": 64, "blockysize": 32}, {"blockysize": 301})):
        with Source.open(write(tmp_path / f"{i}.tif", numbers, **layout)) as source:
            for jobs in (1, 4):
                found = statistics(source, 30.0, jobs=jobs)
                assert (found.low, found.high) == (np.nanmin(numbers), np.nanmax(numbers))
                assert found.valid_fraction == pytest.approx(1 - 50 * 70 / numbers.size, abs=1e-15)


def test_text_for_people(shared_data: Path) -> None:
    result = CliRunner().invoke(cli, ["info", str(shared_data / "spearfish-sfdem-utm13" / "sfdem.tiff")])
    assert result.exit_code == 0
    for part in (
        "477 rows × 634 columns",
        "EPSG:26713",
        "1066 to 1840 m",
        "30 × 30 m",
        "! It contains the number -1e+37",
    ):
        assert part in result.stdout


def test_errors_have_exit_code_3_and_no_traceback(tmp_path: Path, shared_data: Path) -> None:
    for path in (tmp_path / "none.tif", shared_data / "nasty-gdal" / "lzw_corrupted.tif"):
        run = subprocess.run(
            [sys.executable, "-m", "orograph", "info", str(path)], capture_output=True, text=True, timeout=60
        )
        assert run.returncode == 3 and run.stdout == ""
        assert path.name in run.stderr and "Traceback" not in run.stderr and run.stderr.count("\n") == 1


def test_a_store_is_told_from_a_raster(tmp_path: Path) -> None:
    from orograph import store

    dem = write(tmp_path / "a.tif", hills())
    url = tmp_path / "a.oro"
    store.build(dem, str(url)).close()
    found, of_dem = info(url), info(dem)
    assert set(found) == KEYS and found["kind"] == "store"
    for key in ("crs", "shape", "transform", "spacing_m", "height_range", "valid_fraction", "levels", "side"):
        assert found[key] == of_dem[key], key
    assert found["size_bytes"] == sum(p.stat().st_size for p in url.rglob("*") if p.is_file())


def test_what_resampling_has_lost_is_told(tmp_path: Path) -> None:
    from orograph import store

    degrees = Affine(0.001, 0, 8, 0, -0.001, 47)
    dem = write(tmp_path / "a.tif", hills() * 40, transform=degrees, crs="EPSG:4326")
    assert (info(dem)["resampled"], info(dem)["keeps_source"]) == (None, None)
    for keep in (True, False):
        terrain = store.build(dem, tmp_path / "a.oro", keep_source=keep, overwrite=True)
        facts = info(tmp_path / "a.oro")
        assert facts["resampled"] == terrain.resampled.to_json() and facts["keeps_source"] is keep
        assert ("samples of the source" in facts["parts"]) is keep
        assert sum(facts["parts"].values()) == facts["size_bytes"]
        text = CliRunner().invoke(cli, ["info", str(tmp_path / "a.oro")], catch_exceptions=False).output
        lost = terrain.resampled
        assert f"at most {lost.largest:.3g} m; summits lose at most {lost.summit_loss:.3g} m" in text
        assert f"its samples are {'' if keep else 'not '}kept" in text


def test_what_a_store_consists_of(tmp_path: Path) -> None:
    path = tmp_path / "a.oro"
    options = ["--errors", "exact,midpoint", "--color-errors", "--bake", "sky-view-factor"]
    line = ["build", str(write(tmp_path / "dem.tif", hills())), "-o", str(path), *options]
    assert CliRunner().invoke(cli, line, catch_exceptions=False).exit_code == 0
    facts = info(path)
    assert facts["colors"] == {"drape": None, "colormap": None, "sun": [315.0, 45.0], "relief": 1.0, "tints": 2}
    assert facts["layers"] == ["sky-view-factor"]
    parts = facts["parts"]
    names = ["heights", "exact errors", "midpoint errors", "spheres", "color errors", "sky-view-factor"]
    assert list(parts)[:-1] == names and min(parts.values()) > 0
    assert sum(parts.values()) == facts["size_bytes"]
    kept = sum(file.stat().st_size for file in path.glob("diamonds/*/exact/**/*") if file.is_file())
    assert parts["exact errors"] == kept
    text = CliRunner().invoke(cli, ["info", str(path)], catch_exceptions=False).output
    assert "tint alpine, sun at 315°, 45° high" in text and "sky-view-factor (8 bits; azimuths 32" in text
    assert "bytes per sample" in text


def test_amounts_of_memory() -> None:
    assert parse_bytes("1GiB") == 2**30 and parse_bytes("1.5 g") == 1_500_000_000 and parse_bytes("4096") == 4096
    assert parse_bytes("512 MiB") == 512 * 2**20 and parse_bytes("2KB") == 2000
    for bad in ("", "GiB", "-1", "0", "1 furlong", "nan", "1e400"):
        with pytest.raises(ValueError, match="memory"):
            parse_bytes(bad)
    assert math.log2(parse_bytes("1TiB")) == 40
