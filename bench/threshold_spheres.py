"""Threshold spheres on a smooth flight: the part of the front that a frame checks again, and what that costs.

    python bench/threshold_spheres.py [HEIGHTS.npy | DEM | --size 4097] [--cell 30] [--frames 60] [--tolerance 1]

The eye flies 300 m above the ground (the flight of ``bench/roam.py``) at several speeds, straight on or turning, with
each metric. Figures are medians over frames. The first frame builds the mesh and is listed separately.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from orograph.lod.method import Goal
from orograph.lod.threshold_spheres import ThresholdSpheres
from orograph.viewpoint import Camera, View
from roam import RATE, flight, load
from synthetic import synthetic


def turned(view: View, degrees: float) -> View:
    """The view with its target turned to the left around the vertical through the eye."""
    angle = np.radians(degrees)
    x, y = view.target[0] - view.eye[0], view.target[1] - view.eye[1]
    x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    return replace(view, target=(view.eye[0] + x, view.eye[1] + y, view.target[2]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("heights", nargs="?", help="default: a synthetic terrain")
    parser.add_argument("--size", type=int, default=4097, help="its samples along a side")
    parser.add_argument("--cell", type=float, default=30.0)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--tolerance", type=float, default=1.0)
    given = parser.parse_args()
    t = load(given.heights, given.cell) if given.heights else synthetic(given.size, cell=given.cell)
    print(f"{Path(t.name).name}, {given.tolerance:g} px, {given.frames} frames; {RATE:g} frames/s")
    print(f"{'metric':12}{'m/frame':>8}{'°/frame':>8}{'front':>9}{'drawn':>9}{'looked at':>10}{'changed':>9}"
          f"{'of front':>9}{'update':>8}{'put out':>9}{'first':>8}")  # fmt: skip
    for metric in ("anisotropic", "isotropic"):
        method = ThresholdSpheres(t, metric=metric)
        for step, turn in ((1.0, 0.0), (3.0, 0.0), (10.0, 0.0), (30.0, 0.0), (3.0, 0.03), (3.0, 0.3), (0.0, 0.3)):
            method.reset()
            rows = []
            views = flight(t, given.frames, step * RATE)
            start = views[0]
            for number, view in enumerate(views):
                # (the flight's own turn, 2° a second, is taken out)
                ahead = np.subtract(view.eye, start.eye)
                way = float(np.hypot(ahead[0], ahead[1]))
                x, y = start.target[0] - start.eye[0], start.target[1] - start.eye[1]
                far = np.hypot(x, y)
                eye = (start.eye[0] + way * x / far, start.eye[1] + way * y / far, view.eye[2])
                straight = replace(view, eye=eye, target=(eye[0] + x, eye[1] + y, eye[2] - 400), width=1280, height=720)
                mesh, _ = method.mesh(Camera.over(t.grid, turned(straight, turn * number)), Goal(given.tolerance))
                s = mesh.stats
                rows.append([s["front"], mesh.triangles, s["visits"], s["splits"] + s["merges"], s["update_ms"],
                             s["output_ms"]])  # fmt: skip
            front, drawn, visits, changes, update, output = np.median(rows[1:], axis=0)
            print(f"{metric:12}{step:8g}{turn:8g}{front:9.0f}{drawn:9.0f}{visits:10.0f}{changes:9.0f}"
                  f"{visits / front:9.2%}{update:8.1f}{output:9.1f}{rows[0][4]:8.0f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
