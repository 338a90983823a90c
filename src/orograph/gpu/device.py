"""A GPU device that gives correct results, and the basics that every pass needs: shaders, buffers, reading back.

Only Vulkan, Metal and Direct3D 12 are used: on some drivers, wgpu's OpenGL backend computes wrong results without an
error. ``OROGRAPH_ADAPTER`` (a part of an adapter's name, or ``software``) chooses among several; by default, discrete
GPUs come before integrated ones, and these before software renderers (Mesa's lavapipe, WARP).

Some helpers of wgpu-py 0.32 fail (such as waiting for submitted work); ``Device.wait`` and ``Device.read_texture``
replace them.
"""

from __future__ import annotations

import math
import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.folders import temporary
from orograph.gpu.ctypes_quick import quicken_wgpu
from orograph.gpu.sources import source

BACKENDS = ("Vulkan", "Metal", "D3D12")
"""The backends that give correct results."""

OPTIONAL = (
    "float32-filterable",
    "timestamp-query",
    "texture-format-16bit-norm",
    "polygon-mode-line",
    "rg11b10ufloat-renderable",
)
"""Optional features, used if an adapter has them."""

WANTED = (
    ("max-buffer-size", 1 << 31),
    ("max-storage-buffer-binding-size", 1 << 30),
    ("max-texture-dimension-2d", 16384),
    ("max-texture-array-layers", 2048),
    ("max-storage-buffers-per-shader-stage", 16),  # on software, where uniforms are storage buffers (``Device.record``)
)
"""Limits that are raised to this if the adapter allows it, for larger and finer pictures; none is required."""

WRITTEN = 1 << 20
"""Bytes from which a buffer is written after its creation: wgpu-py fills smaller ones in Python, holding the
interpreter lock."""

_ORDER = {"DiscreteGPU": 0, "IntegratedGPU": 1, "VirtualGPU": 2, "Unknown": 3, "CPU": 4}


class NoAdapterError(OrographError):
    """There is no usable GPU adapter, or wgpu is not installed."""

    exit_code = 6


class DeviceLimitError(OrographError):
    """A request exceeds the device's limits, or its remaining memory."""

    exit_code = 6


LESS = "Ask for less at a time (a smaller picture, part of the terrain, a shorter radius), or use the CPU."
"""The default remedy if a request exceeds a device's memory or limits."""


@dataclass(frozen=True, slots=True)
class Adapter:
    """An adapter that the system offers.

    Attributes:
        name: the driver's name for it.
        kind: DiscreteGPU, IntegratedGPU, VirtualGPU, CPU (software) or Unknown.
        backend: Vulkan, Metal, D3D12 (or OpenGL, which is not used).
        driver: the driver's description.
        usable: whether its backend is one of ``BACKENDS``.
    """

    name: str
    kind: str
    backend: str
    driver: str
    usable: bool
    handle: Any = field(repr=False, compare=False)

    @property
    def software(self) -> bool:
        """Whether it computes on the CPU."""
        return self.kind == "CPU"


def adapters() -> list[Adapter]:
    """All adapters, the best first; [] if there are none.

    Raises:
        NoAdapterError: wgpu is not installed.
    """
    try:
        import wgpu
    except ImportError as error:
        raise NoAdapterError("The GPU needs wgpu.", remedy="Install it: pip install 'orograph[gpu]'.") from error
    quicken_wgpu()
    found = []
    with _runtime_folder():
        handles = wgpu.gpu.enumerate_adapters_sync()
    for handle in handles:
        info = handle.info
        backend, kind = str(info["backend_type"]), str(info["adapter_type"])
        found.append(Adapter(str(info["device"]), kind, backend, str(info["description"]), backend in BACKENDS, handle))
    return sorted(found, key=lambda a: (not a.usable, _ORDER.get(a.kind, 3)))


@contextmanager
def _runtime_folder() -> Iterator[None]:
    """Avoid Mesa's messages about a missing XDG_RUNTIME_DIR for users without a desktop session."""
    if sys.platform != "linux" or os.environ.get("XDG_RUNTIME_DIR"):
        yield
        return
    with temporary() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        try:
            yield
        finally:
            del os.environ["XDG_RUNTIME_DIR"]


def choose(wanted: str | None = None) -> Adapter:
    """The adapter to use.

    Args:
        wanted: a part of its name, or "software"; None: that of ``OROGRAPH_ADAPTER``, or the best.

    Raises:
        NoAdapterError: there is none, or none of that name.
    """
    wanted = wanted or os.environ.get("OROGRAPH_ADAPTER")
    offered = adapters()
    usable = [a for a in offered if a.usable]
    if wanted:
        usable = (
            [a for a in usable if a.software]
            if wanted == "software"
            else [a for a in usable if wanted.lower() in a.name.lower()]
        )
    if usable:
        return usable[0]
    others = ", ".join(f"{a.name} ({a.backend})" for a in offered) or "none at all"
    raise NoAdapterError(
        f"There is no GPU adapter{f' named {wanted!r}' if wanted else ''} with Vulkan, Metal or Direct3D 12; "
        f"found: {others}.",
        remedy="Install a driver; on Linux without a GPU, Mesa's software Vulkan: apt install mesa-vulkan-drivers. "
        "See orograph doctor.",
    )


