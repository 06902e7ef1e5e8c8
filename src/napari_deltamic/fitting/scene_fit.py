"""The fit of a scene: threads and spots move, beside meshes that stay, until the image agrees.

It knows no blurred levels. Measured at 40 photons: threads that start 5 voxels off (3 widths of the
PSF) are found without them, and so are points 4 voxels off; with them fits took twice as long.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from ..common.choices import DeviceChoice
from ..errors import InputError
from ..fourier.devices import choose_device
from ..geometry.mesh import FloatArray
from ..runs.fit_settings import FitSettings, validated
from ..scene import Filament, Grid, Points, Scene
from .model.checks import check_image, check_inside, check_psf
from .model.default_accuracy import accuracy_for_image
from .model.level import Level
from .model.likelihood import explained
from .model.problem import Problem
from .scene_unknowns import SceneUnknowns

# A round that moves nothing further, in widths, or gains less, in nats, is rest: as in the fit of
# meshes.
_TOLERANCE, _NATS = 0.02, 0.1
# Nats for a step of one width. Where the image says better than to a width where something is, it
# is then nearer to the best place than a tenth of its standard error.
_SLOPE = 0.1
_GAIN = 1e-6  # relative gain of an iteration below which a round ends: single precision tells less


@dataclass(frozen=True, eq=False)
class SceneFit:
    """What a fit of a scene has found.

    Attributes
    ----------
    scene
        With positions, brightness and PSF as fitted.
    amplitude, background
        Measured image = amplitude * rendered image + background.
    loss
        Weighted residual relative to the variance of the image: 1 explains nothing.
    iterations
        Steps taken.
    converged
        Whether nothing moves any more.
    message
        A warning in plain words; mostly empty.
    """

    scene: Scene
    amplitude: float
    background: float
    loss: float
    iterations: int
    converged: bool
    message: str = ""


@torch.enable_grad()
def fit_scene(
    image: np.ndarray | Tensor,
    grid: Grid,
    scene: Scene,
    accuracy: float | None = None,
    *,
    fit_brightness: bool = True,
    fit_psf: bool = False,
    persistence: float | None = None,
    counted: np.ndarray | None = None,
    max_iterations: int = 1000,
    device: DeviceChoice = "auto",
) -> SceneFit:
    """Fit the filaments and points of a scene to an image; its surfaces and solids stay in place.

    Amplitude and background are solved for. Starts may be two widths of the PSF off. Filaments have
    a weak prior: they bend like polymers, and keep the spacing of their vertices.

    Parameters
    ----------
    image
        (Z, Y, X) measured intensities; NaN, or the mask of a masked array, marks missing voxels.
    grid
        Where the voxels lie.
    scene
        Where to start, with the optics. Its effects stay as they are.
    accuracy
        Relative L2 error of the rendered image; where not given, it follows from the noise.
    fit_brightness
        Whether each point, and each other structure as a whole, has a brightness to be found; else
        their ratios stay.
    fit_psf
        Whether the PSF is fitted, too.
    persistence
        Persistence length of the filaments, um: how stiff they are; 0 for no prior on bending. By
        default 100 widths of the PSF, which suits actin and all that is stiffer. Noise bends a
        thread less under a larger one.
    counted
        (Z, Y, X) bool: voxels that may count. What the scene does not describe should be left out.
    max_iterations
        The fit gives up after so many.
    device
        As in :class:`napari_deltamic.runs.fit_settings.FitSettings`.

    Raises
    ------
    InputError
        If the scene holds neither filaments nor points, one of them lies outside the image or has a
        segment without length; if an argument is wrong, or the image is one that :func:`fit`
        refuses.
    """
    if torch.is_inference_mode_enabled():
        raise InputError("a fit needs gradients: leave torch.inference_mode() first")
    pixels, known = check_image(image, grid, counted)
    _check_scene(scene, grid)
    if persistence is not None and not 0 <= persistence < np.inf:
        raise InputError(f"a persistence length is 0 um or more, not {persistence}")
    settings = validated(
        FitSettings,
        {
            "accuracy": accuracy_for_image(pixels, known) if accuracy is None else accuracy,
            "fit_psf": fit_psf,
            "max_iterations": max_iterations,
            "device": device,
        },
    )
    choose_device(settings.device)  # one that cannot be used is told now
    known = Problem(pixels, known, grid).counted_with(scene.effects)
    unknowns = SceneUnknowns(
        replace(scene, optics=scene.optics.detach()), fit_brightness, fit_psf, persistence
    )
    level = Level(pixels, known, grid, scene.optics, settings, scene.effects, 1.0)
    x, rest, iterations, last = _settled(level, unknowns, settings.max_iterations)
    said, found = "", last.found
    if last.explains_nothing():
        said = "stuck: noise alone would be explained as well; does the start lie near the signal?"
    elif not rest:
        said = f"{iterations} iterations were not enough: something is still moving"
    return SceneFit(
        unknowns.scene(x), found.amplitude, found.background, found.loss, iterations, not said, said
    )


def _check_scene(scene: Scene, grid: Grid) -> None:
    if scene.effects.view is not None:
        raise InputError(f"a scene is fitted to one view: leave out {scene.effects.view.name}")
    check_psf(scene.optics, grid)
    moving = [s for s in scene.structures if isinstance(s, (Filament, Points))]
    if not moving:
        raise InputError("nothing can move: give filaments or points, or fit the mesh by fit()")
    for structure in moving:
        what = "filament" if isinstance(structure, Filament) else "group of points"
        at = structure.positions()
        check_inside(f"a {what}", at.min(0), at.max(0), grid)
        if isinstance(structure, Filament):
            ends = at[structure.joined()]
            if not np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).min() > 0:
                raise InputError("a segment of a filament has no length")


# ------------------------------------------------------------------------------------- rounds


def _settled(
    level: Level, unknowns: SceneUnknowns, most: int
) -> tuple[FloatArray, bool, int, _Round]:
    """Numbers where all comes to rest, whether it has, the iterations; the round there."""
    x, rest, used = unknowns.start(), False, 0
    this = _Round(level, unknowns, x)
    while not rest and used < most:
        done = minimize(
            this,
            x,
            jac=True,
            method="L-BFGS-B",
            bounds=unknowns.bounds(x),
            options={"maxiter": most - used, "ftol": _GAIN, "gtol": _SLOPE},
        )
        near = float(np.abs(done.x - x).max()) <= _TOLERANCE
        rest, used = near or this(x)[0] - float(done.fun) <= _NATS, used + int(done.nit)
        x = done.x
        this = _Round(level, unknowns, x)
    return x, rest, used, this


class _Round:
    """The objective near some numbers: with the plan, voxels' weights and meshes' light of there.

    ``N / 2 log(squared residuals)`` and the prior, in nats: minus the log posterior of N voxels
    with noise of unknown strength.
    """

    def __init__(self, level: Level, unknowns: SceneUnknowns, x: FloatArray) -> None:
        self._level, self._unknowns = level, unknowns
        scene = unknowns.scene(x, brightness=False)
        self._renderer = level.renderer_of(scene)
        moving = (Filament, Points)
        with torch.no_grad():
            self._held = [
                None if isinstance(structure, moving) else self._renderer.part(k)
                for k, structure in enumerate(scene.structures)
            ]
            image = self._image(torch.from_numpy(x))
        effects = scene.effects
        index = torch.nonzero(level.counted.reshape(-1))[:, 0]
        voxels = level.weighted(index, image, effects)
        added = level.offset(effects)
        measured = voxels.measured
        if added is not None:
            measured = measured - added.reshape(-1)[index].to(measured)
        self._given = index, measured, voxels.weights
        self.found = explained(image, *self._given)[1]
        # What the rendering may be off is noise, too.
        self._least = level.accuracy**2 * self.found.squares / max(self.found.loss, 1e-30)

    def explains_nothing(self) -> bool:
        """Whether Schwarz' criterion prefers an even background, which has none of the numbers."""
        voxels, numbers = len(self._given[0]), len(self._unknowns.start())
        gained = -voxels * np.log(max(self.found.loss, 1e-30))
        return self.found.bounded or bool(gained < numbers * np.log(voxels))

    def __call__(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Nats at numbers (n,), and their gradient (n,)."""
        at = torch.tensor(x, requires_grad=True)
        index, measured, weights = self._given
        squares, _ = explained(self._image(at), index, measured, weights)
        grown = (squares.cpu() + self._least) / (self.found.squares + self._least)
        nats = len(index) / 2 * torch.log(grown) + self._unknowns.prior(at)
        nats.backward()
        assert at.grad is not None
        psf = self._unknowns.psf
        further, pull, _ = self._unknowns.imaging.prior(x[psf], np.zeros(0))
        gradient = at.grad.numpy()
        gradient[psf] += pull
        return float(nats.detach()) + further, gradient

    def _image(self, x: Tensor) -> Tensor:
        places, lights, optics = self._unknowns.parts(x)
        boxes = [
            self._renderer.part(k, at, light)
            if held is None
            else light.to(held.real.dtype).to(held.device) * held
            for k, (at, light, held) in enumerate(zip(places, lights, self._held, strict=True))
        ]
        otf = self._renderer.otf(optics)
        return self._level.rendered(self._renderer, sum(boxes[1:], boxes[0]), otf)
