"""What every part may use, free of the engine: names to choose from, files written safely."""
