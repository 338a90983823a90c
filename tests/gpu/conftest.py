"""A GPU device for tests: software Vulkan in CI, where a missing adapter is a failure; elsewhere a reason to skip."""

from __future__ import annotations

import os

import pytest

from orograph.gpu.device import Device, NoAdapterError, open_device


@pytest.fixture(scope="session")
def device() -> Device:
    try:
        return open_device()
    except NoAdapterError as error:
        if os.environ.get("CI"):
            pytest.fail(f"CI tests the GPU: {error}")
        pytest.skip(str(error))
