"""Scattered points: what files say, the Delaunay surface at samples, points that stay with their terrain."""

import json
import math

import numpy as np
import pytest
from pyproj import CRS, Transformer
from scipy.interpolate import LinearNDInterpolator

import orograph
from orograph.dem.delaunay import Merged, lattice_bits, on_lattice, triangulate, without_slivers
from orograph.dem.gridding import PointRaster
from orograph.dem.scattered import is_points, read_scattered
from orograph.errors import ReadError, UsageError
from orograph.store.build import build

X0, Y0 = 500_000.0, 4_000_000.0


def cloud(n=400, seed=1):
    """Places in metres, and a plane's heights."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 900, n).round(3) + X0, rng.uniform(0, 600, n).round(3) + Y0
    return x, y, 100 + 0.3 * (x - X0) - 0.2 * (y - Y0)


def table(path, columns, mark=","):
    names, values = zip(*columns.items())
    rows = [mark.join(names), *(mark.join(map(str, row)) for row in zip(*values))]
    path.write_text("\n".join(rows) + "\n")
    return path


def las(path, x, y, z, kinds=None, crs=32632):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [X0, Y0, 0]
    if crs is not None:
        header.add_crs(CRS.from_epsg(crs))
    data = laspy.LasData(header)
    data.x, data.y, data.z = x, y, z
    if kinds is not None:
        data.classification = kinds
    data.write(str(path))
    return path


def test_a_plane_is_the_plane_within_the_hull_and_nothing_outside(tmp_path):
    x, y, z = cloud()
    raster = PointRaster.open(table(tmp_path / "p.csv", {"x": x, "y": y, "z": z}), resolution=7, max_edge=math.inf)
    rows, cols = raster.grid.shape
    heights = raster.read(0, rows, 0, cols)
    col, row = np.meshgrid(np.arange(cols), np.arange(rows))
    east, north = raster.grid.xy(col, row)
    there = ~np.isnan(heights)
    assert np.abs(heights - (100 + 0.3 * (east - X0) - 0.2 * (north - Y0)))[there].max() < 1e-3
    hull = LinearNDInterpolator(np.stack([x, y], -1), z)(east, north)  # SciPy's own search and interpolation
    assert (np.isnan(hull) == ~there).mean() > 0.999  # (samples on the hull itself are anyone's)
    col, row = raster.grid.index(x, y)
    assert col.min() >= 0 and row.min() >= 0 and col.max() <= cols - 1 and row.max() <= rows - 1


def test_a_rough_surface_is_scipys_interpolation(tmp_path):
    x, y, _ = cloud(700, 2)
    z = np.random.default_rng(3).normal(0, 50, 700).round(2)
    raster = PointRaster.open(table(tmp_path / "p.csv", {"Easting": x, "Northing": y, "Elev": z}), resolution=11.5)
    rows, cols = raster.grid.shape
    east, north = raster.grid.xy(*np.meshgrid(np.arange(cols), np.arange(rows)))
    truth = LinearNDInterpolator(np.stack([x - X0, y - Y0], -1), z)(east - X0, north - Y0)
    found = raster.read(0, rows, 0, cols)
    both = ~np.isnan(truth) & ~np.isnan(found)
    assert both.mean() > 0.9
    assert np.abs(found - truth)[both].max() < 0.02  # (the points moved by up to 2e-5 m)
    places = np.random.default_rng(4).uniform(0, 1, (50, 2)) * [700, 400] + [X0 + 100, Y0 + 100]
    expected = LinearNDInterpolator(np.stack([x - X0, y - Y0], -1), z)(places - [X0, Y0])
    assert np.allclose(raster.heights_at(*places.T), expected, atol=0.02)


def test_windows_are_parts_of_the_whole(tmp_path):
    x, y, _ = cloud(300, 5)
    raster = PointRaster.open(table(tmp_path / "p.csv", {"x": x, "y": y, "z": np.sin(x)}), resolution=9)
    rows, cols = raster.grid.shape
    whole = raster.read(0, rows, 0, cols)
    for r0, r1, c0, c1 in ((0, 1, 0, cols), (10, 43, 7, 50), (rows - 5, rows, cols - 9, cols)):
        assert np.array_equal(raster.read(r0, r1, c0, c1), whole[r0:r1, c0:c1], equal_nan=True)


def test_samples_on_edges_and_corners_have_heights():
    """A lattice of points under samples: each sample lies on a corner or an edge of triangles."""
    col, row = (v.ravel().astype(float) for v in np.meshgrid(np.arange(0, 9, 2), np.arange(0, 9, 2)))
    bits = lattice_bits(9, 9)
    surface = triangulate(on_lattice(col, row, col + 10 * row, bits), bits, "p")
    at = np.stack([surface.x, surface.y], -1)[surface.triangles]
    (ux, uy), (vx, vy) = (at[:, 1] - at[:, 0]).T, (at[:, 2] - at[:, 0]).T
    area = ux * vy - uy * vx
    assert area.sum() == 2 * (8 << bits) ** 2  # they cover the square, once
    from orograph.dem.delaunay import Gridded

    found = Gridded(surface).read(0, 9, 0, 9)
    assert np.array_equal(found, np.add.outer(10 * np.arange(9), np.arange(9)).astype(np.float32))


def test_long_triangles_are_left_out(tmp_path):
    x, y, z = cloud()
    far = np.r_[x, x + 5000], np.r_[y, y], np.r_[z, z]
    path = table(tmp_path / "p.csv", dict(zip("xyz", far)))
    whole, cut = PointRaster.open(path, resolution=20), PointRaster.open(path, resolution=20, max_edge=200)
    rows, cols = whole.grid.shape
    gap = slice(int(1200 / 20), int(4700 / 20))
    assert not np.isnan(whole.read(0, rows, 0, cols)[rows // 2, gap]).any()
    assert np.isnan(cut.read(0, rows, 0, cols)[:, gap]).all()
    assert any("max_edge" in note for note in whole.notes) and any("left out" in note for note in cut.notes)
    with pytest.raises(UsageError, match="No triangle has sides of at most 0"):
        PointRaster.open(path, resolution=20, max_edge=0.1)


def area(surface, triangles):
    at = np.stack([surface.x, surface.y], -1)[triangles].astype(float)
    u, v = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    return np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()


def test_slivers_along_the_hull_are_left_out():
    col, row = np.array([0, 10, 20, 10, 10.0]), np.array([0, 0.02, 0, 10, 4.0])
    bits = lattice_bits(11, 21)
    surface = triangulate(on_lattice(col, row, np.arange(5.0), bits), bits, "p")
    left = without_slivers(surface)
    assert len(left) == len(surface.triangles) - 1
    corners = np.stack([surface.x, surface.y], -1)
    flat = [i for i, p in enumerate(corners.tolist()) if p[1] < 1 << bits]
    assert not any(set(t) == set(flat) for t in left.tolist())


def test_what_slivers_cover_is_peeled_in_turn_but_not_the_tracks_of_a_survey():
    """Points on an arc that bends slightly inwards leave one sliver under another; tracks have long triangles only."""
    col = np.linspace(0, 100, 21)
    arc = np.r_[col, 50.0], np.r_[8 * (1 - ((col - 50) / 50) ** 2), 100.0]
    bits = lattice_bits(128, 128)
    surface = triangulate(on_lattice(*arc, np.zeros(22), bits), bits, "p")
    assert len(without_slivers(surface)) == 20  # those that have the far point
    rng = np.random.default_rng(2)
    track, along = (v.ravel() for v in np.meshgrid(np.arange(5) * 20.0, np.arange(60.0)))
    track, along = track + rng.normal(0, 0.05, 300), along + rng.normal(0, 0.05, 300)
    surface = triangulate(on_lattice(track + 5, along + 5, np.zeros(300), bits), bits, "p")
    assert area(surface, without_slivers(surface)) > 0.995 * area(surface, surface.triangles)


def test_an_infinite_side_keeps_slivers(tmp_path):
    x, y, z = cloud()
    path = table(tmp_path / "p.csv", {"x": x, "y": y, "z": z})
    usual, whole = PointRaster.open(path, resolution=20), PointRaster.open(path, resolution=20, max_edge=math.inf)
    assert len(usual.surface.triangles) < len(whole.surface.triangles)
    assert any("slivers along the rim" in note for note in usual.notes) and not any("sliver" in n for n in whole.notes)


def test_degrees_become_the_utm_zone(tmp_path):
    x, y, z = cloud()
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(x, y)
    raster = PointRaster.open(table(tmp_path / "p.csv", {"Longitude": lon, "Latitude": lat, "height": z}))
    assert raster.grid.crs == CRS.from_epsg(32632)
    inside = (np.abs(x - X0 - 450) < 300) & (np.abs(y - Y0 - 300) < 200)
    assert np.abs(raster.heights_at(x[inside], y[inside]) - z[inside]).max() < 1e-3
    nameless = PointRaster.open(table(tmp_path / "q.csv", {"x": lon, "y": lat, "z": z}), resolution=1e-4)
    assert any("look like degrees" in text for text in nameless.warnings)
    assumed = PointRaster.open(tmp_path / "q.csv", assume_crs="EPSG:4326")
    assert assumed.grid.crs == CRS.from_epsg(32632)


def test_feet_become_metres(tmp_path):
    x, y, z = cloud()
    raster = PointRaster.open(table(tmp_path / "p.csv", {"x": x, "y": y, "z": z / 0.3048}), vertical_unit="ft")
    assert raster.heights_at([X0 + 450], [Y0 + 300])[0] == pytest.approx(175, abs=1e-2)


def test_points_at_one_place_become_one(tmp_path):
    x, y, z = cloud(50)
    doubled = np.r_[x, x[:7]], np.r_[y, y[:7]], np.r_[z, z[:7] + 2]
    raster = PointRaster.open(table(tmp_path / "p.csv", dict(zip("xyz", doubled))))
    assert len(raster.surface.z) == 50
    assert any("Of its 57 points 7 lie where another does" in text and "2 m" in text for text in raster.warnings)
    merged = on_lattice(np.array([0.0, 1, 1]), np.zeros(3), np.array([5.0, 1, 3]), 10)
    assert isinstance(merged, Merged) and merged.z.tolist() == [5, 2] and merged.apart == 2


@pytest.mark.parametrize(
    ("columns", "error", "says"),
    [
        ({"x": [1.0], "y": [2.0], "z": [3.0]}, UsageError, "needs three points; it has 1"),
        ({"x": [1, 1, 1, 1], "y": [2, 2, 2, 2], "z": [3, 3, 3, 3]}, UsageError, "it has 1 at different places"),
        ({"x": [1, 2, 3, 4], "y": [2, 4, 6, 8], "z": [3, 1, 2, 3]}, UsageError, "lie on one line"),
        ({"x": [1, 2, 3], "y": [2, 4, 7], "z": ["nan", "", "none"]}, ReadError, "no column with numbers"),
        ({"x": ["", "", 3], "y": [2, 4, 7], "z": [1, 2, "nan"]}, ReadError, "None of its 3 points has both a position"),
        ({"a": [1, 2, 3], "b": [2, 4, 7], "z": [1, 2, 3]}, ReadError, "do not say where the points lie; they"),
        ({"x": [1, 2, 3], "y": [2, 4, 7], "p": [1, 2, 3], "q": [3, 4, 5]}, UsageError, "holds the heights: p, q"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_surface_is_told(tmp_path, columns, error, says):
    with pytest.raises(error, match=says) as told:
        PointRaster.open(table(tmp_path / "p.csv", columns))
    assert "p.csv" in str(told.value)


def test_points_without_a_height_are_left_out_and_told(tmp_path):
    x, y, z = cloud(30)
    z = [*z[:20], *["nan"] * 10]
    points = read_scattered(table(tmp_path / "p.csv", {"x": x, "y": y, "z": z}, ";"))
    assert len(points) == 20 and "Of its 30 points 10 lack a position or a height" in points.warnings[0]
    with pytest.raises(UsageError, match="There is no column 'Z2' with numbers; there are z"):
        read_scattered(tmp_path / "p.csv", height_column="Z2")


def test_las_and_laz(tmp_path):
    x, y, z = cloud(200)
    kinds = np.where(np.arange(200) % 4, 2, 5)
    for name in ("p.las", "p.laz"):
        path = las(tmp_path / name, x, y, z, kinds)
        points = read_scattered(path)
        assert len(points) == 150 and points.crs == CRS.from_epsg(32632)
        assert np.abs(points.z - z[kinds == 2]).max() < 6e-4
        assert "the 150 of the ground (class 2)" in points.warnings[0]
        assert len(read_scattered(path, point_classes=[2, 5])) == 200
        with pytest.raises(ReadError, match="no points of class 9; its classes are 2, 5"):
            read_scattered(path, point_classes=[9])
        with pytest.raises(UsageError, match="height_column"):
            read_scattered(path, height_column="z")
    unclassified = read_scattered(las(tmp_path / "q.laz", x, y, z, np.where(np.arange(200) % 10, 1, 7), None))
    assert len(unclassified) == 180 and unclassified.crs is None
    data = bytearray((tmp_path / "p.laz").read_bytes())
    (tmp_path / "cut.laz").write_bytes(data[: len(data) // 2])
    with pytest.raises(ReadError, match=r"cut\.laz"):
        read_scattered(tmp_path / "cut.laz")


def test_vectors(tmp_path):
    raw = pytest.importorskip("pyogrio.raw")
    x, y, z = cloud(60)
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(x, y)
    features = [
        {"type": "Feature", "properties": {"elev": float(c), "id": k},
         "geometry": {"type": "Point", "coordinates": [float(a), float(b)]}}
        for k, (a, b, c) in enumerate(zip(lon, lat, z))
    ]  # fmt: skip
    path = tmp_path / "p.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert np.array_equal(read_scattered(path).z, z)
    meta, _, shapes, values = raw.read(path)
    packed = tmp_path / "p.gpkg"
    raw.write(packed, shapes, values, meta["fields"], geometry_type="Point", crs=meta["crs"], layer="one")
    assert is_points(packed) and np.array_equal(read_scattered(packed, height_column="id").z, np.arange(60))
    raw.write(packed, shapes, values, meta["fields"], geometry_type="Point", crs=meta["crs"], layer="two", append=True)
    with pytest.raises(UsageError, match="2 layers: one, two"):
        read_scattered(packed)
    assert len(read_scattered(packed, point_layer="two")) == 60


def test_a_geopackage_of_rasters_is_a_raster(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    path = tmp_path / "r.gpkg"
    with rasterio.open(path, "w", driver="GPKG", width=16, height=16, count=1, dtype="uint8", crs="EPSG:3857",
                       transform=rasterio.transform.from_origin(0, 160, 10, 10)) as made:  # fmt: skip
        made.write(np.ones((1, 16, 16), np.uint8))
    assert not is_points(path)


def test_a_store_keeps_its_points(tmp_path):
    x, y, z = cloud(500, 7)
    z = z + np.random.default_rng(8).normal(0, 9, 500).round(2)
    path = table(tmp_path / "p.csv", {"x": x, "y": y, "z": z})
    terrain = orograph.terrain(str(path), progress=False, resolution=12)
    stores = [build(str(path), tmp_path / f"{jobs}.oro", resolution=12, jobs=jobs, progress=False, chunk=32, shard=64)
              for jobs in (1, 3)]  # fmt: skip
    for store in stores:
        assert store.check() == []
        for mine, theirs in zip(store.derived("points"), terrain.derived("points")):
            assert np.array_equal(mine, theirs)
        inside = (np.abs(x - X0 - 450) < 300) & (np.abs(y - Y0 - 300) < 200)
        assert np.abs(store.samples.heights_at(x[inside], y[inside]) - z[inside]).max() < 1e-3
    files = [sorted(p.relative_to(tmp_path / f"{jobs}.oro") for p in (tmp_path / f"{jobs}.oro").rglob("c/*/*"))
             for jobs in (1, 3)]  # fmt: skip
    assert files[0] == files[1]
    assert all((tmp_path / "1.oro" / p).read_bytes() == (tmp_path / "3.oro" / p).read_bytes() for p in files[0])
    with pytest.raises(UsageError, match="cannot be combined"):
        orograph.terrain([str(path), str(path)], progress=False)
    with pytest.raises(UsageError, match="`band` cannot be used with points"):
        orograph.terrain(str(path), progress=False, band=2)


def test_a_damaged_point_array_is_found(tmp_path):
    x, y, z = cloud(100)
    store = build(str(table(tmp_path / "p.csv", {"x": x, "y": y, "z": z})), tmp_path / "a.oro", progress=False)
    file = next((tmp_path / "a.oro" / "points" / "heights").rglob("c/*/*"))
    data = bytearray(file.read_bytes())
    data[40] ^= 0xFF
    file.write_bytes(data)
    assert [key for key in store.check() if key.startswith("points/heights")]


def test_facts_of_points(tmp_path):
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 410, 10.0), np.arange(0, 210, 10.0)))
    path = str(table(tmp_path / "p.csv", {"x": x + X0, "y": y + Y0, "depth": -y, "quality": y * 0 + 1}))
    found = orograph.info(path, assume_crs="EPSG:32632", height_column="depth", progress=False)
    assert found["kind"] == "points" and found["points"] == 41 * 21 and found["crs"] == "EPSG:32632"
    assert found["bounds"] == [X0, Y0, X0 + 400, Y0 + 200] and found["height_range"] == [-200, 0]
    assert found["spacing_m"] == pytest.approx([np.sqrt(400 * 200 / 861)] * 2)  # the hull's area over their number
    assert found["shape"] is None and found["size_bytes"] > 0
    told = str(found)
    assert "861" in told and "400 m × 200 m" in told and "9.64 × 9.64 m" in told
    with pytest.raises(UsageError, match="not clear which of its columns"):
        orograph.info(path, progress=False)
    with pytest.raises(UsageError, match="`band` cannot be used with points"):
        orograph.info(path, progress=False, height_column="depth", band=2)


def test_facts_of_points_all_over_the_earth(tmp_path):
    path = table(tmp_path / "p.csv", {"lon": [-170, 170, 0, 20.0], "lat": [-60, 60, 0, 10.0], "z": [1, 2, 3, 4.0]})
    found = orograph.info(str(path), progress=False)
    assert found["spacing_m"] == [None, None] and found["bounds"] == [-170, -60, 170, 60]
    assert any("too large for a flat projection" in text for text in found["warnings"]) and "unknown" in str(found)


def test_facts_of_points_in_degrees_and_of_an_area(tmp_path):
    x, y, z = cloud()
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(x, y)
    path = str(table(tmp_path / "p.csv", {"longitude": lon, "latitude": lat, "z": z}))
    found = orograph.info(path, progress=False)
    assert found["crs"] == "EPSG:4326" and "a terrain of them is in EPSG:32632" in str(found)
    assert found["spacing_m"][0] == pytest.approx(np.sqrt(900 * 600 / 400), rel=0.05)
    box = [
        float(v) for v in (np.quantile(lon, 0.2), np.quantile(lat, 0.2), np.quantile(lon, 0.8), np.quantile(lat, 0.8))
    ]
    part = orograph.info(path, progress=False, bbox=box)
    assert part["kind"] == "terrain" and part["shape"][0] * part["spacing_m"][0] < 600


def test_decimal_commas_between_semicolons(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x;y;z\n500000,5;4000000,25;1,5\n500100;4000000;2\n500000;4000100;3.25\n")
    points = read_scattered(path)
    assert points.x.tolist() == [500000.5, 500100, 500000] and points.z.tolist() == [1.5, 2, 3.25]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("500000,4000000,3\n500001,4000000,3\n", "first line holds numbers"),
        ("x,y,z\n", "no points below its header line"),
        ("x,y,z\n1,2,a\n", "no column with numbers for the heights"),
    ],
)
def test_tables_without_names_points_or_heights(tmp_path, text, says):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(ReadError, match=says):
        read_scattered(tmp_path / "p.csv")
