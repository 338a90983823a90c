"""
Ambient occlusion
=================

Light of the whole sky: valleys are darker than ridges, whichever way they run.
"""

import orograph
from orograph.sample import jacksboro

picture = orograph.render(jacksboro(), size=(960, 540), light="ao", exaggeration=2, colormap="grey", progress=False)
