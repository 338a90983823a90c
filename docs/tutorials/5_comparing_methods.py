"""
Comparing methods
=================

Published methods of drawing terrain share one interface, and one referee measures them on the same data.
"""

# %%

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
orograph.methods()

# %%
# First, compare at a tolerance of one pixel, in three views. The referee checks every sample in view and the surface
# between samples; where a method promises the tolerance, "largest px" does not exceed it.

methods = ["top-down", "soar", "roam", "triangle-patches"]
orograph.compare(terrain, methods=methods, tolerance=1, size=(640, 360), progress=False)

# %%
# Then compare with equal numbers of triangles: which error remains?

orograph.compare(terrain, methods=["soar", "roam"], triangles=6000, size=(640, 360), progress=False)

# %%
# The meshes side by side:

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

sheet = Path(mkdtemp()) / "sheet.png"
orograph.compare(terrain, methods=["soar", "roam"], tolerance=3, size=(640, 360), picture=sheet, progress=False)
fig, ax = plt.subplots(figsize=(10, 5))
ax.imshow(plt.imread(sheet))
ax.set_axis_off()
fig.tight_layout(pad=0)
