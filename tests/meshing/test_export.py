"""Mesh files, read back by trimesh and by parsers of their own formats' specifications written here."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from affine import Affine
from pyproj import CRS

from orograph.errors import NothingInViewError, OutputError, UsageError
from orograph.geo.grid import Grid
from orograph.mesh_models import write_surface
from orograph.tessellation import Tessellation

GRID = Grid((40, 50), Affine(8.5, 6, 448262.125, 6, -8.5, 5411932.75), CRS.from_epsg(32632))


@pytest.fixture
def mesh() -> Tessellation:
    """A fan of triangles at odd heights, far from the CRS's origin."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, 14)[:-1]
    rim = np.unique(np.round([25 + 18 * np.cos(angles), 20 + 15 * np.sin(angles)]).T, axis=0)
    rim = rim[np.argsort(np.arctan2(rim[:, 1] - 20, rim[:, 0] - 25))]
    places = np.vstack([[25, 20], rim])
    heights = rng.uniform(100, 4000, len(places)).astype(np.float32)
    n = len(rim)
    # Clockwise as drawn with rows downwards is wrong here: this grid is mirrored, so the map's turn is the other one.
    fan = np.array([[0, 1 + (i + 1) % n, 1 + i] for i in range(n)], np.int32)
    return Tessellation(np.column_stack([places, heights.astype(np.float64)]), fan, None, {"method": "fan"})


COLORS = np.random.default_rng(1).integers(0, 256, (60, 3)).astype(np.uint8)


