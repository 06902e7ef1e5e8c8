"""Panels for the choices of a fit: how careful it is, the PSF, the corrections."""
