"""Models to print: closed by trimesh's judgement, of the volume that prisms under the mesh have, and read back."""

from __future__ import annotations

import io
import json
import zipfile
from collections import Counter
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from affine import Affine
from click.testing import CliRunner

import orograph
from orograph.cli import cli
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.mesh_models import Print, solid
from orograph.tessellation import Tessellation

MAPS = [Affine(10, 0, 5e5, 0, -10, 4e6), Affine(10, 0, 5e5, 0, 20, 4e6), Affine(6, 8, 5e5, 8, -6, 4e6)]


def hills(transform, holes=False):
    y, x = np.mgrid[:41, :57]
    heights = (300 + 40 * np.sin(x / 7) * np.cos(y / 9)).astype(np.float32)
    if holes:
        heights[np.random.default_rng(1).random(heights.shape) < 0.05] = np.nan
        heights[10:16, 20:33] = np.nan
    return orograph.Dem(heights, Grid(heights.shape, transform, "EPSG:32611"))


def prisms(mesh, grid):
    """Cubic metres between a mesh and its lowest vertex, and its square metres on the map."""
    corners = mesh.positions(grid)[mesh.triangles]
    u, v = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    return float((area * (corners[:, :, 2].mean(1) - corners[:, :, 2].min())).sum()), float(area.sum())


def read_3mf(path):
    space = {"m": "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"}
    with zipfile.ZipFile(path) as file:
        assert {"[Content_Types].xml", "_rels/.rels"} < set(file.namelist())
        tree = ElementTree.parse(io.BytesIO(file.read("3D/3dmodel.model"))).getroot()
    assert tree.attrib["unit"] == "millimeter"
    vertices = [[float(v.attrib[k]) for k in "xyz"] for v in tree.iterfind(".//m:vertex", space)]
    faces = [[int(t.attrib[k]) for k in ("v1", "v2", "v3")] for t in tree.iterfind(".//m:triangle", space)]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("transform", MAPS)
def test_models_are_closed_and_hold_what_lies_under_the_mesh(tmp_path, transform, holes):
    dem = hills(transform, holes)
    for ending in (".stl", ".3mf"):
        path = tmp_path / f"model{ending}"
        mesh = orograph.tin(dem, max_error=2, output=path, base=4, scale=5000, exaggeration=1.5)
        model = trimesh.load_mesh(path) if ending == ".stl" else read_3mf(path)
        assert model.is_watertight and model.is_winding_consistent
        volume, area = prisms(mesh, dem.grid)
        mm = 1000 / 5000
        expected = area * mm**2 * 4 + volume * mm**3 * 1.5
        assert model.volume == pytest.approx(expected, rel=1e-3 if holes else 1e-5)  # (corners that meet are moved)
        assert mesh.stats["model"]["volume_cm3"] == pytest.approx(model.volume / 1000, rel=1e-4)
        low, high = model.bounds
        assert low == pytest.approx([0, 0, 0], abs=1e-3)
        relief = np.ptp(mesh.vertices[:, 2])
        assert high[2] == pytest.approx(4 + 1.5 * relief * mm, rel=1e-5)


def test_the_longer_side_has_the_size_that_is_asked(tmp_path):
    dem = hills(MAPS[0])
    mesh = orograph.tin(dem, max_error=5, output=tmp_path / "m.stl")
    assert max(mesh.stats["model"]["size_mm"][:2]) == pytest.approx(150)
    assert mesh.stats["model"]["scale"] == pytest.approx(560 * 1000 / 150)
    assert max(orograph.tin(dem, max_error=5, output=tmp_path / "m.stl", model_size=90).stats["model"]["size_mm"]) == 90


def test_a_tin_saves_itself_as_the_model_that_its_verb_writes(tmp_path):
    dem = hills(MAPS[0])
    for ending in (".stl", ".3mf"):
        tin = orograph.tin(dem, max_error=5, output=tmp_path / f"verb{ending}")
        assert tin.save(tmp_path / f"own{ending}") == tmp_path / f"own{ending}"
    assert (tmp_path / "own.stl").read_bytes() == (tmp_path / "verb.stl").read_bytes()
    assert read_3mf(tmp_path / "own.3mf").is_watertight
    for options, problem in (({"origin": "auto"}, "origin"), ({"colors": np.zeros((4, 3), np.uint8)}, "colours")):
        with pytest.raises(UsageError, match=problem):
            tin.save(tmp_path / "no.stl", **options)
    with pytest.raises(UsageError, match="tin"):  # a mesh for a view is no model
        orograph.tessellate(dem, tolerance=4).save(tmp_path / "no.stl")
    assert not (tmp_path / "no.stl").exists()


