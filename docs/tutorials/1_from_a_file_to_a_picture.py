"""
From a file to a picture
========================

What is in an elevation file, what is odd about it, and the first pictures of it.
"""

# %%
# Any raster that GDAL reads will do; here the built-in sample is written as a GeoTIFF.

from pathlib import Path
from tempfile import mkdtemp

import orograph
from orograph.sample import write_jacksboro

path = write_jacksboro(Path(mkdtemp()))
orograph.info(path)

# %%
# ``info`` says where it lies, how far apart its samples are, and warns of what is suspicious. One call makes a picture;
# degrees became metres on the way.

first = orograph.render(path, size=(960, 540))

# %%
# Who calls several functions reads the terrain once.

terrain = orograph.terrain(path)
terrain

# %%
# A camera is a ``View``. Seen from 225°, looking down by 25°, with the sun low in the west:

view = orograph.camera.around(terrain, (960, 540), azimuth=225, pitch=25, distance=None, exaggeration=1.5)
second = orograph.render(terrain, view, sun=(270, 20), sky=True, exaggeration=1.5)

# %%
# A part of it, with a title, a scale bar and a legend:

box = (-84.35, 36.52, -84.20, 36.64)
third = orograph.render(path, size=(960, 540), bbox=box, exaggeration=1.5, furniture=True, title="Jacksboro fault")

# %%
# ``third.save("fault.png")`` writes it; the command line does the same:
#
# .. code-block:: console
#
#     $ orograph render jacksboro.tif --bbox -84.35,36.52,-84.20,36.64 --exaggeration 1.5 --furniture -o fault.png
