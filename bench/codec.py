"""Bits per sample and millions of samples per second of the codecs for heights in steps, on chunks of 256².

    python bench/codec.py [--data ../shared/data] [--chunks 16] [--rounds 9] [--quick]

*portable*, *compact* and *smallest* are the codecs of stores, including the conversion from and to float32. *Lorenzo*
is W + N - NW with zstd at level 1 or 5, whichever is smaller, as a store without its own codec could have it. LERC and
JPEG XL come from imagecodecs, if that is installed, and get the same numbers. Times are processor time, the best of
several rounds; all codecs take turns in each round, so that other load slows them alike.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rasterio

from orograph._blosc import blosc
from orograph.store.array_spec import ArraySpec
from orograph.store.coding import CODECS, Packing, floored

SIDE = 256
TERRAIN = {
    "SRTM 3″, White Mountains": ("n44w072-hgt/N44W072.hgt", (1.0, 2.0)),
    "Big Tujunga, 30 m": ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", (1.0,)),
    "NRW surface model, 1 m": ("nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif", (0.01, 0.2)),
    "Gabilan lidar, 1 m": ("lsd-topo/gabilan.tif", (0.01, 0.2)),
}
"""Files, and steps in metres: the data's own, or twice the error."""

Coder = tuple[Callable[[Any], Any], Callable[[Any], Any]]


def chunks(path: Path, step: float) -> Iterator[np.ndarray]:
    """Whole chunks of heights in such steps, float32."""
    with rasterio.open(path) as file:
        heights = file.read(1, masked=True).astype(np.float64).filled(np.nan)
    heights = (np.rint(heights / step) * step).astype(np.float32)
    for row in range(0, heights.shape[0] - SIDE + 1, SIDE):
        for col in range(0, heights.shape[1] - SIDE + 1, SIDE):
            part = heights[row : row + SIDE, col : col + SIDE]
            if not np.isnan(part).any():
                yield np.ascontiguousarray(part)


def coders(step: float) -> dict[str, Coder]:
    """(Encode, decode) for heights, by name."""
    found: dict[str, Coder] = {}
    for codec in CODECS[:3]:  # (the chunks of *progressive* are those of *smallest*)
        spec = ArraySpec("heights/0/height", (SIDE, SIDE), SIDE, SIDE, packing=Packing(step, codec))
        found[codec] = (spec._compressed, spec.decompressed)
    packing = Packing(step, "portable")

    def lorenzo(heights: np.ndarray) -> bytes:
        around = np.pad(packing.numbers(heights), ((1, 0), (1, 0)))
        left = (around[1:, 1:] - around[1:, :-1] - around[:-1, 1:] + around[:-1, :-1]).astype(np.int32)
        left = (left << 1) ^ (left >> 31)
        return min((blosc.compress(left, b"zstd", level, blosc.SHUFFLE, 1 << 18) for level in (1, 5)), key=len)

    def unlorenzo(data: bytes) -> np.ndarray:
        left = np.frombuffer(blosc.decompress(data), np.int32).reshape(SIDE, SIDE)
        left = (left >> 1) ^ -(left & 1)
        return packing.heights(np.cumsum(np.cumsum(left, 0, dtype=np.int32), 1, dtype=np.int32))

    found["Lorenzo"] = (lorenzo, unlorenzo)
    try:
        import imagecodecs
    except ImportError:
        return found
    found["LERC"] = (lambda h: imagecodecs.lerc_encode(h, level=step / 2), imagecodecs.lerc_decode)

    for effort in (3, 7):

        def jxl(heights: np.ndarray, effort: int = effort) -> bytes:
            numbers = packing.numbers(heights)
            images = (numbers - numbers.min()).astype(np.uint16)
            return imagecodecs.jpegxl_encode(images, lossless=True, effort=effort, numthreads=1)

        found[f"JPEG XL, effort {effort}"] = (jxl, lambda data: imagecodecs.jpegxl_decode(data, numthreads=1))
    return found


def seconds(work: Callable[[Any], Any], given: Sequence[Any]) -> float:
    """Processor seconds of a call for all items."""
    began = time.process_time()
    for one in given:
        work(one)
    return time.process_time() - began


def measure(
    parts: Sequence[np.ndarray], coders: dict[str, Coder], rounds: int
) -> dict[str, tuple[float, float, float]]:
    """Bits per sample, and millions of samples per second of encoding and decoding, by name."""
    data = {name: [encode(part) for part in parts] for name, (encode, _) in coders.items()}
    encoding, decoding = dict.fromkeys(coders, 1e9), dict.fromkeys(coders, 1e9)
    for name, (_, decode) in coders.items():
        decode(data[name][0])
    for number in range(rounds):
        for name, (encode, decode) in coders.items():
            decoding[name] = min(decoding[name], seconds(decode, data[name]))
            if number % 3 == 0:  # (encoders are slow)
                encoding[name] = min(encoding[name], seconds(encode, parts))
    samples = SIDE * SIDE * len(parts)
    return {
        name: (8 * sum(map(len, data[name])) / samples, samples / encoding[name] / 1e6, samples / decoding[name] / 1e6)
        for name in coders
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--chunks", type=int, default=16, help="of each terrain, at most")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--quick", action="store_true", help="two chunks of each terrain, one round")
    given = parser.parse_args()
    most, rounds = (2, 1) if given.quick else (given.chunks, given.rounds)
    print("| heights | step, m | codec | bits a sample | encode, M samples/s | decode, M samples/s |")
    print("|---|---|---|---|---|---|")
    for name, (path, steps) in TERRAIN.items():
        if not (given.data / path).exists():
            continue
        for step in steps:
            # (where the step is not the data's own, the one that a store would use)
            kept = step if step in (1.0, 0.01) else floored(step)
            parts = list(chunks(given.data / path, kept))[:most]
            for codec, (bits, encoding, decoding) in measure(parts, coders(kept), rounds).items():
                print(f"| {name} | {kept:.4g} | {codec} | {bits:.2f} | {encoding:.0f} | {decoding:.0f} |", flush=True)


if __name__ == "__main__":
    main()
