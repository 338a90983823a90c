"""The shader twin of aperture lighting beside the CPU's kernels, on thousands of random caps and lights."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from orograph.gpu.device import Device
from orograph.gpu.program import Group, bindings
from orograph.lighting import aperture, caps
from orograph.lighting.aperture import Lamp, Lights
from orograph.lighting.gpu import aperture as twin
from orograph.lighting.normal import gradient
from orograph.lighting.sun import Sun

pytestmark = pytest.mark.usefixtures("device")
CELL = np.diag([10.0, -10.0])


def on_gpu(device: Device, body: str, inputs: np.ndarray) -> np.ndarray:
    """``body`` is WGSL that makes f32 ``r`` out of ``v: vec4f``; inputs (n, 4)."""
    from orograph.gpu.sources import source

    text = source("aperture") + (
        "@group(0) @binding(0) var<storage, read> given: array<vec4f>;\n"
        "@group(0) @binding(1) var<storage, read_write> made: array<f32>;\n"
        "@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {\n"
        f"if (id.x >= arrayLength(&given)) {{ return; }} let v = given[id.x]; {body} made[id.x] = r; }}"
    )
    group = Group(device, bindings(text))
    module = device.handle.create_shader_module(code=text)
    pipeline = device.handle.create_compute_pipeline(
        layout=device.handle.create_pipeline_layout(bind_group_layouts=[group.layout]),
        compute={"module": module, "entry_point": "main"},
    )
    out = device.buffer(4 * len(inputs), "STORAGE|COPY_SRC")
    bound = group.bind({"given": device.buffer(inputs.astype(np.float32), "STORAGE"), "made": out})
    encoder = device.handle.create_command_encoder()
    work = encoder.begin_compute_pass()
    work.set_pipeline(pipeline)
    work.set_bind_group(0, bound)
    work.dispatch_workgroups(-(-len(inputs) // 64))
    work.end()
    device.queue.submit([encoder.finish()])
    return device.read_buffer(out, np.float32).astype(float)


def test_angles_are_as_good_as_float32(device: Device):
    rng = np.random.default_rng(0)
    v = np.zeros((20000, 4), np.float32)
    v[:, 0] = rng.uniform(-7, 7, len(v))
    v[:, 1] = rng.normal(size=len(v)) * 10.0 ** rng.uniform(-5, 1, len(v))
    w = v.astype(float)
    np.testing.assert_allclose(on_gpu(device, "let r = sine_cosine(v.x).x;", v), np.sin(w[:, 0]), atol=3e-7)
    np.testing.assert_allclose(on_gpu(device, "let r = sine_cosine(v.x).y;", v), np.cos(w[:, 0]), atol=3e-7)
    np.testing.assert_allclose(
        on_gpu(device, "let r = angle_of(v.y, v.x);", v), np.arctan2(w[:, 1], w[:, 0]), rtol=3e-7, atol=3e-7
    )


def test_overlaps_of_caps(device: Device):
    """All three cases; an error of 1e-5 of the smaller cap for radii over a degree, and 4e-5 down to the sun's."""
    rng = np.random.default_rng(1)
    n = 20000
    a, b = rng.uniform(0.02, math.pi / 2, (2, n))
    b[: n // 2] = np.exp(rng.uniform(math.log(0.0046), math.log(0.3), n // 2))
    d = np.abs(a - b) + (a + b - np.abs(a - b)) * rng.uniform(-0.3, 1.3, n)
    v = np.stack([np.clip(d, 0, 3.1), a, b, 0 * a], axis=1).astype(np.float32)
    w = v.astype(float)
    smaller = np.array([caps.cap_area(min(x, y)) for _, x, y, _ in w])
    assert ((d < np.abs(a - b)).sum() > 1000) and (d > a + b).sum() > 1000
    for name in ("smooth_overlap", "exact_overlap"):
        got = on_gpu(device, f"let r = {name}(v.x, v.y, v.z);", v)
        expected = np.array([getattr(caps, name)(*row[:3]) for row in w])
        error = np.abs(got - expected) / smaller
        wide = np.minimum(w[:, 1], w[:, 2]) > 0.0175
        assert error[wide].max() < 1e-5 and error.max() < 4e-5, (name, error[wide].max(), error.max())
    areas = on_gpu(device, "let r = cap_area(v.z);", v)
    np.testing.assert_allclose(areas, [caps.cap_area(x) for x in w[:, 2]], rtol=1e-6)


def test_caps_in_two_words():
    rng = np.random.default_rng(4)
    some = rng.uniform(-1, 1, (5000, 4)).astype(np.float32)
    some[:, 2:] = np.abs(some[:, 2:])
    some[:3] = [[0, 0, 1, 0], [-1, 1, 0, 1], [1, -1, 0, 0]]
    words = twin.packed(some)
    # A driver may change what is no normal number.
    assert words.shape == (10_000,) and np.isfinite(words).all() and (np.abs(words) >= np.finfo(np.float32).tiny).all()
    bits = words.view(np.int32).reshape(-1, 2)  # as ``packed_pair`` of shade.wgsl does it
    low, high = (bits << 16 >> 16) / 32767, ((bits >> 16) - 128) / 32384
    np.testing.assert_allclose(np.stack([low, high], -1).reshape(-1, 4)[:, [0, 2, 1, 3]], some, atol=1.6e-5)
    np.testing.assert_array_equal(
        twin.packed(np.array([[9, -9, -9, 9]], np.float32)), twin.packed(np.array([[1, -1, 0, 1]], np.float32))
    )


def field_and_points(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    field = np.zeros((40, 50, 4), np.float32)
    axes = rng.normal(size=(40, 50, 3)) * 0.5 + [0, 0, 1]
    field[..., :3] = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    field[..., 3] = np.cos(rng.uniform(0.1, math.pi / 2, (40, 50)))
    field[5:8, 5:8] = np.nan
    # On samples, and between them.
    points = np.column_stack([rng.integers(0, 50, n), rng.integers(0, 40, n), rng.uniform(0, 500, n)]).astype(float)
    points[n // 2 :, :2] += rng.uniform(0, 0.5, (n - n // 2, 2))
    return field, points, rng.normal(size=(n, 2)) * 0.5


@pytest.mark.cases(1)
@pytest.mark.parametrize("exact", [False, True])
def test_several_lights_through_random_caps(exact: bool):
    rng = np.random.default_rng(2)
    field, points, gradient = field_and_points(rng, 6000)
    points[7] = np.nan
    lights = Lights(
        suns=[
            (Sun(300, 15, 30.0), (1.0, 0.9, 0.8)),
            (Sun(120, 40, 10.0), (0.3, 0.4, 0.5)),
            (Sun(200, 70, 4.0), (0.2, 0.2, 0.1)),
        ],
        lamps=[Lamp(12, 30, 900.0, (2e5, 1e5, 0)), Lamp(45, 3, 1500.0, (0, 1e5, 9e4))],
        ambient=(0.2, 0.3, 0.4),
    )
    caps = aperture.CapField(field, CELL)
    expected = aperture.light(caps, points, gradient, lights, exact=exact)
    got = twin.light(caps, points, gradient, lights, exact=exact)
    assert np.isnan(got[7]).all() and np.isnan(expected[7]).all()
    # A cap with a missing corner is open sky on the CPU; the twin mixes what corners there are.
    whole = ~np.isnan(got[:, 0]) & ~((np.abs(points[:, 0] - 6) < 2.5) & (np.abs(points[:, 1] - 6) < 2.5))
    error = np.abs(got - expected)[whole]
    # A lamp on a cap's rim is seen or not: float32 may decide otherwise for a point in a million of such.
    flipped = error.max(axis=1) > 5e-3
    assert flipped.sum() <= 2
    assert error[~flipped].max() < 2e-5 and error[~flipped].mean() < 1e-6


def test_the_true_sun_in_its_penumbra():
    """0.53° wide: half of the points have a cap whose rim cuts the disc."""
    rng = np.random.default_rng(3)
    n = 3000
    sun = Sun(135, 30)
    direction = np.asarray(sun.direction)
    field = np.zeros((1, n, 4), np.float32)
    axes = rng.normal(size=(n, 3)) * 0.4 + [0, 0, 1]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    radius = np.arccos(axes @ direction) + rng.uniform(-0.01, 0.01, n)
    keep = (radius > 0.1) & (radius < math.pi / 2)
    field[0, :, :3], field[0, :, 3] = axes, np.cos(np.clip(radius, 0.1, math.pi / 2))
    points = np.column_stack([np.arange(n), np.zeros(n), np.zeros(n)]).astype(float)
    gradient = rng.normal(size=(n, 2)) * 0.3
    caps = aperture.CapField(field, CELL)
    for exact in (False, True):
        lights = Lights(suns=[(sun, (1.0, 1.0, 1.0))])
        expected = aperture.light(caps, points, gradient, lights, exact=exact)[keep]
        got = twin.light(caps, points, gradient, lights, exact=exact)[keep]
        assert ((expected > 0.01) & (expected < 0.5)).mean() > 0.2
        assert np.abs(got - expected).max() < 6e-5 and np.abs(got - expected).mean() < 5e-6


@pytest.mark.parametrize("exact", [False, True])
def test_moving_lights_on_real_ground(shared_data: Path, exact: bool) -> None:
    """Suns contained by caps, cut by their rims and hidden; lamps inside and outside; the sky less what discs cover:
    through the caps of mountains, in eight moments."""
    import rasterio

    with rasterio.open(next((shared_data / "bigtujunga-srtm30m-utm").glob("*.tif"))) as file:
        h, t = file.read(1, window=((200, 328), (300, 428))).astype(np.float32), file.transform
    linear = np.array([[t.a, t.b], [t.d, t.e]])
    caps = aperture.aperture(h, linear, azimuths=32)
    field = aperture.CapField.of(caps, linear)
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(1, 126, (4000, 2)), np.zeros(4000)])
    gx, gy = gradient(h, linear, 1)
    at = np.rint(points[:, [1, 0]]).astype(int)
    points[:, 2] = h[at[:, 0], at[:, 1]]
    slopes = np.stack([gx, gy], -1)[at[:, 0], at[:, 1]].astype(float)
    kinds = np.zeros(3, int)
    for moment in range(8):
        suns = [
            (Sun(40.0 * moment, 3.0 + 9 * moment), (1.0, 0.9, 0.8)),
            (Sun(300 - 25.0 * moment, 40 - 5.0 * moment, 12.0), (0.3, 0.4, 0.5)),
            (Sun(90, 80 - 10.0 * moment, 80.0), (0.1, 0.2, 0.3)),
        ]
        lamps = [
            Lamp(20 + 12.0 * moment, 64, 1800.0, (2e5, 1e5, 0)),
            Lamp(64, 120 - 10.0 * moment, 1200.0, (0, 9e4, 9e4)),
        ]
        lights = Lights(suns=suns, lamps=lamps, ambient=(0.2, 0.3, 0.4))
        expected = aperture.light(field, points, slopes, lights, exact=exact)
        got = twin.light(field, points, slopes, lights, exact=exact)
        error = np.abs(got - expected).max(axis=1)
        flipped = error > 5e-3  # a lamp on a cap's rim
        assert flipped.sum() <= 1 and error[~flipped].max() < 6e-5 and error[~flipped].mean() < 3e-6
        # Without a kind of light both lack it: what discs cover of the sky is the sky's.
        dark = [f(field, points, slopes, Lights(suns=suns), exact=exact) for f in (aperture.light, twin.light)]
        assert np.abs(dark[0] - dark[1]).max() < 6e-5
        covered = [
            f(
                field,
                points,
                slopes,
                Lights(suns=[(s, (0.0, 0.0, 0.0)) for s, _ in suns], ambient=(1, 1, 1)),
                exact=exact,
            )
            for f in (aperture.light, twin.light)
        ]
        open_sky = aperture.light(field, points, slopes, Lights(ambient=(1, 1, 1)), exact=exact)
        assert np.abs(covered[0] - covered[1]).max() < 6e-5 and (covered[0] <= open_sky + 1e-6).all()
        assert (open_sky - covered[0]).max() > 0.1
        axes, radii = caps[:3, at[:, 0], at[:, 1]], np.radians(caps[3, at[:, 0], at[:, 1]])
        for sun, _ in suns:
            d, b = np.arccos(np.clip(np.asarray(sun.direction) @ axes, -1, 1)), np.radians(sun.diameter / 2)
            whole, none = d <= np.abs(radii - b), d >= radii + b
            kinds += [whole.sum(), none.sum(), (~whole & ~none).sum()]
    assert (kinds > 1000).all(), kinds
