"""Linear algebra that knows nothing of images: L-BFGS, factors, preconditioners."""
