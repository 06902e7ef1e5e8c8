"""What is known of a fit before its image is seen."""

from __future__ import annotations

from dataclasses import dataclass

from ...geometry.bending import BendingEnergy
from ...geometry.cell_bending import CellBending
from ...geometry.junction_bending import JunctionBending
from ..model.density import Density
from ..model.imaging import Imaging
from ..model.unequal_insides import Insides


@dataclass(frozen=True)
class Prior:
    """What is known beforehand.

    Attributes
    ----------
    bending, junctions
        The bending energies of the surface (of cells as closed bodies where insides alone shine)
        and of the lines where walls meet.
    stiffness
        Their weight, a pure number.
    density, insides
        The densities and their prior; the brightness of insides and theirs.
    imaging
        PSF and effects, and theirs.
    """

    bending: BendingEnergy | CellBending
    junctions: JunctionBending
    stiffness: float
    density: Density
    insides: Insides
    imaging: Imaging
