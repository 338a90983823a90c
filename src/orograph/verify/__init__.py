"""The referee: the errors of a mesh or a picture, measured against every point of the full-resolution terrain.

>>> from orograph import verify
>>> report = verify.judge_mesh(tessellation, terrain, view)   # doctest: +SKIP
>>> print(report)                                             # doctest: +SKIP
>>> assert report.ok(tolerance=1.0)                           # doctest: +SKIP
>>> verify.judge_depth(depth, terrain, view).largest          # doctest: +SKIP
>>> verify.judge_mesh(tessellation, terrain, verify.level_view(terrain)).largest  # metres   # doctest: +SKIP
>>> verify.hausdorff(tessellation, terrain).metres            # doctest: +SKIP
"""

from __future__ import annotations

from orograph.verify.depth import DepthReport, judge_depth
from orograph.verify.judge import judge_mesh
from orograph.verify.level import level_view
from orograph.verify.nearest import Distance, hausdorff
from orograph.verify.report import Report

__all__ = ["DepthReport", "Distance", "Report", "hausdorff", "judge_depth", "judge_mesh", "level_view"]
