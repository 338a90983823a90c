"""Layers on the GPU: a virtual texture. One atlas holds the tiles that views want of all layers, streamed like heights.

Every frame determines the tiles it wants of each layer (``image_tiles``, ``wanted``): those whose texels are about
as large as a pixel, and all above them. Separate threads read them (``streamer``) into one atlas (``atlas``) of a fixed
size, created with the first layer. Each layer has a page table: for every tile, the slot of the finest tile
present at its place, itself or one above it. So shaders look up once and there is never a hole; the coarsest
tiles never leave. The same threads open layers and read their coarse levels: frames do not wait for that.
Data that are painted anew (another priority, another time) are a new layer: the old one is drawn until that is ready.

One buffer holds everything that ``shaders/imagery.wgsl`` needs (``image_words``).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError
from orograph.geovis.layers import Layer, drawn
from orograph.geovis.mipmap import TAPS
from orograph.gpu.device import Device
from orograph.progress import SILENT
from orograph.rendering.gpu.stream.atlas import TileAtlas
from orograph.rendering.gpu.stream.image_tiles import SIDE, ImageTiles
from orograph.rendering.gpu.stream.image_words import (
    HEAD_DTYPE,
    HEADS,
    SLOT,
    STATIC,
    THERE,
    aim,
    fixed,
    inherit,
    level_words,
    node_words,
)
from orograph.rendering.gpu.stream.streamer import Streamer
from orograph.rendering.lookup import LEAST
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]
Words = NDArray[np.uint32]
Places = NDArray[np.int64]

FEW = 4
"""Maximum look-ups in a footprint, in a frame that a software driver draws and nothing waits for."""

UPLOAD = 16
"""Maximum tiles uploaded to the GPU in a frame."""

MORE = 2.0
"""Seconds after which a tile of which more is ready is read again."""

PATIENCE = 1.0
"""Seconds after which painted data replace the previous ones, even if only their coarsest tiles are ready."""

OPENING = -1
"""The place in a tile's key that requests opening the layer."""


@dataclass(slots=True)
class Held:
    """An open layer.

    Attributes:
        sheet: its tiles. own: pages of the tiles present; pages: of all places. stale: whether ``own`` is newer.
        at: the offset of its words in the buffer. since: when it was opened, on ``time.monotonic``'s clock.
        there: whether all tiles that some frame wanted were present.
    """

    sheet: ImageTiles
    own: Words
    pages: Words
    stale: bool = True
    at: int = 0
    since: float = field(default_factory=time.monotonic)
    there: bool = False


