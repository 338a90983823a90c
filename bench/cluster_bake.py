"""The cost of one task of a distributed bake, shard by shard: seconds, bytes read and written, and memory.

    python bench/cluster_bake.py STORE [--azimuths 16]

The tasks run here, one after the other, with the state that a worker has. Nothing is written into the store.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

from orograph.lighting.bake import BAKED, _record
from orograph.lighting.bake_folder import KEY, kept
from orograph.lighting.bake_state import BakeState, SweepStage, recipe_of
from orograph.lighting.context import Options
from orograph.lighting.products import product
from orograph.store.storage import FolderStorage
from orograph.store.stored import read_record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store")
    parser.add_argument("--azimuths", type=int, default=16)
    parser.add_argument("--products", default="sky-view-factor,aperture")
    parser.add_argument("--tasks", type=int, default=12, help="tasks to measure")
    args = parser.parse_args()
    options = Options(azimuths=args.azimuths)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.oro"
        shutil.copytree(args.store, copy, ignore=shutil.ignore_patterns("layers"))
        storage = FolderStorage(copy)
        record = read_record(storage)
        made = [_record(product(name), options, None, record) for name in args.products.split(",") if name in BAKED]
        kept(storage, record, made, True)
        plan = storage.get(KEY) or b""
        recipe = recipe_of(storage, storage.named(), options, made, plan, record.shard, 1 << 30)
        state = BakeState(recipe)
        read, written = [0], [0]
        get, put = state.storage.get, state.storage.put

        def counted_get(key):
            data = get(key)
            read[0] += len(data or b"")
            return data

        def counted_put(key, parts):
            written[0] += sum(map(len, parts))
            put(key, parts)

        state.storage.get, state.storage.put = counted_get, counted_put
        heights = state.context.heights
        swept = [0]

        def counted(*window):
            found = heights(*window)
            swept[0] += found.nbytes
            return found

        state.context.heights = counted
        rows, done = [], 0
        for number in range(len(state.numbers)):
            stage = SweepStage(state, number)
            for spot in stage.tasks():
                read[0] = written[0] = swept[0] = 0
                tracemalloc.start()
                began = time.process_time()
                stage.make(spot)
                seconds, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1]
                tracemalloc.stop()
                rows.append((seconds, swept[0], read[0], written[0], peak))
                done += 1
            if done >= args.tasks:
                break
        table = np.array(rows[1:])  # the first one compiles the kernels, or loads them
        print(f"{len(table)} tasks, {args.azimuths} azimuths, {args.products}")
        for name, column, unit in zip(
            ("processor", "heights read", "sums and hulls read", "written", "peak of arrays"), table.T,
            (1.0, 1e6, 1e6, 1e6, 1e6),
        ):  # fmt: skip
            shown = "s" if unit == 1.0 else "MB"
            print(f"{name:22} mean {column.mean() / unit:8.1f} {shown}  most {column.max() / unit:8.1f} {shown}")


if __name__ == "__main__":
    main()
