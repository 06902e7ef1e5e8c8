"""Which effects a scene calls for, with evidence, predicted bias of the shape, and cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..fitting.fit import fit
from ..fitting.job import FitInput
from ..fitting.model.checks import check_image
from ..fitting.model.default_accuracy import accuracy_for_image
from ..fitting.model.hot_voxels import hot_voxels
from ..fitting.model.likelihood import voxel_noise
from ..fitting.model.state import FitState
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..runs.settings import FitSettings
from ..scene import Grid
from ..scene.effects import KINDS, Detection, Effects, VoxelEffect, as_effects
from .camera import Camera, camera_from_image, failed_slices
from .candidates import chosen_candidates, points_inwards
from .effect_cost import EffectCosts
from .evidence_rules import JUDGING
from .search import Judged, Search
from .voxel_variance import voxel_variance


@dataclass(frozen=True)
class Evidence:
    """What speaks for an effect, and what it costs.

    Attributes
    ----------
    name
        Name of the effect.
    score
        Standard deviations by which the image asks for it; see :func:`.score.score`.
    bias_nm, bias_voxels
        Predicted root mean square error of the surface without it, in nm and in smallest voxel
        sides.
    cost_ms
        Predicted further time that an iteration at full resolution takes with it, ms, from the cost
        that it states and the time that a rendering of the scene took.
    recommended
        Whether to add it.
    reason
        Why, in plain words.
    """

    name: str
    score: float
    bias_nm: float
    bias_voxels: float
    cost_ms: float
    recommended: bool
    reason: str


@dataclass(frozen=True)
class Recommendation:
    """The effects that an image calls for.

    Attributes
    ----------
    effects
        Those already present, and those recommended, with first estimates of their numbers.
    evidence
        One for each candidate: those recommended first, then by score.
    threshold
        Score above which an effect counts as seen.
    scene
        The final fit of the part of the image that was judged.
    camera
        What the image tells about its camera.
    remarks
        What else a reader should know, in plain words.
    """

    effects: Effects
    evidence: tuple[Evidence, ...]
    threshold: float
    scene: FitState
    camera: Camera
    remarks: tuple[str, ...] = ()

    @property
    def recommended(self) -> tuple[str, ...]:
        """Names of the effects to add."""
        return tuple(e.name for e in self.evidence if e.recommended)


def recommend(
    image: np.ndarray,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    settings: FitSettings | None = None,
    candidates: Sequence[str] | None = None,
    *,
    counted: np.ndarray | None = None,
    effects: Effects | Sequence[str] = (),
    fitted: FitState | None = None,
    progress: Callable[[str], None] | None = None,
) -> Recommendation:
    """Decide which effects an image calls for.

    The scene is fitted without them. The candidate with the largest score above the threshold is
    added and the scene refitted, and so on, one at a time, because one effect can be mistaken for
    another. In the end, effects are left out that are not significant compared with the remaining
    misfit, or move the surface by less than 0.02 voxel. All but the costs is deterministic.

    A second view is data, which no single image can call for, and so is not a candidate.

    Parameters
    ----------
    image, grid, mesh, optics, settings, counted
        As :func:`napari_deltamic.fit` takes them.
    candidates
        Names of effects to consider; all by default.
    effects
        Effects that are in the scene already, and stay.
    fitted
        Last state of a fit of this image with ``effects``, which is then not repeated.
    progress
        Called with a line before each step.

    Raises
    ------
    InputError
        As :func:`napari_deltamic.fit` does, and if a candidate is unknown.
    """
    settings = settings or FitSettings()
    present = as_effects(effects)
    names = chosen_candidates(candidates, present)
    tell = progress or (lambda _: None)
    pixels, known = check_image(image, grid)
    if fitted is None:
        tell("fitting without further effects")
        *_, fitted = fit(
            image, grid, mesh, optics, settings=settings, counted=counted, effects=present
        )
    camera = camera_from_image(image, known)
    usable = known if counted is None else known & (np.asarray(counted) != 0)
    usable = usable & ~hot_voxels(pixels, usable)
    if camera.saturation.value is not None:
        usable &= pixels < camera.saturation.value
    usable[list(failed_slices(pixels))] = False
    search = Search(
        pixels,
        usable,
        grid,
        fitted,
        present,
        voxel_variance(image, pixels, known, camera),
        settings,
        len(names),
    )
    search.run(names, tell)
    accuracy = settings.accuracy
    if accuracy is None:
        accuracy = accuracy_for_image(pixels, known)
    costs = EffectCosts(fitted.mesh, grid, fitted.optics.detach(), present, accuracy)
    found = _outcome(search, names, present, camera, costs)
    return with_detection(found, search, pixels, known)


def recommend_for(
    job: FitInput,
    fitted: FitState | None = None,
    candidates: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Recommendation:
    """Decide which effects the image of a fit calls for; see :func:`recommend`.

    fitted : the last state of this fit, if already done; its effects have the numbers found there.
    """
    image = job.image
    if fitted is not None:
        image = fitted.without_local_background(image)
        fitted = replace(fitted, local_background=None)
    return recommend(
        image,
        job.grid,
        job.mesh,
        job.optics,
        job.settings.fit,
        candidates,
        counted=job.counted,
        effects=job.settings.scene.effects if fitted is None else fitted.effects,
        fitted=fitted,
        progress=progress,
    )


def _outcome(
    search: Search,
    names: tuple[str, ...],
    present: Effects,
    camera: Camera,
    costs: EffectCosts,
) -> Recommendation:
    voxel = min(search.part.grid.voxel_size)
    evidence = []
    for name in names:
        judged = search.judged(name)
        bias = search.model.modes.size(judged.score.shape)
        clear = abs(judged.score.z) > search.threshold
        evidence.append(
            Evidence(
                name,
                judged.score.z,
                1e3 * bias,
                bias / voxel,
                costs.milliseconds(judged.effect),
                judged.chosen and clear and bias >= JUDGING.negligible * voxel,
                _reason(judged, bias, voxel, search),
            )
        )
    evidence.sort(key=lambda e: (not e.recommended, -abs(e.score)))
    taken = {e.name for e in evidence if e.recommended}
    left = [n for n in search.scene.effects.names if n not in taken and n not in present.names]
    return Recommendation(
        search.scene.effects.without(*left),
        tuple(evidence),
        search.threshold,
        search.scene,
        camera,
        _remarks(search, voxel),
    )


def with_detection(
    found: Recommendation, search: Search, pixels: np.ndarray, known: np.ndarray
) -> Recommendation:
    """The recommendation with effects of detection, which leave voxels out.

    They need no score: saturated voxels and uniform slices are plain to see. What counts is how far
    such voxels would move the surface if left in.
    """
    voxel, detection = min(search.part.grid.voxel_size), _detection(found.camera, pixels)
    rows, effects = list(found.evidence), found.effects
    for name, kind in KINDS.items():
        effect = kind.seen(detection) if issubclass(kind, VoxelEffect) else None
        if effect is None or name in found.effects.names:
            continue
        where = known & effect.missing(pixels)
        score, bias = search.left_in(where)
        taken = bias >= JUDGING.negligible * voxel
        what = f"{int(where.sum())} {effect.about_missing()}"
        reason = f"{what}; left in, they would move the surface by {_nm(bias)}"
        rows.append(Evidence(name, score, 1e3 * bias, bias / voxel, 0.0, taken, reason))
        effects = effects.adding(effect) if taken else effects
    rows.sort(key=lambda e: not e.recommended)
    return replace(found, effects=effects, evidence=tuple(rows))


def _detection(camera: Camera, pixels: np.ndarray) -> Detection:
    """What the image tells about detection; if it shows no camera, equal noise in all voxels."""
    told, line = (camera.saturation.value, failed_slices(pixels)), camera.line
    if line is None:
        low, noise = float(pixels.min()), voxel_noise(pixels, np.ones(pixels.shape, bool))
        almost_none = 1e-6  # of the noise: a gain so that it would not grow with brightness
        return Detection(almost_none * max(noise, 1e-6), low, noise, *told)  # only no division by 0
    offset = line.lowest if camera.offset.value is None else camera.offset.value
    read = np.sqrt(max(line.slope * offset + line.intercept, 0.0))
    return Detection(line.slope, offset, float(read), *told)


def _remarks(search: Search, voxel: float) -> tuple[str, ...]:
    """What else a reader should know."""
    found = []
    part = search.part
    if len(part.cells) < part.of:
        found.append(f"judged by {len(part.cells)} of {part.of} cells, around the middle")
    misfit = search.misfit()
    if misfit > JUDGING.misfit:
        found.append(
            f"the residual varies {misfit:.1f} times as much as noise: scores are relative to it"
        )
    density = search.density()
    if density is not None and abs(density.z) > search.threshold:
        bias = search.model.modes.size(density.shape)
        if bias >= JUDGING.negligible * voxel:
            found.append(
                f"the density varies over the surface (z = {density.z:.1f}): fitted as uniform, "
                f"the surface moves by {_nm(bias)}; use the density 'smooth'"
            )
    return tuple(found)


def _reason(judged: Judged, bias: float, voxel: float, search: Search) -> str:
    score, effect = judged.score, judged.effect
    seen = f"z = {score.z:.1f}"
    if score.hidden:
        return "shape, brightness and PSF explain all of it"
    if judged.chosen:
        numbers = ", ".join(f"{v.name} {v.value:.3g} {v.unit}".strip() for v in effect.values())
        shown = f"{seen}" + (f" ({numbers})" if numbers else "")
        if abs(score.z) <= search.threshold:
            return f"{shown}: no longer significant with the others"
        if bias < JUDGING.negligible * voxel:
            return f"seen, {shown}, but leaving it out would move the surface by only {_nm(bias)}"
        return f"{shown}; leaving it out would move the surface by {_nm(bias)}"
    others = [n for n in effect.contradicts if n in search.scene.effects.names]
    if others and abs(score.z) > search.threshold:
        return f"{others[0]} explains the same"
    if abs(score.z) > search.threshold and effect.name in search.dropped:
        return f"{seen}, but {search.dropped[effect.name]}"
    if abs(score.z) > search.threshold and not points_inwards(effect, score.estimate):
        return f"{seen}, but with a negative amount"
    if abs(score.z) > search.threshold:
        return f"{seen}, as far as the others leave anything to explain"
    return f"{seen}: no more than chance (the threshold is {search.threshold:.1f})"


def _nm(um: float) -> str:
    return f"{1e3 * um:.2g} nm" if um < 0.01 else f"{1e3 * um:.0f} nm"  # would be 1e+01 nm
