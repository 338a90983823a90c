"""Buffers read back by a thread while frames continue.

wgpu-py waits for a buffer in its own thread, inside the native library (``wgpuDevicePoll``), which blocks all
submissions until everything submitted is done (wgpu 29: https://github.com/gfx-rs/wgpu/issues/9470). A frame submitted
meanwhile waits too. Here, the library is polled until it is done. If wgpu-py is not as expected, its own way is used,
as in ``recording``.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device

AGAIN = 0.0005
"""Seconds between two polls of the library."""


def read_aside(device: Device, buffer: Any, dtype: Any = np.uint8) -> NDArray[Any]:
    """A copy of a buffer's content (its usage must have COPY_SRC), one-dimensional; called from any thread."""
    try:
        from wgpu.backends.wgpu_native import _api

        api = _api.ffi, _api.lib, _api.lib.wgpuBufferMapAsync, _api.new_struct, device.handle._internal
    except (ImportError, AttributeError):
        return device.read_buffer(buffer, dtype)
    ffi, lib, map_async, new_struct, handle = api
    size = buffer.size
    read = device.buffer(size, "MAP_READ", "read back")
    encoder = device.handle.create_command_encoder()
    encoder.copy_buffer_to_buffer(buffer, 0, read, 0, size)
    device.queue.submit([encoder.finish()])
    statuses: list[int] = []

    @ffi.callback("void(WGPUMapAsyncStatus, WGPUStringView, void *, void *)")  # type: ignore[untyped-decorator]
    def mapped(status: int, message: Any, first: Any, second: Any) -> None:
        statuses.append(status)

    map_async(
        read._internal, lib.WGPUMapMode_Read, 0, size,
        new_struct("WGPUBufferMapCallbackInfo", mode=lib.WGPUCallbackMode_AllowProcessEvents, callback=mapped),
    )  # fmt: skip
    while not statuses:
        lib.wgpuDevicePoll(handle, False, ffi.NULL)
        if not statuses:
            time.sleep(AGAIN)
    if statuses[0] != lib.WGPUMapAsyncStatus_Success:  # wgpu-py reports the error
        return device.read_buffer(buffer, dtype)
    found = np.frombuffer(bytes(ffi.buffer(lib.wgpuBufferGetConstMappedRange(read._internal, 0, size), size)), dtype)
    read.destroy()
    return found