@dataclass(slots=True)
class Device:
    """A device and its queue.

    Attributes:
        adapter: where it runs.
        handle: wgpu's device; ``queue``: its queue.
        features: the optional features it has.
        portable: whether it has only the limits and features of every browser with WebGPU.
        lost: why the device was lost, or None.
    """

    adapter: Adapter
    handle: Any
    features: frozenset[str]
    portable: bool = False
    lost: str | None = None
    _modules: dict[str, Any] = field(default_factory=dict, repr=False)
    _layouts: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def queue(self) -> Any:
        return self.handle.queue

    @property
    def computes(self) -> bool:
        """Whether compute shaders should do work per pixel (rays, light), instead of fragment shaders.

        On most GPUs both are equally fast. On data-center GPUs few processors run fragments (on an H100 or H200, 2 of
        66 clusters). Software adapters run fragments as fast, and this avoids a copy.
        """
        return not self.adapter.software

    @property
    def record(self) -> str:
        """The type of binding for uniforms in shaders: a storage buffer on software.

        Mesa's lavapipe recompiles a shader, in milliseconds, whenever a pass begins with uniforms on which its branches
        depend, and keeps every version.
        """
        return "read-only-storage" if self.adapter.software and not self.portable else "uniform"

    def shader(self, name: str, constants: dict[str, int | float] | None = None) -> Any:
        """The compiled module ``shaders/NAME.wgsl``, with its includes.

        Args:
            name: file name without ``.wgsl``.
            constants: values for ``{{NAME}}`` in the text, known at compile time.
        """
        key = name + repr(sorted((constants or {}).items()))
        if key not in self._modules:
            text = source(name, constants)
            if self.record != "uniform":
                text = text.replace("var<uniform>", "var<storage, read>")
            self._modules[key] = self.handle.create_shader_module(label=name, code=text)
        return self._modules[key]

    def group_layout(self, entries: list[dict[str, Any]]) -> Any:
        """The bind group layout of entries (``program.Binding.entry``); equal entries share one."""
        key = repr(entries)
        if key not in self._layouts:
            spelled = [{key: _spelled(value) for key, value in entry.items()} for entry in entries]
            for entry in spelled:
                if entry.get("buffer", {}).get("type") == "uniform":
                    entry["buffer"]["type"] = self.record
            self._layouts[key] = self.handle.create_bind_group_layout(entries=[
                {_snake(name): value for name, value in entry.items()} for entry in spelled
            ])  # fmt: skip
        return self._layouts[key]

    def limit(self, name: str) -> int:
        """A limit of the device by WebGPU's name, with hyphens."""
        return int(self.handle.limits[name])

    @property
    def largest(self) -> int:
        """Bytes of the largest buffer that shaders can read."""
        return min(self.limit("max-buffer-size"), self.limit("max-storage-buffer-binding-size"))

    def buffer(self, data: NDArray[Any] | int, usage: str, label: str = "", remedy: str = LESS) -> Any:
        """A buffer, filled with an array or of a given number of bytes.

        Args:
            usage: names of wgpu.BufferUsage, joined by ``|``. label: its content.
            remedy: what to do if it is too large.

        Raises:
            DeviceLimitError: it is larger than the device allows, or than what is left of its memory.
        """
        import wgpu

        words = [part.strip() for part in usage.split("|")]
        flags = wgpu.BufferUsage.COPY_DST
        for part in words:
            flags |= getattr(wgpu.BufferUsage, part)
        if "UNIFORM" in words and self.record != "uniform":
            flags |= wgpu.BufferUsage.STORAGE
        size = data if isinstance(data, int) else data.nbytes
        most = self.limit("max-buffer-size")
        if "STORAGE" in words:  # bound as a whole; uniforms are bound one record at a time
            most = self.largest
        if size > most:
            raise DeviceLimitError(
                f"{self.adapter.name} holds at most {most / 2**20:.0f} MiB in one buffer; "
                f"{label or 'what is to be computed'} takes {size / 2**20:.0f} MiB.",
                remedy=remedy,
            )
        with self._spared(label, size, remedy):
            if isinstance(data, int):
                return self.handle.create_buffer(label=label, size=-(-data // 4) * 4, usage=flags)
            if size < WRITTEN or size % 4:
                return self.handle.create_buffer_with_data(label=label, data=np.ascontiguousarray(data), usage=flags)
            made = self.handle.create_buffer(label=label, size=-(-size // 4) * 4, usage=flags)
            self.queue.write_buffer(made, 0, np.ascontiguousarray(data))
            return made

    @contextmanager
    def _spared(self, label: str, size: int, remedy: str) -> Iterator[None]:
        """Report in plain words that memory has run out."""
        import wgpu

        try:
            yield
        except wgpu.GPUOutOfMemoryError as error:
            raise DeviceLimitError(
                f"{self.adapter.name} has no {size / 2**20:.0f} MiB of memory left for {label or 'what is computed'}.",
                remedy=remedy,
            ) from error

    def texture(
        self, size: tuple[int, ...], format: str, usage: str, *, label: str = "", levels: int = 1, samples: int = 1,
        dimension: Literal["2d", "3d"] = "2d", remedy: str = LESS,
    ) -> Any:  # fmt: skip
        """A texture of (width, height[, layers or depth]); ``usage``: names of wgpu.TextureUsage joined by ``|``.

        Raises:
            DeviceLimitError: it is larger than the device allows, or than what is left of its memory.
        """
        import wgpu

        side = self.limit(f"max-texture-dimension-{dimension}")
        deep = (*size, 1)[2] if len(size) < 4 else size[2]
        if max(size[:2]) > side or deep > (side if dimension == "3d" else self.limit("max-texture-array-layers")):
            raise DeviceLimitError(
                f"{self.adapter.name} has no textures of {' × '.join(str(int(v)) for v in size)}"
                f"{' for ' + label if label else ''}: {side} is the most along a side.",
                remedy=remedy,
            )
        flags = 0
        for part in usage.split("|"):
            flags |= getattr(wgpu.TextureUsage, part.strip())
        with self._spared(label, 4 * math.prod(size), remedy):
            return self.handle.create_texture(
                label=label, size=(*size, 1)[:3] if len(size) == 2 else size, format=format, usage=flags,
                mip_level_count=levels, sample_count=samples, dimension=dimension,
            )  # fmt: skip

    def wait(self) -> None:
        """Wait until all work submitted so far is done."""
        probe = self.buffer(4, "COPY_SRC")
        self.queue.read_buffer(probe)

    def read_buffer(self, buffer: Any, dtype: Any = np.uint8) -> NDArray[Any]:
        """A copy of a buffer's content (its usage must have COPY_SRC), one-dimensional."""
        return np.frombuffer(self.queue.read_buffer(buffer), dtype)

    def read_texture(self, texture: Any, dtype: Any, channels: int, *, layer: int = 0) -> NDArray[Any]:
        """A copy of a texture's layer (usage COPY_SRC): (height, width, channels)."""
        width, height = texture.size[:2]
        row = width * channels * np.dtype(dtype).itemsize
        data = self.queue.read_texture(
            {"texture": texture, "mip_level": 0, "origin": (0, 0, layer)},
            {"offset": 0, "bytes_per_row": row, "rows_per_image": height},
            (width, height, 1),
        )
        return np.frombuffer(data, dtype).reshape(height, width, channels)


def _snake(name: str) -> str:
    """WebGPU's name of a field as wgpu-py spells it."""
    return re.sub("[A-Z]", lambda m: "_" + m.group().lower(), name)


def _spelled(value: Any) -> Any:
    """A copy of a descriptor's field with wgpu-py's spelling of its names."""
    return {_snake(name): inner for name, inner in value.items()} if isinstance(value, dict) else value


_LOCK = threading.Lock()
_OPEN: dict[str, Device] = {}


def has_adapter() -> bool:
    """Whether this process has a usable adapter."""
    try:
        choose()
    except NoAdapterError:
        return False
    return True


def open_device(wanted: str | None = None, *, portable: bool = False) -> Device:
    """The device on the chosen adapter (see ``choose``): one per process, opened on first use, and again if it is lost.

    Args:
        portable: WebGPU's default limits and no optional feature, as in any browser: everything that works on such a
            device works on a web page.

    Raises:
        NoAdapterError: there is no adapter, or its device cannot be made.
    """
    adapter = choose(wanted)
    with _LOCK:
        key = f"{adapter.backend} {adapter.name} {portable}"
        device = _OPEN.get(key)
        if device is None or device.lost is not None:
            have = adapter.handle.features
            features = [] if portable else [f for f in OPTIONAL if f in have]
            limits = {} if portable else {name: min(int(adapter.handle.limits[name]), most) for name, most in WANTED}
            try:
                handle = adapter.handle.request_device_sync(
                    label="orograph", required_features=features, required_limits=limits
                )
            except Exception as error:
                raise NoAdapterError(
                    f"{adapter.name} provides no device: {error}.", remedy="See orograph doctor."
                ) from error
            device = Device(adapter, handle, frozenset(features), portable)
            _OPEN[key] = device
        return device
