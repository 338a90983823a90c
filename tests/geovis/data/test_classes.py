"""Rasters of classes against plain counting."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

import orograph
from orograph.errors import ReadError, UsageError
from orograph.geovis.data.classes import mode
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.painted import painted
from orograph.geovis.data.painting import shown
from orograph.geovis.data.priority import Priority

UTM = "EPSG:32630"
PLACE = from_origin(500_000, 5_600_000, 100.0, 100.0)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.zeros((40, 50), np.float32), transform=PLACE, crs=UTM)


def cover(path, values, step):
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=values.shape[0], width=values.shape[1], dtype="uint8", crs=UTM,
        transform=from_origin(500_000, 5_600_000, step, step), nodata=255,
    ) as file:  # fmt: skip
        file.write(values.astype(np.uint8), 1)
        file.write_colormap(1, {11: (70, 107, 159), 41: (104, 171, 95), 82: (171, 108, 40)})
        file.update_tags(1, flag_values="11,41,82", flag_meanings="open_water forest crops")
    return str(path)


def test_coarse_classes_are_the_nearest_ones_with_crisp_borders(tmp_path, ground):
    values = np.random.default_rng(0).choice([11, 41, 82], (8, 10))
    found = shown(Dataset(cover(tmp_path / "c.tif", values, 500.0), style="classes"), ground.grid, 200, Priority())
    truth = np.kron(np.searchsorted([11, 41, 82], values), np.ones((20, 20)))
    np.testing.assert_array_equal(found.values, truth)
    assert found.classes == ("open water", "forest", "crops")
    by_itself = shown(Dataset(cover(tmp_path / "c.tif", values, 500.0)), ground.grid, 200, Priority())
    np.testing.assert_array_equal(by_itself.values, truth)
    layer = painted(found)
    assert [words for words, _ in layer.key.classes] == list(found.classes) and not layer.key.scales
    np.testing.assert_array_equal(layer.key.classes[0][1][0, 0], [70, 107, 159])


def test_fine_classes_are_the_most_frequent_ones(tmp_path, ground):
    values = np.random.default_rng(1).choice([11, 41, 82, 255], (160, 200), p=[0.5, 0.2, 0.2, 0.1])
    found = shown(Dataset(cover(tmp_path / "f.tif", values, 25.0), style="classes"), ground.grid, 50, Priority())
    blocks = values.reshape(40, 4, 50, 4).swapaxes(1, 2).reshape(40, 50, 16)
    codes = np.array([11, 41, 82])
    for i, j in np.ndindex(40, 50):
        most = Counter(int(v) for v in blocks[i, j]).most_common()
        best = {code for code, count in most if count == most[0][1]}
        value = found.values[i, j]
        assert (255 if np.isnan(value) else int(codes[int(value)])) in best


def test_exported_classes_are_those_of_the_file(tmp_path, ground):
    values = np.random.default_rng(2).choice([11, 41, 82], (8, 10))
    out = tmp_path / "out.tif"
    orograph.export(ground, out, data=Dataset(cover(tmp_path / "c.tif", values, 500.0)))
    with rasterio.open(out) as file:
        np.testing.assert_array_equal(file.read(1), np.kron(values, np.ones((5, 5))))


def bare(path, values):
    """A raster of codes of which nothing says what they are."""
    rows, cols = values.shape
    place = from_origin(500_000, 5_600_000, 100, 100)
    with rasterio.open(path, "w", "GTiff", cols, rows, 1, UTM, place, "uint8") as file:
        file.write(values.astype(np.uint8), 1)
    return str(path)


def test_codes_are_classes_though_nothing_says_so(tmp_path, ground):
    codes = bare(
        tmp_path / "codes.tif", np.kron(np.random.default_rng(3).choice([31, 43, 71], (8, 10)), np.ones((5, 5)))
    )
    found = shown(Dataset(codes), ground.grid, 50, Priority())
    assert found.style == "classes" and found.classes == ("31", "43", "71")
    assert "shown as classes" in " ".join(found.field.warnings)
    assert shown(Dataset(codes, style="continuous"), ground.grid, 50, Priority()).classes is None
    ranks = np.add.outer(np.arange(40), np.arange(50)) // 9  # steps of one between neighbours: counts, not codes
    assert shown(Dataset(bare(tmp_path / "ranks.tif", ranks)), ground.grid, 50, Priority()).classes is None


def test_users_name_and_colour_classes_by_number_or_name(tmp_path, ground):
    path = bare(tmp_path / "c.tif", np.kron(np.random.default_rng(4).choice([11, 41, 82], (8, 10)), np.ones((5, 5))))
    told = Dataset(path, names={11: "water"}, colormap={"water": "#0000ff", 41: "#00ff00", "82": "#ff0000", 95: "red"})
    layer = painted(shown(told, ground.grid, 50, Priority()))
    assert [(words, tuple(look[0, 0])) for words, look in layer.key.classes] == [
        ("water", (0, 0, 255)), ("41", (0, 255, 0)), ("82", (255, 0, 0))]  # fmt: skip
    assert layer.key.title == "c" and layer.key.entries[0] == ("c", None)
    shell = Dataset.parse(f"{path},names=11:water,colormap=water:#0000ff;41:#00ff00;82:#ff0000;95:red")
    assert shell == told.but(names={"11": "water"}, colormap={str(k): v for k, v in told.colormap.items()})
    assert Dataset.parse(f"{path},colormap=crameri:batlow").colormap == "crameri:batlow"
    with pytest.raises(UsageError, match="no class 'Forest' to colour"):
        shown(Dataset(path, colormap={"Forest": "red"}), ground.grid, 50, Priority())
    with pytest.raises(UsageError, match="by number, not by 'water'"):
        Dataset(path, names={"water": "blue"})
    with pytest.raises(UsageError, match="CLASS:VALUE"):
        Dataset.parse(f"{path},names=water")


def test_modes_of_votes():
    votes = np.array([[[1.0, np.nan]], [[2.0, np.nan]], [[2.0, 3.0]]], np.float32)
    np.testing.assert_array_equal(mode(votes), [[2, np.nan]])


def test_what_has_no_classes_is_refused(ground):
    with pytest.raises(ReadError, match="whole numbers"):
        shown(Dataset(np.full((8, 10), 0.5, np.float32), style="classes"), ground.grid, 50, Priority())
    several = np.zeros((2, 8, 10), np.float32)
    with pytest.raises(UsageError, match="no mean"):
        shown(Dataset(several, band="all", style="classes"), ground.grid, 50, Priority())


def plain(path, values):
    """A raster that says nothing of its classes."""
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=values.shape[0], width=values.shape[1], dtype="uint8", crs=UTM,
        transform=from_origin(500_000, 5_600_000, 500.0, 500.0),
    ) as file:  # fmt: skip
        file.write(values.astype(np.uint8), 1)
    return str(path)


def note(fields, rows, more=""):
    """A note as GDAL writes it (frmts/gdal_pam): fields (name, type, usage)."""
    told = "".join(
        f'<FieldDefn index="{k}"><Name>{name}</Name><Type>{kind}</Type><Usage>{use}</Usage></FieldDefn>'
        for k, (name, kind, use) in enumerate(fields)
    )
    lines = "".join(f'<Row index="{k}">{"".join(f"<F>{v}</F>" for v in row)}</Row>' for k, row in enumerate(rows))
    table = f'<GDALRasterAttributeTable tableType="thematic"{more}>{told}{lines}</GDALRasterAttributeTable>'
    return f'<PAMDataset><PAMRasterBand band="1">{table}</PAMRasterBand></PAMDataset>'


RGB = [("r", 0, 6), ("g", 0, 7), ("b", 0, 8)]


@pytest.mark.parametrize(
    ("fields", "rows", "more", "names", "first"),
    [
        ([("Value", 0, 5), ("Class", 2, 2), *RGB],
         [(11, "Open water", 1, 2, 3), (41, "Forest", 4, 5, 6), (82, "Crops", 7, 8, 9)], "",
         ("Open water", "Forest", "Crops"), (1, 2, 3)),
        # Without usages, as some programs write it; the names are in the column that is called so.
        ([("VALUE", 0, 0), ("COUNT", 0, 1), ("LABEL", 2, 0)], [(11, 5, "w"), (41, 5, "f"), (82, 5, "c")], "",
         ("w", "f", "c"), None),
        # Ranges, and colours from 0 to 1 (Erdas Imagine).
        ([("low", 0, 3), ("high", 0, 4), ("n", 2, 2), ("r", 1, 6), ("g", 1, 7), ("b", 1, 8)],
         [(0, 40, "low", 0.5, 0, 1), (41, 99, "high", 0, 0.25, 0)], "",
         ("low", "high (41)", "high (82)"), (128, 0, 255)),
        # Counted rows.
        ([("n", 2, 2)], [("a",), ("b",), ("c",)], ' Row0Min="11" BinSize="30"', ("a", "b", "82"), None),
    ],
)  # fmt: skip
def test_names_and_colors_of_an_attribute_table(tmp_path, ground, fields, rows, more, names, first):
    values = np.random.default_rng(0).choice([11, 41, 82], (8, 10))
    path = plain(tmp_path / "c.tif", values)
    bare = shown(Dataset(path), ground.grid, 200, Priority())
    assert bare.classes is None
    (tmp_path / "c.tif.aux.xml").write_text(note(fields, rows, more))
    found = shown(Dataset(path), ground.grid, 200, Priority())
    assert found.classes == names
    np.testing.assert_array_equal(found.values, np.kron(np.searchsorted([11, 41, 82], values), np.ones((20, 20))))
    if first is not None:
        np.testing.assert_array_equal(painted(found).key.classes[0][1][0, 0], first)


def test_category_names_of_a_note_and_of_a_vrt(tmp_path, ground):
    values = np.random.default_rng(0).choice([0, 1, 2], (8, 10))
    path = plain(tmp_path / "c.tif", values)
    words = "<CategoryNames><Category>sea</Category><Category/><Category>land</Category></CategoryNames>"
    (tmp_path / "c.tif.aux.xml").write_text(f'<PAMDataset><PAMRasterBand band="1">{words}</PAMRasterBand></PAMDataset>')
    assert shown(Dataset(path), ground.grid, 200, Priority()).classes == ("sea", "1", "land")
    (tmp_path / "c.tif.aux.xml").unlink()
    vrt = tmp_path / "c.vrt"
    vrt.write_text(
        f'<VRTDataset rasterXSize="10" rasterYSize="8"><SRS>{UTM}</SRS><GeoTransform>500000,500,0,5600000,0,-500'
        f'</GeoTransform><VRTRasterBand dataType="Byte" band="1">{words}<SimpleSource>'
        '<SourceFilename relativeToVRT="1">'
        "c.tif</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    assert shown(Dataset(str(vrt)), ground.grid, 200, Priority()).classes == ("sea", "1", "land")


def test_broken_notes_are_refused_and_histograms_are_no_classes(tmp_path, ground):
    values = np.random.default_rng(0).choice([11, 41], (8, 10))
    path = plain(tmp_path / "c.tif", values)
    beside = tmp_path / "c.tif.aux.xml"
    beside.write_text(note([("Value", 0, 5), ("Count", 0, 1)], [(11, 7)]))
    assert shown(Dataset(path), ground.grid, 200, Priority()).classes is None
    beside.write_text(note([("Value", 0, 5), ("Class", 2, 2)], [("eleven", "w")]))
    with pytest.raises(ReadError, match="lacks a number"):
        shown(Dataset(path), ground.grid, 200, Priority())
    beside.write_text("<PAM")
    with pytest.raises(ReadError):
        shown(Dataset(path), ground.grid, 200, Priority())
