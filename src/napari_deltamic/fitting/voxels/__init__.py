"""Which voxels count in a fit, and what light of other objects adds to them."""
