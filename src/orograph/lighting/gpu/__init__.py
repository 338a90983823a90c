"""Products of light made on the GPU: ambient occlusion by shadow maps and by cones, light through apertures."""
