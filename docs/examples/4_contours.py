"""
A map with contour lines
========================

A plan is a map in the terrain's CRS, so matplotlib can draw over it in the same coordinates.
"""

import matplotlib.pyplot as plt

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
plan = orograph.render(terrain, "plan", size=(700, 700), contours=50)

fig, ax = plt.subplots(figsize=(7, 6))
plan.plot(ax)
plan.colorbar(ax)
ax.plot(*terrain.grid.xy([60, 300], [80, 250]), "o-", color="crimson")
