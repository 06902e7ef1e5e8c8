"""How far the surfaces of a fit are thought to be from the true ones, cell by cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
import torch

from ..common.triple import geometric_mean
from ..errors import InputError
from ..fitting.job import FitInput
from ..fitting.model.state import FitState
from ..fitting.objective.convergence import Patches, vertex_normals
from ..fitting.objective.posed import Posed
from ..fitting.objective.prediction import as_floats
from ..fitting.surface.triangle_quality import gaps
from ..fitting.uncertainty.errors_of_measures import posed_at
from ..fitting.uncertainty.refits import RULES as REFITS
from ..fitting.uncertainty.responses import Responses, noise_of, responses_of
from ..geometry.mesh import FloatArray, Mesh
from ..scene import Grid
from ..scene.light import INSIDES
from .candidates import allowed, chosen_candidates, points_inwards, variants
from .fainter_membranes import fainter_membranes


@dataclass(frozen=True)
class PredictedErrorRules:
    """Which alternatives count, and what is added for what no alternative tells.

    Attributes
    ----------
    as_good
        Of what the best alternative gains: then it is as likely.
    times
        What surfaces are off by, over what the fit itself tells of it: no model is right in all.
        Measured on 54 scenes (``benchmarks.defaults`` on f7b2103) and 52 random ones, without those
        graded poor: 1.45 and 1.60 in the median, 0.97 and 1.09 with this, and two thirds within
        0.73 to 1.2 and 0.72 to 2.2. A multiple of alternatives as well scatters more.
    """

    as_good: float = 0.5
    times: float = 1.5


RULES = PredictedErrorRules()
_OTHER_PSF = "another PSF"
_INSIDE = "light inside"


@dataclass(frozen=True)
class ShapeDeviation:
    """Of the surface of one cell, or of all: um, root of the mean square over it.

    What lies outside of the image is a guess, and left out, unless all of a cell does.
    Displacements along the normal, each averaged over a patch as wide as the PSF.

    Attributes
    ----------
    noise
        What other noise of the same kind would move it by; the misfit of the model is in it, as
        the variance is that of the residuals.
    settling
        What more iterations would.
    prior
        What the prior on its shape pulls.
    triangles
        How far flat triangles lie from a surface as curved as theirs is.
    alternative
        What it would move by if the model had what it lacks.
    """

    noise: float
    settling: float
    prior: float
    triangles: float = 0.0
    alternative: float = 0.0

    @property
    def total(self) -> float:
        """All together."""
        return float(np.linalg.norm(list(self.shares().values())))

    def shares(self) -> dict[str, float]:
        """What each part adds to the total, by its name; all but the last count ``times``."""
        parts = {name: RULES.times * part for name, part in asdict(self).items()}
        return {**parts, "alternative": self.alternative}


@dataclass(frozen=True)
class PredictedError:
    """The predicted errors of a fit.

    Attributes
    ----------
    whole, cells
        Of all surfaces, and of each cell by its number.
    lacks
        The alternative that explains most of what is left; empty where none does.
    unknown
        Why there are none; empty where there are.
    cone
        Whether the image shows the light cone of an objective, which the fitted PSF lacks.
    """

    whole: ShapeDeviation | None = None
    cells: Mapping[int, ShapeDeviation] = field(default_factory=dict)
    lacks: str = ""
    unknown: str = ""
    cone: bool = False


def predicted_error(job: FitInput, state: FitState) -> PredictedError:
    """The errors of the end of a fit, from what it gives way to there.

    The standard deviation of a displacement is that of H^-1 J' W r with the residuals r, each with
    a sign by lot; an alternative is a further column of the image (another width of the PSF, light
    inside, an effect), and moves the surface by its best amplitude times what the surface follows
    it by.
    """
    try:
        settings = job.settings.fit
        posed = posed_at(job.image, job.grid, state, settings, job.counted)
        responses = responses_of(posed, state, settings)
        noise = noise_of(responses)
    except InputError as error:
        return PredictedError(unknown=str(error))
    except np.linalg.LinAlgError:
        return PredictedError(unknown="the image does not determine the shape")
    patches = _Patches(state)
    squares = [patches.means(one) ** 2 for one in noise]
    lacks, other = _alternative(posed, responses, state)
    parts = (
        np.mean(squares, axis=0),
        patches.means(responses.settled()) ** 2,
        patches.means(responses.pulled()) ** 2,
        _squared_gaps(state.mesh),
        patches.means(other) ** 2,
    )

    seen = _in_image(state.mesh, job.grid)

    def over(chosen: np.ndarray) -> ShapeDeviation:
        chosen = chosen[seen[chosen]] if seen[chosen].any() else chosen
        return ShapeDeviation(*(float(np.sqrt(part[chosen].mean())) for part in parts))

    every = np.unique(state.mesh.faces)
    cells = {region: over(own) for region, own in _vertices(state.mesh).items()}
    return PredictedError(over(every), cells, lacks, cone=state.cone)


def _in_image(mesh: Mesh, grid: Grid) -> np.ndarray:
    """(V,) bool: vertices within the voxels of an image."""
    at = (mesh.vertices_numpy() - np.asarray(grid.origin)) / np.asarray(grid.voxel_size)
    inside: np.ndarray = ((at >= -0.5) & (at <= np.asarray(grid.shape) - 0.5)).all(1)
    return inside


def _squared_gaps(mesh: Mesh) -> FloatArray:
    """(V,) um^2: means over the faces of each vertex, of how far these lie from the surface."""
    at, squares = mesh.faces.reshape(-1), np.repeat(gaps(mesh) ** 2, 3)
    n = len(mesh.vertices)
    found: FloatArray = np.bincount(at, squares, n) / np.maximum(np.bincount(at, minlength=n), 1)
    return found


def _alternative(posed: Posed, responses: Responses, state: FitState) -> tuple[str, FloatArray]:
    """What the model lacks, and (V, 3) what the surface would move by with it."""
    tried = responses.alternatives(_lacking(posed, responses, state))
    best = max((one.gain for one in tried), default=0.0)
    likely = [one for one in tried if one.gain >= max(REFITS.sure, RULES.as_good * best)]
    # Around dark nuclei, fits of both have been held against insides alone.
    membranes = None if state.dimmed is not None else fainter_membranes(posed, responses, state)
    if membranes is not None:
        likely.append(membranes)
    if not likely:
        return "", np.zeros((len(state.mesh.vertices), 3))
    found = max(likely, key=lambda one: float(np.square(one.moved).sum()))
    return found.name, found.moved


def _lacking(
    posed: Posed, responses: Responses, state: FitState
) -> Iterator[tuple[str, FloatArray]]:
    """What the model may lack, and its columns (N, m); of large images only one fits in memory."""
    if not len(posed.at.optics):
        yield _OTHER_PSF, posed.posterior.psf_columns(posed.at)
    if not state.light.interior and state.mesh.is_closed():
        yield _INSIDE, _inside(posed, state)
    for name in chosen_candidates(None, state.effects):
        for effect in variants(name, state.optics):
            fits = posed.posterior.pads_enough_for(posed.at, effect)
            if fits and allowed(effect, state.effects) and effect.bounds:
                columns = posed.posterior.columns_of(posed.at, effect)
                if columns.any() and points_inwards(effect, responses.amplitudes(columns)):
                    yield name, columns


def _inside(posed: Posed, state: FitState) -> FloatArray:
    """(N, 1) the image of the insides alone."""
    level, view = posed.posterior.level, posed.posterior.views[0]
    renderer = level.renderer(state.mesh, state.optics, state.effects, insides=True)
    with torch.no_grad():
        otf = renderer.otf(state.optics)
        shown = level.rendered(renderer, renderer.transform(light=INSIDES), otf)
        return as_floats(view.voxels.of(shown))[:, None]


class _Patches:
    """Means over patches as wide as the PSF."""

    def __init__(self, state: FitState) -> None:
        width = geometric_mean(state.optics.sigma_um)
        self._patches = Patches(state.mesh, width)
        self._normals = vertex_normals(state.mesh.vertices_numpy(), state.mesh.faces)

    def means(self, displaced: FloatArray) -> FloatArray:
        """(V,) along the normals, of displacements (V, 3)."""
        return self._patches.means((displaced * self._normals).sum(1))


def _vertices(mesh: Mesh) -> dict[int, np.ndarray]:
    """Vertices of each cell."""
    return {region: np.unique(mesh.faces[own]) for region, own in mesh.faces_by_region().items()}
