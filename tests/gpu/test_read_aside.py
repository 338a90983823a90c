"""Buffers read back by a thread while frames go on."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from orograph.gpu.device import Device
from orograph.gpu.read_aside import read_aside


def test_a_buffer_is_read_back_from_any_thread_and_nothing_is_left_to_be_polled(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """wgpu-py's own thread, which would hold up whoever submits, is not asked."""
    monkeypatch.setattr(device.handle._poller, "get_token", lambda: pytest.fail("wgpu-py polls"))
    values = np.arange(100, dtype=np.uint32)
    buffers = [device.buffer(values + k, "STORAGE|COPY_SRC") for k in range(8)]
    found: dict[int, np.ndarray] = {}

    def read(k: int) -> None:
        found[k] = read_aside(device, buffers[k], np.uint32)

    threads = [threading.Thread(target=read, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for _ in range(50):
        device.queue.submit([device.handle.create_command_encoder().finish()])
    for thread in threads:
        thread.join()
    for k in range(8):
        np.testing.assert_array_equal(found[k], values + k)
