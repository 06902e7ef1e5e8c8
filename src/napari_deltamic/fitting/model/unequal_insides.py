"""How bright the inside of each cell is: nuclei and cytoplasm are seldom alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from ...common.choices import DensityModel, Structure
from ...geometry.mesh import FloatArray, IntArray, Mesh
from ...scene.light import Light
from ..solvers.lbfgs import dot


@dataclass(frozen=True)
class UnequalInsidesRules:
    """How unequal insides are thought to be, and may be.

    Attributes
    ----------
    alike
        In the mean over cells, of what they share: insides that differ by less count as alike, as
        smooth densities of membranes do.
    least, most
        How much darker or brighter than what they share an inside may be, of that: beyond, a cell
        is none of those that the others are; chosen, not measured.
    shared
        Of what they share: with a smaller mean, cells of either sign, that is no scale.
    at_blurred
        How bright insides have to be, of the peak of a membrane's blurred image, to differ at
        blurred levels; chosen, nuclei are brighter at all of them but perhaps the first.
    """

    alike: float = 0.05
    least: float = -2.0
    most: float = 9.0
    shared: float = 0.1
    at_blurred: float = 1.0


RULES = UnequalInsidesRules()


@dataclass(frozen=True, eq=False)
class Insides:
    """The brightness of insides as unknowns of a fit, their bounds and prior.

    How unequal they are, nobody knows beforehand: as for membranes, a Gaussian prior of unknown
    variance, integrated over it, pulls what the image does not ask for to nothing.

    Attributes
    ----------
    regions
        (R,) numbers of the regions whose insides differ; empty where all are alike.
    held
        Whether they stay as they were found where the surface was then. At blurred levels they
        would stand in for shapes that are far off; alike, dim cells would shrink to nothing.
    """

    regions: IntArray
    held: bool = False

    @classmethod
    def of(cls, mesh: Mesh, model: DensityModel, structure: Structure, blurred: bool) -> Insides:
        """The insides of a mesh, where they shine.

        Alike where densities are to be the same everywhere, and at blurred levels where cells share
        walls: nuclei do not, and in clusters of membranes insides would stand in for missing walls.
        """
        regions = mesh.region_ids()
        differ = structure != "membrane" and model != "uniform" and len(regions) > 1
        differ = differ and not (blurred and bool((mesh.regions > 0).all(axis=1).any()))
        return cls(regions if differ else regions[:0], blurred)

    def __len__(self) -> int:
        return len(self.regions)

    def alike(self) -> Insides:
        """All of them alike."""
        return Insides(self.regions[:0], self.held)

    def numbers(self, light: Light, volumes: FloatArray) -> FloatArray:
        """(R,) those of a light, so that insides of volumes (R,) um^3 share their mean."""
        if not len(self):
            return np.zeros(0)
        cells = light.of_cells(self.regions)
        mean = float(np.average(cells, weights=np.abs(volumes) + 1e-300))
        return self.bounded(cells / mean - 1 if mean > RULES.shared else cells - 1)

    def factors(self, numbers: Tensor) -> Tensor | None:
        """(R,) on what they share, differentiable in the numbers (R,); None: alike."""
        return 1 + numbers if len(self) else None

    def shining(self, light: Light, numbers: FloatArray) -> Light:
        """The same light with these insides."""
        cells = zip(self.regions.tolist(), (1 + numbers).tolist(), strict=True)
        return replace(light, cells=tuple(cells))

    @staticmethod
    def bounded(numbers: FloatArray) -> FloatArray:
        """The same within their bounds."""
        return np.clip(numbers, RULES.least, RULES.most)

    @staticmethod
    def prior(numbers: FloatArray) -> tuple[float, FloatArray]:
        """Nats, and their gradient (R,)."""
        even = len(numbers) * RULES.alike**2
        value = 0.5 * len(numbers) * float(np.log1p(dot(numbers, numbers) / max(even, 1e-300)))
        return value, Insides.prior_curvature(numbers) * numbers

    @staticmethod
    def prior_curvature(numbers: FloatArray) -> FloatArray:
        """(R,) how firmly it holds each."""
        firm = len(numbers) / max(len(numbers) * RULES.alike**2 + dot(numbers, numbers), 1e-300)
        return np.full(len(numbers), firm)


def each_alone(regions: IntArray) -> list[Light]:
    """The inside of each region by itself, of amplitude 1."""
    return [Light(0.0, 1.0, tuple((int(k), float(k == one)) for k in regions)) for one in regions]
