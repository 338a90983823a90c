"""Ground drawn into the G-buffer on the GPU: patches, meshes, fills over missing ground."""
