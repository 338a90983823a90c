"""Render passes and writes with a fraction of wgpu-py's Python overhead, because every frame repeats the same few.

wgpu-py describes the attachments of a pass by dictionaries, which it checks and copies into C structures every time,
and checks for errors after every call. Here, attachments are described once (``Attachments``), and calls between the
beginning and the end of a pass go straight to the native library. By WebGPU's rules, their errors are not reported
before the pass or the encoder ends, and those calls are wgpu-py's own, as are its errors.

If wgpu-py is not as expected (another backend, another version), its own passes are used, which have the same methods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from orograph.gpu.device import Device

KEEP = "keep"
"""A depth attachment that is read and not changed."""

Color = tuple[Any, tuple[float, float, float, float] | None]
"""A texture's view, and its clear value; None: its content is loaded."""


class Attachments:
    """The attachments of a pass: described once, used in every frame.

    Args:
        colours: the views. depth: a view and what it is cleared with, None (it is loaded), or ``KEEP``.
    """

    def __init__(self, colors: Sequence[Color], depth: tuple[Any, float | str | None] | None = None) -> None:
        self._colors, self._depth = tuple(colors), depth
        self._native = _native()
        self._described = None if self._native is None else self._native.described(self._colors, depth)

    def begin(self, encoder: Any) -> Any:
        """Begin a pass of a wgpu-py command encoder: a ``GPURenderPassEncoder``, or an equivalent."""
        if self._native is not None:
            return self._native.begin(encoder, self._described)
        colors = [
            {
                "view": view, "clear_value": clear or (0, 0, 0, 0), "load_op": "load" if clear is None else "clear",
                "store_op": "store",
            }
            for view, clear in self._colors
        ]  # fmt: skip
        depth: dict[str, Any] = {}
        if self._depth is not None:
            view, clear = self._depth
            depth = {"view": view, "depth_read_only": True}
            if clear != KEEP:
                depth = {
                    "view": view, "depth_load_op": "load" if clear is None else "clear",
                    "depth_clear_value": clear or 0.0, "depth_store_op": "store",
                }  # fmt: skip
        return encoder.begin_render_pass(color_attachments=colors, depth_stencil_attachment=depth or None)


def begin_compute(encoder: Any) -> Any:
    """Begin a compute pass of a wgpu-py command encoder: a ``GPUComputePassEncoder``, or an equivalent."""
    native = _native()
    return encoder.begin_compute_pass() if native is None else native.begin_compute(encoder)


def write(device: Device, buffer: Any, values: NDArray[Any] | bytes) -> None:
    """Write the beginning of a buffer: a contiguous array, or bytes; a multiple of 4."""
    native = _native()
    if native is None:
        device.queue.write_buffer(buffer, 0, values)
    else:
        native.write(device.queue, buffer, values)


def copy_to_texture(
    encoder: Any, buffer: Any, offset: int, row: int, texture: Any, origin: tuple[int, int, int], size: tuple[int, int]
) -> None:  # fmt: skip
    """Record a copy of texels (width, height) from a buffer into a layer of a texture.

    Args:
        offset: bytes where they begin. row: bytes from one row to the next. origin: x, y and layer.
    """
    native = _native()
    if native is not None:
        native.copy(encoder, buffer, offset, row, texture, origin, size)
        return
    encoder.copy_buffer_to_texture(
        {"buffer": buffer, "offset": offset, "bytes_per_row": row, "rows_per_image": size[1]},
        {"texture": texture, "origin": origin}, (*size, 1),
    )  # fmt: skip


