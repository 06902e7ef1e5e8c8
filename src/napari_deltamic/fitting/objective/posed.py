"""An objective as it is posed, and what a descent has to know of it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...geometry.mesh import FloatArray
from ...scene import Renderer
from ..model.level import Voxels, differences
from ..model.likelihood import Match, solve_scale, total
from ..model.state import FitState
from ..model.variables import Variables
from .posterior import Posterior
from .prediction import as_floats


@dataclass(frozen=True, eq=False)
class Posed:
    """An objective, and what a descent has to know of it.

    Attributes
    ----------
    posterior
        The objective.
    at
        Where the fit is.
    renderer
        Planned for the surface there.
    variance
        Of the first image's residuals, see :class:`View`.
    left
        Weighted squares that are left of the first image where the fit is, over their weights.
    held
        Whether voxels, weights and variances are those of before.
    firmness
        Second derivative of its misfit by a displacement of a piece of surface along its normal,
        for each um^2 of it: nats / um^4.
    whole
        The voxels that count, without foreign light, before insides were evened.
    """

    posterior: Posterior
    at: Variables
    renderer: Renderer
    variance: float
    left: float
    held: bool
    firmness: float
    whole: Voxels

    def shown(self, state: FitState) -> FloatArray:
        """(N,) the image of a state where voxels count, of amplitude 1."""
        return as_floats(self.posterior.views[0].voxels.of(self._image(state)))

    def left_by(self, image: Tensor) -> tuple[float, float]:
        """What another image would leave of the first one, as :attr:`left`, and noise of that.

        Noise is what differs from voxel to voxel along X. image : (Z, Y, X), of any amplitude.
        """
        level, voxels = self.posterior.level, self.posterior.views[0].voxels
        shown = voxels.of(image).to(voxels.weights)
        measured = torch.from_numpy(self.posterior.measured(self.at)[0]).to(shown)
        weights = voxels.weights_for(shown, measured)
        a, b, _ = solve_scale(shown, measured, weights)
        rest = voxels.of(differences(level.target - a * image.to(level.target)))
        squares = ((measured - a * shown - b) ** 2, rest.to(weights) ** 2)
        whole = total(voxels.weights)
        left, noise = (float(total(weights * one) / whole) for one in squares)
        return left, noise

    def nats_left_by(self, image: Tensor, evened: bool) -> Tensor:
        """(N,) what another image would leave of each voxel of the first one, in nats.

        evened : whether of insides that are as even as they are modelled, or as they were measured.
        """
        voxels = self.posterior.views[0].voxels if evened else self.whole
        shown = voxels.of(image).to(voxels.weights)
        measured = self.posterior.less_effects(self.at, voxels).to(shown)
        weights = voxels.weights_for(shown, measured)
        a, b, _ = solve_scale(shown, measured, weights)
        return weights * (measured - a * shown - b) ** 2 / (2 * self.variance)

    def _image(self, state: FitState) -> Tensor:
        """(Z, Y, X) of a state, of amplitude 1."""
        level = self.posterior.level
        renderer = level.renderer(state.mesh, state.optics, state.effects, insides=True)
        with torch.no_grad():
            density = torch.from_numpy(state.density)
            spectrum = renderer.transform(density=density, light=state.light)
            return level.rendered(renderer, spectrum, renderer.otf(state.optics))


def squares_left(found: Match, voxels: Voxels) -> float:
    """Weighted squares that are left of an image, over their weights."""
    return found.squares / max(float(total(voxels.weights)), 1e-300)
