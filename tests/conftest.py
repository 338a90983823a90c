"""Shared fixtures: the open data sets beside the checkout (``../shared/data``), absent on most machines; a GPU."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from orograph.gpu.device import Device

# Where tests are started in the background Ctrl-C is ignored, and so it would be in the processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A first call compiles, and machines are busy: time is not what these tests are about.
settings.register_profile("orograph", deadline=None)
settings.load_profile("orograph")

DATA = Path(os.environ.get("OROGRAPH_DATA", Path(__file__).parents[1].parent / "shared" / "data"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of open test data; tests that need it are skipped, with the reason, where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"the open data sets are not at {DATA} (set OROGRAPH_DATA)")
    return DATA


@pytest.fixture(scope="session")
def device() -> Device:
    """A GPU: software Vulkan in CI, where a missing adapter is a failure; elsewhere a reason to skip."""
    from orograph.gpu.device import NoAdapterError, open_device

    try:
        return open_device()
    except NoAdapterError as error:
        if os.environ.get("CI"):
            pytest.fail(f"CI tests the GPU: {error}")
        pytest.skip(str(error))
