"""Lines and polygons as data: against areas, distances, and points in polygons by other means."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest
import rasterio
from affine import Affine
from matplotlib.path import Path as Outline

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, apply
from orograph.geo.wkb import parse
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import read_features
from orograph.geovis.data.painted import painted
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.shape_kernels import crossed, fill, stroke
from orograph.geovis.data.shape_painting import shown_shapes
from orograph.geovis.data.shapes import cut_line, cut_ring, read_shapes
from orograph.scene.theming import themed

UTM = "EPSG:32630"
PLACE = Affine(100, 0, 500_000, 0, -100, 5_600_000)


def terrain_of(rows=40, cols=50, place=PLACE, crs=UTM):
    return orograph.terrain(np.add.outer(np.arange(rows), np.arange(cols)).astype(np.float32), transform=place, crs=crs)


def feature(kind, coordinates, **properties):
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def collection(*features, crs=UTM):
    told = {} if crs is None else {"crs": {"type": "name", "properties": {"name": crs}}}
    return {"type": "FeatureCollection", "features": list(features), **told}


def square(x, y, size, **properties):
    ring = [[x, y], [x + size, y], [x + size, y - size], [x, y - size], [x, y]]
    return feature("Polygon", [ring], **properties)


def rings_of(*rings):
    closed = [np.concatenate([r, r[:1]]) for r in rings]
    first = np.cumsum([0, *map(len, closed)])
    x, y = np.concatenate(closed).T.copy()
    return x, y, first, np.zeros(len(rings), np.int64)


def filled(shape, *rings):
    which, best, total = np.full(shape, -1, np.int32), np.zeros(shape), np.zeros(shape)
    fill(*rings_of(*rings), which, best, total)
    return which, total


def star(rng, middle, size, n=9):
    turn = np.sort(rng.uniform(0, 2 * np.pi, n))
    return middle + size * rng.uniform(0.3, 1, n)[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)


def shoelace(ring):
    x, y = ring.T
    return abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


@pytest.mark.parametrize("seed", range(5))
def test_polygons_cover_their_area_and_what_lies_in_them(seed):
    rng = np.random.default_rng(seed)
    outer, hole = star(rng, (40, 30), 28), star(rng, (40, 30), 6)
    which, total = filled((60, 80), outer, hole)
    assert total.sum() == pytest.approx(shoelace(outer) - shoelace(hole), rel=0.01)
    y, x = np.mgrid[:60, :80] + 0.5
    at = np.stack([x.ravel(), y.ravel()], 1)
    inside = (Outline(outer).contains_points(at) ^ Outline(hole).contains_points(at)).reshape(60, 80)
    far = np.abs(total - 0.5) > 0.49
    np.testing.assert_array_equal((total > 0.5)[far], inside[far])
    np.testing.assert_array_equal(which >= 0, total > 0)


def test_what_reaches_beyond_the_image_is_filled_up_to_its_border():
    _, total = filled((10, 12), np.array([[-50.0, -50], [100, -50], [100, 4.5], [-50, 4.5]]))
    np.testing.assert_allclose(total[:4], 1)
    np.testing.assert_allclose(total[4], 0.5)
    assert (total[5:] == 0).all()


def test_neighbours_leave_no_seam_and_the_later_lies_above():
    one, two = (
        np.array([[0.0, 0], [20.3, 0], [9.6, 30], [0, 30]]),
        np.array([[20.3, 0], [40, 0], [40, 30], [9.6, 30.0]]),
    )
    which, best, total = np.full((30, 40), -1, np.int32), np.zeros((30, 40)), np.zeros((30, 40))
    x, y, first, _ = rings_of(one, two)
    fill(x, y, first, np.array([0, 1]), which, best, total)
    np.testing.assert_allclose(total, 1, atol=1e-9)
    fill(*rings_of(np.array([[5.0, 5], [15, 5], [15, 15], [5, 15]]))[:3], np.array([2]), which, best, total)
    assert (which[5:15, 5:15] == 2).all() and (total <= 1).all()


@pytest.mark.parametrize("tall", [1.0, 1.7])
def test_lines_cover_what_is_nearer_than_half_their_width(tall):
    rng = np.random.default_rng(3)
    line = rng.uniform(5, 45, (6, 2))
    which, cover = np.full((50, 50), -1, np.int32), np.zeros((50, 50))
    stroke(*line.T.copy(), np.array([0, 6]), np.array([4]), 2.5, tall, which, cover)
    y, x = np.mgrid[:50, :50] + 0.5
    away = np.full((50, 50), np.inf)
    scaled = line * [1, tall]
    for a, b in pairwise(scaled):
        t = np.linspace(0, 1, 4001)
        places = a + (b - a) * t[:, None]
        for p in places[::8]:
            away = np.minimum(away, np.hypot(x - p[0], y * tall - p[1]))
    np.testing.assert_allclose(cover, np.clip(3.0 - away, 0, 1), atol=0.02)
    assert set(np.unique(which)) == {-1, 4}


def test_rings_and_lines_are_cut_to_a_box():
    rng = np.random.default_rng(5)
    low, high = np.array([-10.0, -8]), np.array([9.0, 12])
    at = rng.uniform(low, high, (4000, 2))
    for _ in range(10):
        ring = star(rng, rng.uniform(-12, 12, 2), 20)
        closed = np.column_stack([np.concatenate([ring, ring[:1]]), np.zeros(len(ring) + 1)])
        cut = cut_ring(closed, low, high)
        assert (cut[:, :2] >= low - 1e-9).all() and (cut[:, :2] <= high + 1e-9).all()
        inside = Outline(cut[:, :2]).contains_points(at) if len(cut) else np.zeros(len(at), bool)
        assert (inside == Outline(ring).contains_points(at)).mean() > 0.999
        dense = np.concatenate([a + (b - a) * np.linspace(0, 1, 2000)[:, None] for a, b in pairwise(closed)])
        there = ((dense[:, :2] >= low) & (dense[:, :2] <= high)).all(1)
        length = np.hypot(*np.diff(dense[:, :2], axis=0).T)[there[1:]].sum()
        pieces = cut_line(closed, low, high)
        assert sum(np.hypot(*np.diff(p[:, :2], axis=0).T).sum() for p in pieces) == pytest.approx(
            length, rel=1e-2, abs=0.1
        )


@pytest.mark.stress
def test_edges_bend_as_their_projection_bends_them():
    grid = terrain_of(400, 500, Affine(1000, 0, 300_000, 0, -1000, 6_400_000)).grid
    ring = [[-6.0, 54.6], [1.0, 54.6], [1.0, 57.0], [-6.0, 57.0], [-6.0, 54.6]]
    given = Dataset(collection(feature("Polygon", [ring], v=1.0), crs=None))
    shapes = read_shapes(given, read_features(given, grid), grid, 20.0)
    from pyproj import Transformer

    move = Transformer.from_crs(4326, UTM, always_xy=True).transform
    true = np.stack(move(np.linspace(-6, 1, 3001), np.full(3001, 54.6)), 1)
    true = true[(true[:, 0] > 300_000) & (true[:, 0] < 800_000)]
    x, y = shapes.x, shapes.y
    off = [
        min(
            float(np.hypot(*(p - (a + (b - a) * np.clip(((p - a) @ (b - a)) / max((b - a) @ (b - a), 1e-9), 0, 1)))))
            for a, b in zip(np.stack([x, y], 1), np.stack([x, y], 1)[1:])
        )
        for p in true[::60]
    ]  # fmt: skip
    assert max(off) < 21
    assert len(x) < 400


def image_of(shown):
    layer = painted(shown)
    with rasterio.open(layer.path) as file:
        return file.read().transpose(1, 2, 0), file.transform


def shape(source, grid, texels=500, pixel=1.0, priority=Priority(data=True), **more):  # noqa: B008
    given = Dataset(source, **more)
    return shown_shapes(given, read_features(given, grid), grid, texels, pixel, priority)


def color_at(shown, x, y):
    image, place = image_of(shown)
    j, i = (int(v) for v in apply(~place, x, y))
    return image[i, j].astype(int)


def test_polygons_have_the_colours_of_their_values():
    grid = terrain_of().grid
    shown = shape(
        collection(square(501_000, 5_599_000, 1000, v=2.0, s=0.0), square(502_000, 5_599_000, 1000, v=8.0, s=1.0)),
        grid, variable="v", range=(0, 10), style="continuous", uncertainty="s", width=2,
    )  # fmt: skip
    from orograph.geovis.color import linear_to_srgb

    for x, value in ((501_500, 2.0), (502_500, 8.0)):
        wanted = np.rint(linear_to_srgb(shown.scale.color(np.array(value))) * 255)
        assert np.abs(color_at(shape(collection(square(501_000, 5_599_000, 1000, v=2.0), square(
            502_000, 5_599_000, 1000, v=8.0)), grid, range=(0, 10), style="continuous"), x, 5_598_500)[:3] - wanted
        ).max() <= 1  # fmt: skip
    assert color_at(shown, 502_000, 5_598_500)[:3].max() < 130  # the outline between
    assert shown.field.chosen == "2 polygons"
    sigma = shown.sigma[np.isfinite(shown.sigma)]
    assert set(np.unique(sigma)) == {0.0, 1.0}


def test_lines_are_as_wide_as_asked_for_in_pixels_and_metres():
    grid = terrain_of().grid
    line = collection(feature("LineString", [[500_500, 5_598_000], [504_500, 5_598_000]], v=1.0))
    for width, pixel, metres in ((4, 2.0, 80), ("150m", 2.0, 150), ("150m", 3.0, 150)):
        shown = shape(line, grid, pixel=pixel, width=width)
        across = shown.cover[:, shown.cover.shape[1] // 2].sum() * abs(shown.over.transform.e)
        assert across == pytest.approx(metres, rel=0.02), (width, pixel)
        assert shown.outline.sum() > shown.cover.sum()


def test_attributes_of_text_are_classes_with_names_and_colours():
    grid = terrain_of().grid
    source = collection(
        *(
            square(500_500 + 1000 * k, 5_599_000, 900, cover=name, n=k)
            for k, name in enumerate(("wood", "lake", "wood"))
        )
    )
    shown = shape(source, grid, variable="cover", colormap={"lake": "#0000ff"})
    key = painted(shown).key
    assert key.scales == () and [name for name, _ in key.classes] == ["lake", "wood"]
    assert color_at(shown, 501_900, 5_598_500)[:3].tolist() == [0, 0, 255]
    np.testing.assert_array_equal(color_at(shown, 500_900, 5_598_500), color_at(shown, 502_900, 5_598_500))
    for style in ("hatching", "stipple"):
        tiles = [tile for _, tile in painted(shape(source, grid, variable="cover", style=style)).key.classes]
        assert np.abs(tiles[0].astype(int) - tiles[1]).max() > 50
    many = collection(*(square(500_100 + 30 * k, 5_599_000, 20, name=f"n{k}", b="x") for k in range(20)))
    with pytest.raises(UsageError, match="20 classes"):
        shape(many, grid, variable="name")
    with pytest.raises(UsageError, match="Colours by name"):
        shape(source, grid, variable="n", colormap={"lake": "blue"})


@pytest.mark.parametrize("sign", ["transparency", "whiteness", "saturation", "palette", "hatching", "noise"])
@pytest.mark.parametrize("kind", ["lines", "polygons"])
def test_signs_tell_the_certain_from_the_uncertain(kind, sign):
    grid = terrain_of().grid
    made = [
        square(500_200, 5_599_800, 2000, v=5.0, s=0.01) if kind == "polygons" else
        feature("LineString", [[500_200, 5_599_000], [502_300, 5_599_000]], v=5.0, s=0.01),
        square(502_500, 5_599_800, 2000, v=5.0, s=1.0) if kind == "polygons" else
        feature("LineString", [[502_500, 5_599_000], [504_700, 5_599_000]], v=5.0, s=1.0),
    ]  # fmt: skip
    doubt = orograph.Uncertainty("s", style=sign)
    more = {"variable": "v", "range": (0, 10), "width": 12 if kind == "lines" else 1}
    one, two = (image_of(shape(collection(*made), grid, **more, **u))[0] for u in ({}, {"uncertainty": doubt}))
    off = np.abs(one.astype(int) - two).max(-1)
    half = off.shape[1] // 2
    assert off[:, half + 10 :].mean() > 3 * off[:, : half - 10].mean()


def test_what_cannot_be_meant_is_told():
    grid = terrain_of().grid
    lines = feature("LineString", [[501_000, 5_599_000], [503_000, 5_598_000]], v=1.0)
    fine = square(501_000, 5_599_000, 1000, v=1.0)
    with pytest.raises(UsageError, match="1 lines and 1 polygons"):
        shape(collection(lines, fine), grid)
    assert read_features(Dataset(collection(lines, fine), geometry="lines"), grid).kind == "lines"
    with pytest.raises(UsageError, match="no points"):
        shape(collection(lines, fine), grid, geometry="points")
    with pytest.raises(ReadError, match="no point, line or polygon"):
        shape(collection(feature("Polygon", [], v=1.0), {"type": "Feature", "geometry": None, "properties": {}}), grid)
    with pytest.raises(ReadError, match="coordinates"):
        shape(collection(feature("Polygon", [[["a", 1], [2, 2], [3, 3]]])), grid)
    with pytest.raises(ReadError, match="None of its 1 polygons lies on the terrain"):
        shape(collection(square(0, 0, 10, v=1.0)), grid)
    with pytest.raises(ReadError, match="has a v"):
        shape(collection(square(501_000, 5_599_000, 1000, v=None, w=1.0)), grid, variable="v")
    with pytest.raises(UsageError, match="several attributes"):
        shape(collection(square(501_000, 5_599_000, 1000, v=1.0, w=1.0)), grid)
    with pytest.raises(UsageError, match="celestial bodies"):
        shape(collection(fine, crs="ESRI:104905"), grid)
    with pytest.raises(UsageError, match="no style arrows of polygons"):
        shape(collection(fine), grid, style="arrows")
    with pytest.raises(UsageError, match="glyphs"):
        shape(collection(feature("LineString", lines["geometry"]["coordinates"], v=1.0, s=1.0)), grid, variable="v",
              uncertainty=orograph.Uncertainty("s", style="glyphs"))  # fmt: skip
    with pytest.raises(ReadError, match="cannot be negative"):
        shape(collection(square(501_000, 5_599_000, 1000, v=1.0, s=-1.0)), grid, variable="v", uncertainty="s")
    for text in ("-3", "5km", "x"):
        with pytest.raises(UsageError):
            Dataset(collection(fine), width=text)


def test_polygons_that_cross_themselves_are_told():
    grid = terrain_of().grid
    tie = [[501_000, 5_599_000], [502_000, 5_598_000], [502_000, 5_599_000], [501_000, 5_598_000], [501_000, 5_599_000]]
    shown = shape(collection(feature("Polygon", [tie], v=1.0), square(503_000, 5_599_000, 900, v=2.0)), grid)
    assert "1 crosses itself" in shown.field.chosen
    assert shown.cover.sum() * abs(shown.over.transform.determinant) == pytest.approx(0.5e6 + 0.81e6, rel=0.02)
    ring = star(np.random.default_rng(0), np.zeros(2), 5.0, 40)
    assert not crossed(*rings_of(ring)[:3], 10**6)


@pytest.mark.parametrize("how", ["jumps", "goes on", "is split"])
def test_shapes_across_the_antimeridian_are_whole(how):
    place = Affine(1000, 0, 400_000, 0, -1000, 8_200_000)
    grid = terrain_of(300, 400, place, "EPSG:32701").grid  # Fiji: 177° W is its middle
    lon = {"jumps": (179.0, -179.0), "goes on": (179.0, 181.0)}.get(how)
    box = lambda a, b: [[[a, -17.5], [b, -17.5], [b, -18.5], [a, -18.5], [a, -17.5]]]  # noqa: E731
    coordinates = [box(*lon)] if lon else [box(179.0, 180.0), box(-180.0, -179.0)]
    grid = Grid((300, 500), Affine(1000, 0, 0, 0, -1000, 8_200_000), grid.crs)
    shown = shape(collection(feature("MultiPolygon", coordinates, v=1.0), crs=None), grid, width=0)
    from pyproj import Geod

    true = abs(Geod(ellps="WGS84").polygon_area_perimeter(*np.array(box(179.0, 181.0)[0]).T)[0])
    assert shown.cover.sum() * abs(shown.over.transform.determinant) == pytest.approx(true, rel=0.01)


def test_a_ring_around_the_pole_holds_it():
    grid = Grid((200, 200), Affine(10_000, 0, -1e6, 0, -10_000, 1e6), orograph.terrain(
        np.zeros((4, 4), np.float32), transform=PLACE, crs="EPSG:3995").grid.crs)  # fmt: skip
    lon = [*range(-180, 180, 5), 180]
    shown = shape(collection(feature("Polygon", [[[x, 85.0] for x in lon]], v=1.0), crs=None), grid, width=0)
    i, j = (int(v) for v in apply(~shown.over.transform, 0, 0))
    assert shown.cover[i, j] == 1
    radius = np.sqrt(shown.cover.sum() * abs(shown.over.transform.determinant) / np.pi)
    assert radius == pytest.approx(544_000, rel=0.02)


def wkb(kind, parts):
    """Plain well-known binary, by another hand: ``struct`` alone."""
    import struct

    def places(p):
        return struct.pack("<I", len(p)) + b"".join(struct.pack("<dd", *q) for q in p)

    if kind == "LineString":
        return struct.pack("<BI", 1, 2) + places(parts)
    return struct.pack("<BII", 1, 3, len(parts)) + b"".join(places(r) for r in parts)


def test_files_that_ogr_reads_are_as_geojson(tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    grid = terrain_of().grid
    made = collection(square(501_000, 5_599_000, 1000, v=2.0, c="a"), square(502_500, 5_599_000, 900, v=8.0, c="b"))
    shapes = np.array([wkb("Polygon", one["geometry"]["coordinates"]) for one in made["features"]], object)
    path = tmp_path / "p.gpkg"
    pyogrio.raw.write(
        path, shapes, [np.array([2.0, 8.0]), np.array(["a", "b"], object)], ["v", "c"], geometry_type="Polygon",
        crs=UTM, layer="one",
    )  # fmt: skip
    (tmp_path / "p.geojson").write_text(json.dumps(made))
    one, two = (shape(str(tmp_path / f"p.{end}"), grid, variable="v") for end in ("gpkg", "geojson"))
    np.testing.assert_array_equal(one.values, two.values)
    np.testing.assert_array_equal(image_of(one)[0], image_of(two)[0])
    assert [k for k, _ in painted(shape(str(path), grid, variable="c")).key.classes] == ["a", "b"]
    line = np.array([wkb("LineString", [[501_000, 5_599_000], [503_000, 5_598_000]])], object)
    pyogrio.raw.write(
        path, line, [np.array([1.0])], ["v"], geometry_type="LineString", crs=UTM, layer="two", append=False
    )
    with pytest.raises(UsageError, match="2 layers: one, two"):
        shape(str(path), grid)
    assert shape(str(path), grid, layer="two").cased
    with pytest.raises(UsageError, match="no layer 'three'"):
        shape(str(path), grid, layer="three")


def test_binary_of_other_kinds():
    import struct

    ewkb = struct.pack("<BII", 1, 0x20000000 | 0x80000000 | 2, 4326) + struct.pack("<I6d", 2, 1, 2, 3, 4, 5, 6)
    (kind, (line,)), = parse(ewkb)  # fmt: skip
    assert kind == "lines" and line.tolist() == [[1, 2, 3], [4, 5, 6]]
    inner = wkb("LineString", [[0, 0], [1, 1]])
    both = struct.pack(">BII", 0, 7, 2) + inner + wkb("Polygon", [[[0, 0], [1, 0], [1, 1], [0, 0]]])
    assert [kind for kind, _ in parse(both)] == ["lines", "polygons"]
    for bad in (ewkb[:-3], struct.pack("<BII", 1, 8, 0)):
        with pytest.raises(ValueError):
            parse(bad)


def test_objects_with_a_geo_interface_have_their_own_crs():
    class Frame:
        crs = UTM
        columns = ("v", "geometry")
        __geo_interface__ = collection(square(501_000, 5_599_000, 1000, v=2.0), crs=None)

    grid = terrain_of().grid
    assert shape(Frame(), grid).field.chosen == "1 polygon"
    Frame.crs = None  # not known: the terrain's own
    assert shape(Frame(), grid).field.chosen == "1 polygon"


def test_pictures_have_shapes_their_legend_and_their_words():
    terrain = terrain_of()
    view = orograph.camera.plan(terrain, (250, 200))
    data = Dataset(
        collection(square(501_000, 5_599_500, 3000, v=2.0), square(504_000, 5_599_500, 900, v=8.0)), range=(0, 10),
        name="Rain", unit="mm", style="continuous",
    )  # fmt: skip
    picture = orograph.render(terrain, view, data=data, light="none")
    (at, _) = view.project(np.array([502_500, 5_598_000, 0.0]))
    from orograph.geovis.color import color_table, linear_to_srgb

    wanted = np.rint(linear_to_srgb(color_table("viridis", 1024)[round(0.2 * 1023)]) * 255)
    assert np.abs(picture.pixels[int(at[1]), int(at[0])].astype(int) - wanted).max() <= 3
    assert "Rain, 0 to 10 mm" in picture.facts["description"]
    assert "2 polygons" in picture.facts["description"]


def test_lines_leave_the_ground_its_colours_and_polygons_do_not():
    ground = terrain_of()
    ring = [[500_500, 5_599_500], [503_000, 5_599_500], [503_000, 5_598_000], [500_500, 5_599_500]]
    for kind, shape in (("LineString", ring[:3]), ("Polygon", [ring])):
        made = themed({"data": Dataset(collection(feature(kind, shape)))}, ground, (200, 150))
        assert ("colormap" in made.options) == (kind == "Polygon")
