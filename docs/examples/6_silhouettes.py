"""
Lines alone
===========

Silhouettes and contour lines on pale ground: a drawing rather than a picture.
"""

from matplotlib.colors import ListedColormap

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
view = orograph.camera.around(terrain, (960, 540), azimuth=160, pitch=16, distance=None, exaggeration=3)
picture = orograph.render(
    terrain, view, silhouettes=True, contours=50, light="none", colormap=ListedColormap(["#f3efe6"] * 2), water=None,
    exaggeration=3,
)  # fmt: skip
