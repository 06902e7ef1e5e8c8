"""The scene: a grid, what is in it, and how it becomes an image."""

from .grid import Grid
from .render import Renderer, render

__all__ = ["Grid", "Renderer", "render"]
