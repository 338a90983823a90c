"""GPU time between two marks, by the GPU's own clock (timestamp queries).

A mark is an empty compute pass that records the time; marks and frames run in the order of their submission. Adapters
without the feature ``timestamp-query`` give None; then there is only wall time, with the queue drained. Ticks in,
seconds out; only wgpu's native library knows the length of a tick (wgpu-py does not pass it on).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph.gpu.device import Device


class Clock:
    """Two marks and the time between them.

    Attributes:
        works: whether the adapter supports timestamps.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.works = "timestamp-query" in device.features
        if self.works:
            self._queries = device.handle.create_query_set(type="timestamp", count=4)
            self._times = device.buffer(32, "QUERY_RESOLVE|COPY_SRC", "timestamps")
            self._empty = self._pipeline()
            self._tick = _nanoseconds(device) * 1e-9

    def begin(self) -> None:
        """The first mark."""
        self._mark(0)

    def end(self) -> None:
        """The second mark."""
        self._mark(1)

    def seconds(self) -> float | None:
        """Seconds from the first mark to the second; waits for the GPU. None without timestamps."""
        if not self.works:
            return None
        encoder = self.device.handle.create_command_encoder()
        encoder.resolve_query_set(self._queries, 0, 4, self._times, 0)
        self.device.queue.submit([encoder.finish()])
        _, first, second, _ = (int(t) for t in self.device.read_buffer(self._times, np.uint64))
        return max(0, second - first) * self._tick

    def _mark(self, which: int) -> None:
        if not self.works:
            return
        encoder = self.device.handle.create_command_encoder()
        pass_ = encoder.begin_compute_pass(
            timestamp_writes={
                "query_set": self._queries, "beginning_of_pass_write_index": 2 * which,
                "end_of_pass_write_index": 2 * which + 1,
            }
        )  # fmt: skip
        pass_.set_pipeline(self._empty)
        pass_.dispatch_workgroups(1)
        pass_.end()
        self.device.queue.submit([encoder.finish()])

    def _pipeline(self) -> Any:
        code = "@compute @workgroup_size(1) fn main() {}"
        module = self.device.handle.create_shader_module(label="mark", code=code)
        return self.device.handle.create_compute_pipeline(
            layout="auto", compute={"module": module, "entry_point": "main"}
        )


def _nanoseconds(device: Device) -> float:
    """Nanoseconds per tick of the clock."""
    try:
        from wgpu.backends.wgpu_native import lib

        return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))
    except (ImportError, AttributeError):  # another backend of wgpu-py: WebGPU's timestamps are nanoseconds
        return 1.0
