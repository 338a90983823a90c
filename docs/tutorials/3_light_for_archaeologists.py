"""
Light for archaeologists
========================

Ditches and banks of half a metre may not show in a hillshade lit from one side. Maps of light reveal them.
"""

# %%
# A sloping field at 1 m has a ring ditch, a bank and the ridges of old ploughing, 20 to 50 cm high or deep.

import numpy as np

import orograph

rng = np.random.default_rng(1)
y, x = np.mgrid[:300, :400].astype(float)
ground = 0.06 * x + 0.03 * y + 2 * np.sin(x / 90) * np.cos(y / 70)
ring = np.hypot(x - 140, y - 150)
ground -= 0.5 * np.exp(-(((ring - 60) / 4) ** 2))
ground += 0.4 * np.exp(-(((x - 0.5 * y - 240) / 6) ** 2))
ground += 0.15 * np.sin((x + 0.3 * y) / 2.2) * (x > 250)
terrain = orograph.terrain((ground + rng.normal(0, 0.02, ground.shape)).astype(np.float32), False, spacing=1.0)

# %%
# A hillshade hides features that lie parallel to the light.

import matplotlib.pyplot as plt

products = ["hillshade", "sky-view-factor", "openness", "openness-negative"]
fig, axes = plt.subplots(2, 2, figsize=(10, 7.6))
for ax, product in zip(axes.flat, products):
    values = orograph.light(terrain, product, radius=30, progress=False).values[0]
    low, high = np.nanpercentile(values, (1, 99))
    ax.imshow(values, cmap="gray", vmin=low, vmax=high)
    ax.set_title(product)
    ax.set_axis_off()
fig.tight_layout()

# %%
# The map can also be a layer over relief: here openness, multiplied onto an oblique view.

openness = orograph.light(terrain, "openness", radius=30, progress=False)
layer = orograph.Layer(openness.to_xarray(), colormap="grey", blend="multiply")
view = orograph.camera.around(terrain, (960, 540), azimuth=200, pitch=35, distance=None, exaggeration=4)
picture = orograph.render(terrain, view, layers=[layer], exaggeration=4, water=None)
