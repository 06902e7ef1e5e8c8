"""The scene: a grid, the structures in it, and how they become an image."""

from .grid import Grid
from .random_cells import random_cells
from .render import Renderer, expected_image, render, render_scene
from .scene import Scene
from .simulate import Simulation, simulate
from .structures import Filament, Points, Solid, Surface

__all__ = [
    "Filament",
    "Grid",
    "Points",
    "Renderer",
    "Scene",
    "Simulation",
    "Solid",
    "Surface",
    "expected_image",
    "random_cells",
    "render",
    "render_scene",
    "simulate",
]
