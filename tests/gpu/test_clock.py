"""The GPU's own clock: it runs with the work, and not beyond the wall's."""

from __future__ import annotations

import time

import numpy as np
import pytest

from orograph.gpu.clock import Clock
from orograph.gpu.device import Device

CODE = """@group(0) @binding(0) var<storage, read_write> a: array<f32>;
@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) i: vec3<u32>) {
  var x = a[i.x];
  for (var k = 0u; k < LOOPSu; k++) { x = sin(x) + 0.5; }
  a[i.x] = x;
}"""


def measured(device: Device, loops: int) -> tuple[float, float]:
    """Seconds by the GPU's clock, and by the wall's."""
    clock = Clock(device)
    if not clock.works:
        pytest.skip(f"{device.adapter.name} tells no time")
    module = device.handle.create_shader_module(code=CODE.replace("LOOPS", str(loops)))
    pipeline = device.handle.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "main"})
    buffer = device.buffer(np.zeros(1 << 14, np.float32), "STORAGE")
    group = device.handle.create_bind_group(
        layout=pipeline.get_bind_group_layout(0), entries=[{"binding": 0, "resource": {"buffer": buffer}}]
    )
    found, wall = [], []
    for _ in range(3):
        device.wait()
        begun = time.perf_counter()
        clock.begin()
        encoder = device.handle.create_command_encoder()
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(pipeline)
        pass_.set_bind_group(0, group)
        pass_.dispatch_workgroups((1 << 14) // 64)
        pass_.end()
        device.queue.submit([encoder.finish()])
        clock.end()
        found.append(clock.seconds())
        wall.append(time.perf_counter() - begun)
    return min(s for s in found if s is not None), min(wall)


def test_more_work_takes_longer_and_no_longer_than_the_wall_says(device: Device) -> None:
    little, _ = measured(device, 10)
    much, wall = measured(device, 4000 if device.adapter.software else 1_000_000)
    assert 0 < little < much <= wall
    assert much > 5 * little


def test_without_the_feature_there_is_no_time(device: Device) -> None:
    bare = Device(device.adapter, device.handle, frozenset())
    clock = Clock(bare)  # as on an adapter that lacks it
    clock.begin()
    clock.end()
    assert not clock.works and clock.seconds() is None
