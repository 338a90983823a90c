"""Bind groups in a line each: wgpu wants a layout, a pipeline layout and a group for every set of resources.

A layout is written as words, one per binding: ``uniform``, ``uniform+dynamic``, ``read`` and ``write`` (storage
buffers), ``texture`` and ``texture3d`` (filterable floats), ``depth`` and ``depths`` (an unfilterable float texture, an
array of them), ``sampler``, ``out:FORMAT`` (a storage texture to write).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orograph.gpu.device import Device


@dataclass(frozen=True, slots=True)
class Layout:
    """A bind group layout and the pipeline layout that has it as its only group.

    Attributes:
        group, pipeline: wgpu's objects. words: what each binding is.
    """

    group: Any
    pipeline: Any
    words: tuple[str, ...]


def layout(device: Device, *words: str, stages: str = "COMPUTE") -> Layout:
    """A layout of bindings 0, 1, … described by words (see the module), seen by ``stages`` (joined by ``|``).

    Raises:
        ValueError: a word that means nothing.
    """
    import wgpu

    seen = 0
    for stage in stages.split("|"):
        seen |= getattr(wgpu.ShaderStage, stage)
    entries = []
    for index, word in enumerate(words):
        kind: dict[str, Any]
        visible = seen
        if word.startswith("uniform"):
            kind = {"buffer": {"type": device.record, "has_dynamic_offset": word.endswith("+dynamic")}}
        elif word == "read":
            kind = {"buffer": {"type": "read-only-storage"}}
        elif word == "write":
            kind = {"buffer": {"type": "storage"}}
            visible &= ~wgpu.ShaderStage.VERTEX  # which may not write
        elif word in ("texture", "texture3d"):
            kind = {"texture": {"sample_type": "float", "view_dimension": "3d" if word.endswith("3d") else "2d"}}
        elif word == "depth":
            kind = {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d"}}
        elif word == "depths":
            kind = {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d-array"}}
        elif word == "sampler":
            kind = {"sampler": {"type": "filtering"}}
        elif word.startswith("out:"):
            texture, dimension = word[4:].removesuffix("/3d"), "3d" if word.endswith("/3d") else "2d"
            kind = {"storage_texture": {"access": "write-only", "format": texture, "view_dimension": dimension}}
        else:
            raise ValueError(f"A binding cannot be {word!r}.")
        entries.append({"binding": index, "visibility": visible, **kind})
    group = device.handle.create_bind_group_layout(entries=entries)
    return Layout(group, device.handle.create_pipeline_layout(bind_group_layouts=[group]), words)


def bind(device: Device, to: Layout, *resources: Any, sizes: dict[int, int] | None = None) -> Any:
    """A bind group of buffers, textures (or their views) and samplers, in the layout's order.

    Args:
        sizes: bytes of a buffer that are seen, by binding: of a dynamic uniform, those of one of its records.
    """
    entries = []
    for index, (word, resource) in enumerate(zip(to.words, resources, strict=True)):
        bound = resource
        if word.startswith(("uniform", "read", "write")):
            bound = {"buffer": resource, "offset": 0, "size": (sizes or {}).get(index, resource.size)}
        elif hasattr(resource, "create_view"):
            bound = resource.create_view()
        entries.append({"binding": index, "resource": bound})
    return device.handle.create_bind_group(layout=to.group, entries=entries)


def compute(
    device: Device, to: Layout, shader: str, entry: str = "main", *, beside: Layout | None = None,
    **constants: int | float,
) -> Any:  # fmt: skip
    """A compute pipeline: the entry point of ``shaders/SHADER.wgsl``; ``beside``: the layout of its group 1."""
    pipeline = to.pipeline
    if beside is not None:
        pipeline = device.handle.create_pipeline_layout(bind_group_layouts=[to.group, beside.group])
    return device.handle.create_compute_pipeline(
        label=f"{shader}.{entry}",
        layout=pipeline,
        compute={"module": device.shader(shader, constants), "entry_point": entry},
    )
