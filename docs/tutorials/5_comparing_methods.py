"""
Comparing methods
=================

Published ways of drawing terrain stand behind one interface, and one referee measures them on the same data.
"""

# %%

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
orograph.methods()

# %%
# At a tolerance of one pixel, on three views. The referee looks at every sample in view, and at the surface between
# them; where a method promises the tolerance, "largest px" is no larger.

methods = ["top-down", "soar", "roam", "triangle-patches"]
orograph.compare(terrain, methods=methods, tolerance=1, size=(640, 360), progress=False)

# %%
# The same number of triangles instead: which error is left?

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
