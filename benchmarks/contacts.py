"""Which cells touch, and how many of the contacts that a fit shows are wrong."""

from __future__ import annotations

from dataclasses import dataclass

# Voxel areas: a smaller contact is none that an image could tell (measured on the movie of
# ``clusters.tracking``, whose cells come to touch bit by bit).
SEEN = 10.0


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
