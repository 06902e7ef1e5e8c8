"""What shines, and how evenly, as far as a fit leaves it open: asked at fixed points of its way."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..runs.settings import FitSettings
from .model.amplitudes import RULES, all_small, inside_over_membrane, may_shine
from .model.density import RULES as DENSITY
from .model.fitted import Fitted
from .objective.fit_objective import Objective, Terms
from .objective.schedule import Progress
from .rivals.dark_nuclei import around_nuclei
from .rivals.hidden_membranes import RULES as HIDDEN
from .rivals.hidden_membranes import membranes_as_well
from .rivals.rival_structures import RULES as RIVALS
from .rivals.rival_structures import (
    insides_alone,
    is_uneven,
    with_even_membranes,
    without_rim,
)
from .rivals.small_cells import (
    insides_as_well,
    may_be_insides,
    nearer_of,
    other_of_small,
)
from .solvers.preconditioner import Preconditioners
from .stage import Stage
from .surface.collisions import CollisionGuard


@dataclass(frozen=True)
class ModelChoice:
    """Chooses the structure and densities that a fit goes on with; changes no other object.

    Attributes
    ----------
    settings
        Of the fit.
    levels
        How many there are.
    """

    settings: FitSettings
    levels: int

    def first(self, stage: Stage) -> bool:
        """Whether a level still follows the first one, whose shape is found without PSF, effects
        and smooth brightness: far from it, they would stand in for it."""
        return stage.level_number == 0 and self.levels > 1

    def last(self, stage: Stage) -> bool:
        """Whether no level follows."""
        return stage.level_number == self.levels - 1

    # ---- structure ------------------------------------------------------------------------

    def is_open(self, fitted: Fitted) -> bool:
        """Whether the image decides what shines, and both still may."""
        return self.settings.structure == "auto" and fitted.structure == "both"

    def asked(self, fitted: Fitted, stage: Stage) -> bool:
        """Whether to ask what shines: at the last level, once the surface has come near."""
        near = stage.level_number > 0 or stage.progress.iterations > 0
        return self.is_open(fitted) and self.last(stage) and near and not stage.progress.sure

    def of_small(self, terms: Terms, fitted: Fitted) -> Fitted:
        """Whether membranes or insides shine where cells are too small to fit both."""
        asked, mesh = self.settings.structure == "auto", fitted.mesh
        if asked and mesh.is_closed() and all_small(mesh, fitted.optics):
            return fitted.with_structure(nearer_of(terms, fitted))
        return fitted

    def of_small_again(self, terms: Terms, fitted: Fitted) -> tuple[Fitted, int]:
        """The fit of cells that began small, at the last level; and evaluations that this took.

        With the other of membranes and insides, if it explains more: its shape is wanted also where
        cells are larger by now, as membranes that were taken for insides end at twice their volume.
        Cells that are found to be larger go on with all that may shine: from starts inside them,
        they had been fitted as membranes. Earlier levels do not tell: a haze makes small cells
        twice as large there.
        """
        known = self.settings.structure != "auto" or fitted.structure == "both"
        if known or not fitted.mesh.is_closed():
            return fitted, 0
        found, taken = other_of_small(terms, fitted)
        fitted = fitted if found is None else found
        small = all_small(fitted.mesh, fitted.optics, RULES.clearly)
        return (fitted if small else fitted.with_structure("both")), taken

    def asked_anew(
        self,
        terms: Terms,
        objective: Objective,
        fitted: Fitted,
        factored: Preconditioners,
        progress: Progress,
        psf_guessed: bool,
    ) -> tuple[Fitted, int, Progress]:
        """What shines at rest, the evaluations that it took to ask, and where that leaves the fit.

        The same object where that is what had been clear on the way.
        """
        if psf_guessed and self._small_membranes(terms, fitted, progress):
            found, taken = insides_as_well(terms, objective)
            after = replace(progress, asked_again=True, unsure=found is not None)
            return (fitted if found is None else found), taken, after
        if self._asked_again(fitted, progress):
            one = self.levels == 1  # else blurred levels have told most
            further = HIDDEN.further if one else 0
            found, taken, unsure = self._with_both_again(
                terms, objective, fitted, factored, further
            )
            # Where a user asks for both, there is nothing to say: the other doubt is that of both.
            unsure = unsure and one and fitted.structure == "interior"
            return found, taken, replace(progress, asked_again=True, unsure=unsure)
        if self.is_open(fitted) and not progress.answered:  # once for each surface
            found, taken = self._at_rest(terms, objective, fitted, factored)
            return found, taken, replace(progress, answered=True)
        return fitted, 0, progress

    def around_nuclei(
        self, terms: Terms, objective: Objective, fitted: Fitted, progress: Progress
    ) -> tuple[Fitted, int, Progress]:
        """A fit of both that is about to end, or that of insides around dark nuclei instead.

        And the evaluations that it took to ask, and where that leaves the fit.
        """
        if not self.is_open(fitted) or not progress.answered or progress.nuclei:
            return fitted, 0, progress
        found, unsure, taken = around_nuclei(terms, objective)
        if found is None:
            return fitted, taken, replace(progress, nuclei=True, unsure=unsure)
        return found, taken, Progress(answered=True, asked_again=True, nuclei=True)

    @staticmethod
    def _at_rest(
        terms: Terms, objective: Objective, fitted: Fitted, factored: Preconditioners
    ) -> tuple[Fitted, int]:
        """The fit with what shines at rest, or the same object; and the evaluations taken."""
        found = objective.structure()
        if found.structure != "both":
            return fitted.with_structure(found.structure), 0
        if objective.dark_insides_denied():
            return fitted.with_structure("membrane"), 0
        alone, taken, more, rim = None, 0, 0, False
        if found.outshone:
            over = inside_over_membrane(objective.now.light, fitted.optics.sigma_um)
            even, taken = with_even_membranes(terms, objective, factored)
            # In flat cells, membranes of any brightness explain all chromatin: none is left.
            rim = over > RIVALS.drowned or is_uneven(objective) or is_uneven(even)
        if rim:
            alone, more = without_rim(terms, objective, even, factored)
        elif found.faint:
            alone, more = insides_alone(terms, objective, factored)
        return (fitted if alone is None else alone), taken + more

    def _small_membranes(self, terms: Terms, fitted: Fitted, progress: Progress) -> bool:
        """Whether, at rest, to ask membranes of small cells whether insides may do as well."""
        alone = self.settings.structure == "auto" and fitted.structure == "membrane"
        if not alone or progress.asked_again or not fitted.mesh.is_closed():
            return False
        return may_be_insides(fitted, terms.level.grid.voxel_size)

    def _asked_again(self, fitted: Fitted, progress: Progress) -> bool:
        """Whether, at rest, to ask once more for what left a fit.

        Insides leave soon after the start, where walls that labels drew wrongly may hide them.
        Measured on cells that fill the stack, 40 % as bright inside (``confluent-0``,
        benchmarks.defaults): 0.9 standard errors after 7 iterations; had they stayed, 27 after 43.
        Membranes leave where labels are too large. Measured on labels of both, grown by two or
        three voxels: eight of twelve fits ended 1.0 to 1.2 voxel too far out, with insides alone;
        a fit of both, where a user asks for both, can end there with next to no membrane. After
        blurred levels, insides alone are asked as well: of 17 such fits, membranes came back in
        two, 0.75 and 0.52 voxel off before and 0.24 and 0.18 then; the others ended as before,
        within 0.02 voxel.
        """
        asked = self.settings.structure
        open_still = asked == "both" or (asked == "auto" and fitted.structure != "both")
        if (
            not open_still
            or progress.asked_again
            or (self.levels > 1 and fitted.structure != "interior")
        ):
            return False
        return may_shine("auto", fitted.mesh, fitted.optics) == "both"

    @staticmethod
    def _with_both_again(
        terms: Terms,
        objective: Objective,
        fitted: Fitted,
        factored: Preconditioners,
        further: int,
    ) -> tuple[Fitted, int, bool]:
        """The fit with what shines if both may again; the same fit if one alone does.

        Also the evaluations, and whether membranes may shine as well.
        """
        wanted = fitted.structure == "both"
        if wanted and objective.structure().structure != "interior":
            return fitted, 0, False
        if wanted or fitted.structure == "interior":
            found, taken, unsure = membranes_as_well(terms, objective, factored, further)
            return (fitted if found is None else found), taken, unsure
        both = fitted.with_structure("both")
        again = Objective(terms, both, CollisionGuard(terms.settings.collisions), factored)
        structure = again.structure().structure
        taken = again.evaluations()
        found = fitted if structure == "membrane" else both.with_structure(structure)
        return found, taken, False

    def anew(self, fitted: Fitted) -> Fitted:
        """The same with all that may shine, for other settings; small cells keep what was found."""
        asked, known = self.settings.structure, fitted.structure != "both"
        if asked == "auto" and known and all_small(fitted.mesh, fitted.optics):
            return fitted
        return fitted.with_structure(may_shine(asked, fitted.mesh, fitted.optics))

    # ---- densities ------------------------------------------------------------------------

    def density_fitted(self, fitted: Fitted, stage: Stage) -> bool:
        """Numbers of walls are too few to stand in for a shape; held back, it would for them."""
        if fitted.structure == "interior":
            return False
        return fitted.shape.model == "interface" or not self.first(stage)

    def density_waits(self, fitted: Fitted) -> bool:
        """Whether densities of walls are still fitted in place of what was asked for."""
        return fitted.shape.model != self.settings.density

    @staticmethod
    def walls_first(objective: Objective, fitted: Fitted) -> bool:
        """Whether insides shine: a smooth density would stand in for them."""
        over = inside_over_membrane(objective.now.light, fitted.optics.sigma_um)
        return over > DENSITY.walls_first
