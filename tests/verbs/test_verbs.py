"""What the command line can do, as functions: the same names, the same options, the same results."""

from __future__ import annotations

import importlib
import inspect
import json
import logging
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS

import orograph
from orograph.cli import VERBS, cli
from orograph.cli.scenes import DETAILS
from orograph.cli.wording import spoken
from orograph.errors import OutputError, UsageError
from orograph.geo import Grid
from orograph.lighting.context import MORE, Options
from orograph.progress import Progress
from orograph.store.given import READING

GRID = Grid((65, 81), Affine(30, 0, 380000, 0, -30, 3790000), CRS.from_epsg(32611))


@pytest.fixture(scope="module")
def dem() -> orograph.Dem:
    y, x = np.mgrid[:65, :81]
    return orograph.Dem((800 + 90 * np.sin(x / 9) * np.cos(y / 7)).astype(np.float32), GRID, name="hills")


@pytest.fixture(scope="module")
def path(dem: orograph.Dem, tmp_path_factory: pytest.TempPathFactory) -> Path:
    import rasterio

    file = tmp_path_factory.mktemp("verbs") / "hills.tif"
    rows, cols = dem.grid.shape
    with rasterio.open(
        file, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="float32", crs="EPSG:32611",
        transform=GRID.transform,
    ) as out:  # fmt: skip
        out.write(dem.heights, 1)
    return file


def run(*args: Any) -> str:
    ran = CliRunner().invoke(cli, [str(a) for a in args], obj={}, catch_exceptions=False)
    assert ran.exit_code == 0, ran.output
    return ran.stdout


NOT_HERE: dict[str, dict[str, str]] = {
    "": {
        "paths": "the first argument", "path": "the first argument", "as_json": "the result has the same facts",
        "json_path": "the result has the same facts",
    },
    "render": {"save_view": "picture.view.save(path)"},
    "build": {"dem": "source", "store": "url", "repair": "orograph.store.repair.repair, with a result of its own"},
    "compare": {"every": "methods", "method": "methods, which takes one or several"},
    "movie": {"tour_path": "tour, which takes its file, too"},
    "best_view": {"output": "found.save(path)", "tour_path": "found.tour().save(path)", "seconds": "found.tour()"},
    "tour": {"output": "tour.save(path)"}, "manifest": {"output": "path"},
    "fetch": {"list_products": "orograph.fetching.products", "try_products": "orograph.fetching.trying",
              "yes": "most, a limit of bytes"},
    "view": {"adapter": "GPUs are chosen by WebGPU", "screenshot": "orograph.render", "frames": "a window's test"},
}  # fmt: skip
"""Options of the command line that are said otherwise in Python, by verb, and how."""

ONLY_HERE: dict[str, dict[str, str]] = {
    "": {
        "terrain": "an argument", "source": "an argument", "url": "--output", "progress": "--quiet",
        "storage_options": "GDAL's and fsspec's environment variables; a command line is read by others",
    },
    "build": {
        "chunked": "--for chunked-lod,cells=32 says it; on a cluster, this is what each task is told of that",
        "quadtin": "--for quadtin says it, likewise",
    },
    "bake": {"options": "an option each"},
    "compare": {"methods": "--method, --methods"},
    "fetch": {"area": "--bbox, --at, --geojson"},
    "light": {"data": "an argument", "cell": "the size of an array's cells; files know theirs"},
    "manifest": {"files": "arguments", "path": "--output"},
    "movie": {"tour": "--tour, --keys, --orbit"},
    "render": {"view": "--view and the options of a camera", "depths": "of a series, whose pictures share them"},
    "tessellate": {"view": "--view and the options of a camera"},
    "view": {
        "camera": "--view and the options of a camera",
        "panels": "a window has room for them; a notebook's cell begins without",
    },
}  # fmt: skip
"""Options in Python that the command line says otherwise or cannot mean, by verb, and why."""

CAMERA = {"azimuth", "pitch", "distance", "lonlat", "look_at", "view_path", "fov", "projection"}
"""What a ``view`` says."""


