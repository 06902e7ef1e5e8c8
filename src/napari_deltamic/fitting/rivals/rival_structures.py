"""Whether insides alone explain an image as well as membranes and insides together.

A faint membrane around a smaller inside, seen through a wider PSF, looks like a larger inside, and
so does chromatin that a border cuts. Linear estimates at one place do not tell which of them it is
(:mod:`.structure_choice`). So at rest a few steps are taken with the rival as well, from where it
looks the same, and what both explain is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.doing import doing
from ...common.triple import geometric_mean
from ...geometry.connected import adjacency
from ...geometry.mesh import FloatArray
from ...geometry.outwards import outwards
from ..model.amplitudes import inside_over_membrane
from ..model.fitted import Fitted
from ..model.shape import Shape
from ..objective.fit_objective import Objective, Terms
from ..solvers.preconditioner import Preconditioners
from ..surface.collisions import CollisionGuard
from .gains import gains_over


@dataclass(frozen=True)
class RivalRules:
    """How long rivals are followed, and when one wins.

    Attributes
    ----------
    steps
        Of each. Chosen on fits of ``mixed`` scenes (benchmarks.defaults), in which the better rival
        had passed the others by then.
    renewed_every
        Steps after which voxels and weights are chosen anew.
    less
        Share of the squares that are left by which it must leave less: small differences could be
        those of steps not yet taken. Half and twice change nothing in small fits.
    nats
        By which insides alone may explain less than with faint membranes, and be taken: half the
        square of the errors that membranes have to differ from 0 by (S. S. Wilks, 1938). Measured:
        -3 to 1 in four fits of nuclei, 33 to 2900 in eight of cells whose insides are up to 2.5
        times as bright as their membranes. By more than that, both must explain more at rest to be
        taken where insides were alone: less than 0 in eight fits of nuclei, measured as well.
    errors
        Of the sum over blocks, which that must exceed as well: chromatin is correlated. Measured:
        3.2 to 11 where membranes were real; around nuclei with chromatin -7 to 2.7, once 3.5. One
        membrane that left 5 % less than both reached only 1.8; taken, it ended at half the volume
        of a nucleus.
    uneven
        Times as many squares left of insides as they are as of evened ones, from which on they are
        uneven. Measured: 1.2 to 2.1 with chromatin; 1.00 to 1.16 on cells that are even, and all
        of those above 1.0 far from hidden membranes.
    hidden
        Of the peak of an even membrane's image: where insides are uneven and brighter than this,
        the membrane would not be seen, and is not believed. By definition the membrane then adds
        to the rim less than 8 % of the inside, less than that varies. Measured: 3.0 to 4.8 in seven
        of eight fits of nuclei with chromatin that had ended with a membrane, 1.1 to 2.2 in eight
        of ten of cells that have one.
    clear
        How many of those errors are enough, of what was measured, where insides are no brighter
        than ``hidden``. Measured on 66 fits of one cell each, from labels: seven of both, which
        insides alone had fitted 0.66 to 1.36 voxels off, reached 2.2 to 3.0 and ended 0.05 to 0.33
        off; of 34 nuclei one reached it, and no result changed. Not where, with insides evened,
        these alone explain more by as many: -2.4 in a flat cell with chromatin, off by 1.8 voxels
        as both and by 0.4 as insides. And of membranes that explain more
        than insides alone, with these evened as well: 2.7 in a pair of cells that had ended as
        insides, -7.0 to -1.1 in four fits of nuclei, of which none left ``less``.
    near
        How many are enough of both over insides alone that have been followed from where they look
        like both. Measured after two legs: 1.9 and 5.3 in small cells of both; 1.0 and -2.0 in two
        others, in which insides alone explain as much in the end; -5.3 in a crowd of nuclei.
    drowned
        Of the same peak: where insides are brighter than this, membranes are not believed even if
        insides are even. By definition the membrane then adds to the rim less than 4 % of the
        inside, which nucleoli do as well. Measured: 9.9 in a nucleus with two nucleoli, whose
        surface ended 0.65 voxel (a quarter of the PSF's width) too far in.
    even
        Of the same peak: where brightness deep inside varies by less, what is seen at the rim is
        taken for a membrane, and not for chromatin that a border cuts, however uneven it is.
        Measured: 0.04 and 0.05 in two scenes of both that this mends, 0.2 in one of 7 photons, 1.3
        in a nucleus with chromatin.
    legs
        How often insides alone are followed as far again, while a leg gains more than they lack.
        Measured: in a small cell, they lacked 23, 10 and 3 nats after one to three legs, and had 4
        more than both after four; a crowd of nuclei had 13 more after one, and 102 after three.
    hollow
        Times as many squares left of insides as of evened ones, from which on small insides may be
        membranes. Measured: 4.0 where they were; up to 2.1 with chromatin, see ``uneven``.
    dim, out
        Insides dimmer than the first, of the peak of a membrane's image, may be cytoplasm around a
        nucleus that is darker still. The second: widths of the PSF by which that begins further out
        than the membrane; by definition the half maximum of a Gaussian. Measured: 0.30 to 0.32 in
        five cells of cytoplasm, which both explained better by 1.4 to 3.4 errors; 0.55 and 0.65,
        and 8.7 and 8.9 errors, in two of both.
    """

    steps: int = 12
    renewed_every: int = 6
    less: float = 0.05
    nats: float = 12.5
    errors: float = 3.0
    uneven: float = 1.1
    hidden: float = 2.5
    clear: float = 2.0
    near: float = 1.5
    drowned: float = 5.0
    even: float = 0.15
    legs: int = 3
    hollow: float = 2.5
    dim: float = 0.7
    out: float = 1.18


RULES = RivalRules()
_FOLLOWED = 10  # edges from a rim, over which walls follow; chosen


def insides_alone(
    terms: Terms, objective: Objective, factored: Preconditioners
) -> tuple[Fitted | None, int]:
    """The fit without its faint membranes, where insides alone explain as much; and evaluations.

    A faint membrane with a smaller inside and a wider PSF looks like a larger inside: they differ
    in the third derivative of what is seen across the border. Linear estimates at one place do not
    tell (:mod:`.structure_choice`), a few steps do.
    """
    both = objective.anew()
    rival, taken = descend_and_pose_anew(begun(terms, _alone_further_out(terms, both), factored))
    taken += both.evaluations()
    gains = gains_over(both, rival)
    for _ in range(RULES.legs):
        if not _stay(both, rival, gains):
            break
        further, more = descend_and_pose_anew(rival)
        taken += more
        gained, rival = gains_over(further, rival)[0].sum(), further
        gains = gains_over(both, rival)
        if gained < gains[0].sum():
            break
    return (None if _stay(both, rival, gains) else rival.fitted), taken


def insides_may_do(
    terms: Terms, objective: Objective, factored: Preconditioners
) -> tuple[bool, int]:
    """Whether insides alone may explain as much as both do, further out; and evaluations.

    Cytoplasm around a dark nucleus, a few widths of the PSF thick, looks like a membrane and a dim
    inside seen through a wider PSF.
    """
    fitted = objective.fitted
    if objective.now.light.interior <= 0:
        return False, 0
    both = objective.anew()
    if insides_over(objective) > RULES.dim:
        begin = _alone_further_out(terms, both)
    else:
        width = geometric_mean(fitted.optics.sigma_um)
        vertices = moved_in(fitted.shape, -RULES.out * width, terms.settings.collisions)
        begin = fitted.displaced(vertices, fitted.first_optics).with_structure("interior")
    rival, taken = descend_and_pose_anew(begun(terms, begin, factored))
    return not gains_exceed_error(gains_over(both, rival), RULES.errors), taken + both.evaluations()


def _stay(both: Objective, alone: Objective, gains: Sequence[FloatArray]) -> bool:
    """Whether both explain more than insides alone that began further out: they are near, too."""
    return gains_exceed_error(gains, RULES.near) or both_beat_insides(both, alone, gains)


def with_even_membranes(
    terms: Terms, objective: Objective, factored: Preconditioners
) -> tuple[Objective, int]:
    """The fit with one brightness for each wall, followed a few steps; and evaluations.

    Membranes of any brightness, around a smaller inside, explain chromatin that a border cuts. Even
    ones do not.
    """
    return descend_and_pose_anew(begun(terms, objective.fitted.with_density("interface"), factored))


def without_rim(
    terms: Terms, objective: Objective, even: Objective, factored: Preconditioners
) -> tuple[Fitted | None, int]:
    """The fit of insides alone, unless membranes that are even show beside them; evaluations."""
    rival, taken = descend_and_pose_anew(
        begun(terms, _alone_further_out(terms, objective), factored)
    )
    stay = insides_over(even) <= RULES.hidden and both_beat_insides(even, rival)
    return (None if stay else rival.fitted), taken


def _alone_further_out(terms: Terms, both: Objective) -> Fitted:
    """Insides without the membranes around them, where that looks the same.

    To first order, a membrane of amplitude a on an inside of amplitude c looks like an inside that
    reaches a / c further out; further in, if it is darker than the medium.
    """
    fitted, light = both.fitted, both.now.light
    width = geometric_mean(fitted.first_optics.sigma_um)
    further = light.membrane / light.interior if light.interior else 0.0
    further = float(np.clip(further, -width, width))
    vertices = moved_in(fitted.shape, -further, terms.settings.collisions)
    return fitted.displaced(vertices, fitted.first_optics).with_structure("interior")


def shows_membranes(objective: Objective) -> bool:
    """Whether membranes would stay in a fit of both."""
    return objective.structure().structure != "interior"


def both_beat_insides(
    both: Objective, alone: Objective, gains: Sequence[FloatArray] | None = None
) -> bool:
    """Whether both surely explain more than insides alone, or the membranes of both are clear.

    Insides alone follow a membrane as unevenness, so once insides are evened, both gain little over
    them; and sums over few blocks never reach many errors. gains : if they are known.
    """
    gains = gains_over(both, alone) if gains is None else gains
    if more_than_insides(both, gains):
        return True
    clear = both.now.light.membrane > 0 and insides_over(both) <= RULES.hidden
    denied = gains_exceed_error([-gains[0]], RULES.clear)
    less = both.leaves_over(alone) <= 1
    return bool(clear and less and not denied and gains_exceed_error(gains[1:], RULES.clear))


def more_than_insides(both: Objective, gains: Sequence[FloatArray]) -> bool:
    """Whether both surely explain more than insides alone by these gains.

    With insides evened as well, unless these vary too little to look like a membrane.
    """
    asked = errors_asked(both)
    return gains_exceed_error(gains[1:], asked) and (
        gains_exceed_error(gains[:1], asked) or are_even(both)
    )


def are_even(both: Objective) -> bool:
    """Whether insides vary too little to look like the membrane beside them."""
    if both.now.light.membrane <= 0 or insides_over(both) > RULES.drowned:
        return False
    return both.insides_vary()[1] < RULES.even


def is_uneven(both: Objective) -> bool:
    """Whether insides are, and by so much that they may look like the membrane beside them."""
    return both.unevenness() > RULES.uneven and not are_even(both)


def insides_over(objective: Objective) -> float:
    """How bright insides are, of the peak of a membrane's image."""
    return inside_over_membrane(objective.now.light, objective.fitted.optics.sigma_um)


def errors_asked(one: Objective) -> float:
    """How many errors a rival has to explain more by.

    Where a user has asked for both, chromatin is not suspected of being a membrane.
    """
    return RULES.errors if one.terms.settings.structure == "auto" else 0.0


def gains_exceed_error(gains: Sequence[FloatArray], errors: float) -> bool:
    """Whether each of these sums over blocks is so many times its error, and enough nats."""
    least = [max(RULES.nats, errors * np.sqrt((gain**2).sum())) for gain in gains]
    return all(gain.sum() > bound for gain, bound in zip(gains, least, strict=True))


def moved_in(shape: Shape, depth: float | FloatArray, collisions: bool) -> FloatArray:
    """(V, 3) um: its vertices so much further in, where neither pins nor thin places hold them.

    depth : um, of all or (V, 1) of each; further out where it is negative.

    Those of walls between cells follow what is around them, so that rims do not fold.
    """
    mesh, places = shape.mesh, shape.mesh.vertices_numpy()
    moved = -depth * outwards(mesh)
    links, free = adjacency(mesh), (moved != 0).any(axis=1, keepdims=True)
    valence = np.asarray(links.sum(1)).clip(1)
    for _ in range(_FOLLOWED):
        moved = np.where(free, moved, links @ moved / valence)
    guard = CollisionGuard(collisions)
    guard.watch(mesh)
    return np.asarray(guard.limited(places, places + moved * ~shape.pinned[:, None]))


def begun(terms: Terms, fitted: Fitted, factored: Preconditioners) -> Objective:
    """The objective of a rival, where it begins."""
    terms = replace(terms, density_fitted=terms.density_fitted and fitted.structure != "interior")
    return Objective(terms, fitted, CollisionGuard(terms.settings.collisions), factored)


def descend_and_pose_anew(objective: Objective) -> tuple[Objective, int]:
    """A few steps down; the objective as it is posed there, and evaluations."""
    there, taken = stepped(objective)
    end = there.anew()
    return end, taken + end.evaluations()


def stepped(
    objective: Objective,
    hopeless: Callable[[Objective], bool] = lambda objective: False,
) -> tuple[Objective, int]:
    """A few steps down; the objective in which the last was taken, and evaluations.

    hopeless : whether to go no further; asked where it begins, and before it is posed anew.
    """
    taken = since = 0
    if hopeless(objective):
        return objective, objective.evaluations()
    for step in range(1, RULES.steps + 1):
        doing("comparing models")  # which yields no state, and may take minutes
        moved, since = objective.step(), since + 1
        if step == RULES.steps or (not moved and since == 1):  # posed anew, it would not move
            break
        if moved and since < RULES.renewed_every and not objective.strayed():
            continue
        taken += objective.evaluations()
        if hopeless(objective):
            return objective, taken
        objective, since = objective.anew(), 0
    return objective, taken + objective.evaluations()
