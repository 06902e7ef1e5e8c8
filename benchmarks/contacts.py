"""Which cells touch, and how many of the contacts that a fit shows are wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from napari_deltamic import Mesh

# Voxel areas: a smaller contact is none that an image could tell (measured on the movie of
# ``clusters.tracking``, whose cells come to touch bit by bit).
SEEN = 10.0


def wall_areas(mesh: Mesh) -> dict[tuple[int, int], float]:
    """um^2 of each wall, by its regions, the larger first; 0 is the outside."""
    pairs, index = mesh.interfaces()
    areas = np.bincount(index, mesh.areas(), len(pairs))
    return {(int(a), int(b)): float(s) for (a, b), s in zip(pairs, areas, strict=True)}


def contacts(mesh: Mesh) -> dict[tuple[int, int], float]:
    """The same of two cells only."""
    return {pair: area for pair, area in wall_areas(mesh).items() if pair[1] > 0}


@dataclass(frozen=True)
class ContactErrors:
    """Contacts that are right, lost and made up; those too small to be seen do not count."""

    right: int
    lost: int
    made_up: int

    @property
    def wrong(self) -> int:
        """Lost and made up."""
        return self.lost + self.made_up

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1 where there is none to be found."""
        every = 2 * self.right + self.wrong
        return 2 * self.right / every if every else 1.0


def contact_errors(
    found: dict[tuple[int, int], float], true: dict[tuple[int, int], float], seen: float
) -> ContactErrors:
    """Compare contacts of the same cells; those of less area than ``seen`` (um^2) are open."""
    large = {pair for pair, area in true.items() if area > seen}
    lost = {pair for pair in large if pair not in found}
    made_up = {pair for pair, area in found.items() if area > seen and pair not in true}
    return ContactErrors(len(large - lost), len(lost), len(made_up))
