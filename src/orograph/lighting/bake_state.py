"""Light baked by the workers of a cluster: the tasks, and the files between them.

*Horizons without a radius.* All azimuths of one axis and sense form a way over the terrain (four at most), and strips
of shards (``STRIPS``) with the same steps form a row. A task sweeps one strip in all azimuths of a way
(``sweep_part``). It reads the heights of the strip and as much on either side as lines shift within it, the hulls that
its neighbours in the row in front have left, and the strip's sums from the way before; it writes the sums, and the
hulls that leave the strip. Rows follow one another; strips of a row are swept at once. Lines that cross from one strip
of a row into the next are swept in both; the flatter strips are, the fewer lines do so. Sums are stored in squares as
long as strips are wide, because the strips of the next way may be perpendicular. *Within a radius* a task needs only
heights: it sweeps a shard in all azimuths.

*Rays and walks* are made window by window, and so are products of a GPU, by workers that have one. In the end a task
encodes a shard's values (``bake_layers``).

Sums are added in the order of azimuths of one process, so the bytes are those of one process. All files are in
``layers/.partial`` until the bake is complete: in a folder, or in the store's bucket, where workers of other machines
find them.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import StoreError
from orograph.lighting.bake_folder import partial_of
from orograph.lighting.bake_layers import LayerStage, is_cap, layer_stages
from orograph.lighting.context import BASE, Context, Options, Values
from orograph.lighting.gather import Sweep, Window
from orograph.lighting.products import product
from orograph.lighting.raster_resume import PLAN, Checkpoint
from orograph.lighting.sweep import Block, ways
from orograph.lighting.sweep_lines import Lines
from orograph.lighting.sweep_part import Hulls, Part
from orograph.progress import Progress, Within
from orograph.store.addresses import storage_at
from orograph.store.clusters import Cluster
from orograph.store.digests import Spot
from orograph.store.executing import Stage
from orograph.store.layers import PARTIAL, LayerRecord
from orograph.store.parts import pieces, unpack
from orograph.store.storage import FolderStorage
from orograph.store.stored import open as open_store
from orograph.store.worker_state import guarded
from orograph.store.writer import ShardWriter

CACHE = 64 << 20
"""Bytes of a worker's cache of heights."""

STRIPS = 4
"""Strips of a shard: an eighth of the lines of all directions is then swept twice (half with whole shards)."""

SWEEP = 192 << 20
"""Bytes for the heights, slopes and stacks of a task."""


class BakeRecipe(NamedTuple):
    """What workers receive once for a bake.

    Attributes:
        named: the store (``Storage.named``). folder: the parent of ``layers/.partial``, the store's or another; "": the
            store's bucket.
        options: of the products. layers: to make. plan: as stored in the bake's folder.
        memory, base: as for all recipes.
    """

    named: tuple[str, dict[str, Any] | None]
    folder: str
    options: Options
    layers: list[LayerRecord]
    plan: bytes
    memory: int
    base: int

    def open(self) -> BakeState:
        return BakeState(self)


def recipe_of(
    folder: FolderStorage | None, named: tuple[str, dict[str, Any] | None], options: Options, layers: list[LayerRecord],
    plan: bytes, shard: int, memory: int,
) -> BakeRecipe:  # fmt: skip
    """The recipe of a bake.

    Args:
        folder: None: the store's bucket. named, options, layers, plan: as for the recipe.
        shard: samples along the sides of the store's shards. memory: bytes for each task, if they suffice.
    """
    # Sums may be larger than the values that follow from them.
    bands = sum(len(layer.bands) for layer in layers) + 2 * len(layers)
    needed = SWEEP + 3 * 4 * bands * shard * shard
    at = "" if folder is None else str(folder.path.absolute())
    return BakeRecipe(named, at, options, layers, plan, max(needed, memory - BASE), BASE)


