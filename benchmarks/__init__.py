"""Figures that the software is held to: ``python -m benchmarks --help``."""
