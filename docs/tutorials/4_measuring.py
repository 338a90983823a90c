"""
Measuring
=========

Lengths, areas, sight lines and viewsheds on the true surface, in true metres.
"""

# %%

import matplotlib.pyplot as plt

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
(a, b), (c, d) = (terrain.grid.xy(col, row) for col, row in ((80, 250), (300, 90)))

# %%
# ``place`` gives height, slope and aspect: ``height`` is the file's own, ``surface_height`` that of the grid.

place = orograph.measure.place(terrain, (a, b))
print(place)

# %%
# A profile is cut wherever its line crosses an edge of the surface, so its length is exact.

profile = orograph.measure.profile(terrain, [(a, b), (c, d)])
print(f"{profile.length:.1f} m along the ground, {profile.distance[-1]:.1f} m on the ellipsoid, "
      f"{profile.climb:.0f} m up, {profile.descent:.0f} m down")  # fmt: skip
fig, ax = plt.subplots(figsize=(9, 2.6))
ax.fill_between(profile.distance / 1000, profile.heights, profile.lowest, color="tan")
ax.set_xlabel("km")
ax.set_ylabel("m")
fig.tight_layout()

# %%
# Is the second place visible from the first, with eyes 1.7 m above the ground?

sight = orograph.measure.line_of_sight(terrain, (a, b), (c, d), 1.7, 0.0)
print("seen" if sight.visible else "hidden")

# %%
# The viewshed of the second place, for an eye 10 m above it (dark: visible).

shed = orograph.measure.viewshed(terrain, (c, d), 10.0, radius=20_000)
values = shed.values()
fig, ax = plt.subplots(figsize=(6, 5))
ax.imshow(values, cmap="Greys")
ax.set_axis_off()
