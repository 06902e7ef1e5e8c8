"""Other models of what shines and of the PSF, held against the one that was fitted."""
