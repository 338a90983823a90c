"""What is written: GeoTIFFs, stores and pictures with their datum and attribution; the verb; tables of products."""

from __future__ import annotations

import json

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from PIL import Image
from sources import copernicus, heights

import orograph
from orograph.cli.fetch import command
from orograph.errors import OutputError, ReadError, UsageError
from orograph.fetching import Request, products, register
from orograph.fetching.areas import area_of
from orograph.geo.ellipsoid import EARTH
from orograph.verbs.info_text import describe

BOX = (-119.3, 36.8, -118.6, 37.25)
NAMED = "© DLR e.V. 2010-2014 and © Airbus Defence and Space GmbH 2014-2018"


def fetch(*args, code=0):
    """Run the verb; its output."""
    done = CliRunner().invoke(command, [str(arg) for arg in args], obj={"quiet": True})
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == code, done.output
    return done.output


def test_a_geotiff_has_the_samples_their_datum_and_whom_to_name(california, tmp_path):
    out = tmp_path / "area.tif"
    said = fetch("--bbox", "-119.3,36.8,-118.6,37.25", "--product", "copernicus-90", "-o", out)
    assert NAMED in said
    dem = orograph.fetch(BOX, "copernicus-90")
    again = orograph.read(out)
    np.testing.assert_array_equal(again.heights, dem.heights)
    assert again.grid == dem.grid
    assert again.vertical == "EGM2008 height"
    assert again.attribution == dem.attribution
    with rasterio.open(out) as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.units == ("m",)
        assert np.isnan(file.nodata)
        assert NAMED in file.tags()["ATTRIBUTION"]
        assert NAMED.replace("©", "(c)") in file.tags()["TIFFTAG_COPYRIGHT"]
        assert {"PRODUCT", "LICENSE", "YEARS", "MODEL", "SOURCE"} <= set(file.tags())
    assert list(tmp_path.glob(".*")) == []
    with pytest.raises(OutputError, match="there already"):
        fetch("--bbox", "-119.3,36.8,-118.6,37.25", "--product", "copernicus-90", "-o", out)
    fetch("--bbox", "-119.3,36.8,-118.6,37.25", "--product", "copernicus-90", "-o", out, "--overwrite")


def test_whole_metres_stay_whole_metres(srtm, tmp_path, shared_data):
    orograph.fetch((-119, 37, -118, 38), "srtm-3", output=tmp_path / "area.tif")
    with rasterio.open(tmp_path / "area.tif") as file:
        assert file.dtypes == ("int16",)
        assert file.nodata == -32768
        np.testing.assert_array_equal(file.read(1), heights(shared_data, "N37W119"))


def test_heights_are_moved_to_the_ellipsoid(california, web, cut_tiles, shared_data, tmp_path):
    """By the geoid grid of the Alps, at tiles that lie there."""
    path, data = copernicus("N46E007", cut_tiles["N37W119"])
    web.files[f"copernicus-90/{path}"] = data
    geoid = shared_data / "swiss-alps-geoids" / "us_nga_egm2008_1_clipAlps.tif"
    box = (7.3, 46.3, 7.5, 46.5)
    plain = orograph.fetch(box, "copernicus-90")
    out = tmp_path / "high.tif"
    moved = orograph.fetch(box, "copernicus-90", output=out, to_vertical="ellipsoidal", geoid=geoid)
    from orograph.geo.vertical import Geoid

    x, y = moved.grid.xy(*np.meshgrid(np.arange(moved.grid.cols), np.arange(moved.grid.rows)))
    truth = plain.heights + Geoid.open(geoid).undulation(x, y)
    np.testing.assert_allclose(moved.heights, truth, atol=2e-3)
    np.testing.assert_array_equal(orograph.read(out).heights, moved.heights)
    assert moved.vertical.startswith("ellipsoidal")
    assert orograph.read(out).vertical == "ellipsoidal height"


def test_attribution_goes_through_a_store_into_info_and_pictures(california, tmp_path):
    out = tmp_path / "area.oro"
    fetch("--bbox", "-118.9,37.0,-118.8,37.1", "--product", "copernicus-90", "-o", out)
    with orograph.open(out) as terrain:
        assert NAMED in terrain.attribution[0]
        assert terrain.grid.crs.is_projected
        assert terrain.samples is not None
        picture = orograph.render(terrain, size=(640, 400), furniture=True)
        without = orograph.render(terrain, size=(640, 400))
    facts = orograph.info(str(out), progress=False)
    assert NAMED in facts["attribution"][0]
    assert NAMED in describe(facts)
    for name in ("a.png", "a.jpg", "a.tif", "a.webp"):
        picture.save(tmp_path / name)
    assert Image.open(tmp_path / "a.png").text["Copyright"].startswith(NAMED)
    assert "Airbus" in Image.open(tmp_path / "a.jpg").getexif()[0x8298]
    assert "Airbus" in Image.open(tmp_path / "a.webp").getexif()[0x8298]
    assert "Airbus" in Image.open(tmp_path / "a.tif").tag_v2[0x8298]
    assert (picture.pixels != without.pixels).any()