def truth(mesh: Tessellation) -> np.ndarray:
    """The vertices' places, by the definition of a geotransform."""
    a, b, c, d, e, f = GRID.transform[:6]
    col, row, z = mesh.vertices.T
    return np.stack([a * (col + 0.5) + b * (row + 0.5) + c, d * (col + 0.5) + e * (row + 0.5) + f, z], -1)


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, list[str]]:
    """Property by property, as the header says."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    kinds = {"double": "d", "float": "f", "uchar": "B", "int": "i"}
    counts: dict[str, int] = {}
    properties: dict[str, list[list[str]]] = {}
    comments = []
    for line in head.decode().splitlines():
        word, *rest = line.split()
        if word == "comment":
            comments.append(" ".join(rest))
        elif word == "element":
            counts[rest[0]], properties[rest[0]] = int(rest[1]), []
        elif word == "property":
            properties[list(properties)[-1]].append(rest)
    assert list(counts) == ["vertex", "face"]
    vertex = struct.Struct("<" + "".join(kinds[p[0]] for p in properties["vertex"]))
    rows = [vertex.unpack_from(body, i * vertex.size) for i in range(counts["vertex"])]
    at, faces = counts["vertex"] * vertex.size, []
    assert properties["face"] == [["list", "uchar", "int", "vertex_indices"]]
    for _ in range(counts["face"]):
        (n,) = struct.unpack_from("<B", body, at)
        faces.append(struct.unpack_from(f"<{n}i", body, at + 1))
        at += 1 + 4 * n
    assert at == len(body)
    names = [p[1] for p in properties["vertex"]]
    values = np.array(rows)
    colors = values[:, 3:6] if names[3:] == ["red", "green", "blue"] else None
    assert names[:3] == ["x", "y", "z"]
    return values[:, :3], np.array(faces), colors, comments


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the buffer of a binary glTF."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    tree = json.loads(data[20 : 20 + size])
    size_2, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0"
    return tree, data[28 + size : 28 + size + size_2]


def accessor(tree: dict[str, Any], buffer: bytes, index: int) -> np.ndarray:
    a = tree["accessors"][index]
    view = tree["bufferViews"][a["bufferView"]]
    kind = {5126: np.float32, 5125: np.uint32, 5123: np.uint16, 5121: np.uint8}[a["componentType"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[a["type"]]
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    return np.frombuffer(buffer, kind, a["count"] * width, start).reshape(a["count"], width)


def turns_left(points: np.ndarray, faces: np.ndarray) -> bool:
    """Whether all faces turn counter-clockwise in x and y."""
    u, v = (points[faces[:, i]] - points[faces[:, 0]] for i in (1, 2))
    return bool((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all())


@pytest.mark.parametrize("colored", [False, True])
def test_ply_keeps_every_bit(tmp_path: Path, mesh: Tessellation, colored: bool):
    colors = COLORS[: len(mesh.vertices)] if colored else None
    path = mesh.save(tmp_path / "m.PLY", GRID, colors=colors)
    points, faces, read_colors, comments = read_ply(path)
    assert np.array_equal(points, mesh.positions(GRID)) and np.allclose(points, truth(mesh), rtol=0, atol=1e-8)
    assert np.array_equal(faces, mesh.triangles) and turns_left(points, faces)
    assert (read_colors is not None) == colored and (not colored or np.array_equal(read_colors, colors))
    assert any(CRS.from_wkt(c.removeprefix("crs ")).to_epsg() == 32632 for c in comments if c.startswith("crs "))
    again = trimesh.load_mesh(path, process=False)
    assert np.array_equal(again.vertices, points) and np.array_equal(again.faces, faces)
    if colored:
        assert np.array_equal(again.visual.vertex_colors[:, :3], colors)


@pytest.mark.parametrize("colored", [False, True])
def test_obj_keeps_micrometres(tmp_path: Path, mesh: Tessellation, colored: bool):
    colors = COLORS[: len(mesh.vertices)] if colored else None
    path = mesh.save(tmp_path / "m.obj", GRID, colors=colors)
    lines = [line.split() for line in path.read_text().splitlines()]
    points = np.array([line[1:] for line in lines if line[0] == "v"], float)
    faces = np.array([line[1:] for line in lines if line[0] == "f"], int) - 1
    assert np.allclose(points[:, :3], truth(mesh), rtol=0, atol=6e-7)
    assert np.array_equal(faces, mesh.triangles) and turns_left(points, faces)
    assert points.shape[1] == (6 if colored else 3)
    if colored:
        assert np.array_equal(np.round(points[:, 3:] * 255), colors)
    again = trimesh.load_mesh(path, process=False, maintain_order=True)
    assert np.allclose(again.vertices, points[:, :3], rtol=0, atol=1e-9) and np.array_equal(again.faces, faces)


def test_obj_of_more_lines_than_are_formatted_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mesh):
    whole = mesh.save(tmp_path / "whole.obj", GRID).read_text()
    monkeypatch.setattr("orograph.mesh_files.LINES", 3)
    assert mesh.save(tmp_path / "parts.obj", GRID).read_text() == whole


@pytest.mark.parametrize("colored", [False, True])
def test_glb_is_precise_about_its_origin(tmp_path: Path, mesh: Tessellation, colored: bool):
    colors = COLORS[: len(mesh.vertices)] if colored else None
    path = mesh.save(tmp_path / "m.glb", GRID, colors=colors)
    tree, buffer = read_glb(path)
    (node,) = (node for node in tree["nodes"] if "mesh" in node)
    (primitive,) = tree["meshes"][node["mesh"]]["primitives"]
    assert primitive.get("mode", 4) == 4 and "matrix" not in node and "NORMAL" not in primitive["attributes"]
    local = accessor(tree, buffer, primitive["attributes"]["POSITION"])
    faces = accessor(tree, buffer, primitive["indices"]).reshape(-1, 3)
    origin = np.array(node["extras"]["origin"])
    east_north_up = np.stack([local[:, 0], -local[:, 2], local[:, 1]], -1).astype(float)
    assert np.abs(east_north_up + origin - truth(mesh)).max() < 2e-4 < np.spacing(np.float32(5.4e6))
    assert np.array_equal(faces, mesh.triangles) and turns_left(east_north_up, faces)
    assert node["translation"] == [origin[0], origin[2], -origin[1]]
    assert CRS.from_wkt(node["extras"]["crs"]).to_epsg() == 32632
    assert ("COLOR_0" in primitive["attributes"]) == colored
    if colored:
        assert np.array_equal(accessor(tree, buffer, primitive["attributes"]["COLOR_0"])[:, :3], colors)
    scene = trimesh.load_scene(path)
    world = scene.to_geometry().vertices  # translated by float64 matrices
    expected = truth(mesh)[:, [0, 2, 1]] * [1, 1, -1]
    assert len(world) == len(expected)
    assert np.abs(np.sort(world, axis=0) - np.sort(expected, axis=0)).max() < 2e-4


def test_npz_is_the_tessellation(tmp_path: Path, mesh: Tessellation):
    again = Tessellation.load(mesh.save(tmp_path / "m.npz", GRID))
    assert np.array_equal(again.vertices, mesh.vertices) and again.stats == {"method": "fan"} and again.grid == GRID


def test_a_grid_without_crs_and_a_mesh_without_triangles(tmp_path: Path, mesh: Tessellation):
    bare = Grid(GRID.shape, GRID.transform)
    tree, _ = read_glb(mesh.save(tmp_path / "m.glb", bare))
    assert next(node for node in tree["nodes"] if "mesh" in node)["extras"]["crs"] == ""
    assert read_ply(mesh.save(tmp_path / "m.ply", bare))[3] == ["metres; x east, y north, z up"]
    nothing = Tessellation(np.empty((0, 3)), np.empty((0, 3), np.int32))
    assert b"element face 0\n" in nothing.save(tmp_path / "n.ply", bare).read_bytes()
    assert "f " not in nothing.save(tmp_path / "n.obj", bare).read_text()
    with pytest.raises(NothingInViewError, match="no triangles"):
        nothing.save(tmp_path / "n.glb", bare)


def test_what_cannot_be_written(tmp_path: Path, mesh: Tessellation, monkeypatch: pytest.MonkeyPatch):
    for name in ("m.dxf", "m"):
        with pytest.raises(UsageError, match=r"\.npz, \.ply, \.obj or \.glb"):
            mesh.save(tmp_path / name, GRID)
    with pytest.raises(UsageError, match="Colours"):
        mesh.save(tmp_path / "m.ply", GRID, colors=COLORS)
    with pytest.raises(UsageError, match="Colours"):
        mesh.save(tmp_path / "m.ply", GRID, colors=np.zeros((len(mesh.vertices), 3)))
    with pytest.raises(UsageError, match="cannot hold colours"):
        mesh.save(tmp_path / "m.npz", GRID, colors=COLORS[: len(mesh.vertices)])
    for name in ("m.ply", "m.obj", "m.glb", "m.npz"):
        with pytest.raises(OutputError, match="no folder"):
            mesh.save(tmp_path / "none" / name, GRID)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(UsageError, match=r"orograph\[mesh\]"):
        mesh.save(tmp_path / "m.glb", GRID)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", [".ply", ".obj", ".glb"])
@pytest.mark.parametrize("origin", ["auto", "448500,5411700", (448_500.0, 5_411_700.0, 120.0)])
def test_positions_are_relative_to_an_origin(mesh, tmp_path, ending, origin) -> None:
    path = mesh.save(tmp_path / f"m{ending}", GRID, origin=origin)
    middle = np.round((mesh.positions(GRID).min(0) + mesh.positions(GRID).max(0)) / 2)
    start = [*middle[:2], 0] if origin == "auto" else [448_500, 5_411_700, 0 if isinstance(origin, str) else 120]
    read = trimesh.load(path, process=False)
    found = np.asarray(read.vertices if ending != ".glb" else next(iter(read.geometry.values())).vertices)
    found = found if ending != ".glb" else found[:, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose(found, mesh.positions(GRID) - start, atol=1e-3)
    if ending != ".glb":
        assert "origin {:.10g} {:.10g} {:.10g}".format(*start).encode() in path.read_bytes()


def test_mistakes_about_origins(mesh, tmp_path) -> None:
    with pytest.raises(UsageError, match="easting, northing"):
        mesh.save(tmp_path / "m.ply", GRID, origin=(1.0,))
    with pytest.raises(UsageError, match=r"surfaces as \.stl only"):
        mesh.save(tmp_path / "m.npz", GRID, origin="auto")
    with pytest.raises(UsageError, match=r"Use \.npz"):
        mesh.save(tmp_path / "m.dxf", GRID)


def test_an_open_surface_in_metres(mesh, tmp_path) -> None:
    start = write_surface(mesh.positions(GRID), mesh.triangles, tmp_path / "m.stl", "auto")
    read = trimesh.load(tmp_path / "m.stl", process=False)
    corners = mesh.positions(GRID)[mesh.triangles] - start
    np.testing.assert_allclose(read.vertices.reshape(-1, 3, 3), corners, atol=1e-3)
    assert (read.face_normals[:, 2] > 0).all() and b"metres from" in (tmp_path / "m.stl").read_bytes()[:80]