@pytest.mark.parametrize("verb", sorted({verb.replace("-", "_") for verb in VERBS} - {"demo", "measure"}))
def test_every_verb_is_a_function_with_its_options(verb: str) -> None:
    function = getattr(orograph, verb)
    command = importlib.import_module(f"orograph.cli.{verb}").command
    if isinstance(command, click.Group):
        command = command.commands["new"]
    there = set(inspect.signature(function).parameters) | set(READING)
    if verb in ("movie", "view"):
        there |= set(inspect.signature(orograph.render).parameters) | set(inspect.signature(orograph.tour).parameters)
    if verb in ("light", "bake"):
        there |= set(Options.__dataclass_fields__) | set(MORE)
    said = {p.name for p in command.params} - {*NOT_HERE[""], *NOT_HERE.get(verb, {})}
    said -= {name for more in DETAILS.values() for name in more}  # (they are of ``Contours`` and ``Silhouettes``)
    said.discard("uncertainty")  # (it is a ``Dataset``'s)
    if verb not in ("tour", "best_view"):
        said -= CAMERA
    assert not said - there
    names = {p.name for p in command.params}
    assert ("resolution" in names) == ("crs" in names) == ("resampling" in names) or verb == "synth"
    assert names >= NOT_HERE.get(verb, {}).keys(), "an excuse without an option"
    assert not NOT_HERE.get(verb, {}).keys() & inspect.signature(function).parameters.keys(), "an excuse for nothing"
    rest = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    only = {p.name for p in inspect.signature(function).parameters.values() if p.kind not in rest} - names
    assert only - {*READING, *ONLY_HERE[""]} == ONLY_HERE.get(verb, {}).keys()


@pytest.mark.parametrize("name", sorted({verb.replace("-", "_") for verb in VERBS} - {"demo", "measure"}))
def test_help_is_complete(name: str) -> None:
    function = getattr(orograph, name)
    told = inspect.getdoc(function)
    assert told is not None
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            assert f"{parameter.name}:" in told or f"{parameter.name}, " in told or f", {parameter.name}" in told, (
                parameter.name
            )


def test_the_package_is_tidy() -> None:
    from importlib.metadata import version

    assert orograph.__version__ == version("orograph")
    assert dir(orograph) == sorted(orograph.__all__)
    code = "import orograph; [getattr(orograph, name) for name in dir(orograph)]; print(orograph.camera.__name__)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "orograph.scene.camera"
    quick = "import sys, orograph; dir(orograph); print('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", quick], capture_output=True, text=True).stdout.strip() == "False"


def test_info(dem: orograph.Dem, path: Path, tmp_path: Path) -> None:
    found = orograph.info(path)
    told = json.loads(run("info", path, "--json"))
    assert {k: v for k, v in found.items() if not k.startswith("_")} == told
    assert spoken(repr(found)).strip() == run("info", path).strip()
    assert "<pre>" in found._repr_html_()
    held = orograph.info(dem)
    assert held["shape"] == [65, 81] and held["kind"] == "terrain" and "65 rows × 81 columns" in repr(held)
    assert held["height_range"] == pytest.approx(found["height_range"])
    store = orograph.build(dem, tmp_path / "a.oro").url
    assert (
        orograph.info(store)["kind"] == "store"
        and spoken(repr(orograph.info(store))).strip() == run("info", store).strip()
    )


def test_doctor_and_check(dem: orograph.Dem, tmp_path: Path) -> None:
    found = orograph.doctor()
    assert found["orograph"] == orograph.__version__ and repr(found).startswith("Orograph ")
    with orograph.build(dem, tmp_path / "a.oro") as store:
        assert orograph.check(store) == []
        assert orograph.check(store.url, progress=False) == []
    victim = max((tmp_path / "a.oro" / "heights").rglob("*"), key=lambda f: f.stat().st_size if f.is_file() else 0)
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 255
    victim.write_bytes(data)
    assert len(orograph.check(tmp_path / "a.oro")) == 1