class _Native:
    """wgpu-native's functions, as ``wgpu.backends.wgpu_native`` loads them.

    Attributes:
        begin, begin_compute: begin a pass of an encoder. write: writes a buffer. copy: records a copy into a texture.
    """

    def __init__(self) -> None:
        from wgpu.backends.wgpu_native import _api

        self._ffi, self._lib = _api.ffi, _api.lib
        lib, checked, ffi = _api.lib, _api.libf, _api.ffi
        begin_pass = lib.wgpuCommandEncoderBeginRenderPass
        pass_ = _pass_class(lib, checked, ffi)
        write_buffer, from_buffer = checked.wgpuQueueWriteBuffer, ffi.from_buffer

        def begin(encoder: Any, described: Any) -> Any:
            return pass_(begin_pass(encoder._internal, described[0]))

        def write(queue: Any, buffer: Any, values: Any) -> None:
            data = from_buffer(values)
            write_buffer(queue._internal, buffer._internal, 0, data, len(data))

        copied, source, target = (
            lib.wgpuCommandEncoderCopyBufferToTexture, ffi.new("WGPUTexelCopyBufferInfo *"),
            ffi.new("WGPUTexelCopyTextureInfo *"),
        )  # fmt: skip
        extent = ffi.new("WGPUExtent3D *")
        target.aspect, extent.depthOrArrayLayers = lib.WGPUTextureAspect_All, 1

        def copy(
            encoder: Any, buffer: Any, offset: int, row: int, texture: Any, origin: tuple[int, int, int],
            size: tuple[int, int],
        ) -> None:  # fmt: skip
            source.buffer, source.layout.offset = buffer._internal, offset
            source.layout.bytesPerRow, source.layout.rowsPerImage = row, size[1]
            target.texture = texture._internal
            target.origin.x, target.origin.y, target.origin.z = origin
            extent.width, extent.height = size
            copied(encoder._internal, source, target, extent)

        compute_, begin_compute_ = _compute_class(lib, checked, ffi), lib.wgpuCommandEncoderBeginComputePass

        def begin_compute(encoder: Any) -> Any:
            return compute_(begin_compute_(encoder._internal, ffi.NULL))

        self.begin_compute: Callable[[Any], Any] = begin_compute
        self.copy: Callable[..., None] = copy
        self.begin: Callable[[Any, Any], Any] = begin
        self.write: Callable[[Any, Any, Any], None] = write

    def described(self, colors: tuple[Color, ...], depth: tuple[Any, float | str | None] | None) -> tuple[Any, ...]:
        """The C structure of a pass, and the objects it points to."""
        ffi, lib = self._ffi, self._lib
        targets = ffi.new("WGPURenderPassColorAttachment[]", len(colors))
        for target, (view, clear) in zip(targets, colors, strict=True):
            target.view = view._internal
            target.depthSlice = lib.WGPU_DEPTH_SLICE_UNDEFINED
            target.loadOp = lib.WGPULoadOp_Load if clear is None else lib.WGPULoadOp_Clear
            target.storeOp = lib.WGPUStoreOp_Store
            c = target.clearValue
            c.r, c.g, c.b, c.a = clear or (0.0, 0.0, 0.0, 0.0)
        whole = ffi.new("WGPURenderPassDescriptor *")
        whole.colorAttachmentCount, whole.colorAttachments = len(colors), targets
        behind = ffi.NULL
        if depth is not None:
            view, empty = depth
            behind = ffi.new("WGPURenderPassDepthStencilAttachment *")
            behind.view = view._internal
            behind.depthReadOnly = empty == KEEP
            if empty != KEEP:
                behind.depthLoadOp = lib.WGPULoadOp_Load if empty is None else lib.WGPULoadOp_Clear
                behind.depthStoreOp = lib.WGPUStoreOp_Store
                behind.depthClearValue = empty or 0.0
        whole.depthStencilAttachment = behind
        return whole, targets, behind, colors, depth


def _ended_by(end: Any, let_go: Any) -> type:
    """The class of passes that these functions end and release."""

    class Recorded:
        """A pass being recorded."""

        __slots__ = ("_internal",)

        def __init__(self, internal: Any) -> None:
            self._internal = internal

        def end(self) -> None:
            internal, self._internal = self._internal, None
            try:
                end(internal)
            finally:
                let_go(internal)

        def __del__(self) -> None:
            if self._internal is not None:  # an error occurred before its end
                let_go(self._internal)

    return Recorded


