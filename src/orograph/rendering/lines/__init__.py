"""Lines drawn on the ground by both backends: contours and their labels, silhouettes."""