def test_furniture_names_the_makers_whole_or_not_at_all():
    from orograph.rendering.furniture.furnish import lay_out

    layout = lay_out((1280, 720), note="Light from 315°", credit=products()["copernicus-30"].attribution)
    lines = [words for piece, _ in layout.placed for _, _, words, *_ in piece.texts]
    assert " ".join(lines[1:]) == products()["copernicus-30"].attribution
    layout = lay_out((120, 90), note="Light from 315°", credit=products()["copernicus-30"].attribution)
    assert not [words for piece, _ in layout.placed for _, _, words, *_ in piece.texts if "DLR" in words]


def test_a_build_of_two_products_names_both(california, srtm, tmp_path):
    orograph.fetch(BOX, "copernicus-90", output=tmp_path / "a.tif")
    orograph.fetch((-118.9, 37, -118.8, 37.1), "srtm-3", output=tmp_path / "b.tif")
    from orograph.dem.mosaic import Mosaic

    mosaic = Mosaic.open([tmp_path / "a.tif", tmp_path / "b.tif"])
    assert len(mosaic.attribution) == 2


def test_products_are_listed_and_tried(web):
    told = json.loads(fetch("--products", "--json"))
    assert {"copernicus-30", "copernicus-90", "srtm-1", "srtm-3", "aster", "alos-30", "3dep-10", "3dep-30", "terrarium",
            "mola", "lola"} <= set(told)  # fmt: skip
    listed = fetch("--products")
    assert all(name in listed for name in told)
    assert "needs an account: NASA Earthdata" in listed
    path = "Copernicus_DSM_COG_10_N46_00_E007_00_DEM"
    web.files[f"copernicus-30/{path}/{path}.tif"] = b"x"
    web.set(always={"aster/ASTGTMV003_N46E007_dem.tif": "401"})
    tried = {one["product"]: one for one in json.loads(fetch("--try-products", "--json", code=3))}
    assert tried["copernicus-30"]["code"] == 206
    assert tried["aster"]["good"]
    fetch("--try-products", "--product", "copernicus-30")
    assert not tried["srtm-1"]["good"]
    assert tried["srtm-1"]["url"] == f"{web.url}/srtm-1/N46E007.tif"
    assert tried["3dep-10"]["url"] == f"{web.url}/3dep-10/n40w106/USGS_13_n40w106.tif"
    assert tried["terrarium"]["url"] == f"{web.url}/terrarium/12/2133/1448.png"
    assert tried["skadi"]["url"] == f"{web.url}/skadi/N46/N46E007.hgt.gz"


def test_a_table_of_a_users_own(california, tmp_path, monkeypatch):
    table = tmp_path / "mine.toml"
    table.write_text(f'[mine]\nlike = "copernicus-90"\ntitle = "Mine"\nbase = "{california.url}/copernicus-90"\n'
                     'attribution = "me"\n')  # fmt: skip
    dem = orograph.fetch((-118.9, 37, -118.8, 37.1), "mine", table=table)
    assert dem.attribution == ("me",)
    monkeypatch.setenv("OROGRAPH_PRODUCTS", str(table))
    assert "mine" in json.loads(fetch("--products", "--json"))
    (tmp_path / "mine.json").write_text('{"mine": {"like": "copernicus-90", "colour": 3}}')
    with pytest.raises(UsageError, match="no field 'colour'"):
        products(tmp_path / "mine.json")
    (tmp_path / "mine.json").write_text("{")
    with pytest.raises(ReadError, match="does not match its file ending"):
        products(tmp_path / "mine.json")
    with pytest.raises(UsageError, match="no product 'nothing'; the products are copernicus-30"):
        orograph.fetch(BOX, "nothing")
    with pytest.raises(UsageError, match="lacks"):
        register("other", base="http://x")
    with pytest.raises(UsageError, match="an http or https URL"):
        register("copernicus-90", base="ftp://x")
    with pytest.raises(UsageError, match="degrees, web-mercator, one"):
        register("copernicus-90", tiling="hexagons")


