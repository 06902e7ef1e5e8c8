"""The structures of a scene: surfaces, solids, filaments and points.

Each gives its Fourier transform on a band, by its closed form or by the particle-mesh. Times of the
latter, measured (48^3 to 96^3 voxels, accuracies 1e-2 to 1e-5, one core): the transform of a solid
takes 3.4 to 4.4 times as long as that of its surface, together with its gradient 1.9 to 2.3 times,
since a solid's gradient is the simpler one; filaments and points take as long as a surface with as
many quadrature points.
"""

from ...geometry.mesh import Mesh
from .checked_numbers import Values
from .insides import Solid
from .membranes import Surface
from .site import Planned, Site, Structure
from .threads_and_spots import Filament, Points

__all__ = [
    "Filament",
    "Planned",
    "Points",
    "Site",
    "Solid",
    "Structure",
    "Surface",
    "Values",
    "membranes_and_insides",
]


def membranes_and_insides(mesh: Mesh, interior: float = 0.0) -> tuple[Structure, ...]:
    """Return the membranes of a mesh, of density 1, and its insides if ``interior`` is not 0."""
    return (Surface(mesh), Solid(mesh, interior)) if interior else (Surface(mesh),)
