"""Devices: what they say, and that what is written to them comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orograph.gpu import device as gpu
from orograph.gpu.device import Adapter, Device, DeviceLimitError, NoAdapterError
from orograph.lighting.occlusion import ambient_occlusion


def test_there_is_one_device_for_the_process(device: Device) -> None:
    assert gpu.open_device() is device
    assert device.adapter.backend in gpu.BACKENDS


def test_textures_come_back(device: Device) -> None:
    values = np.random.default_rng(1).integers(0, 255, (7, 10, 4), dtype=np.uint8)
    texture = device.texture((10, 7), "rgba8unorm", "COPY_SRC|COPY_DST")
    device.queue.write_texture({"texture": texture}, values, {"bytes_per_row": 40}, (10, 7, 1))
    np.testing.assert_array_equal(device.read_texture(texture, np.uint8, 4), values)


def test_layers_come_back(device: Device) -> None:
    values = np.random.default_rng(2).normal(size=(3, 5, 6)).astype(np.float32)
    texture = device.texture((6, 5, 3), "r32float", "COPY_SRC|COPY_DST")
    device.queue.write_texture({"texture": texture}, values, {"bytes_per_row": 24, "rows_per_image": 5}, (6, 5, 3))
    for layer in range(3):
        np.testing.assert_array_equal(device.read_texture(texture, np.float32, 1, layer=layer)[..., 0], values[layer])


def test_a_shader_computes(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "@group(0) @binding(0) var<storage, read_write> a: array<f32>;\n@compute @workgroup_size({{N}})\n"
    text += "fn main(@builtin(global_invocation_id) i: vec3<u32>) { a[i.x] = sqrt(a[i.x]); }"
    values = np.arange(64, dtype=np.float32)
    buffer = device.buffer(values, "STORAGE|COPY_SRC")
    module = device.handle.create_shader_module(code=text.replace("{{N}}", "64"))
    pipeline = device.handle.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
    group = device.handle.create_bind_group(
        layout=pipeline.get_bind_group_layout(0), entries=[{"binding": 0, "resource": {"buffer": buffer}}]
    )
    encoder = device.handle.create_command_encoder()
    pass_ = encoder.begin_compute_pass()
    pass_.set_pipeline(pipeline)
    pass_.set_bind_group(0, group)
    pass_.dispatch_workgroups(1)
    pass_.end()
    device.queue.submit([encoder.finish()])
    device.wait()
    np.testing.assert_allclose(device.read_buffer(buffer, np.float32), np.sqrt(values), rtol=1e-6)


class Small:
    """A device's handle with limits of its own."""

    def __init__(self, handle: Any, **limits: int) -> None:
        self._handle = handle
        self.limits = {**handle.limits, **{name.replace("_", "-"): most for name, most in limits.items()}}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._handle, name)


def test_what_is_too_large_is_told_with_the_remedy(device: Device) -> None:
    limits = {"max_storage_buffer_binding_size": 4096, "max_texture_dimension_2d": 256, "max_texture_array_layers": 8}
    small = replace(device, handle=Small(device.handle, **limits, max_texture_dimension_3d=64))
    assert small.buffer(4096, "STORAGE").size == 4096 and small.buffer(1 << 20, "VERTEX").size == 1 << 20
    with pytest.raises(DeviceLimitError, match=r"heights takes 1 MiB.*smaller picture"):
        small.buffer(np.zeros(1 << 18, np.float32), "STORAGE", "heights")
    with pytest.raises(DeviceLimitError, match="Walk"):
        small.buffer(device.limit("max-buffer-size") + 4, "COPY_SRC", remedy="Walk.")
    for size, dimension in (((257, 4), "2d"), ((4, 4, 9), "2d"), ((4, 4, 65), "3d")):
        with pytest.raises(DeviceLimitError, match="× 4"):
            small.texture(size, "rgba8unorm", "TEXTURE_BINDING", dimension=dimension)  # type: ignore[arg-type]
    assert small.texture((256, 4, 8), "rgba8unorm", "TEXTURE_BINDING").size == (256, 4, 8)


def test_a_device_out_of_memory_is_told(device: Device) -> None:
    import wgpu

    def full(**how: Any) -> None:
        raise wgpu.GPUOutOfMemoryError("Not enough memory left.")

    handle = Small(device.handle)
    handle.create_buffer = handle.create_texture = full  # type: ignore[attr-defined]
    small = replace(device, handle=handle)
    with pytest.raises(DeviceLimitError, match="no 3 MiB of memory left for maps"):
        small.buffer(3 << 20, "STORAGE", "maps")
    with pytest.raises(DeviceLimitError, match="memory left"):
        small.texture((64, 64), "rgba8unorm", "TEXTURE_BINDING")


def _offers(monkeypatch: pytest.MonkeyPatch, *offered: tuple[str, str, str]) -> None:
    found = [Adapter(n, k, b, "", b in gpu.BACKENDS, None) for n, k, b in offered]
    monkeypatch.setattr(gpu, "adapters", lambda: found)


def test_opengl_is_never_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OROGRAPH_ADAPTER", raising=False)
    _offers(monkeypatch, ("Fast", "DiscreteGPU", "OpenGL"))
    with pytest.raises(NoAdapterError, match=r"Fast \(OpenGL\).*mesa-vulkan-drivers"):
        gpu.choose()


def test_an_adapter_is_chosen_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OROGRAPH_ADAPTER", raising=False)
    _offers(monkeypatch, ("Big One", "DiscreteGPU", "Vulkan"), ("llvmpipe", "CPU", "Vulkan"))
    assert gpu.choose().name == "Big One"
    assert gpu.choose("software").name == "llvmpipe"
    assert gpu.choose("big").name == "Big One"
    monkeypatch.setenv("OROGRAPH_ADAPTER", "llvm")
    assert gpu.choose().name == "llvmpipe"
    with pytest.raises(NoAdapterError, match="named 'none'"):
        gpu.choose("none")


def test_records_that_change_compile_nothing_anew(device: Device) -> None:
    """Lavapipe makes shaders of uniforms' values, and keeps them: software is given storage instead."""
    if not device.adapter.software or not Path("/proc/self/maps").exists():
        pytest.skip("of software renderers on Linux")

    def compiled() -> int:
        maps = [line.split() for line in Path("/proc/self/maps").read_text().splitlines()]
        return sum("x" in fields[1] and len(fields) == 5 for fields in maps)  # executable, of no file

    heights = np.random.default_rng(3).normal(0, 20, (24, 24)).astype(np.float32)
    linear = np.diag([10.0, -10.0])
    ambient_occlusion(heights, linear, method="shadow-maps", rays=4)
    before = compiled()
    ambient_occlusion(heights, linear, method="shadow-maps", rays=64)
    assert compiled() - before < 10