class Imagery:
    """The layers over a terrain on a device.

    Args:
        gpu_memory: bytes of the atlas. jobs: threads that read.

    Attributes:
        missing: tiles and layers that would improve the last frame. loaded: tiles that arrived for it.
        warnings: messages for the user about the open layers; each is reported once (``told``).
        progress: receives the progress of work that a frame waits for.
    """

    def __init__(self, device: Device, terrain: Terrain, gpu_memory: int, jobs: int | None = None) -> None:
        self.device, self.terrain, self.gpu_memory, self.jobs = device, terrain, gpu_memory, jobs
        self.missing = self.loaded = 0
        self.warnings: list[str] = []
        self.progress = SILENT
        self._held: dict[Layer, Held] = {}
        self._atlas: TileAtlas | None = None
        self._streamer: Streamer[Layer, int, NDArray[Any]] | None = None
        self._sheets: dict[Layer, ImageTiles] = {}
        self._buffer: Any = None
        self._frame = 0
        self._full = self._refused = False
        self._known: set[Layer] = set()
        self._asked: set[tuple[Layer, int]] = set()
        self._none: tuple[Any, Any] | None = None
        self._came: list[Array] = []
        self._data: list[Layer] = []  # painted data of the last frame, bottom to top

    def prepare(
        self, layers: Sequence[Layer], view: View, exaggeration: float, *, wait: bool = False
    ) -> int:  # fmt: skip
        """Prepare layers for drawing, as well as possible.

        Args:
            layers: the scene's, bottom to top. view: what is drawn.
            wait: until all tiles that the view wants are present, or the atlas is full.

        Returns:
            the number of layers to draw.

        Raises:
            ReadError: with ``wait``, a layer or one of its tiles cannot be read.
        """
        self.missing = self.loaded = 0
        self._came.clear()
        seen = drawn(layers)
        if not seen and not self._held:
            return 0
        self._known = {layer.content for layer in (*layers, *(() if wait else self._data))}
        self._drop()
        if self._streamer is None:
            self._streamer = Streamer(self._make, self.jobs or 2)
        if wait:  # retry what failed before
            self._streamer.failed.clear()
        self._upload(1 << 16 if wait else UPLOAD)
        wanted = self._want(seen, view, exaggeration, wait=wait)
        self._refused = False
        while wait and (wanted or self._streamer.waiting) and not self._refused:
            self._streamer.wait(1.0)
            self._upload(1 << 16)
            for layer, place in self._asked & set(self._streamer.failed):
                raise self._error(layer, place)
            wanted = self._want(seen, view, exaggeration, wait=True)
        self.missing = wanted
        ready = self._ready(seen, () if wait else self._data)
        if ready:
            self._write(ready, view, TAPS if wait or not self.device.adapter.software else FEW)
        return len(ready)

    def _ready(self, seen: Sequence[Layer], data: Sequence[Layer]) -> list[Layer]:
        """The layers to draw: the open ones; if painted data are not ready yet, the previous ones, ``data``."""
        assert self._streamer is not None
        before = dict(zip((layer for layer in seen if layer.key is not None), data))
        drawn = {}
        for layer in seen:
            held = self._held.get(layer.content)
            there = held is not None and (held.there or layer not in before)
            if not there and layer in before and (layer.content, OPENING) not in self._streamer.failed:
                drawn[layer] = replace(before[layer], opacity=layer.opacity)
            elif held is not None:
                drawn[layer] = layer
        ready = [layer for layer in drawn.values() if layer.content in self._held]
        self._data = [layer for layer in ready if layer.key is not None]
        return ready

    def bound(self) -> tuple[Any, Any]:
        """The atlas's view and the buffer of ``shaders/imagery.wgsl``."""
        if self._atlas is not None and self._buffer is not None:
            return self._atlas.texture.create_view(dimension="2d-array"), self._buffer
        if self._none is None:
            texture = self.device.texture((1, 1, 1), "rgba8unorm-srgb", "TEXTURE_BINDING|COPY_DST", label="no layers")
            self._none = (
                texture.create_view(dimension="2d-array"),
                self.device.buffer(np.zeros(STATIC, np.uint32), "STORAGE", "no layers"),
            )
        return self._none

    @property
    def waiting(self) -> int:
        """The number of tiles being loaded."""
        return 0 if self._streamer is None else self._streamer.waiting

    @property
    def count(self) -> int:
        """The number of tiles present."""
        return 0 if self._atlas is None else self._atlas.count

    @property
    def full(self) -> bool:
        """Whether the last frame wanted more tiles than there is room for."""
        return self._full or self._refused

    @property
    def failure(self) -> str:
        """What could not be read, and why; "" if nothing."""
        if self._streamer is None:
            return ""
        for (layer, place), (_, why) in list(self._streamer.failed.items()):
            if (layer, place) in self._asked:
                return why if place == OPENING else f"{layer.label}: {why}"
        return next((held.sheet.failure for held in list(self._held.values()) if held.sheet.failure), "")

    def take_warnings(self) -> list[str]:
        """Warnings that have not been reported yet."""
        new, self.warnings = self.warnings, []
        return new

    @property
    def areas(self) -> Array:
        """West, north, east, south (n, 4) of the ground under the new tiles, sample coordinates."""
        return np.array(self._came).reshape(-1, 4)

    @property
    def making(self) -> str:
        """What is being made in the background, with its progress; "" if nothing."""
        for layer, held in list(self._held.items()):
            done = held.sheet.making
            if done is not None:
                return f"Coarse levels of {layer.label} are being made: {done:.0%}."
        return ""

    def covered(self, layers: Sequence[Layer], x: Array, y: Array) -> Array:
        """The approximate part (n,) of the ground's own colours that layers hide at places in the terrain's CRS."""
        clear = np.ones(len(x))
        for layer in drawn(layers):
            held = self._held.get(layer.content)
            if held is not None and layer.blend == "normal":
                clear *= 1 - layer.opacity * held.sheet.opacity_at(x, y)
        return 1 - clear

    def close(self) -> None:
        """Stop reading."""
        if self._streamer is not None:
            self._streamer.close()
        for held in self._held.values():
            held.sheet.close()

    # ---- tiles ---------------------------------------------------------------------------------------------------

    def _make(self, layer: Layer, place: int) -> NDArray[Any]:
        """Read a tile, or open the layer; called from the streamer's threads."""
        if place == OPENING:
            self._sheets[layer] = ImageTiles(layer, self.terrain)
            return np.empty(0, np.uint8)
        return self._held[layer].sheet.tile(place)

    def _error(self, layer: Layer, place: int) -> ReadError:
        assert self._streamer is not None
        failure = self._streamer.failed[layer, place][1]
        if place == OPENING:
            return ReadError(failure)
        return ReadError(f"A tile cannot be read: {failure}", path=layer.path)

    def _want(self, layers: Sequence[Layer], view: View, exaggeration: float, *, wait: bool = False) -> int:
        """Request what a view lacks; return how many of these tiles are readable."""
        assert self._streamer is not None
        self._frame += 1  # tiles that are no longer wanted may leave
        wanted: list[tuple[float, Layer, int]] = []
        tiles: list[tuple[Layer, Held, Places, Array, NDArray[np.int32]]] = []
        for content in dict.fromkeys(layer.content for layer in layers):
            held = self._held.get(content)
            if held is None:
                wanted.append((math.inf, content, OPENING))
                continue
            if wait:
                held.sheet.complete(self.progress, self.jobs)
            self._refresh(held)
            which, priority = held.sheet.tree.of(view, exaggeration, pixels=LEAST)
            # Tiles known to show nothing, themselves or through one above, are not requested.
            pages = held.pages[which]
            some = ~((pages & THERE > 0) & (pages & SLOT == 0))
            which, priority = which[some], priority[some]
            priority[which < held.sheet.pinned] = math.inf
            slots = (held.own[which] & SLOT).astype(np.int32) - np.int32(1)
            more = held.sheet.outdated(MORE)
            if more:  # of these, more is ready now
                lacking = np.isin(which, more)
                self._atlas.touch(slots[lacking], self._frame) if self._atlas is not None else None
                slots[lacking] = -1
            tiles.append((content, held, which, priority, slots))
        least = self._least([t[3] for t in tiles])
        for content, there, which, priority, slots in tiles:
            assert self._atlas is not None
            fits = priority >= least
            self._atlas.touch(slots[fits], self._frame)
            lack = fits & (slots < 0)
            pinned = bool((there.own[: there.sheet.pinned] & THERE).all())
            there.there |= not lack.any() or (pinned and time.monotonic() - there.since > PATIENCE)
            wanted += [(p, content, i) for p, i in zip(priority[lack].tolist(), which[lack].tolist(), strict=True)]
        self._streamer.want(wanted)
        self._asked = {(layer, place) for _, layer, place in wanted}
        return len(self._asked - set(self._streamer.failed))

    def _least(self, priorities: list[Array]) -> float:
        """The lowest priority whose tiles all fit; sets ``full``."""
        every = np.concatenate(priorities) if priorities else np.empty(0)
        every = every[np.isfinite(every)]  # without pinned ones
        pinned = sum(held.sheet.pinned for held in self._held.values())
        room = 0 if self._atlas is None else max(self._atlas.capacity - pinned, 0)
        self._full = len(every) > room
        if not self._full:
            return -math.inf
        return float(np.nextafter(np.partition(every, len(every) - room - 1)[len(every) - room - 1], np.inf))

    def _upload(self, most: int) -> None:
        assert self._streamer is not None
        for layer, place, data in self._streamer.take(most):
            if place == OPENING:
                self._open(layer)
                continue
            held = self._held.get(layer)
            if held is None:  # dropped meanwhile
                continue
            self.loaded += 1
            self._came.append(held.sheet.area(place))
            self._insert(layer, held, place, data)

    def _insert(self, layer: Layer, held: Held, place: int, data: NDArray[Any]) -> None:
        assert self._atlas is not None
        page = THERE | np.uint32(held.sheet.level_of(place) << 24)
        if data.size:
            if self._atlas.slot((layer, place)) >= 0:
                self._atlas.replace((layer, place), data)  # there is more of it now
                return
            slot, before = self._atlas.put((layer, place), data, self._frame, pin=place < held.sheet.pinned)
            if slot < 0:
                self._refused = True
                return
            if before is not None:
                other = self._held[before[0]]
                other.own[before[1]], other.stale = 0, True
            page |= np.uint32(slot + 1)
        elif self._atlas.slot((layer, place)) >= 0:  # its earlier version showed nothing either
            self._atlas.free((layer, place))
        held.own[place], held.stale = page, True

    def _open(self, layer: Layer) -> None:
        """Take over a layer that a thread has opened."""
        sheet = self._sheets.pop(layer)
        if layer not in self._known:  # dropped meanwhile
            return
        if self._atlas is None:
            self._atlas = TileAtlas(
                self.device, SIDE, "rgba8unorm-srgb", 4, self.gpu_memory, 1 << 20, "imagery"
            )  # the capacity for all tiles that fit: other layers may follow
        self._held[layer] = Held(sheet, np.zeros(sheet.count, np.uint32), np.zeros(sheet.count, np.uint32))
        self.warnings += sheet.warnings
        self._buffer = None

    def _drop(self) -> None:
        """Forget layers that the scene no longer has."""
        for layer in [known for known in self._held if known not in self._known]:
            held = self._held.pop(layer)
            held.sheet.close()
            assert self._atlas is not None
            for place in np.flatnonzero(held.own & SLOT).tolist():
                self._atlas.free((layer, place))
            self._buffer = None

    # ---- the buffer ----------------------------------------------------------------------------------------------

    def _refresh(self, held: Held) -> None:
        """Update pages, on the GPU as well."""
        if not held.stale:
            return
        held.stale = False
        first, last = inherit(held.own, held.sheet.tree.parents, held.pages)
        if self._buffer is not None and first < last:
            at = 4 * (held.at + fixed(held.sheet) + first)
            self.device.queue.write_buffer(self._buffer, at, held.pages[first:last])

    def _write(self, layers: Sequence[Layer], view: View, taps: int) -> None:
        """Write all open layers to the buffer, and heads for those to draw; ``taps``: look-ups in a footprint."""
        for held in self._held.values():
            self._refresh(held)
        if self._buffer is None:
            parts, at = [np.zeros(STATIC, np.uint32)], STATIC
            for held in self._held.values():
                held.at = at
                words = [level_words(held.sheet), node_words(held.sheet), held.pages]
                parts += words
                at += sum(w.size for w in words)
            self._buffer = self.device.buffer(np.concatenate(parts), "STORAGE", "imagery")
        head = np.zeros(STATIC, np.uint32)
        head[:2] = len(layers), taps
        heads = head[HEADS:].view(HEAD_DTYPE)
        for k, layer in enumerate(layers):
            held = self._held[layer.content]
            aim(heads[k], held.sheet, held.at, view)
            heads[k]["opacity"], heads[k]["multiply"] = layer.opacity, layer.blend == "multiply"
        self.device.queue.write_buffer(self._buffer, 0, head)
