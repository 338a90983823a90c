"""Tiles read ahead: what a steady flight lacks with it and without, at the same rate of reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.gpu.stream import residency
from orograph.rendering.gpu.stream.residency import Residency
from orograph.rendering.gpu.stream.tiles import Key, Kind, make_tile
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

RATE, SPEED = 30.0, 300.0


class Reader:
    """Stands in for the threads: begins two tiles a frame, the most urgent first, and takes ten frames for each."""

    RETRY = 5.0

    def __init__(self, terrain: Terrain) -> None:
        self.terrain, self.frame = terrain, 0
        self.failed: dict[tuple[Kind, Key], tuple[float, str]] = {}
        self.begun: dict[tuple[Kind, Key], int] = {}
        self.read: list[tuple[Kind, Key]] = []

    def want(self, wanted: object) -> None:
        waiting = sorted((-p, kind, key) for p, kind, key in wanted if (kind, key) not in self.begun)  # type: ignore[attr-defined]
        for _, kind, key in waiting[: 2 - sum(when == self.frame for when in self.begun.values())]:  # two a frame
            self.begun[kind, key] = self.frame

    def take(self, most: int) -> list[tuple[Kind, Key, NDArray[np.float32]]]:
        for (kind, key), when in self.begun.items():
            if self.frame - when >= 10:
                del self.begun[kind, key]
                self.read.append((kind, key))
                return [(kind, key, make_tile(self.terrain, kind, key))]
        return []

    @property
    def waiting(self) -> int:
        return len(self.begun)

    def close(self) -> None:
        pass


def ground() -> Terrain:
    y, x = np.mgrid[:900, :4200].astype(np.float32)
    z = 40 * np.sin(x / 90) * np.cos(y / 70) + 6 * np.sin(x / 7 + y / 11) + 2 * np.sin(x * 1.7) * np.sin(y * 1.3)
    grid = Grid(z.shape, Affine(1, 0, 500_000, 0, -1, 5_300_000), CRS.from_epsg(32632))
    return in_memory(Dem(z.astype(np.float32), grid))


def flown(device: Device, terrain: Terrain, monkeypatch: pytest.MonkeyPatch, look: bool) -> tuple[int, Reader]:
    """How many tiles all frames together lacked."""
    tiles = Residency(device, terrain, 1 << 29, 1 << 28, 1)
    tiles.streamer.close()
    tiles.look_ahead = look
    reader = tiles.streamer = Reader(terrain)  # type: ignore[assignment]
    clock = [0.0]
    monkeypatch.setattr(residency.time, "monotonic", lambda: clock[0])
    # How fast this machine is must not matter: no upload is put off, and pages of errors are there at once.
    monkeypatch.setattr(residency, "UPLOADING", float("inf"))
    select = tiles.method.patches
    monkeypatch.setattr(
        tiles.method, "patches",
        lambda camera, tolerance, ready, **more: select(camera, tolerance, replace(ready, wait=True), **more),
    )  # fmt: skip
    x, y = (float(v) for v in terrain.grid.xy(300, 450))
    view = View((x, y, 150.0), (x + 600, y, 0.0), width=640, height=360)
    lacking = 0
    for frame in range(300):
        reader.frame, clock[0] = frame, frame / RATE
        far = max(0.0, frame - 60) / RATE * SPEED  # two seconds at rest: the first view is complete by then or never
        here = replace(view, eye=(x + far, y, 150.0), target=(x + far + 600, y, 0.0))
        chosen = tiles.choose(here, 1.0, 1.0, wait=False)
        tiles.prepare(here, 1.0, 1.0)
        lacking += chosen.missing if frame > 60 else 0
    return lacking, reader


@pytest.mark.stress
def test_a_steady_flight_lacks_less_if_it_reads_ahead(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    terrain = ground()
    without, _ = flown(device, terrain, monkeypatch, look=False)
    with_it, reader = flown(device, terrain, monkeypatch, look=True)
    assert len(set(reader.read)) == len(reader.read)  # none twice
    assert without > 100
    assert with_it < 0.2 * without, (with_it, without)  # measured: 23 and 846


def test_a_small_atlas_settles_on_the_largest_errors(device: Device) -> None:
    """More tiles are wanted than fit: the same ones are there in every frame, and nothing is read over and over."""
    terrain = ground()
    tiles = Residency(device, terrain, 2 * 16 * 258 * 258 * 4, 1 << 28, 1)
    tiles.streamer.close()
    reader = tiles.streamer = Reader(terrain)  # type: ignore[assignment]
    x, y = (float(v) for v in terrain.grid.xy(300, 450))
    view = View((x, y, 60.0), (x + 600, y, 0.0), width=1280, height=720)
    shown = []
    for frame in range(400):
        reader.frame = frame
        chosen = tiles.choose(view, 0.25, 1.0, wait=False)
        shown.append((len(reader.read), chosen.patches.instances["slot"].tobytes()))
    assert tiles.heights.count >= 15 and tiles.heights.capacity == 16
    assert len(chosen.patches.wanted) > 16
    assert len(set(shown[-100:])) == 1
