"""The description of what is drawn, without any drawing: ``scene``, ``camera``, ``contours``, ``silhouettes``,
``diagnostics``."""