@pytest.mark.parametrize(
    ("area", "radius", "said"),
    [
        ((1, 2, 3), None, "not 3 numbers"), ((0, 0), None, "needs a radius"), ((0, 0), -5, "needs a radius"),
        ((0, 0, 1, 1), 5, "needs a place"), ((0, 5, 1, 4), None, "empty"), ((0, 0, 1, 95), None, "not degrees"),
        ((0, 89.9), 50_000, "a pole"), ("Zermatt", None, "four numbers"), ({"type": "Point"}, None, "no coord"),
        ({"type": "Point", "coordinates": ["a", "b"]}, None, "pairs of numbers"),
        ((float("nan"), 0, 1, 1), None, "finite"),
    ],
)  # fmt: skip
def test_what_is_no_area_is_told(area, radius, said):
    with pytest.raises(UsageError, match=said):
        area_of(area, radius, EARTH)


def test_geometries_on_both_sides_of_the_180th_meridian_are_one_small_box():
    parts = [[[[179, -17], [180, -17], [180, -16], [179, -17]]], [[[-180, -17], [-179, -17], [-180, -16], [-180, -17]]]]
    box = area_of({"type": "MultiPolygon", "coordinates": parts}, None, EARTH)
    assert (box.west, box.south, box.east, box.north) == (179, -17, 181, -16)
    box = area_of((179, -17, -179, -16), None, EARTH)
    assert (box.west, box.east, box.across) == (179, 181, True)


def test_options_that_do_not_go_together(web, tmp_path):
    out = tmp_path / "a.tif"
    with pytest.raises(UsageError, match="An area is needed: `bbox`"):
        fetch("-o", out)
    with pytest.raises(UsageError, match="`radius` needs `at`"):
        fetch("--bbox", "0,0,1,1", "--radius", "5", "-o", out)
    assert "Missing option" in fetch("--bbox", "0,0,1,1", code=2)
    with pytest.raises(UsageError, match=r"more than 10 MiB"):
        fetch("--bbox", "0,0,1,1", "-o", out, "--most", "10MiB")
    with pytest.raises(UsageError, match="GeoTIFF or a store"):
        fetch("--bbox", "0,0,1,1", "-o", tmp_path / "a.png")
    with pytest.raises(UsageError, match="no zooms"):
        Request((0, 0, 1, 1), zoom=4)
    with pytest.raises(UsageError, match="covers latitudes -56 to 60"):
        Request((0, 70, 1, 71), "srtm-3")


def test_a_store_of_the_webs_mercator_is_true_to_scale(web, shared_data, tmp_path):
    png = (shared_data / "pymartini-tiles" / "terrarium.png").read_bytes()
    for x in (2132, 2133):
        for y in (1448, 1449):
            web.files[f"terrarium/12/{x}/{y}.png"] = png
    terrain = orograph.fetch((7.45, 46.45, 7.55, 46.5), "terrarium", output=tmp_path / "area.oro")
    assert terrain.grid.crs.to_epsg() == 32632
    assert terrain.grid.spacing[0] == pytest.approx(38.2 * np.cos(np.radians(46.5)), rel=0.02)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF"])
def test_large_pictures_name_the_makers(tmp_path, kind):
    from orograph.rendering.assembly import Assembly

    out = tmp_path / "picture"
    with Assembly(out, 64, 32) as assembly:
        assembly.write(0, 0, np.zeros((32, 64, 3), np.uint8))
        assembly.encode(kind, ("© the makers & others",))
    with Image.open(out) as image:
        said = {"PNG": lambda: image.text["Copyright"], "JPEG": lambda: image.getexif()[0x8298],
                "TIFF": lambda: image.tag_v2[0x8298]}[kind]()  # fmt: skip
    assert said == ("© the makers & others" if kind == "PNG" else "(c) the makers & others")
    assert list(tmp_path.iterdir()) == [out]


def test_heights_of_no_one_datum_are_not_converted_and_that_is_said_first(web, shared_data):
    geoid = shared_data / "swiss-alps-geoids" / "us_nga_egm2008_1_clipAlps.tif"
    with pytest.raises(UsageError, match="no single datum"):
        orograph.fetch((7.3, 46.3, 7.5, 46.5), "skadi", to_vertical="ellipsoidal", geoid=geoid)
    with pytest.raises(UsageError, match="EGM96 height"):
        orograph.fetch((7.3, 46.3, 7.5, 46.5), "srtm-3", to_vertical="ellipsoidal", geoid=geoid)
    assert web.total == 0
