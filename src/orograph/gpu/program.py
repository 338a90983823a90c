"""Shaders with their bindings, which are derived from the shader's text.

WGSL names a variable for every resource: ``@group(1) @binding(4) var<storage, read> pages: array<u32>;``. These lines
determine the layouts that WebGPU needs, and resources are given by the variables' names. Details that the types leave
open follow WebGPU's own ``layout: "auto"``: a float texture is filterable if it is sampled with a sampler anywhere in
the text. Unlike automatic layouts, equal ones are the same object, so that pipelines share bind groups; resources are
visible to all stages of the shader. A uniform whose line ends with ``// dynamic`` holds records, of which each draw
sees one.

``Binding.entry`` is a ``GPUBindGroupLayoutEntry`` in its JSON form, so a web page can use the same shaders with the
same bindings.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

from orograph.gpu.device import Device
from orograph.gpu.sources import source

_DECLARED = re.compile(
    r"^ *@group\((\d+)\) *@binding\((\d+)\) *var *(?:<([^>]*)>)? +(\w+) *: *([^;]+);(.*)$", re.MULTILINE
)
_SAMPLED = re.compile(r"\btextureSample\w*\( *(\w+)")
_STAGES = {"VERTEX": 1, "FRAGMENT": 2, "COMPUTE": 4}
"""WebGPU's ``GPUShaderStage``."""
_DIMENSIONS = {"2d": "2d", "2d_array": "2d-array", "3d": "3d"}
_SCALARS = {"f32": "float", "u32": "uint", "i32": "sint"}


@dataclass(frozen=True, slots=True)
class Binding:
    """A resource that a shader declares.

    Attributes:
        group, index, name: ``@group(group) @binding(index) var name``.
        entry: WebGPU's description of it (``GPUBindGroupLayoutEntry``), with WebGPU's names.
    """

    group: int
    index: int
    name: str
    entry: dict[str, Any] = field(hash=False)


def bindings(text: str) -> tuple[Binding, ...]:
    """The resources that the text of a shader declares, by group and index.

    Args:
        text: WGSL from ``sources.source``, with includes and constants.

    Raises:
        ValueError: a type that is not known here, or two variables at one place.
    """
    code = re.sub(r"//(?! *dynamic\b).*", "", text)
    sampled = set(_SAMPLED.findall(code))
    seen = sum(bit for stage, bit in _STAGES.items() if re.search(rf"@{stage.lower()}\b", code))
    found = []
    for group, index, space, name, of, rest in _DECLARED.findall(code):
        kind = _kind(space, of.strip(), name in sampled, dynamic="dynamic" in rest)
        # Vertex stages may not write.
        written = kind.get("buffer") == {"type": "storage"} or "storageTexture" in kind
        visible = seen & ~_STAGES["VERTEX"] if written else seen
        entry = {"binding": int(index), "visibility": visible, **kind}
        found.append(Binding(int(group), int(index), name, entry))
    found.sort(key=lambda one: (one.group, one.index))
    for one, other in itertools.pairwise(found):
        if (one.group, one.index) == (other.group, other.index):
            raise ValueError(f"`{one.name}` and `{other.name}` are both binding {one.index} of group {one.group}.")
    return tuple(found)


def _kind(space: str, of: str, sampled: bool, *, dynamic: bool) -> dict[str, Any]:
    """The part of an entry that describes the kind of resource, from the words of its declaration."""
    words = space.replace(" ", "")
    if words == "uniform":
        return {"buffer": {"type": "uniform", "hasDynamicOffset": dynamic}}
    if words.startswith("storage"):
        return {"buffer": {"type": "storage" if words.endswith("read_write") else "read-only-storage"}}
    if of == "sampler":
        return {"sampler": {"type": "filtering"}}
    if of == "texture_depth_2d":
        return {"texture": {"sampleType": "depth", "viewDimension": "2d"}}
    storage = re.fullmatch(r"texture_storage_(\w+)<(\w+), *write>", of)
    if storage:
        dimension, format = _DIMENSIONS[storage[1]], storage[2]
        return {"storageTexture": {"access": "write-only", "format": format, "viewDimension": dimension}}
    texture = re.fullmatch(r"texture_(\w+)<(\w+)>", of)
    if texture is None or texture[1] not in _DIMENSIONS:
        raise ValueError(f"A binding cannot be of type {of!r}.")
    scalar = _SCALARS[texture[2]]
    if scalar == "float" and not sampled:
        scalar = "unfilterable-float"
    return {"texture": {"sampleType": scalar, "viewDimension": _DIMENSIONS[texture[1]]}}


