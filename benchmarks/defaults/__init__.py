"""What the default command makes of many kinds of images: ``python -m benchmarks.defaults``."""
