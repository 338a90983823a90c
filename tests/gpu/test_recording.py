"""Passes recorded directly draw what wgpu-py's own draw, and what is wrong with them is told as an exception."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu import recording
from orograph.gpu.device import Device
from orograph.gpu.recording import Attachments, write
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.viewpoint import View

wgpu = pytest.importorskip("wgpu")
SIZE = 96, 64


def scene() -> Scene:
    y, x = np.mgrid[:90, :120].astype(np.float32)
    z = 40 * np.sin(x / 9) * np.cos(y / 7)
    terrain = in_memory(Dem(z, Grid(z.shape, Affine(10, 0, 5e5, 0, -10, 5e6), CRS.from_epsg(32632))))
    east, north = (float(v) for v in terrain.grid.xy(60, 45))
    view = View((east, north - 900, 700.0), (east, north, 0.0), width=SIZE[0], height=SIZE[1])
    return Scene.of(terrain, view, sky=True, tolerance=1.0)


def drawn(device: Device, method: str) -> list[NDArray[np.uint8]]:
    """Two frames in motion, and a picture of four samples."""
    from dataclasses import replace

    one = scene().but(method=method)
    renderer = Renderer(device, one.terrain, gpu_memory=1 << 26)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    other = one.but(view=replace(one.view, eye=(one.view.eye[0] + 5, *one.view.eye[1:])))
    pictures = []
    for what, options in ((one, {"wait": True}), (other, {}), (one, {"wait": True, "samples": 4})):
        renderer.draw(texture.create_view(), "rgba8unorm", what, **options)
        pictures.append(device.read_texture(texture, np.uint8, 4))
    renderer.close()
    return pictures


@pytest.mark.parametrize("method", ["auto", "raycast"])  # (rays begin with a compute pass)
def test_pictures_are_those_of_plain_passes(device: Device, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    quick = drawn(device, method)
    assert recording._FOUND[0] is not None  # it was recorded directly
    monkeypatch.setattr(recording, "_FOUND", [None])
    plain = drawn(device, method)
    assert max(int(p.std()) for p in plain) > 10
    for a, b in zip(quick, plain, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_mistake_in_a_pass_is_told(device: Device) -> None:
    view = device.texture((8, 8), "rgba8unorm", "RENDER_ATTACHMENT").create_view()
    encoder = device.handle.create_command_encoder()
    pass_ = Attachments([(view, (0.0, 0.0, 0.0, 1.0))]).begin(encoder)
    pass_.draw(3)  # without a pipeline
    with pytest.raises(wgpu.GPUValidationError):
        pass_.end()
        encoder.finish()


@pytest.mark.parametrize("values", [b"\x01\x00\x00\x00\x02\x00\x00\x00", np.array([1, 2], np.uint32)])
def test_buffers_are_written(device: Device, values: bytes | NDArray[np.uint32]) -> None:
    buffer = device.buffer(8, "COPY_SRC")
    write(device, buffer, values)
    np.testing.assert_array_equal(device.read_buffer(buffer, np.uint32), [1, 2])
    with pytest.raises(wgpu.GPUValidationError):
        write(device, buffer, np.zeros(4, np.uint32))