def _pass_class(lib: Any, checked: Any, ffi: Any) -> type:
    """The class of passes that call ``lib`` directly; ``checked``: wgpu-py's functions, which raise its errors."""
    pipeline, group, vertices = (
        lib.wgpuRenderPassEncoderSetPipeline, lib.wgpuRenderPassEncoderSetBindGroup,
        lib.wgpuRenderPassEncoderSetVertexBuffer,
    )  # fmt: skip
    indices, scissor, blend = (
        lib.wgpuRenderPassEncoderSetIndexBuffer, lib.wgpuRenderPassEncoderSetScissorRect,
        lib.wgpuRenderPassEncoderSetBlendConstant,
    )  # fmt: skip
    draw, draw_indexed, draw_indirect, let_go = (
        lib.wgpuRenderPassEncoderDraw, lib.wgpuRenderPassEncoderDrawIndexed, lib.wgpuRenderPassEncoderDrawIndirect,
        lib.wgpuRenderPassEncoderRelease,
    )  # fmt: skip
    end, null, whole = checked.wgpuRenderPassEncoderEnd, ffi.NULL, lib.WGPU_WHOLE_SIZE
    widths = {"uint16": lib.WGPUIndexFormat_Uint16, "uint32": lib.WGPUIndexFormat_Uint32}

    class Pass(_ended_by(end, let_go)):  # type: ignore[misc]
        """A pass being recorded; the methods are ``GPURenderPassEncoder``'s."""

        __slots__ = ()

        def set_pipeline(self, which: Any) -> None:
            pipeline(self._internal, which._internal)

        def set_bind_group(self, index: int, which: Any) -> None:
            group(self._internal, index, which._internal, 0, null)

        def set_vertex_buffer(self, slot: int, buffer: Any) -> None:
            vertices(self._internal, slot, buffer._internal, 0, whole)

        def set_index_buffer(self, buffer: Any, width: str) -> None:
            indices(self._internal, buffer._internal, widths[width], 0, whole)

        def set_scissor_rect(self, x: int, y: int, width: int, height: int) -> None:
            scissor(self._internal, x, y, width, height)

        def set_blend_constant(self, color: tuple[float, float, float, float]) -> None:
            blend(self._internal, ffi.new("WGPUColor *", color))

        def draw(self, vertices: int, instances: int = 1) -> None:
            draw(self._internal, vertices, instances, 0, 0)

        def draw_indexed(self, count: int, instances: int = 1) -> None:
            draw_indexed(self._internal, count, instances, 0, 0, 0)

        def draw_indirect(self, buffer: Any, offset: int) -> None:
            draw_indirect(self._internal, buffer._internal, offset)

    return Pass


def _compute_class(lib: Any, checked: Any, ffi: Any) -> type:
    """Like ``_pass_class``, for compute passes."""
    pipeline, group, dispatch, dispatch_indirect, let_go = (
        lib.wgpuComputePassEncoderSetPipeline, lib.wgpuComputePassEncoderSetBindGroup,
        lib.wgpuComputePassEncoderDispatchWorkgroups, lib.wgpuComputePassEncoderDispatchWorkgroupsIndirect,
        lib.wgpuComputePassEncoderRelease,
    )  # fmt: skip
    end, null = checked.wgpuComputePassEncoderEnd, ffi.NULL

    class Compute(_ended_by(end, let_go)):  # type: ignore[misc]
        """A pass being recorded; the methods are ``GPUComputePassEncoder``'s."""

        __slots__ = ()

        def set_pipeline(self, which: Any) -> None:
            pipeline(self._internal, which._internal)

        def set_bind_group(self, index: int, which: Any) -> None:
            group(self._internal, index, which._internal, 0, null)

        def dispatch_workgroups(self, x: int, y: int = 1, z: int = 1) -> None:
            dispatch(self._internal, x, y, z)

        def dispatch_workgroups_indirect(self, buffer: Any, offset: int) -> None:
            dispatch_indirect(self._internal, buffer._internal, offset)

    return Compute


_FOUND: list[_Native | None] = []


def _native() -> _Native | None:
    """The native functions; None if wgpu-py has others."""
    if not _FOUND:
        try:
            _FOUND.append(_Native())
        except (ImportError, AttributeError):
            _FOUND.append(None)
    return _FOUND[0]
