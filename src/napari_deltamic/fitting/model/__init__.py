"""What is fitted, and to what: unknowns, levels of the image, likelihood, states."""
