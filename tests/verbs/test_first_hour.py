"""What people try first is answered with what to use, and what functions give shows itself."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import ReadError, UsageError


@pytest.fixture(scope="module")
def dem():
    y, x = np.mgrid[:60, :80] * 30.0
    heights = (500 + 90 * np.sin(x / 300) * np.cos(y / 250)).astype(np.float32)
    return orograph.Dem(heights, orograph.Grid((60, 80), Affine(30, 0, 500_000, 0, -30, 4_000_000), "EPSG:32611"))


@pytest.mark.parametrize(
    ("guess", "said"),
    [
        ("hillshade", 'orograph.light(dem, "hillshade")'),
        ("svf", 'orograph.light(dem, "sky-view-factor")'),
        ("sky_view_factor", 'orograph.light(dem, "sky-view-factor")'),
        ("viewshed", "orograph.measure.viewshed"),
        ("profile", "orograph.measure.profile"),
        ("isolines", "orograph.contours"),
        ("mosaic", "orograph.build"),
        ("subtract", "orograph.difference"),
        ("hilshade", 'Did you mean orograph.light(dem, "hillshade")?'),
        ("rendr", "Did you mean orograph.render or"),
    ],
)
def test_names_that_are_elsewhere(guess, said):
    with pytest.raises(AttributeError) as error:
        getattr(orograph, guess)
    assert said in str(error.value)


def test_names_that_nothing_is_like():
    with pytest.raises(AttributeError, match=r"has no attribute 'zzzz'$"):
        _ = orograph.zzzz
    assert not hasattr(orograph, "__wrapped__")


@pytest.mark.parametrize(
    ("option", "there"),
    [("vmin", "range"), ("clim", "range"), ("texture", "layers"), ("drape", "layers"), ("cmap", "colormap"),
     ("z_factor", "exaggeration")],
)  # fmt: skip
def test_options_of_other_libraries(dem, option, there):
    with pytest.raises(UsageError, match=f"It is called {there} here"):
        orograph.render(dem, **{option: 1})


def test_suns_and_points_that_are_given_otherwise(dem, tmp_path):
    with pytest.raises(UsageError, match=r"sun=\(315, 45\)"):
        orograph.light(dem, "hillshade", azimuth=315)
    with pytest.raises(UsageError, match=r"light\(dem, 'slope'\).save\('slope.tif'\)"):
        orograph.light(dem, "slope", path="slope.tif")
    assert orograph.light(dem, "slope", output=tmp_path / "slope.tif") == tmp_path / "slope.tif"
    with pytest.raises(UsageError, match="`resolution` must be one or several numbers"):
        orograph.terrain(dem, resolution="fine")
    with pytest.raises(AttributeError, match=r"no attribute 'length'. There are .*pick, .*profile"):
        _ = orograph.measure.length
    with pytest.raises(UsageError, match=r"Its signature is profile\(terrain, polyline, lonlat\)"):
        orograph.measure.profile(dem, (500_100, 3_999_000), (500_900, 3_999_500))


def test_results_say_what_they_are(dem):
    assert re.fullmatch(r"<Map 'slope': 60 × 80 samples, 30 m apart, .*>", repr(orograph.light(dem, "slope")))
    line = orograph.measure.profile(dem, [(500_100, 3_999_000), (501_900, 3_999_500)])
    assert re.fullmatch(r"<Profile over 'terrain': [\d,]+ m along the ground, 1,869 m across, .* places>", repr(line))
    shed = orograph.measure.viewshed(dem, (501_000, 3_999_000))
    assert repr(shed).startswith("<Viewshed 'from 501000, 3999000': eye 1.7 m, 60 × 80 samples")
    seen = shed.to_xarray()
    assert seen.dims == ("y", "x") and np.array_equal(seen.values, shed.values(), equal_nan=True)
    assert shed.summary()["seen"] == int((shed.values() > 0).sum())


def test_results_are_drawn_on_axes(dem):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    fig, (left, right) = pyplot.subplots(1, 2)
    image = orograph.light(dem, "slope").plot(left, cmap="magma")
    assert image.get_extent() == [500_000, 502_400, 3_998_200, 4_000_000]
    line = orograph.measure.profile(dem, [(500_100, 3_999_000), (501_900, 3_999_500)])
    assert line.plot(right) is right and right.get_xlabel() == "distance (m)"
    drawn = right.lines[0].get_ydata()
    assert np.allclose(drawn, line.surface_heights)
    pyplot.close(fig)


def test_a_figure_is_no_axes(dem):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    figure = pyplot.figure()
    picture = orograph.render(dem, size=(60, 40))
    for given, kind in ((figure, "a Figure"), ((figure, figure.subplots()), "a tuple")):
        with pytest.raises(UsageError, match=rf"not on {kind}. Those of a figure are figure\.subplots\(\)"):
            picture.plot(given)
    pyplot.close(figure)


def test_what_other_libraries_call_saving(dem):
    picture = orograph.render(dem, size=(60, 40))
    with pytest.raises(AttributeError, match=r"use picture\.save\(path\)"):
        picture.savefig("x.png")
    with pytest.raises(AttributeError, match=r"use picture\.pixels\.shape"):
        picture.shape  # noqa: B018
    with pytest.raises(UsageError, match=r"not in an open file. PIL\.Image"):
        picture.save(io.BytesIO())
    with pytest.raises(UsageError, match="It is called sun here"):
        orograph.render(dem, azdeg=315)
    assert not hasattr(picture, "_repr_html_")


@pytest.mark.parametrize("jobs", ["2", 0, -1, 1.5])
def test_threads_are_a_number(dem, jobs):
    with pytest.raises(UsageError, match="`jobs`"):
        orograph.light(dem, "slope", jobs=jobs)
    with pytest.raises(UsageError, match="`jobs`"):
        orograph.tin(dem, max_error=5, jobs=jobs)


def test_a_profile_is_a_table(dem):
    pandas = pytest.importorskip("pandas")
    line = orograph.measure.profile(dem, [(500_100, 3_999_000), (501_900, 3_999_500)])
    table = line.to_dataframe(every=100)
    assert isinstance(table, pandas.DataFrame) and len(table) == 20
    assert table.distance_m.iloc[-1] == pytest.approx(line.distance[-1])


def test_heights_at_many_points(dem):
    points = np.column_stack([np.linspace(500_015, 502_385, 1000), np.linspace(3_999_985, 3_998_215, 1000)])
    found = orograph.measure.heights(dem, points)
    one = [orograph.measure.place(dem, point).height for point in points[::100]]
    assert found.shape == (1000,) and found[::100] == pytest.approx(one)
    degrees = orograph.measure.Places(dem).lonlat(points)
    assert orograph.measure.heights(dem, degrees, lonlat=True) == pytest.approx(found, abs=1e-4)
    with pytest.raises(UsageError, match=r"orograph\.measure\.heights"):
        orograph.measure.place(dem, points)


def test_a_pattern_names_the_files_that_it_matches(dem, tmp_path):
    orograph.export(dem, tmp_path / "a.tif", progress=False)
    moved = orograph.Grid(dem.grid.shape, Affine.translation(2400, 0) * dem.grid.transform, dem.grid.crs)
    orograph.export(orograph.Dem(dem.heights, moved), tmp_path / "b.tif", progress=False)
    both = orograph.terrain(str(tmp_path / "*.tif"))
    assert both.grid.shape == (60, 160)
    with pytest.raises(ReadError, match="no such file"):
        orograph.terrain(str(tmp_path / "*.hgt"))


def test_areas_and_pictures_that_are_given_otherwise(dem, tmp_path):
    for given, wrong in (
        ({}, "An area is needed: `bbox`, `at` .with `radius`. or `geojson`"),
        ({"bbox": "7,45,8,46", "at": (7, 45)}, "Give one of `bbox`"),
        ({"bbox": "7,45,8,46", "radius": 5}, "`radius` needs `at`"),
        ({"at": (7, 45)}, "radius of more than 0"),
        ({"box": (7, 45, 8, 46)}, r"fetch has no option 'box'. Did you mean bbox\?"),
    ):
        with pytest.raises(UsageError, match=wrong):
            orograph.fetch(**given)
    with pytest.raises(UsageError, match=r"picture\.save\('relief\.png'\)"):
        orograph.render(dem, "relief.png")
    with pytest.raises(UsageError, match="`interval` must be a number, or none, not '20'"):
        orograph.contours(dem, "20")
    with pytest.raises(UsageError, match="Products are given first, or as `products`"):
        orograph.light(dem, product="slope")
    mesh = orograph.tessellate(dem, tolerance=2, progress=False)
    assert mesh.save(tmp_path / "mesh.npz").exists() and len(mesh.positions()) == len(mesh.vertices)
    for kind in (orograph.Layer, orograph.Dataset):
        with pytest.raises(UsageError, match=r"no 'cmap'\. It is called colormap here"):
            kind("a.tif", cmap="viridis")
        with pytest.raises(UsageError, match=r"Did you mean opacity"):
            kind("a.tif", opacty=1)
    with pytest.raises(UsageError, match=r"mesh\.xyz"):
        mesh.save(tmp_path / "mesh.xyz", dem.grid)
    assert repr(orograph.View((1 / 3, 0, 9), (0, 0, 1))).startswith("View(eye=(0.333, 0.0, 9.0), target=")


@pytest.mark.parametrize(
    ("module", "name", "meant"),
    [("measure", "profil", "orograph.measure.profile"), ("camera", "arround", "orograph.camera.around")],
)
def test_names_that_modules_do_not_have(module, name, meant):
    with pytest.raises(AttributeError, match=f"Did you mean {meant}"):
        getattr(getattr(orograph, module), name)
    assert not hasattr(getattr(orograph, module), "zzzz")


def test_texts_of_several_parts(dem):
    """What the command line writes as one text may be that text here."""
    lights = [orograph.light(dem, "hillshade", lights=these).values
              for these in (["315,45", "225,30,1"], [(315, 45), (225, 30, 1.0)])]  # fmt: skip
    np.testing.assert_array_equal(*lights)
    line = [(500_100, 3_999_000), (501_900, 3_999_500)]
    texts = ["500100,3999000", "501900,3999500"]
    assert orograph.measure.profile(dem, texts).length == orograph.measure.profile(dem, line).length
    assert orograph.measure.place(dem, texts[0]) == orograph.measure.place(dem, line[0])
    assert orograph.terrain(dem, resolution="60").grid.spacing == orograph.terrain(dem, resolution=60).grid.spacing


@pytest.mark.parametrize("verb", ["export", "difference", "contours"])
def test_no_result_replaces_what_it_is_made_from(dem, tmp_path, verb):
    path = orograph.export(dem, tmp_path / "dem.tif")
    if verb == "contours":
        path = tmp_path / "points.gpkg"
        geopandas = pytest.importorskip("geopandas")
        x, y = np.random.default_rng(1).uniform((500_000, 3_999_000), (500_900, 3_999_900), (60, 2)).T
        places = geopandas.points_from_xy(x, y)
        geopandas.GeoDataFrame({"z": x % 70}, geometry=places, crs=32611).to_file(path, layer="points")
    before = path.read_bytes()
    again = path.parent / ".." / path.parent.name / path.name
    calls = {
        "export": lambda: orograph.export(path, again, overwrite=True),
        "difference": lambda: orograph.difference(dem, [path], ["change.tif", again]),
        "contours": lambda: orograph.contours(path, 10, output=again),
    }
    with pytest.raises(UsageError, match="would overwrite what it is made from"):
        calls[verb]()
    assert path.read_bytes() == before


def test_a_build_warns_of_what_is_doubtful(dem, tmp_path):
    heights = dem.heights.copy()
    heights[20:40, 30:60] = -9999
    path = tmp_path / "dem.tif"
    profile = {"driver": "GTiff", "width": 80, "height": 60, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", transform=dem.grid.transform, **profile) as file:
        file.write(heights, 1)
    with pytest.warns(UserWarning) as told:
        orograph.build(path, tmp_path / "a.oro")
    said = [str(one.message) for one in told]
    for words in ("It has no CRS", "Its lowest stored number is -9999"):
        assert sum(words in text for text in said) == 1, said
    ran = CliRunner().invoke(cli, ["build", str(path), "-o", str(tmp_path / "b.oro")], obj={})
    assert ran.exit_code == 0 and all(ran.stderr.count(one) == 1 for one in ("no CRS", "--nodata -9999"))
