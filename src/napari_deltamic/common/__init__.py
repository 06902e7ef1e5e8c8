"""What every part may use, independent of the engine: names to choose from, safe writing."""
