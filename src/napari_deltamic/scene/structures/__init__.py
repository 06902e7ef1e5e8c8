"""What a scene may hold: surfaces, solids, filaments and points.

Each gives its Fourier transform on a band, by its closed form or by the particle-mesh. What the
latter takes, measured (48^3 to 96^3 voxels, accuracies 1e-2 to 1e-5, one core): the transform of a
solid 3.4 to 4.4 times as long as that of its surface, together with its gradient 1.9 to 2.3 times,
since a solid's gradient is the simpler one; filaments and points as long as a surface of as many
quadrature points.
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
    """Its membranes, of density 1, and the insides of its regions where they shine."""
    return (Surface(mesh), Solid(mesh, interior)) if interior else (Surface(mesh),)
