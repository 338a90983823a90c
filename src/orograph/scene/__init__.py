"""The description of what is drawn, without any drawing.

See ``scene``, ``camera``, ``contours``, ``silhouettes``, ``diagnostics``.
"""
