"""How far the surfaces of a fit are expected to be from the true ones, cell by cell."""

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
    """Which alternatives count, and what is added for errors that no alternative shows.

    Attributes
    ----------
    as_good
        Share of the best alternative's gain from which on another counts: it is then as likely.
    times
        Actual error of surfaces over what the fit itself tells of it: no model is entirely right.
        Measured on 54 scenes (``benchmarks.defaults`` on f7b2103) and 52 random ones, without those
        graded poor: 1.45 and 1.60 in the median, 0.97 and 1.09 with this, and two thirds within
        0.73 to 1.2 and 0.72 to 2.2. Scaling the alternatives as well would scatter more.
    """

    as_good: float = 0.5
    times: float = 1.5


RULES = PredictedErrorRules()
_OTHER_PSF = "another PSF"
_INSIDE = "light inside"


@dataclass(frozen=True)
class ShapeDeviation:
    """Predicted error of the surface of one cell, or of all: root mean square over it, um.

    Displacements are along the normal, each averaged over a patch as wide as the PSF. What lies
    outside of the image is a guess and left out, unless all of a cell does.

    Attributes
    ----------
    noise
        Displacement by other noise of the same kind; it includes the misfit of the model, as the
        variance is that of the residuals.
    settling
        Displacement by further iterations.
    prior
        Displacement due to the prior on shape.
    triangles
        Distance of flat triangles from the curved surface that they stand for.
    alternative
        Displacement if the model had what it lacks.
    """

    noise: float
    settling: float
    prior: float
    triangles: float = 0.0
    alternative: float = 0.0

    @property
    def total(self) -> float:
        """The total error, um: all parts, added in squares."""
        return float(np.linalg.norm(list(self.shares().values())))

    def shares(self) -> dict[str, float]:
        """What each part adds to the total, um, by name; all but the last times ``times``."""
        parts = {name: RULES.times * part for name, part in asdict(self).items()}
        return {**parts, "alternative": self.alternative}


@dataclass(frozen=True)
class PredictedError:
    """The predicted errors of a fit.

    Attributes
    ----------
    whole, cells
        Error of all surfaces, and of each cell by its number.
    lacks
        The likely alternative that moves the surfaces most; "" if there is none.
    unknown
        Why there are no predicted errors; "" if there are.
    cone
        Whether the image shows the light cone of an objective, which the fitted PSF lacks.
    """

    whole: ShapeDeviation | None = None
    cells: Mapping[int, ShapeDeviation] = field(default_factory=dict)
    lacks: str = ""
    unknown: str = ""
    cone: bool = False


def predicted_error(job: FitInput, state: FitState) -> PredictedError:
    """The predicted errors at the end of a fit, from how the surfaces respond to changes there.

    The standard deviation of a displacement is that of H^-1 J' W r for the residuals r with random
    signs. An alternative is a further column of the image (another width of the PSF, light inside,
    an effect); it moves the surface by its best amplitude times the response of the surface.
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
    mesh = state.mesh
    patches = Patches(mesh, geometric_mean(state.optics.sigma_um))
    normals = vertex_normals(mesh.vertices_numpy(), mesh.faces)

    def squared(displaced: FloatArray) -> FloatArray:
        """(V,) squared means over patches of displacements (V, 3) along the normals."""
        found: FloatArray = patches.means((displaced * normals).sum(1)) ** 2
        return found

    lacks, other = _alternative(posed, responses, state, told=settings.structure == "interior")
    parts = (
        np.mean([squared(one) for one in noise], axis=0),
        squared(responses.settled()),
        squared(responses.pulled()),
        _squared_gaps(mesh),
        squared(other),
    )
    seen = _in_image(mesh, job.grid)

    def over(chosen: np.ndarray) -> ShapeDeviation:
        chosen = chosen[seen[chosen]] if seen[chosen].any() else chosen
        return ShapeDeviation(*(float(np.sqrt(part[chosen].mean())) for part in parts))

    cells = {k: over(np.unique(mesh.faces[own])) for k, own in mesh.faces_by_region().items()}
    return PredictedError(over(np.unique(mesh.faces)), cells, lacks, cone=state.cone)


def _in_image(mesh: Mesh, grid: Grid) -> np.ndarray:
    """(V,) bool: which vertices lie within the voxels of the image."""
    at = (mesh.vertices_numpy() - np.asarray(grid.origin)) / np.asarray(grid.voxel_size)
    inside: np.ndarray = ((at >= -0.5) & (at <= np.asarray(grid.shape) - 0.5)).all(1)
    return inside


def _squared_gaps(mesh: Mesh) -> FloatArray:
    """(V,) squared distances (um^2) of faces from the curved surface, means at each vertex."""
    at, squares = mesh.faces.reshape(-1), np.repeat(gaps(mesh) ** 2, 3)
    n = len(mesh.vertices)
    found: FloatArray = np.bincount(at, squares, n) / np.maximum(np.bincount(at, minlength=n), 1)
    return found


def _alternative(
    posed: Posed, responses: Responses, state: FitState, told: bool
) -> tuple[str, FloatArray]:
    """What the model lacks, "" for nothing, and how the surface would move with it, (V, 3) um.

    told : whether membranes do not shine, as the user says.
    """
    tried = responses.alternatives(_lacking(posed, responses, state))
    best = max((one.gain for one in tried), default=0.0)
    likely = [one for one in tried if one.gain >= max(REFITS.sure, RULES.as_good * best)]
    # Around dark nuclei, fits of both have already been compared with insides alone.
    asked = state.dimmed is None and not told
    membranes = fainter_membranes(posed, responses, state) if asked else None
    if membranes is not None:
        likely.append(membranes)
    if not likely:
        return "", np.zeros((len(state.mesh.vertices), 3))
    found = max(likely, key=lambda one: float(np.square(one.moved).sum()))
    return found.name, found.moved


def _lacking(
    posed: Posed, responses: Responses, state: FitState
) -> Iterator[tuple[str, FloatArray]]:
    """What the model may lack, with its columns (N, m), one at a time as memory may be short."""
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
