"""
Evening light
=============

The sun at a given date and hour, long shadows, a sky, and haze in the distance.
"""

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
view = orograph.camera.around(terrain, (960, 540), azimuth=225, pitch=22, distance=None, exaggeration=2)
picture = orograph.render(terrain, view, sun="2026-10-21T17:00-05:00", sky=True, exaggeration=2)
