"""Shared fixtures: the open data sets beside the checkout (``../shared/data``), absent on most machines; a GPU."""

from __future__ import annotations

import os
import signal
import subprocess
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from orograph.gpu.device import Device

# Where tests are started in the background Ctrl-C is ignored, and so it would be in the processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A first call compiles, and machines are busy: time is not what these tests are about.
settings.register_profile("orograph", deadline=None)
settings.load_profile("orograph")

DATA = Path(os.environ.get("OROGRAPH_DATA", Path(__file__).parents[1].parent / "shared" / "data"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is beyond the first cases of a test that says how many ``make test`` runs."""
    seen: Counter[str] = Counter()
    for item in items:
        few = item.get_closest_marker("cases")
        if few:
            name = item.nodeid.partition("[")[0]
            seen[name] += 1
            if seen[name] > few.args[0]:
                item.add_marker("stress")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of open test data; tests that need it are skipped, with the reason, where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"the open data sets are not at {DATA} (set OROGRAPH_DATA)")
    return DATA


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Gives empty disks of so many KiB; tests that need one are skipped where none can be mounted."""
    disks: list[Path] = []

    def make(kib: int) -> Path:
        disk = tmp_path / f"disk{len(disks)}"
        disk.mkdir()
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", disk], capture_output=True)
        if done.returncode:
            pytest.skip("only root may mount a disk")
        disks.append(disk)
        return disk

    try:
        yield make
    finally:
        for disk in disks:
            subprocess.run(["umount", "-l", disk], check=True)


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


def _tujunga(folder: Path, rows: slice, cols: slice) -> tuple[np.ndarray, np.ndarray]:
    """Heights of a part of the San Gabriel Mountains, 30 m apart, and the linear part of their geotransform."""
    import rasterio

    with rasterio.open(next((folder / "bigtujunga-srtm30m-utm").glob("*.tif"))) as file:
        heights = file.read(1, window=((rows.start, rows.stop), (cols.start, cols.stop))).astype(np.float32)
        t = file.transform
    return heights, np.array([[t.a, t.b], [t.d, t.e]])


@pytest.fixture(scope="session")
def real_ground(shared_data: Path) -> tuple[np.ndarray, np.ndarray]:
    """48 × 48 samples of real mountains, see ``_tujunga``."""
    return _tujunga(shared_data, slice(200, 248), slice(300, 348))


@pytest.fixture(scope="session")
def small_real_ground(shared_data: Path) -> tuple[np.ndarray, np.ndarray]:
    """32 × 32 samples of real mountains, see ``_tujunga``."""
    return _tujunga(shared_data, slice(208, 240), slice(308, 340))
