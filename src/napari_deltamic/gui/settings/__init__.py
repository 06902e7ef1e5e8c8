"""What is chosen of a fit: how careful it is, the PSF, the corrections."""
