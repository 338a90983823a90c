"""
Values over the ground
======================

Any array, raster or tile service can be a layer; the legend shows its values and unit.
"""

import matplotlib.pyplot as plt

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
slope = orograph.light(terrain, "slope", progress=False)
layer = orograph.Layer(slope.to_xarray(), colormap=plt.get_cmap("magma"), range=(0, 45), name="Slope", opacity=0.8)
picture = orograph.render(terrain, size=(960, 540), layers=[layer], exaggeration=1.5, furniture=True)