class BakeState:
    """What one process needs for a bake.

    Attributes:
        groups: the products (their numbers) that share sweeps, with their ways.
        made: where layers are made: with the sweeps, unless parts make them in a bucket.
    """

    def __init__(self, recipe: BakeRecipe) -> None:
        self.recipe = recipe
        url, options = recipe.named
        folder = Path(recipe.folder) / PARTIAL if recipe.folder else None
        self.storage = guarded(
            FolderStorage(folder) if folder is not None else partial_of(storage_at(url, options)), PLAN, recipe.plan
        )
        self.made = self.storage
        self.terrain = open_store(url, cache_bytes=CACHE, storage_options=options)
        self.record = self.terrain.record
        self.strip = max(1, self.record.shard // STRIPS)
        kept = None if folder is None else Checkpoint(folder, json.loads(recipe.plan or b"{}"))
        self.context = Context(
            self.terrain, recipe.options, jobs=1, max_memory=recipe.base + recipe.memory, kept=kept
        )  # fmt: skip
        self.products = [product(layer.name) for layer in recipe.layers]
        self._own = threading.local()
        self._stages: dict[tuple[str, int], Stage[Any]] = {}
        self.sweeps = {
            k: made for k, each in enumerate(self.products) if isinstance(made := each.make(self.context), Sweep)
        }
        alike: dict[Any, list[int]] = {}
        for k, sweep in self.sweeps.items():
            alike.setdefault(sweep.group, []).append(k)
        self.groups = [(group, self._ways(group)) for group in alike.values()]
        self.numbers = [
            (g, w, row) for g, (_, of) in enumerate(self.groups) for w in range(len(of)) for row in self.rows(of[w])
        ]  # fmt: skip

    def _ways(self, group: list[int]) -> list[list[list[Lines]]]:
        """The ways of a group: one for each axis and sense, one after the other; or a single one for all."""
        found = ways(self.sweeps[group[0]].azimuths, self.context.linear, self.context.shape)
        return [found] if self.recipe.options.radius is not None else [[way] for way in found]

    def rows(self, together: list[list[Lines]]) -> list[int]:
        """The rows of strips along the steps of a way, in order; [-1]: all shards at once."""
        if self.recipe.options.radius is not None:
            return [-1]
        (way,) = together
        rows = range(-(-way[0].steps // self.strip))
        return list(reversed(rows) if way[0].backward else rows)

    def stage(self, name: str, number: int) -> Stage[Any]:
        if (name, number) not in self._stages:
            self._stages[name, number] = self.layer(number) if name == LayerStage.name else SweepStage(self, number)
        return self._stages[name, number]

    def layer(self, number: int) -> LayerStage:
        """The stage of a layer."""
        layer = self.recipe.layers[number]
        writer = ShardWriter(self.made)

        def reader(spot: Spot) -> Callable[[Window], Values]:
            window = stage.window(spot)
            return self._summed(number, spot, window) if number in self.sweeps else self._windows(number, window)

        stage = LayerStage(writer, self.record, layer, is_cap(layer), reader, True, number)
        return stage

    def own(self, window: Window) -> dict[int, Sweep]:
        """The sweeps, with windows counted from a shard's first row and column; valid until this thread's next call."""
        own = self._own
        if not hasattr(own, "context"):
            own.context = _Shifted(self.context)
            own.sweeps = {k: self.products[k].make(own.context) for k in self.sweeps}
        own.context.move(window)
        found: dict[int, Sweep] = own.sweeps
        return found

    def _summed(self, number: int, spot: Spot, window: Window) -> Callable[[Window], Values]:
        """A function that returns a product's values from a shard's sums."""
        g, (_, of) = next((g, each) for g, each in enumerate(self.groups) if number in each[0])
        sweep = self.own(window)[number]
        canvas = self.sums(folder_of(g, len(of) - 1), window, {number: sweep})[number]

        def read(of: Window) -> Values:
            return sweep.finish(canvas, (of[0] - window[0], of[1] - window[0], of[2] - window[2], of[3] - window[2]))

        return read

    def squares(self, window: Window) -> list[Window]:
        """The squares of sums that make up a window, which begins with one."""
        row0, row1, col0, col1 = window
        side = self.strip
        return [
            (row, min(row + side, row1), col, min(col + side, col1))
            for row in range(row0, row1, side) for col in range(col0, col1, side)
        ]  # fmt: skip

    def sums(self, folder: str, window: Window, sweeps: dict[int, Sweep]) -> dict[int, Values]:
        """The sums of a window after a way.

        Raises:
            ValueError: they are damaged, or not there.
        """
        row0, row1, col0, col1 = window
        found = {k: np.empty((sweep.bands, row1 - row0, col1 - col0), np.float32) for k, sweep in sweeps.items()}
        for square in self.squares(window):
            kept = unpack(self.storage.get(self.square(folder, square)) or b"")
            r0, r1, c0, c1 = square
            for k, canvas in found.items():
                canvas[:, r0 - row0 : r1 - row0, c0 - col0 : c1 - col0] = kept[str(k)]
        return found

    def square(self, folder: str, square: Window) -> str:
        """Where the sums of a square are stored."""
        return f"{folder}/{square[0] // self.strip}.{square[2] // self.strip}.sums"

    def _windows(self, number: int, window: Window) -> Callable[[Window], Values]:
        """A function that returns the values of a product made window by window."""
        context = Context(
            self.terrain, self.recipe.options, jobs=1, max_memory=self.context.max_memory, kept=self.context.kept,
            only=window,
        )  # fmt: skip
        made = self.products[number].make(context)
        assert not isinstance(made, Sweep)
        row0, row1, col0, col1 = window
        values = np.empty((len(self.recipe.layers[number].bands), row1 - row0, col1 - col0), np.float32)
        for row, col, block in made:
            r0, c0 = max(row, row0), max(col, col0)
            r1, c1 = min(row + block.shape[1], row1), min(col + block.shape[2], col1)
            values[:, r0 - row0 : r1 - row0, c0 - col0 : c1 - col0] = block[:, r0 - row : r1 - row, c0 - col : c1 - col]
        return lambda of: values[:, of[0] - row0 : of[1] - row0, of[2] - col0 : of[3] - col0]


class _Shifted(Context):
    """A context whose windows are counted from the first row and column of a window of the terrain."""

    def __init__(self, whole: Context) -> None:
        super().__init__(whole.terrain, whole.options, jobs=1, max_memory=whole.max_memory)
        self._whole, self._at = whole, (0, 0)

    def move(self, window: Window) -> None:
        self._at, self.shape = (window[0], window[2]), (window[1] - window[0], window[3] - window[2])

    def heights(self, row0: int, row1: int, col0: int, col1: int) -> Values:
        row, col = self._at
        return self._whole.heights(row0 + row, row1 + row, col0 + col, col1 + col)

    def gradient(self, row0: int, row1: int, col0: int, col1: int) -> tuple[Values, Values]:
        row, col = self._at
        return self._whole.gradient(row0 + row, row1 + row, col0 + col, col1 + col)


def folder_of(group: int, way: int) -> str:
    """Where the sums and hulls of a way are stored."""
    return f"sweeps/{group}.{way}"


class SweepStage(Stage[bool]):
    """The strips of a row, swept in all azimuths of a way (or all shards, in all azimuths)."""

    name = "sweep"

    def __init__(self, state: BakeState, number: int) -> None:
        self.state, self.number = state, number
        self.group, self.way, self.row = state.numbers[number]
        self.products, of = state.groups[self.group]
        self.ways = of[self.way]
        self.shard = state.record.shard
        names = ", ".join(state.products[k].name for k in self.products)
        self.label = f"Sweeping horizons for {names}"

    @property
    def place(self) -> str:
        return self.state.terrain.url

    def tasks(self) -> list[Spot]:
        rows, cols = (-(-n // self.shard) for n in self.state.context.shape)
        if self.row < 0:
            return [(i, j) for i in range(rows) for j in range(cols)]
        if self.ways[0][0].by_columns:
            return [(i, self.row) for i in range(rows)]
        return [(self.row, j) for j in range(cols)]

    def window(self, spot: Spot) -> Window:
        """The samples of a task."""
        tall = wide = self.shard
        if self.row >= 0:
            tall, wide = (tall, self.state.strip) if self.ways[0][0].by_columns else (self.state.strip, wide)
        row, col = spot[0] * tall, spot[1] * wide
        rows, cols = self.state.context.shape
        return row, min(row + tall, rows), col, min(col + wide, cols)

    def key(self, spot: Spot) -> str:
        return f"{folder_of(self.group, self.way)}/{spot[0]}.{spot[1]}.swept"

    def kept(self, spot: Spot) -> bool:
        return self.state.storage.exists(self.key(spot))

    def found(self, spot: Spot, proof: bool = True) -> bool | None:
        if not self.kept(spot):
            return None
        try:
            for square in self.state.squares(self.window(spot)) if proof else ():
                unpack(self.state.storage.get(self.state.square(folder_of(self.group, self.way), square)) or b"")
        except ValueError:
            return None
        return True

    def forget(self, spot: Spot) -> None:
        """Remove the sums that a task has used up."""
        self.state.storage.remove(self.key(spot))
        for square in self.state.squares(self.window(spot)):
            self.state.storage.remove(self.state.square(folder_of(self.group, self.way), square))

    def add(self, spot: Spot, found: bool) -> None:
        """Nothing to add: sums are in files."""

    def make(self, spot: Spot) -> bool:
        state, storage = self.state, self.state.storage
        window = self.window(spot)
        sweeps = {k: state.own(window)[k] for k in self.products}
        canvases = self._before(window, sweeps)

        def add(block: Block) -> None:
            for k, sweep in sweeps.items():
                sweep.add(canvases[k], block, 0, block.row1 - block.row0)

        first = next(iter(sweeps.values()))
        terms = state.context.terms(first.lowest, first.below)
        for way in self.ways:
            part = Part(way, state.context.shape, terms, window)
            left: dict[str, NDArray[Any]] = {}
            for index, hulls in part.sweep(state.context.heights, self._handed(part, spot), add, 1, SWEEP // 2):
                left |= hulls.packed(index)
            if left:
                storage.put(self._hulls(spot), pieces(left))
        folder = folder_of(self.group, self.way)
        for square in state.squares(window):
            r0, r1, c0, c1 = square
            own = slice(None), slice(r0 - window[0], r1 - window[0]), slice(c0 - window[2], c1 - window[2])
            storage.put(state.square(folder, square), pieces({str(k): sums[own] for k, sums in canvases.items()}))
        storage.put(self.key(spot), [b"all of its sums are there"])
        return True

    def _before(self, window: Window, sweeps: dict[int, Sweep]) -> dict[int, Values]:
        """The sums of a task's samples after the way before."""
        if self.way == 0:
            shape = window[1] - window[0], window[3] - window[2]
            return {k: np.zeros((sweep.bands, *shape), np.float32) for k, sweep in sweeps.items()}
        return self.state.sums(folder_of(self.group, self.way - 1), window, sweeps)

    def _hulls(self, spot: Spot) -> str:
        return f"{folder_of(self.group, self.way)}/{spot[0]}.{spot[1]}.hulls"

    def _handed(self, part: Part, spot: Spot) -> Callable[[int], list[Hulls]]:
        """Azimuth → the hulls left by the parts in front; none before the first row."""
        if part.terms.radius is not None or self.number == 0 or self.state.numbers[self.number - 1][:2] != (
            self.group, self.way,
        ):  # fmt: skip
            return lambda index: []
        row = self.state.numbers[self.number - 1][2]
        spots = [(lane, row) if part.by_columns else (row, lane) for lane in part.before(self.shard)]
        before = [unpack(self.state.storage.get(self._hulls(at)) or b"") for at in spots]
        return lambda index: [Hulls.unpacked(each, index) for each in before]


def on_cluster(cluster: Cluster, state: BakeState, writer: ShardWriter, progress: Progress) -> None:
    """Make all shards of a bake's layers.

    Args:
        state: of this process. writer: of the coarse shards.

    Raises:
        StoreError: tasks were given up.
    """
    layers = layer_stages(writer, state.record, state.recipe.layers)
    for g, (group, of) in enumerate(state.groups):
        if all(layers[k].kept(spot) for k in group for spot in layers[k].tasks()):
            continue
        stages = [SweepStage(state, n) for n, (h, _, _) in enumerate(state.numbers) if h == g]
        with progress.task(stages[0].label, total=sum(len(stage.tasks()) for stage in stages)) as task:
            for way in range(len(of)):
                mine = [stage for stage in stages if stage.way == way]
                done = f"{folder_of(g, way)}.done"
                if state.storage.exists(done):
                    task.advance(sum(len(stage.tasks()) for stage in mine))
                    continue
                for stage in mine:
                    cluster.run(stage, Within(progress, task))
                state.storage.put(done, [b"all of this way is swept"])
                if way:
                    with contextlib.suppress(StoreError):  # a worker that was written off may still write there
                        state.storage.remove(folder_of(g, way - 1))
    for layer in layers:
        cluster.run(layer, progress)
