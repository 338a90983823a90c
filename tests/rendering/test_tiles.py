"""Pictures drawn by workers, tile by tile: the bytes of one process, whatever tiles there are; tiles of equal cost."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from scenes import hills, holes, terrain

import orograph
from orograph.errors import StoreError, UsageError
from orograph.progress import SILENT
from orograph.rendering import large, tiles
from orograph.rendering.large import draw_large
from orograph.rendering.tiles import Tiles, coarse_costs, cut, draw_by_workers
from orograph.scene import camera
from orograph.scene.scene import Scene

SIZE = (417, 250)

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")


def ground():
    heights = holes(hills(140, 180))
    heights[90:125, 60:110] = 640.0  # a lake
    return terrain(heights)


class Workers:
    """Stands for a cluster: its tasks are done by a state that knows nothing but the recipe, the last ones first."""

    def __init__(self, client, recipe):
        self.recipe, self.left = recipe, client

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def imbalance(self):
        return 1.25

    def run(self, stage, progress):
        state = self.recipe.open()
        for spot in reversed(stage.tasks()):
            own = state.stage(stage.name, stage.number)
            if own.found(spot) is None:
                if self.left[0] == 0:
                    raise StoreError("stopped")
                self.left[0] -= 1
                own.make(spot)
            stage.add(spot, stage.found(spot, proof=False))
        stage.finish()


@pytest.fixture
def by_workers(monkeypatch):
    """How many tiles workers draw before they stop."""
    left = [-1]

    @contextlib.contextmanager
    def workforce(*_):
        yield left

    monkeypatch.setattr(tiles, "workforce", workforce)
    monkeypatch.setattr(tiles, "Cluster", Workers)
    monkeypatch.setattr(tiles, "threads_of", lambda client: 2)
    return left


@pytest.mark.stress
@pytest.mark.parametrize("ending", ["png", "tif", "jpg"])
def test_the_bytes_of_one_process(tmp_path, ending, by_workers):
    land = ground()
    scene = Scene.of(land, camera.around(land, SIZE, azimuth=215, pitch=22, distance=3500), furniture=True, sky=True)
    (tmp_path / "one").mkdir()
    one, depth = tmp_path / f"one/a.{ending}", tmp_path / "one/depth.tif"
    facts = draw_large(scene, one, depth=depth)
    told = draw_by_workers(scene, tmp_path / f"a.{ending}", workers=2, depth=tmp_path / "depth.tif", progress=SILENT)
    assert (tmp_path / f"a.{ending}").read_bytes() == one.read_bytes()
    with rasterio.open(depth) as a, rasterio.open(tmp_path / "depth.tif") as b:
        np.testing.assert_array_equal(a.read(1), b.read(1))
    assert told["shown"] == facts["shown"] and told["imbalance"] == 1.25
    assert sorted(f.name for f in tmp_path.iterdir()) == sorted([f"a.{ending}", "depth.tif", "one"])


@pytest.mark.parametrize("plan", [True, False])
def test_render_has_workers(tmp_path, by_workers, monkeypatch, plan):
    """The same picture as from one process, in memory and as a file; nothing is left beside it."""
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    land, how = ground(), {"samples": 1, "furniture": plan}
    view = (
        camera.plan(land, (161, 97)) if plan else camera.around(land, (161, 97), azimuth=215, pitch=22, distance=3500)
    )
    one = orograph.render(land, view, **how)
    many = orograph.render(land, view, **how, workers=2)
    np.testing.assert_array_equal(many.pixels, one.pixels)
    np.testing.assert_array_equal(many.depth, one.depth)
    assert (many.grid, many.crs, many.attribution) == (one.grid, one.crs, one.attribution)
    assert many.tint is not None and repr(many.tint) == repr(one.tint)
    assert many.facts["shown"] == one.facts["shown"] and many.facts["imbalance"] == 1.25
    file = orograph.render(land, view, **how, workers=2, output=tmp_path / "a.tif", depth=tmp_path / "d.tif")
    with rasterio.open(file) as pixels, rasterio.open(tmp_path / "d.tif") as depth:
        np.testing.assert_array_equal(pixels.read().transpose(1, 2, 0), one.pixels)
        np.testing.assert_array_equal(depth.read(1), one.depth)
    assert {path.name for path in tmp_path.iterdir()} == {"a.tif", "d.tif", "cache"}
    assert not list((tmp_path / "cache").iterdir())


def test_render_writes_files(tmp_path):
    """At once, and in bands if the picture takes too much memory: the same pixels."""
    land = ground()
    how = {"view": camera.whole(land, SIZE), "samples": 1}
    small = orograph.render(land, output=tmp_path / "a.png", **how)
    bands = orograph.render(land, output=tmp_path / "b.png", max_memory=8 << 20, **how)
    orograph.render(land, **how).save(tmp_path / "c.png")
    assert (small, bands) == (tmp_path / "a.png", tmp_path / "b.png")
    assert small.read_bytes() == (tmp_path / "c.png").read_bytes()
    with rasterio.open(small) as a, rasterio.open(bands) as b:
        np.testing.assert_array_equal(a.read(), b.read())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"depth": "d.tif"}, "`depth` is a file beside `output`"),
        ({"output": "a.tif", "depth": "d.png"}, "saved as a TIFF"),
        ({"output": "a.xyz"}, "a.xyz"),
        ({"output": "a.tif", "depth": "d.tif", "each": "view"}, "`each` makes several"),
        ({"workers": 2, "each": "view"}, "Panels are drawn by this process"),
        ({"workers": 2, "dask": "tcp://there:8786"}, "exclude each other"),
        ({"sort_last": True}, "`sort_last` needs workers"),
        ({"sort_last": True, "workers": 2, "backend": "gpu"}, "draws on the CPU"),
        ({"workers": 0}, "at least one worker"),
    ],
)
def test_render_refuses_what_makes_no_sense(wrong, words):
    with pytest.raises(UsageError, match=words):
        orograph.render(ground(), size=SIZE, **wrong)


@pytest.mark.stress
def test_what_is_drawn_is_not_drawn_again(tmp_path, by_workers):
    land = ground()
    scene = Scene.of(land, camera.whole(land, SIZE))
    draw_large(scene, tmp_path / "one.png")
    by_workers[0] = 5
    with pytest.raises(StoreError, match="stopped"):
        draw_by_workers(scene, tmp_path / "a.png", workers=2, progress=SILENT)
    there = {p.name: p.stat().st_mtime_ns for p in (tmp_path / ".a.png.tiles").iterdir()}
    assert len(there) == 11  # (the plan; of each tile two)
    by_workers[0] = 5
    with pytest.raises(StoreError, match="stopped"):
        draw_by_workers(scene, tmp_path / "a.png", workers=2, progress=SILENT)
    now = {p.name: p.stat().st_mtime_ns for p in (tmp_path / ".a.png.tiles").iterdir()}
    assert len(now) == 21 and there.items() <= now.items()
    by_workers[0] = -1
    draw_by_workers(scene, tmp_path / "a.png", workers=2, progress=SILENT)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    by_workers[0] = 2
    with pytest.raises(StoreError):  # another picture has nothing of the one that was begun
        draw_by_workers(scene, tmp_path / "b.png", workers=2, progress=SILENT)
    by_workers[0] = -1
    other = scene.but(exaggeration=2.0)
    draw_by_workers(other, tmp_path / "b.png", workers=2, progress=SILENT)
    draw_large(other, tmp_path / "two.png")
    assert (tmp_path / "b.png").read_bytes() == (tmp_path / "two.png").read_bytes()


@pytest.mark.stress
def test_what_is_damaged_is_drawn_again(tmp_path, by_workers, monkeypatch):
    land, made = ground(), []
    scene = Scene.of(land, camera.whole(land, SIZE))
    draw_large(scene, tmp_path / "one.tif")
    plain, run = Tiles.make, Workers.run
    monkeypatch.setattr(Tiles, "make", lambda self, spot: made.append(spot) or plain(self, spot))

    def damaged_first(self, stage, progress):
        own = self.recipe.open().stage(stage.name, 0)
        first, second, third = stage.tasks()[:3]
        for spot in (first, second, third):
            own.make(spot)
        folder = tmp_path / ".a.tif.tiles"
        pixels = folder / own.pieces(first)[0]
        data = bytearray(pixels.read_bytes())
        data[-7] ^= 1
        pixels.write_bytes(data)
        (folder / own.key(second)).write_bytes(b"cut off")
        run(self, stage, progress)

    monkeypatch.setattr(Workers, "run", damaged_first)
    draw_by_workers(scene, tmp_path / "a.tif", workers=2, progress=SILENT)
    assert sorted(spot for spot in set(made) if made.count(spot) == 2) == sorted(set(made))[:2]
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "one.tif").read_bytes()


@pytest.mark.stress
def test_workers_share_the_memory_that_a_picture_may_take(tmp_path, by_workers, monkeypatch):
    land, seen = ground(), []
    scene = Scene.of(land, camera.whole(land, SIZE), max_memory=2 << 30)
    plain = Tiles.make
    monkeypatch.setattr(Tiles, "make", lambda self, spot: seen.append(self.recipe.scene) or plain(self, spot))
    draw_by_workers(scene, tmp_path / "a.png", workers=4, progress=SILENT)
    assert seen and {one.budget.max_memory for one in seen} == {512 << 20}
    draw_large(scene.but(max_memory=512 << 20), tmp_path / "one.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "one.png").read_bytes()


@pytest.mark.stress
def test_a_real_cluster(tmp_path):
    pytest.importorskip("distributed")
    land = ground()
    scene = Scene.of(land, camera.whole(land, SIZE), furniture=True)
    draw_large(scene, tmp_path / "one.png")
    facts = draw_by_workers(scene, tmp_path / "a.png", workers=2, progress=SILENT)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    assert 1.0 <= facts["imbalance"] <= 2.0


@given(
    st.integers(1, 3000), st.integers(1, 2000), st.integers(1, 7), st.integers(1, 9), st.integers(1, 60),
    st.integers(1 << 12, 1 << 18), st.randoms(use_true_random=False),
)  # fmt: skip
def test_tiles_cover_a_picture_once(width, height, r, c, count, most, random):
    costs = np.array([[random.uniform(1e-6, 1) for _ in range(c)] for _ in range(r)])
    row = 0
    for band in cut(width, height, costs, count, most):
        assert {(t, h) for _, t, _, h in band} == {(row, band[0][3])} and row % large.ROWS == 0
        column = 0
        for left, _, wide, tall in band:
            assert left == column and left % large.COLUMNS == 0 and wide > 0
            assert wide * tall <= max(most, large.COLUMNS * tall)
            column += wide
        assert column == width
        row += band[0][3]
    assert row == height


def test_tiles_are_small_where_it_takes_long():
    costs = np.ones((4, 8))
    costs[:, 5] = 40.0
    band = cut(8192, 4096, costs, 40, 1 << 30)[0]
    narrow = [wide for left, _, wide, _ in band if left >= 5 * 1024 and left + wide <= 6 * 1024]
    assert len(narrow) >= 4 and max(narrow) < 512
    assert max(wide for left, _, wide, _ in band if left < 4096) > 1024


@pytest.mark.stress
def test_the_coarse_pass_knows_sky_from_ground():
    """Half of the picture shows nothing: that half costs less."""
    land = ground()
    low = camera.around(land, (1024, 1024), azimuth=180, pitch=-10, distance=9000)
    costs = coarse_costs(Scene.of(land, low), large.session(), SILENT)
    assert costs.shape == (8, 4) and (costs > 0).all()


def test_wireframes_are_one_process_work(tmp_path):
    land = ground()
    scene = Scene.of(land, camera.whole(land, SIZE), method="soar", wireframe=True)
    with pytest.raises(UsageError, match="wireframe"):
        draw_by_workers(scene, tmp_path / "a.png", workers=2, progress=SILENT)
