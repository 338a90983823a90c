"""What views want of terrain and imagery, read by threads into atlases on the GPU."""
