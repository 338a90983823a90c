"""
From a file to a picture
========================

Find out what is in an elevation file and what looks suspicious, and make the first pictures of it.
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
# ``info`` gives the file's location and sample spacing, and warns of anything suspicious. One call makes a picture;
# degrees become metres on the way.

first = orograph.render(path, size=(960, 540))

# %%
# If you call several functions, read the terrain once.

terrain = orograph.terrain(path)
terrain

# %%
# A camera is a ``View``. This one looks from 225°, 25° downwards, with the sun low in the west:

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
