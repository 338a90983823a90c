"""A map's furniture: title, colour bar, north arrow, scale bar, and their lettering."""
