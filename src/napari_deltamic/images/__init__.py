"""Images: stacks and series from files, their voxel size, missing voxels."""
