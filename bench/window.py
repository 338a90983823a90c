"""How long ``orograph view`` takes to show terrain: from exec to pixels on a screen.

    python bench/window.py [PATH...] [--runs N] [--size WxH] [--cold]

A virtual screen (Xvfb) is captured every few milliseconds, so the times are those of what a user sees, not what the
program reports. There are three, in seconds from exec: the window (anything is drawn: panels, a sentence), the ground
(a tenth of the middle of the picture is neither background nor sky), and a still picture (no change for a second).
``--cold``: also once with Mesa's shader cache empty (the first start on a machine; compiled kernels are kept). Uses
software Vulkan unless OROGRAPH_ADAPTER says otherwise. Needs Xvfb. The first run fills caches and is not counted.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ImageGrab

TILE = Path(__file__).parents[2] / "shared" / "data" / "n44w072-hgt" / "N44W072.hgt"
STEP = 0.04
"""Seconds between two captures, each of which takes 6 ms: some machines have only two processors."""
PATIENCE = 120.0
REST = 1.0


@dataclass(frozen=True, slots=True)
class Start:
    """Seconds from exec until the window, the ground, and a still picture."""

    window: float
    ground: float
    rest: float


def screen(width: int, height: int) -> tuple[subprocess.Popen[bytes], str]:
    """A virtual screen and its name."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp", "-noreset"],
        pass_fds=[write], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as number:
        return server, f":{number.readline().strip()}"


def look(display: str, size: tuple[int, int]) -> np.ndarray:
    """The middle of the terrain's area on the screen: (height, width, 3)."""
    w, h = size
    box = w * 3 // 8, h * 2 // 5, w * 5 // 8, h * 4 // 5
    return np.asarray(ImageGrab.grab(bbox=box, xdisplay=display).convert("RGB"))


def ground(picture: np.ndarray) -> bool:
    """Whether a tenth of it is lit ground.

    Ground is neither the dark of an empty window nor a smooth sky, whose neighbours down a column hardly differ.
    """
    some = picture[:, ::8].astype(int)
    lit = some.max(2)[1:] > 40
    rough = np.abs(np.diff(some, axis=0)).max(2) > 0
    return bool((lit & rough).mean() > 0.1)


def start(display: str, paths: list[str], size: tuple[int, int], env: dict[str, str]) -> Start:
    """Open a window on the paths, watch it, close it."""
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as log:
        program = subprocess.Popen(
            [sys.executable, "-m", "orograph", "view", *paths, "--size", f"{size[0]}x{size[1]}"],
            env={**env, "DISPLAY": display}, stdout=log, stderr=log,
        )  # fmt: skip
        try:
            window = seen = rest = 0.0
            before = None
            while not rest:
                time.sleep(STEP)
                now = time.perf_counter() - begun
                if program.poll() is not None or now > PATIENCE:
                    log.seek(0)
                    raise SystemExit(f"no picture after {now:.0f} s:\n{log.read().decode()}")
                picture = look(display, size)
                if not window and picture.max() > 0:
                    window = now
                if not seen and ground(picture):
                    seen = now
                if before is None or not np.array_equal(picture, before):
                    before, changed = picture, now
                elif seen and now - changed > REST:
                    rest = changed
            return Start(window, seen, rest)
        finally:
            program.kill()
            program.wait()


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", default=[str(TILE)], help="default: an SRTM tile of the open data")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--cold", action="store_true")
    args = parser.parse_args()
    width, height = (int(v) for v in args.size.split("x"))
    server, display = screen(width, height)
    try:
        with tempfile.TemporaryDirectory() as folder:
            config = Path(folder) / "config"
            env = {"OROGRAPH_ADAPTER": "software", **os.environ, "OROGRAPH_CONFIG": str(config)}
            env.pop("WAYLAND_DISPLAY", None)
            start(display, args.paths, (width, height), env)
            runs = [start(display, args.paths, (width, height), env) for _ in range(args.runs)]
            rows = [("warm", Start(*(statistics.median(getattr(r, n) for r in runs) for n in Start.__slots__)))]
            rows.append(("warm, best", min(runs, key=lambda r: r.ground)))
            if args.cold:
                empty = {**env, "MESA_SHADER_CACHE_DIR": str(Path(folder) / "shaders")}
                rows.append(("no shader cache", start(display, args.paths, (width, height), empty)))
    finally:
        server.terminate()
        server.wait()
    print(f"{'seconds until':16} {'window':>8} {'ground':>8} {'rest':>8}")
    for name, r in rows:
        print(f"{name:16} {r.window:8.2f} {r.ground:8.2f} {r.rest:8.2f}")


if __name__ == "__main__":
    main()
