"""What accuracy costs: forecasts, measured trade-offs, and their charts."""
