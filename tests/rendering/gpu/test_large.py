"""Pictures drawn by tiles on the GPU: a tile is what the whole picture shows there, lines, haze and hatching too."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import hills, holes, read, terrain

from orograph.errors import NothingInViewError, UsageError
from orograph.lighting.sun import Sun
from orograph.rendering.gpu.shade.light_maps import sun_windows
from orograph.rendering.large import draw_large
from orograph.scene import camera
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes

SIZE = (417, 250)


@pytest.fixture(scope="module")
def session(device):
    from orograph.rendering.gpu.draw import session

    return session()


@pytest.fixture(scope="module")
def land():
    heights = holes(hills(300, 420))
    heights[190:225, 60:110] = 640.0  # a lake
    return terrain(heights)


@pytest.mark.stress
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sky": True, "sun": Sun(120, 12)},
        {"contours": Contours(20.0), "sky": True},
        {"silhouettes": Silhouettes(width=4.0), "sky": True},
        {"light": "none", "exaggeration": 2.5},
        {"light": "raytraced", "rays": 16},
        {"method": "soar", "tolerance": 2.0},
    ],
    ids=lambda o: "-".join(o) or "plain",
)
@pytest.mark.parametrize("kind", ["perspective", "plan"])
def test_no_seam(session, land, tmp_path, options, kind):
    view = (
        camera.plan(land, SIZE, azimuth=150)
        if kind == "plan"
        else camera.around(land, SIZE, azimuth=215, pitch=22, distance=6000)
    )
    scene = Scene.of(land, view, **options)
    whole = session(scene)
    out, depth = tmp_path / "large.png", tmp_path / "depth.tif"
    facts = draw_large(scene, out, depth=depth, draw=session, pixels=128 * 96, across=128)
    off = np.abs(read(out).astype(int) - whole.pixels).max(-1)
    # (A few pixels on edges differ: the corners of triangles are rounded in a tile's own frame.)
    assert np.mean(off > 2) < 2e-4, (off.max(), np.mean(off > 2))
    assert facts["shown"]["ground"] == pytest.approx(whole.facts["shown"]["ground"], rel=1e-3)
    assert facts["hit_fraction"] == pytest.approx(whole.facts["hit_fraction"], abs=1e-3)


def test_a_tile_may_be_empty_but_not_the_picture(session, land):
    view = camera.around(land, SIZE, azimuth=215, pitch=22, distance=60_000)
    corner = session(Scene.of(land, view.tile(0, 0, 64, 48), sky=True))
    assert not np.isfinite(corner.depth).any()
    x, y, z = view.eye
    away = replace(view, target=(2 * x - view.target[0], 2 * y - view.target[1], z + 1000.0))
    with pytest.raises(NothingInViewError):
        session(Scene.of(land, away.tile(0, 0, 64, 48)))


def test_a_tile_has_no_furniture(session, land):
    with pytest.raises(UsageError, match="whole picture"):
        session(Scene.of(land, camera.whole(land, SIZE).tile(0, 0, 64, 48), furniture=True))


@pytest.mark.parametrize("side", [900, 16384])
def test_maps_of_light_have_a_bound(side):
    flat = terrain(np.zeros((3000, 2500), np.float32))
    view = camera.whole(flat, (side, side), pitch=60)
    found = sun_windows(flat, view, 1.0, 0.1)
    assert max((w.row1 - w.row0) * (w.col1 - w.col0) for w in found) <= 6_000_000
    outer = found[0]
    assert (outer.row0, outer.col0, outer.row1, outer.col1) == (0, 0, *flat.mean_shape(outer.level))
    assert all(a.level > b.level for a, b in pairwise(found))


def test_a_software_driver_keeps_within_what_is_allowed(device, monkeypatch):
    """Its textures are the process' memory: they take a third of what the driver leaves, at least 64 MiB."""
    from orograph.rendering.gpu import draw as module

    made: list[dict[str, int]] = []
    monkeypatch.setattr(module, "Renderer", lambda *_, **share: made.append(share))
    ground = terrain(hills(60, 70))
    scene = Scene.of(ground, camera.whole(ground, (40, 30)))
    for software in (True, False):
        adapter = replace(device.adapter, kind="CPU" if software else "DiscreteGPU")
        fake = type("Fake", (), {"adapter": adapter})()
        for mib in (512, 1280, None):
            module.renderer_of(fake, scene.but(max_memory=None if mib is None else mib << 20))
    atlases = [share.get("gpu_memory") for share in made]
    assert atlases == [64 << 20, 320 << 20, None, None, None, None]
    assert [share.get("memory") for share in made] == 2 * [64 << 20, 160 << 20, None]
