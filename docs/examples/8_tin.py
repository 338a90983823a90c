"""
A TIN
=====

As few triangles as a bound in metres allows: small where the ground is rough, large where it is smooth.
"""

import matplotlib.pyplot as plt

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
mesh = orograph.tin(terrain, max_error=40, progress=False)

x, y = terrain.grid.xy(mesh.vertices[:, 0], mesh.vertices[:, 1])
fig, ax = plt.subplots(figsize=(8, 7))
orograph.render(terrain, "plan", size=(700, 700)).plot(ax)
ax.triplot(x, y, mesh.triangles, color="black", linewidth=0.4)
ax.set_title(f"{len(mesh.triangles):,} triangles, off by at most {mesh.stats['largest']:.0f} m")
