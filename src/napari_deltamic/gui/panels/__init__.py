"""The image and its settings."""
