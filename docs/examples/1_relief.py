"""
Relief
======

A DEM as a picture: all of it, from the south, lit from the north-west.
"""

import orograph
from orograph.sample import jacksboro

dem = jacksboro()
picture = orograph.render(dem, size=(960, 540), exaggeration=1.5, furniture=True)
