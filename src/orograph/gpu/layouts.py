"""Entries of bind group layouts, a call each."""

from __future__ import annotations

from typing import Any

from orograph.gpu.device import Device


def stage(names: str) -> int:
    import wgpu

    flags = 0
    for name in names.split("|"):
        flags |= int(getattr(wgpu.ShaderStage, name))
    return flags


def uniform(device: Device, binding: int, stages: str) -> dict[str, Any]:
    return {"binding": binding, "visibility": stage(stages), "buffer": {"type": device.record}}


def storage(binding: int) -> dict[str, Any]:
    return {"binding": binding, "visibility": stage("FRAGMENT"), "buffer": {"type": "read-only-storage"}}


def texture(binding: int, kind: str, dimension: str = "2d") -> dict[str, Any]:
    return {
        "binding": binding, "visibility": stage("FRAGMENT"),
        "texture": {"sample_type": kind, "view_dimension": dimension},
    }  # fmt: skip
