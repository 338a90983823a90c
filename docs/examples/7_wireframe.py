"""
The mesh of a method
====================

The triangles that SOAR makes within two pixels, drawn as they are.
"""

import orograph
from orograph.sample import jacksboro

terrain = orograph.terrain(jacksboro(), progress=False)
picture = orograph.render(terrain, size=(960, 540), method="soar", tolerance=2, wireframe=True, exaggeration=1.5)
