"""The choice of the PSF."""
