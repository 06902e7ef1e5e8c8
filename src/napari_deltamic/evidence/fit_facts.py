"""Measures what is known about a fit when it has ended, for its verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.triple import geometric_mean
from ..fitting.by_hand import is_by_hand
from ..fitting.job import FitInput, levelled
from ..fitting.model.amplitudes import RULES as AMPLITUDES
from ..fitting.model.amplitudes import hardly_wider
from ..fitting.model.noise_blur import is_sharpened, is_white
from ..fitting.model.saturation import filled_in, share_cut
from ..fitting.model.state import FitState
from ..fitting.objective.deep_insides import Cells, dark_insides_shown, deep_brightness
from ..fitting.surface.growth_alarm import shrunken
from ..fitting.voxels.necks import beyond_necks
from ..fitting.voxels.voxel_ownership import surface_shares
from ..geometry.border import cut_cells
from ..geometry.mesh import Mesh
from ..optics import GaussianPSF, ScalarPSF
from ..optics.narrow import narrower_than_told
from ..scene.effects import Halo
from ..scene.render import offset
from .compressed_brightness import compressed
from .dents import dents
from .enclosing import enclosing_membranes
from .facts import CellFacts, Facts
from .first_sigma import first_sigma
from .folds import folds
from .left_out import left_out
from .outgrowths import outgrowths
from .predicted_error import PredictedError, predicted_error
from .residual import Residual
from .sanity import RULES as SANITY
from .sanity import SINGLE, doubted_scale, followed, single_slice
from .slices_apart import slices_apart
from .uneven_insides import inside_shares, uneven_insides
from .unseen_walls import unseen_walls
from .verdict import Verdict, judged
from .verdict_rules import RULES

_Tables = dict[str, Mapping[int, Any]]  # by name of a fact of a cell, and by cell


def verdict_of(
    job: FitInput, state: FitState, left: Residual, rendered: np.ndarray | None = None
) -> Verdict:
    """The verdict on a fit; parameters as for :func:`facts_of`."""
    return judged(facts_of(job, state, left, rendered))


def facts_of(
    job: FitInput, state: FitState, left: Residual, rendered: np.ndarray | None = None
) -> Facts:
    """What is known about a fit.

    Parameters
    ----------
    left
        The residual, which the fit does not explain.
    rendered
        (Z, Y, X) image of the state, if it is known already.
    """
    image = np.asarray(state.rendered() if rendered is None else rendered)
    pixels, size = np.asarray(job.image), job.grid.voxel_size
    measured = filled_in(pixels, image)
    seen, shown = (
        levelled(state.without_local_background(i), job.grid, state.effects)
        for i in (measured, image)
    )
    single = job.second is None and single_slice(pixels)
    narrow = narrower_than_told(state.optics.sigma_um, size)
    images = _Images(image, seen, shown)
    untold = job.settings.fit.structure == "auto"
    return Facts(
        finished=state.converged,
        explained=left.explained,
        widths=_widths(job, state, images),
        slices=slices_apart(measured, image),
        dome=_dome(job, state, shown),
        narrow=job.settings.fit.fit_psf and narrow,
        cells=_cells(job, state, left, images),
        error=PredictedError(unknown=SINGLE) if single else predicted_error(job, state),
        voxel=geometric_mean(size),
        cut=share_cut(pixels),
        compressed=compressed(pixels),
        sharpened=state.light.interior > 0
        and is_sharpened(seen - shown, state.optics.sigma_um, size),
        unsure=state.unsure and not state.light.membrane,
        alone=state.unsure and state.light.membrane > 0,
        nuclei=state.dimmed is not None,
        lit=state.local_background is not None,
        leans=untold and _leans(state),
        blurred_deep=untold and isinstance(state.optics, ScalarPSF) and not state.light.membrane,
        accuracy=job.settings.fit.image_accuracy,
        followed=_followed(job, state, seen),
        single=single,
        missing=job.missing,
        by_hand=is_by_hand(state),
        doubts=doubted_scale(job),
    )


def _leans(state: FitState) -> bool:
    if state.optics.diagonal or state.light.interior <= 0:
        return False
    return state.effects.role(Halo) is None or not state.light.membrane


@dataclass(frozen=True, eq=False)
class _Images:
    """The rendered image, and the measured and the rendered one without the background effects."""

    rendered: np.ndarray
    seen: np.ndarray
    shown: np.ndarray


def _cells(
    job: FitInput, state: FitState, left: Residual, images: _Images
) -> tuple[CellFacts, ...]:
    tables = {
        **_telling(job, state, left),
        **_light(job, state, left, images),
        **_shape(job, state),
    }
    return tuple(
        CellFacts(region, **{fact: of[region] for fact, of in tables.items() if region in of})
        for region in _areas(state.mesh)
    )


def _telling(job: FitInput, state: FitState, left: Residual) -> _Tables:
    """How well the image tells each cell."""
    mesh, known = state.mesh, np.isfinite(np.asarray(job.image))
    counted = known if job.counted is None else known & job.counted
    high = {} if job.second is not None else _heights(mesh)
    return {
        "explained": left.shares(),
        "shown": left.shown(),
        "seen": surface_shares(known, job.grid, mesh),
        "counted": surface_shares(counted, job.grid, mesh),
        "slices": {r: height / job.grid.voxel_size[0] for r, height in high.items()},
        "cut": dict.fromkeys(cut_cells(mesh, job.grid), True),
    }


def _light(job: FitInput, state: FitState, left: Residual, images: _Images) -> _Tables:
    """Facts about the light of each cell, and beside it."""
    light, place = state.light, Cells(state.mesh, state.optics, job.grid)
    everywhere = np.ones(job.grid.shape, bool)
    found: _Tables = {
        "stray": _stray(left, state, images.shown),
        "lit": _lit(state),
        "uneven": uneven_insides(job, state, images.rendered),
        "inside_share": inside_shares(state),
    }
    if light.interior == 0:
        counts = everywhere if job.counted is None else job.counted
        found["inside"] = deep_brightness(place, images.seen, counts)
    if light.interior < 0:
        found["medium"] = dark_insides_shown(place, images.seen, images.shown, everywhere)
    if light.interior > 0 and not light.membrane:
        found["left_out"] = left_out(
            state.mesh, job.grid, state.optics, images.seen, images.shown, state.background
        )
    if light.membrane:
        found["enclosed"] = enclosing_membranes(place, images.seen, state.background)
    return found


def _shape(job: FitInput, state: FitState) -> _Tables:
    """Facts about the shape of each cell, and compared with that of its start."""
    mesh, fit = state.mesh, job.settings.fit
    given = mesh, job.grid, state.optics
    asked = fit.structure == "auto" and state.light.interior == 0
    volumes = mesh.volumes() if asked else {}
    return {
        "growth": _growth(job.mesh, mesh),
        "compact": _compactness(job.mesh, mesh),
        "small": {r: hardly_wider(v, job.optics, AMPLITUDES.clearly) for r, v in volumes.items()},
        "point": dict.fromkeys(shrunken(mesh, min(state.optics.sigma_um)), True),
        "crowded": dict.fromkeys(job.crowded, True),
        "outgrowth": outgrowths(*given),
        "dent": dents(*given),
        "beyond_neck": beyond_necks(job.mesh, *given).middles,
        "fold": folds(state),
        "unseen_wall": unseen_walls(state),
    }


def _stray(left: Residual, state: FitState, shown: np.ndarray) -> dict[int, float]:
    """Largest light of a residual spot near each region, over the light of the region."""
    areas = _areas(state.mesh)
    total = float(np.abs(shown - state.background).sum()) / (sum(areas.values()) or 1.0)
    found: dict[int, float] = {}
    for spot in left.spots:
        own = max(total * areas.get(spot.region, 0.0), 1e-30)
        found[spot.region] = max(found.get(spot.region, 0.0), abs(spot.light) / own)
    return found


def _widths(job: FitInput, state: FitState, images: _Images) -> dict[str, float]:
    """Width of the blur across and along Z over that of the PSF, as far as the image tells it.

    What is narrower than voxels can tell does not count, as voxels blur, too: for a stack of
    vesicles the spectrum gave 0.55 voxel along Z, and the PSF was 1.2.
    """
    optics, size = state.optics, job.grid.voxel_size
    tilted = isinstance(optics, GaussianPSF) and not optics.diagonal
    # Beside its long axis, a tilted one passes sharper light than along the axes of the image.
    sigma = optics.width() if tilted else optics.sigma_um
    told = first_sigma(images.seen, size, insides=False)  # as the bounds were measured
    widths = {"across": (told.yx.value, max(sigma[1:]), max(size[1:]))}
    if isinstance(optics, GaussianPSF):  # the spectrum tells less about a light cone
        widths["along Z"] = told.z.value, sigma[0], size[0]
    found = {
        axis: float(value / of)
        for axis, (value, of, side) in widths.items()
        if value is not None and not narrower_than_told((value,), (side,))
    }
    if not is_white(images.seen - images.shown):  # smoothed noise looks like sharper light
        # Measured across in 15 smoothed images: 0.64 to 0.79 of the true width is found.
        much = {"across": RULES.far_off}
        found = {axis: w for axis, w in found.items() if w > 1 or w < much.get(axis, 0.0)}
    if state.light.interior:  # the spectrum of insides falls faster than that of membranes
        found = {axis: width for axis, width in found.items() if width < 1}
    return found


def _followed(job: FitInput, state: FitState, seen: np.ndarray) -> float | None:
    """Share of what counted that surfaces explain, if the start explains hardly any; else None."""
    if not len(job.mesh.faces) or followed(seen, job.grid, job.mesh) >= SANITY.followed:
        return None
    counted = seen if job.counted is None else np.where(job.counted, seen, np.nan)
    return followed(counted, job.grid, state.mesh)


def _dome(job: FitInput, state: FitState, shown: np.ndarray) -> float:
    """Height of a dome in what effects add, over the range of the image; slopes do not count."""
    added = offset(state.effects, job.grid)
    if added is None or not np.ptp(shown):
        return 0.0
    left = added.numpy().astype(float)
    for axis, n in enumerate(left.shape):
        along = np.arange(n) - (n - 1) / 2
        others = tuple(other for other in range(3) if other != axis)
        slope = (left.mean(others) * along).sum() / max((along**2).sum(), 1.0)
        left -= np.expand_dims(slope * along, others)
    return float(np.ptp(left) / np.ptp(shown))


def _areas(mesh: Mesh) -> dict[int, float]:
    areas = mesh.areas()
    return {r: float(areas[own].sum()) for r, own in mesh.faces_by_region().items()}


def _heights(mesh: Mesh) -> dict[int, float]:
    """Height of each region along Z, um."""
    heights = mesh.vertices_numpy()[mesh.faces][..., 0]
    return {r: float(np.ptp(heights[own])) for r, own in mesh.faces_by_region().items()}


def _lit(state: FitState) -> dict[int, float]:
    """Share of the surface of each region that shines, as if that part were evenly bright.

    The squared mean density over the mean squared density: all light on a tenth of the surface
    gives 0.1. Empty if only insides shine.
    """
    if not state.light.membrane:
        return {}
    areas, light = state.mesh.areas(), state.mesh.areas() * np.asarray(state.density)
    squared = light * np.asarray(state.density)
    return {
        r: float(light[own].sum() ** 2 / max(areas[own].sum() * squared[own].sum(), 1e-300))
        for r, own in state.mesh.faces_by_region().items()
    }


def _growth(start: Mesh, end: Mesh) -> dict[int, float]:
    before: Mapping[int, float] = start.volumes()
    return {
        region: abs(volume / before[region])
        for region, volume in end.volumes().items()
        if before.get(region)
    }


def _compactness(start: Mesh, end: Mesh) -> dict[int, float]:
    before, after = _roundness(start), _roundness(end)
    return {r: value / before[r] for r, value in after.items() if before.get(r)}


def _roundness(mesh: Mesh) -> dict[int, float]:
    """Area of the sphere with the volume of each region, over the region's own area."""
    areas = _areas(mesh)
    return {
        region: float(np.cbrt(np.pi) * (6 * abs(volume)) ** (2 / 3) / areas[region])
        for region, volume in mesh.volumes().items()
        if areas.get(region)
    }
