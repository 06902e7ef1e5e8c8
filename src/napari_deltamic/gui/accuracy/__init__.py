"""What accuracy costs: the dial, forecasts, and measurements on the scene."""
