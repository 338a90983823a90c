"""A map's furniture: title, colour bar, north arrow, scale bar, and the lettering of all."""
