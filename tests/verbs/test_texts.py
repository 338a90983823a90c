"""What the command line takes as a text, functions take as that text, too: sizes, memory, areas, lists."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import click
import numpy as np
import pytest
from affine import Affine

import orograph
from orograph.cli import cli
from orograph.cli.options import Bytes, Classes, Nodata, Numbers
from orograph.errors import OrographError, UsageError
from orograph.folders import bytes_of
from orograph.lighting.context import MORE, Options
from orograph.measuring import HeightError
from orograph.scene.parts import OPTIONS
from orograph.scene.sizes import dpi_of, size_of
from orograph.several import numbers, words

AMOUNTS = ("max_memory", "gpu_memory", "cache_bytes", "max_bytes", "most")
SIZES = ("size",)


def functions() -> dict[str, Any]:
    found = {name: getattr(orograph, name) for name in orograph.__all__}
    found |= {f"measure.{name}": getattr(orograph.measure, name) for name in orograph.measure.__all__}
    found |= {f"camera.{name}": getattr(orograph.camera, name) for name in ("whole", "around", "standing", "plan")}
    return {name: one for name, one in found.items() if inspect.isfunction(one)}


def having(options: tuple[str, ...]) -> list[tuple[str, str]]:
    return [
        (name, option) for name, one in functions().items() for option in options
        if option in inspect.signature(one).parameters and (name, option) != ("synth", "size")  # (rows, cols)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def dem():
    y, x = np.mgrid[:40, :50] * 30.0
    heights = (500 + 90 * np.sin(x / 300) * np.cos(y / 250)).astype(np.float32)
    return orograph.Dem(heights, orograph.Grid((40, 50), Affine(30, 0, 500_000, 0, -30, 4_000_000), "EPSG:32611"))


@pytest.fixture(scope="module")
def given(dem, tmp_path_factory):
    """The arguments that functions need, by their names."""
    folder = tmp_path_factory.mktemp("texts")
    store = orograph.build(dem, folder / "hill.oro", progress=False).url
    return {
        "terrain": dem, "a": dem, "b": dem, "source": dem, "data": dem, "store": store,
        "name": "slope", "url": folder / "new.oro", "output": folder / "out.tif", "path": folder / "none.tif",
        "area": (0, 0, 1, 1), "target": [(500_700.0, 3_999_400.0)], "point": (500_700.0, 3_999_400.0), "level": 480.0,
        "error": HeightError(sigma=1), "eye": (-116.9, 36.1, 900.0), "look_at": None, "tolerance": 1,
        "files": folder / "none.tif", "polygon": None, "zones": None, "points": [], "view": None, "polyline": [],
        "size": (64, 48),
    }  # fmt: skip


def called(function: Any, given: dict[str, Any], **options: Any) -> Any:
    names = [
        one.name for one in inspect.signature(function).parameters.values()
        if one.default is one.empty and one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)
    ]  # fmt: skip
    needed = [given[name] for name in names if name not in options]
    return function(**dict(zip([name for name in names if name not in options], needed)), **options)


@pytest.mark.parametrize(("name", "option"), having(AMOUNTS + SIZES))
def test_texts_are_read_and_wrong_ones_refused_by_the_options_name(given, name, option):
    one = functions()[name]
    wrong = dict.fromkeys(["interval"], 10.0) if name == "measure.contours" else {}
    with pytest.raises(UsageError) as error:
        called(one, given, **{option: "some"}, **wrong)
    assert "'some'" in error.value.what and (option in error.value.what or "1280x720" in error.value.what)
    annotation = str(inspect.signature(one).parameters[option].annotation)
    scene = name == "render" and option == "max_memory"  # (its type is the scene's own field)
    assert scene or "Amount" in annotation or "Size" in annotation, f"{name}: {option}: {annotation}"


def single() -> Iterator[tuple[str, str, str]]:
    """Every argument that is one number or one switch: the function, the argument, and what it must be."""
    light = {name: str(one.annotation) for name, one in inspect.signature(Options).parameters.items()} | MORE
    scene = {one.name: one.annotation for one in OPTIONS.values() if one.read is None}
    for name, one in functions().items():
        types = {option: str(about.annotation) for option, about in inspect.signature(one).parameters.items()}
        types |= {"light": light, "bake": light, "view": scene, "movie": scene}.get(name, {})
        if "reading" in types:
            types |= {"spacing": "float", "skip_damaged": "bool"}
        for option, annotation in types.items():
            kind = re.fullmatch(r"(int|float|bool)( \| None)?", annotation)
            if kind is not None and option not in ("band", *AMOUNTS):  # (a band's name is answered with its number)
                what = {"int": "a whole number", "float": "a number", "bool": "(True or False|yes or no)"}[kind[1]]
                yield name, option, what


@pytest.mark.parametrize(("name", "option", "what"), [*single()])
def test_a_text_in_place_of_a_number_is_refused_by_the_options_name(given, name, option, what):
    more = {"light": {"products": "slope"}, "movie": {"output": "film.mp4"}, "tin": {"max_error": 5},
            "manifest": {"path": "a.manifest.geojsonl"}}.get(name, {})  # fmt: skip
    with pytest.raises(UsageError, match=rf"`{option}` must be {what}.*, not '500'"):
        called(functions()[name], given, **{**more, option: "500"})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda dem: orograph.tin(dem, True), "`max_error` must be a number, or none, not True"),
        (lambda dem: orograph.tin(dem, triangles=50.5), "`triangles` must be a whole number, or none, not 50.5"),
        (lambda dem: orograph.synth(seed=None), "`seed` must be a whole number, not None"),
        (lambda dem: orograph.contours(dem, [10]), "`interval` must be a number, or none, not \\[10\\]"),
        (lambda dem: orograph.Layer("a.png", opacity="half"), "`opacity` must be a number"),
        (lambda dem: orograph.best_view(dem, [(500_700.0, 3_999_400.0)], azimuths="north"), "`azimuths` must be"),
        (lambda dem: orograph.light(dem.heights, "slope", cell="wide"), "A cell must be .* not 'wide'"),
        (lambda dem: orograph.synth(exemplar=dem, size=40, jitter="much"), "`jitter` must be .* not 'much'"),
        (lambda dem: orograph.measure.pick(dem, orograph.camera.whole(dem), ("a", 3)), "two finite numbers"),
        (lambda dem: orograph.read("none.tif", band=1.5), "There is no such file"),
    ],
)
def test_what_is_no_number_is_refused(dem, call, said):
    with pytest.raises(OrographError, match=said):
        call(dem)


def test_numbers_may_be_numpys(dem):
    whole, half = np.int64(40), np.float32(0.5)
    assert len(orograph.tin(dem, triangles=whole, progress=False).triangles) <= 40
    assert orograph.synth(size=33, seed=np.array(3), roughness=half).heights.shape == (33, 33)


@pytest.mark.parametrize("name", ["export", "tin", "light", "terrain", "measure.viewshed", "build", "tour"])
def test_memory_as_text_does_the_same(given, name):
    more = {
        "tin": {"max_error": 5},
        "light": {"products": "slope"},
        "export": {"overwrite": True},
        "build": {"overwrite": True},
    }.get(name, {})
    called(functions()[name], given, max_memory="512MiB", **more)


def special() -> set[tuple[str, str]]:
    """(verb, argument) of the options whose texts are not simply numbers, words, paths or choices."""
    found = set()

    def walk(command: click.Command, path: tuple[str, ...]) -> None:
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                inner = command.get_command(context, name)
                assert inner is not None
                walk(inner, (*path, name))
            return
        for one in command.params:
            if isinstance(one.type, Bytes | Numbers | Nodata | Classes) or type(one.type).__name__ in (
                "Size", "Names", "ErrorKinds", "MaxError", "Most",
            ):  # fmt: skip
                found.add((" ".join(path), str(one.name)))

    walk(cli, ())
    return found


READ = {
    "max_memory", "gpu_memory", "most", "size", "bbox", "errors", "max_error", "nodata", "products", "around", "points",
    "at", "point_classes",
}  # fmt: skip
ONLY_THERE = {"lonlat", "look_at", "lights", "pixels"}
"""A camera is made by ``orograph.camera`` in Python; lights and pixels are numbers there."""


def test_every_option_with_a_text_of_its_own_is_read_in_python_too():
    assert {name for _, name in special()} <= READ | ONLY_THERE


def test_what_texts_mean():
    assert bytes_of("1GiB") == 1 << 30 and bytes_of(1e9) == 10**9 and bytes_of(None) is None
    assert size_of("1280x720") == (1280, 720) == size_of([1280, 720]) and dpi_of(size_of("2x1in@100")) == 100
    assert size_of("2x1in@100") == (200, 100)
    assert size_of(2400) == size_of("2400") == (2400, 1350) and size_of("16cm@254") == (1600, 900)
    assert words("exact, midpoint") == ("exact", "midpoint") and words("none") == () == words(())
    assert numbers("1,2.5", "x") == (1.0, 2.5) and numbers(3, "x") == (3.0,) == numbers([3], "x")
    for wrong in (0, -1, True, 1.5, "0", "many", [1]):
        with pytest.raises(UsageError, match="`max_memory`"):
            bytes_of(wrong)
    with pytest.raises(UsageError, match="`heights` must be one or several numbers"):
        numbers("high", "heights")


def test_lists_and_areas_as_texts(dem, tmp_path):
    # (a corner of the terrain)
    box = "-117,36.1315,-116.993,36.2"
    part = orograph.terrain(dem, bbox=box)
    assert part.grid.shape == orograph.terrain(dem, bbox=tuple(map(float, box.split(",")))).grid.shape < (40, 50)
    store = orograph.build(dem, tmp_path / "a.oro", errors="exact,midpoint", progress=False)
    assert set(store.errors) >= {"exact", "midpoint"}
    orograph.bake(store.url, "sky-view-factor,openness", azimuths=8, progress=False)
    x, y = 500_700.0, 3_999_400.0
    lon, lat = orograph.measure.Places(dem).lonlat(np.array([[x, y]]))[0]
    text = orograph.tour(dem, around=f"{lon},{lat},300", size="160x100")
    assert text.keys[0].view == orograph.tour(dem, around=(lon, lat, 300), size=(160, 100)).keys[0].view
    assert len(orograph.compare(dem, methods="soar", size="160x100", progress=False)) == 1
    found = orograph.best_view(dem, [(x, y)], k=1, size="160x100", pitches=30, azimuths=4, distances=800)
    assert len(found) == 1


def test_places_in_degrees(dem):
    measure = orograph.measure
    corners = np.array([[500_300.0, 3_999_300.0], [501_100.0, 3_999_700.0], [500_300.0, 3_999_700.0]])
    round_it = measure.Places(dem).lonlat(corners)
    points, degrees = corners[:2], round_it[:2]
    assert measure.profile(dem, degrees, lonlat=True).length == pytest.approx(measure.profile(dem, points).length)
    found = measure.area(dem, round_it, lonlat=True)
    assert found.surface == pytest.approx(measure.area(dem, corners).surface, rel=1e-6)
    assert measure.place(dem, degrees[0], lonlat=True).height == pytest.approx(measure.place(dem, points[0]).height)
    sight = measure.line_of_sight(dem, *degrees, lonlat=True)
    assert sight.visible == measure.line_of_sight(dem, *points).visible
    assert measure.slope_aspect(dem, degrees[0], lonlat=True) == pytest.approx(measure.slope_aspect(dem, points[0]))
    seen = measure.viewshed(dem, degrees[0], lonlat=True).values()
    assert np.array_equal(seen, measure.viewshed(dem, points[0]).values(), equal_nan=True)
    wet = measure.flood(dem, 500, degrees[:1], lonlat=True).values()
    assert np.array_equal(wet, measure.flood(dem, 500, points[:1]).values(), equal_nan=True)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda dem: orograph.render(dem, "map"), '"plan"'),
        (lambda dem: orograph.light(dem, "svf"), "Did you mean sky-view-factor?"),
        (lambda dem: orograph.light(dem, "sky_view_factr"), "Did you mean sky-view-factor?"),
        (lambda dem: orograph.measure.place(dem, (-116.994, 36.139)), "lonlat=True"),
    ],
)
def test_what_is_nearly_right_is_answered_with_what_is(dem, call, said):
    with pytest.raises(OrographError) as error:
        call(dem)
    assert said in str(error.value)
