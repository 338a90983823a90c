"""What is drawn, and nothing that draws: ``scene``, ``camera``, ``contours``, ``silhouettes``, ``diagnostics``."""