def test_build_completes_a_store(path: Path, tmp_path: Path) -> None:
    """As the command line does: the same bytes."""
    orograph.build(
        path, tmp_path / "own.oro", methods=["roam,error=wedgie", "chunked-lod,cells=16"], products="openness",
        color_errors=True, tins=8, progress=False,
    )  # fmt: skip
    run("build", path, "-o", tmp_path / "cli.oro", "--for", "roam,error=wedgie", "--for", "chunked-lod,cells=16",
        "--bake", "openness", "--color-errors", "--tins", 8)  # fmt: skip
    own, cli_ = ({file.relative_to(tmp_path / name): file.read_bytes() for file in (tmp_path / name).rglob("*")
                  if file.is_file()} for name in ("own.oro", "cli.oro"))  # fmt: skip
    assert own == cli_
    with orograph.open(tmp_path / "own.oro") as store:
        assert {"exact", "wedgie"} <= set(store.errors) and tuple(store.layers) == ("openness",)
    for wrong, words in (
        ({"drape": "a.png"}, "`drape` is only used"), ({"methods": "sore"}, "soar"), ({"products": "slope"}, "baked"),
        ({"methods": "bdam,legs=4", "tins": 8}, "TINs of one kind"),
        ({"part": "1/2", "products": "openness"}, "heights"), ({"for_": "soar"}, "called methods here"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            orograph.build(path, tmp_path / "no.oro", **wrong)


def test_maps_of_light_as_files(path: Path, tmp_path: Path) -> None:
    """As the command line writes them; an interrupted one is resumed."""
    run("light", path, "--product", "openness,slope", "--azimuths", 8, "--byte", "-o", tmp_path / "cli.tif")
    how: dict[str, Any] = {"azimuths": 8, "byte": True, "progress": False}
    own = orograph.light(path, "openness,slope", output=tmp_path / "own.tif", resume=True, **how)
    assert own == tmp_path / "own.tif" and own.read_bytes() == (tmp_path / "cli.tif").read_bytes()
    assert not (tmp_path / "own.tif.partial").exists()
    for wrong, words in (
        ({"byte": True}, "`byte` is about a file"), ({"resume": True}, "`resume` is about a file"),
        ({"output": "a.png"}, "saved as a GeoTIFF"), ({"output": path}, "overwrite"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            orograph.light(path, "slope", **wrong)


def test_synth(tmp_path: Path) -> None:
    run("synth", "-o", tmp_path / "cli.tif", "--size", "33x41", "--seed", 3, "--compress", "none")
    made = orograph.synth(size=(33, 41), seed=3)
    assert isinstance(made, orograph.Dem)
    np.testing.assert_array_equal(made.heights, orograph.read(tmp_path / "cli.tif").heights)
    file = orograph.synth(tmp_path / "own.tif", size="33x41", seed=3, compress="none")
    assert isinstance(file, Path) and file.read_bytes() == (tmp_path / "cli.tif").read_bytes()
    with pytest.raises(OutputError, match="overwrite=True"):
        orograph.synth(file)


def test_tessellate(dem: orograph.Dem, path: Path, tmp_path: Path) -> None:
    run("tessellate", path, "-o", tmp_path / "cli.npz", "--tolerance", 2, "--exaggeration", 1.5)
    truth = np.load(tmp_path / "cli.npz")
    for given in (path, dem):
        mesh = orograph.tessellate(given, tolerance=2, exaggeration=1.5, check=True)
        np.testing.assert_array_equal(mesh.triangles, truth["triangles"])
        np.testing.assert_array_equal(mesh.vertices, truth["vertices"])
    assert mesh.stats["bound"] == 2.0 and mesh.stats["report"]["largest"] <= 2.0
    orograph.tessellate(dem, method="top-down", triangles=200, output=tmp_path / "own.ply")
    assert (tmp_path / "own.ply").stat().st_size > 1000
    for wrong in ({"method": "raycast"}, {"tolerance": 1, "triangles": 5}, {"method": "sore"}):
        with pytest.raises(UsageError):
            orograph.tessellate(dem, **wrong)


def test_compare(dem: orograph.Dem) -> None:
    found = orograph.compare(dem, methods=["soar", "top-down"], tolerance=2, size=(160, 120))
    assert list(found) == ["soar", "top-down"]
    assert all(m.largest is not None and m.largest <= 2 for m in found.values())
    head, *rows = repr(found).splitlines()
    assert head.split()[0] == "method" and len(rows) == 2 and found._repr_html_().count("<tr>") == 3
    view = orograph.camera.whole(dem, (80, 60))
    assert orograph.compare(dem, {"a": view}, methods=["roam"])["roam"].triangles


def test_compare_on_a_flight_and_on_a_sheet(dem: orograph.Dem, path: Path, tmp_path: Path) -> None:
    """As the command line does it: the same frames, the same triangles, the same sheet."""
    tour = orograph.tour(dem, orbit=True, seconds=0.2, size=(160, 120))
    tour.save(tmp_path / "t.json")
    found = orograph.compare(dem, flight=tour, judged=2, methods=["soar"])
    told = json.loads(run("compare", path, "--flight", tmp_path / "t.json", "--judged", 2, "--method", "soar",
                          "--json", "-"))["methods"]["soar"]  # fmt: skip
    assert found.flight and found["soar"].judged == 2 and found["soar"].changes is not None
    assert {k: told[k] for k in ("frames", "triangles", "largest")} == {
        k: getattr(found["soar"], k) for k in ("frames", "triangles", "largest")
    }
    orograph.compare(dem, methods=["soar"], size=(160, 120), picture=tmp_path / "own.png")
    run("compare", path, "--method", "soar", "--size", "160x120", "--picture", tmp_path / "cli.png")
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "cli.png").read_bytes()
    with pytest.raises(UsageError, match="not both"):
        orograph.compare(dem, [tour.keys[0].view], flight=tour)


def test_tour_and_movie(dem: orograph.Dem, path: Path, tmp_path: Path) -> None:
    made = orograph.tour(dem, seconds=2, pitch=40, size=(64, 48))
    run("tour", "new", path, "--orbit", "--seconds", 2, "--pitch", 40, "--size", "64x48", "-o", tmp_path / "t.json")
    assert made.to_dict() == orograph.Tour.load(tmp_path / "t.json").to_dict()
    options: dict[str, Any] = {"samples": 1, "shadows": False, "water": None, "fps": 2}
    film = orograph.movie(dem, tmp_path / "f%02d.png", made, **options)
    assert film == tmp_path / "f%02d.png" and len(list(tmp_path.glob("f*.png"))) == 4
    orograph.movie(path, tmp_path / "g%02d.png", orbit=True, seconds=2, pitch=40, size=(64, 48), **options)
    for one in tmp_path.glob("f*.png"):
        assert one.read_bytes() == (tmp_path / one.name.replace("f", "g")).read_bytes()
    for wrong, words in (
        ({"orbit": True, "line": "a.gpx"}, "two tours"), ({"tour": made, "orbit": True}, "not both"),
        ({"height": 100}, "does not apply"), ({"ligt": "ao"}, "light"),
        ({"speed": 1.0, "seconds": 2.0, "line": "a.gpx"}, "twice"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            orograph.movie(dem, tmp_path / "h%02d.png", **wrong)


@pytest.mark.parametrize(
    ("option", "words"),
    [("projection", "camera.plan"), ("pitch", "camera.around"), ("lonlat", "camera.standing"),
     ("cmap", "called colormap"), ("drape", "called layers"), ("light_at", "called lamps"), ("transfrom", "transform"),
     ("vert_exag", "called exaggeration")],
)  # fmt: skip
def test_what_is_nearly_right_is_answered_with_the_right_one(dem: orograph.Dem, option: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        orograph.render(dem, **{option: 1})


def test_warnings_are_pythons_unless_silenced(capfd: pytest.CaptureFixture[str]) -> None:
    heights = np.zeros((20, 20))
    with pytest.warns(UserWarning, match="1 m apart") as told:
        orograph.terrain(heights)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        orograph.terrain(heights, progress=False)
    assert capfd.readouterr() == ("", "")


def test_long_tasks_have_bars_where_somebody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    from orograph import reporting

    seen: list[str] = []

    class Bars:
        def start(self) -> None:
            seen.append("start")

        def stop(self) -> None:
            seen.append("stop")

        def add_task(self, what: str, total: float | None) -> int:
            seen.append(what)
            return 1

        def update(self, *_: Any, **__: Any) -> None: ...
        def remove_task(self, _: int) -> None: ...

    monkeypatch.setattr(reporting, "bars", lambda console: Bars())
    monkeypatch.setattr(reporting, "_watched", lambda: True)
    clock = [0.0]
    monkeypatch.setattr(reporting.time, "monotonic", lambda: clock[0])
    shown = reporting.reporting(None)
    with shown.task("short", 2) as task:
        task.advance()
    assert not seen
    with shown.task("long", 2) as task:
        clock[0] += 2 * reporting.LASTS
        task.advance()
    assert seen == ["start", "long", "stop"]
    silent = Progress()
    assert reporting.reporting(silent) is silent


@pytest.mark.parametrize(("watched", "handler"), [(True, False), (False, False), (True, True)])
def test_notes_are_told_where_a_person_watches_and_to_loggers(monkeypatch, capsys, watched, handler):
    from orograph import reporting

    told = []

    class Told(logging.Handler):
        def emit(self, record):
            told.append(record.getMessage())

    log = logging.Logger("orograph", logging.INFO)
    if handler:
        log.addHandler(Told())
    monkeypatch.setattr(reporting, "LOG", log)
    monkeypatch.setattr(reporting, "_watched", lambda: watched)
    reporting.reporting(None).note("3 rasters taken")
    reporting.reporting(False).note("nothing")
    assert capsys.readouterr().err == "3 rasters taken\n" * (watched and not handler)
    assert told == ["3 rasters taken"] * handler


def test_methods_are_a_table_in_notebooks() -> None:
    found = orograph.methods()
    for name in ("soar", "roam", "top-down"):
        assert name in repr(found) and name in found._repr_html_()
    assert found._repr_html_().count("<tr>") > 5
    assert "tolerance" in repr(orograph.methods("soar"))


def test_views_and_stores_that_are_nearly_right(dem: orograph.Dem, tmp_path: Path) -> None:
    plain: dict[str, Any] = {"size": (48, 32), "samples": 1, "shadows": False}
    wanted = orograph.render(dem, orograph.camera.plan(dem, (48, 32)), **plain)
    np.testing.assert_array_equal(orograph.render(dem, "plan", **plain), wanted)
    (tmp_path / "v.json").write_text(json.dumps(wanted.view.to_dict()))
    np.testing.assert_array_equal(orograph.render(dem, tmp_path / "v.json", **plain), wanted)
    for call, words in (
        (lambda: orograph.render(dem, 5), "A view must be .*camera"),
        (lambda: orograph.render(dem, size=-300), "A size must be"),
        (lambda: orograph.tessellate(dem, size=(3, 4.5)), "A size must be"),
        (lambda: orograph.open(dem), "A store must .*build"), (lambda: orograph.bake(dem, "aperture"), "A store must"),
        (lambda: orograph.check(dem), "A store must"), (lambda: orograph.read(dem), "orograph.terrain"),
        (lambda: orograph.bake(tmp_path / "a.oro", "aperture", raduis=3), "Did you mean radius"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            call()


def test_films_name_whom_their_makers_want_to_be_named(tmp_path: Path) -> None:
    """In the metadata of videos and of single frames."""
    av = pytest.importorskip("av")
    from PIL import Image

    y, x = np.mgrid[:65, :81]
    heights = (800 + 90 * np.sin(x / 9) * np.cos(y / 7)).astype(np.float32)
    ground = orograph.Dem(heights, GRID, name="hills", attribution=("Éric's survey",))
    how: dict[str, Any] = {"orbit": True, "seconds": 1, "fps": 2, "size": (64, 48), "samples": 1, "progress": False}
    for name in ("a.mp4", "a.webm", "a.mkv"):
        with av.open(str(orograph.movie(ground, tmp_path / name, **how))) as film:
            assert {k.lower(): v for k, v in film.metadata.items()}["copyright"] == "Éric's survey"
    orograph.movie(ground, tmp_path / "f%02d.png", **how)
    with Image.open(tmp_path / "f00.png") as frame:
        assert frame.info["Copyright"] == "Éric's survey"
