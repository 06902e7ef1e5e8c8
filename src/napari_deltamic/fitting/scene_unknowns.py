"""What a fit of a scene moves: one vector of numbers, and the scene that they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..geometry.arrays import FloatArray, to_numpy
from ..optics import Optics
from ..scene import Filament, Points, Scene, Solid, Surface
from ..scene.structures import Structure
from .model.imaging import Imaging
from .model.level import SHARPER
from .thread_prior import PERSISTENCE, ThreadPrior

_REACH = 1.0  # widths that positions may go, or factors e of a brightness, before a new plan
# Standard deviation of the prior on log brightness: a factor of e is nothing odd.
_BRIGHTNESS = 1.0


class SceneUnknowns:
    """One vector (n,): places in widths of the PSF from their start, log brightness, the PSF.

    Parameters
    ----------
    scene
        At the start; its optics are no part of a gradient.
    fit_brightness, fit_psf
        Whether these move, too.
    persistence
        um, of its filaments; by default :data:`.thread_prior.PERSISTENCE`.
    """

    def __init__(
        self, scene: Scene, fit_brightness: bool, fit_psf: bool, persistence: float | None
    ) -> None:
        self._start = scene
        self.width = min(scene.optics.sigma_um)
        self.imaging = Imaging(scene.optics, scene.effects, scene.optics, fit_psf, False)
        self._fit_brightness = fit_brightness
        self._places = [torch.from_numpy(_places(s)) for s in scene.structures]
        self._lights = [len(s.places) if isinstance(s, Points) else 1 for s in scene.structures]
        if persistence is None:
            persistence = PERSISTENCE * self.width
        self._threads = [
            (k, ThreadPrior.of(_places(s), s.joined(), persistence))
            for k, s in enumerate(scene.structures)
            if isinstance(s, Filament)
        ]
        self._moving = sum(at.numel() for at in self._places)
        self.psf = slice(self._moving + sum(self._lights), None)

    def start(self) -> FloatArray:
        """The unknowns of the given scene."""
        return np.concatenate([np.zeros(self.psf.start), self.imaging.numbers()[0]])

    def bounds(self, x: FloatArray) -> list[tuple[float, float]]:
        """Bounds of a round that begins there."""
        reach = np.zeros(len(x))
        reach[: self._moving] = _REACH
        reach[self._moving : self.psf.start] = _REACH * self._fit_brightness
        reach[self.psf] = -np.log(SHARPER)
        ends = [x - reach, x + reach]
        for end in ends:
            end[self.psf] = self.imaging.bounded(end[self.psf], np.zeros(0))[0]
        return list(zip(*(end.tolist() for end in ends), strict=True))

    def parts(self, x: Tensor) -> tuple[list[Tensor], list[Tensor], Optics]:
        """Places (N, 3) um and brightness (P,) or (1,) of each structure, and the PSF."""
        sizes = [at.numel() for at in self._places]
        split = list(x[: self.psf.start].split(sizes + self._lights))
        moves = [move.reshape(-1, 3) for move in split[: len(sizes)]]
        places = [at + self.width * m for at, m in zip(self._places, moves, strict=True)]
        lights = [light.exp() for light in split[len(sizes) :]]
        return places, lights, self.imaging.optics_of(x[self.psf])

    def scene(self, x: FloatArray, brightness: bool = True) -> Scene:
        """The scene with these numbers; its brightness as it was given, if asked."""
        places, lights, optics = self.parts(torch.from_numpy(x))
        given = zip(self._start.structures, places, lights, strict=True)
        structures = tuple(
            _changed(s, at.numpy(), light.numpy() if brightness else np.ones(len(light)))
            for s, at, light in given
        )
        return replace(self._start, structures=structures, optics=optics)

    def prior(self, x: Tensor) -> Tensor:
        """Nats, differentiable; of all but the PSF."""
        places, lights, _ = self.parts(x)
        nats = 0.5 * (torch.cat(lights).log() / _BRIGHTNESS).square().sum()
        return nats + sum(prior.nats(places[k]) for k, prior in self._threads)


def _places(structure: Structure) -> FloatArray:
    """(N, 3) um of what moves."""
    return structure.positions() if isinstance(structure, (Filament, Points)) else np.zeros((0, 3))


def _changed(structure: Structure, places: FloatArray, light: FloatArray) -> Structure:
    """The structure at other places, if it moves, and with another brightness, (P,) or (1,)."""
    if isinstance(structure, Points):
        return Points(places, to_numpy(structure.weight) * light)
    factor = float(light[0])
    if isinstance(structure, Filament):
        return Filament(places, structure.segments, to_numpy(structure.density) * factor)
    if factor == 1:
        return structure
    if isinstance(structure, Solid):
        return Solid(structure.mesh, structure.densities().numpy() * factor)
    assert isinstance(structure, Surface)
    return Surface(structure.mesh, to_numpy(structure.density) * factor)