def test_parts_that_meet_in_a_vertex_are_moved_apart():
    """Two squares that share a corner: without that a vertical edge would have four walls."""
    places = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 1], [2, 2], [1, 2], [9, 9]], float)
    vertices = np.column_stack([places, np.full(8, 7.0)])
    faces = np.array([[0, 2, 1], [0, 3, 2], [2, 5, 4], [2, 6, 5]], np.int32)
    grid = Grid((3, 3), Affine(1, 0, 0, 0, -1, 0))
    made = solid(Tessellation(vertices, faces).positions(grid), faces, Print(base=2, scale=1000))
    edges = Counter(tuple(sorted(e)) for t in made.triangles.tolist() for e in zip(t, t[1:] + t[:1]))
    assert set(edges.values()) == {2}
    assert len({tuple(v) for v in made.vertices.tolist()}) == len(made.vertices) == 16
    assert made.volume == pytest.approx(2 * 2, rel=0.02)


def test_the_command_line(tmp_path):
    dem = orograph.export(hills(MAPS[0]), tmp_path / "dem.tif")
    args = ["tin", str(dem), "--max-error", "2", "-o", str(tmp_path / "m.3mf"), "--model-size", "90", "--base", "2"]
    ran = CliRunner().invoke(cli, args, obj={"quiet": True})
    assert ran.exit_code == 0 and "\n90.0 × " in ran.stdout and "1:6,222" in ran.stdout, ran.output
    told = json.loads(CliRunner().invoke(cli, [*args, "--json"], obj={"quiet": True}).stdout)
    assert told["model"]["size_mm"][0] == 90


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"output": "m.ply", "base": 3}, "`base` applies to printable models only"),
        ({"scale": 1000}, "`scale` applies to printable models"),
        ({"output": "m.stl", "base": 0}, "`base` must be more than 0"),
        ({"output": "m.stl", "scale": 10, "model_size": 10}, "say the same twice"),
        ({"output": "m.stl", "exaggeration": -1}, "exaggeration"),
    ],
)
def test_what_cannot_be_meant(options, said):
    with pytest.raises(UsageError, match=said):
        orograph.tin(hills(MAPS[0]), max_error=2, **options)


def test_meshes_of_a_view_are_no_models(tmp_path):
    with pytest.raises(UsageError, match=r"orograph\.tin"):
        orograph.tessellate(hills(MAPS[0]), output=tmp_path / "m.stl")


def test_a_surface_in_metres_by_the_command_line(tmp_path):
    y, x = np.mgrid[:40, :50] * 30.0
    dem = tmp_path / "dem.tif"
    orograph.export(
        orograph.Dem((500 + 90 * np.sin(x / 300) * np.cos(y / 250)).astype(np.float32),
                     orograph.Grid((40, 50), Affine(30, 0, 500_000, 0, -30, 4_000_000), "EPSG:32611")), dem,
    )  # fmt: skip
    run = ["tin", str(dem), "--max-error", "2", "--surface", "-o", str(tmp_path / "m.stl")]
    ran = CliRunner().invoke(cli, run, obj={"quiet": True})
    assert ran.exit_code == 0 and "coordinates from 500750, 3999400, height 0 m" in ran.stdout, ran.output
    low, high = trimesh.load(tmp_path / "m.stl").bounds
    assert (high - low)[:2] == pytest.approx((49 * 30, 39 * 30)) and 400 < low[2] < high[2] < 600
    for wrong, words in ((["--base", "3"], "applies to models to print"), (["--surface", "-o", "m.ply"], ".stl files")):
        ran = CliRunner().invoke(cli, [*run, *wrong], obj={"quiet": True})
        assert isinstance(ran.exception, UsageError) and words in str(ran.exception)
