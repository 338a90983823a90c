"""Layouts come out of the shaders' own text, and are those that WebGPU would find."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

from orograph.gpu.device import Device
from orograph.gpu.program import Program, bindings
from orograph.gpu.sources import source

DOUBLE = """
@group(0) @binding(1) var<storage, read_write> made: array<f32>;  // dynamic, this is not: it is no uniform
@group(0) @binding(0) var<storage, read> given: array<f32>;
// @group(0) @binding(2) var<uniform> old: f32;
"""
EVERYTHING = """
@group(0) @binding(0) var<uniform> frame: Frame;  // dynamic
@group(0) @binding(1) var <storage,read> given: array<f32>;
@group(1) @binding(0) var fine: texture_2d<f32>;  // textureSample(fine, …) is not done
@group(1) @binding(1) var smooth_: texture_2d_array<f32>;
@group(1) @binding(2) var block: texture_3d<f32>;
@group(1) @binding(3) var marks: texture_2d<u32>;
@group(1) @binding(4) var depths: texture_depth_2d;
@group(1) @binding(5) var filtering: sampler;
@group(1) @binding(6) var out: texture_storage_3d<rgba8unorm, write>;
@fragment fn fragment() { textureSampleLevel( smooth_, filtering, p, 0.0); }
@vertex fn vertex() {}
"""
# The shaders that are included by others and have no entry of their own.
PARTS = {
    "angles", "aperture", "camera", "cbt_node", "chunk_heights", "contours", "drawn", "faces", "field", "ground_light",
    "imagery", "lines", "place", "ray_field", "rays", "rho", "runs", "sky", "slopes", "synthesis_plane",
}  # fmt: skip


def test_order_and_what_is_commented_out() -> None:
    found = bindings(DOUBLE)
    assert [(one.index, one.name) for one in found] == [(0, "given"), (1, "made")]
    assert [one.entry["buffer"] for one in found] == [{"type": "read-only-storage"}, {"type": "storage"}]


def test_every_type() -> None:
    found = {one.name: one.entry for one in bindings(EVERYTHING)}
    assert found["frame"] == {
        "binding": 0, "visibility": 3, "buffer": {"type": "uniform", "hasDynamicOffset": True},
    }  # fmt: skip
    assert found["given"]["buffer"] == {"type": "read-only-storage"}
    assert found["fine"]["texture"] == {"sampleType": "unfilterable-float", "viewDimension": "2d"}
    assert found["smooth_"]["texture"] == {"sampleType": "float", "viewDimension": "2d-array"}
    assert found["block"]["texture"] == {"sampleType": "unfilterable-float", "viewDimension": "3d"}
    assert found["marks"]["texture"]["sampleType"] == "uint"
    assert found["depths"]["texture"]["sampleType"] == "depth"
    assert found["filtering"]["sampler"] == {"type": "filtering"}
    assert found["out"]["storageTexture"]["format"] == "rgba8unorm"
    assert json.loads(json.dumps(found)) == found  # a page gets it as JSON


def test_what_is_wrong_is_told() -> None:
    with pytest.raises(ValueError, match="both binding 0 of group 0"):
        bindings(DOUBLE.replace("binding(1)", "binding(0)"))
    with pytest.raises(ValueError, match="texture_cube"):
        bindings("@group(0) @binding(0) var sky: texture_cube<f32>;")


def test_binding_by_name(device: Device) -> None:
    program = Program(device, "resolve")
    nothing = device.texture((1, 1), "rgba8unorm", "TEXTURE_BINDING")
    uniform = device.buffer(np.zeros(4, np.uint32), "UNIFORM")
    assert program.bind({"resolve": uniform, "light": nothing, "open": nothing.create_view()})
    with pytest.raises(KeyError, match="open"):
        program.bind({"resolve": uniform, "light": nothing})
    with pytest.raises(KeyError, match="dark"):
        program.bind({"resolve": uniform, "light": nothing, "open": nothing, "dark": nothing})


def test_equal_groups_are_shared(device: Device) -> None:
    one, other = (
        Program(device, "patches", EDGES=0, STORED=0, MISSING=0),
        Program(device, "temporal_antialiasing", COMPUTED=0),
    )
    assert one.groups[0].layout is other.groups[0].layout  # the camera's
    assert one.groups[1].layout is not other.groups[1].layout


def whole() -> list[str]:
    names = (entry.name for entry in files("orograph.gpu").joinpath("shaders").iterdir())
    return sorted({name.removesuffix(".wgsl") for name in names} - PARTS)


@pytest.mark.parametrize("name", whole())
def test_every_shader_compiles_with_the_bindings_it_declares(device: Device, name: str) -> None:
    constants = {
        "FLAGS": 0, "RAYS": 1, "RAY_GROUP": {"shade": 2}.get(name, 0), "MISSING": 0, "EDGES": 1, "STORED": 1, "N": 8,
        "WORDS": 1024, "SIDE": 1 if name == "surface_rays" else 16, "BEAM": 16, "SPACING": 4, "COUNTED": 1,
        "BILINEAR": 0, "CONSTANT": 0, "FRACTAL": 1, "BLOCK": 16, "PARTS": 4, "PART": 0.01, "BRIGHT": 0.1, "PLAN": 0,
        "BREAKS": 1, "THREADS": 64, "OUT_GROUP": 3, "COMPUTED": 1, "SLOPED": 1,
        "ONES": 8, "RAW": 20, "DEPTH": 48, "MET": 192,
    }  # fmt: skip
    program = Program(device, name, **constants)
    assert program.groups and program.layout and program.module
    assert all(group.bindings for group in program.groups)


@pytest.mark.parametrize("computed", [0, 1])
@pytest.mark.parametrize("sloped", [0, 1])
def test_conditions_inside_others(computed: int, sloped: int) -> None:
    """Without slopes no ray asks for one; of two ways to draw, a shader has one."""
    text = source("surface_rays", {"COMPUTED": computed, "SLOPED": sloped})
    assert "when:" not in text and "unless:" not in text
    assert ("@compute" in text) == bool(computed) and text.count("fn fragment(") == 1
    assert ("slope = slope_at(" in text) == bool(computed and sloped)