class Group:
    """The layout of one group of a shader's resources.

    Attributes:
        bindings: of the group, by index. layout: wgpu's object; groups with equal bindings have the same.
    """

    def __init__(self, device: Device, declared: tuple[Binding, ...]) -> None:
        self.device, self.bindings = device, declared
        self.layout = device.group_layout([one.entry for one in declared])

    def bind(self, resources: Mapping[str, Any], sizes: Mapping[str, int] | None = None) -> Any:
        """A bind group of buffers, textures (or their views) and samplers, by the names of the shader's variables.

        Args:
            sizes: visible bytes of a buffer; for a dynamic uniform, those of one record.

        Raises:
            KeyError: a resource is missing, or there is no variable of its name.
        """
        unknown = resources.keys() - {one.name for one in self.bindings}
        if unknown:
            raise KeyError(f"The shader has no {', '.join(sorted(unknown))}.")
        entries = []
        for one in self.bindings:
            bound = resources[one.name]
            if "buffer" in one.entry:
                bound = {"buffer": bound, "offset": 0, "size": (sizes or {}).get(one.name, bound.size)}
            elif hasattr(bound, "create_view"):
                seen = one.entry.get("texture") or one.entry["storageTexture"]
                bound = bound.create_view(dimension=seen["viewDimension"])
            entries.append({"binding": one.index, "resource": bound})
        return self.device.handle.create_bind_group(layout=self.layout, entries=entries)


@lru_cache(256)
def _declared(name: str, constants: tuple[tuple[str, int | float], ...]) -> tuple[Binding, ...]:
    return bindings(source(name, dict(constants)))


class Program:
    """A shader on a device: its groups are known at once, and it is compiled when its module is first used.

    Args:
        name: ``shaders/NAME.wgsl``. constants: values for ``{{NAME}}`` in its text.

    Attributes:
        groups: the layouts of its groups, by number.
    """

    def __init__(self, device: Device, name: str, **constants: int | float) -> None:
        self.device, self.name, self.constants = device, name, constants
        declared = _declared(name, tuple(constants.items()))
        count = 1 + max((one.group for one in declared), default=-1)
        self.groups = tuple(
            Group(device, tuple(one for one in declared if one.group == number)) for number in range(count)
        )

    @property
    def module(self) -> Any:
        """wgpu's compiled module, one for the device."""
        return self.device.shader(self.name, self.constants)

    @cached_property
    def layout(self) -> Any:
        """The pipeline layout."""
        return self.device.handle.create_pipeline_layout(bind_group_layouts=[group.layout for group in self.groups])

    def bind(self, resources: Mapping[str, Any], group: int = 0, sizes: Mapping[str, int] | None = None) -> Any:
        """A bind group of one of its groups: see ``Group.bind``."""
        return self.groups[group].bind(resources, sizes)

    def compute(self, entry: str = "main") -> Any:
        """A compute pipeline."""
        return self.device.handle.create_compute_pipeline(
            label=f"{self.name}.{entry}", layout=self.layout,
            compute={"module": self.module, "entry_point": entry},
        )  # fmt: skip

    def draw(
        self, targets: list[dict[str, Any]], *, vertex: str = "vertex", fragment: str = "fragment",
        buffers: list[dict[str, Any]] | None = None, primitive: dict[str, Any] | None = None,
        depth: dict[str, Any] | None = None,
    ) -> Any:  # fmt: skip
        """A render pipeline.

        Args:
            targets: to draw into (``GPUColorTargetState``). vertex, fragment: the entry points.
            buffers: of vertices. primitive: if not triangles without culling.
            depth: ``GPUDepthStencilState``.
        """
        return self.device.handle.create_render_pipeline(
            label=f"{self.name}.{fragment}", layout=self.layout,
            vertex={"module": self.module, "entry_point": vertex, "buffers": buffers or []},
            primitive={"topology": "triangle-list", "cull_mode": "none", **(primitive or {})},
            depth_stencil=depth,
            fragment={"module": self.module, "entry_point": fragment, "targets": targets},
        )  # fmt: skip
