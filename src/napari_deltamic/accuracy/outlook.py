"""The forecast of a fit that could be started now."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting.job import FitInput, completed, optics_of
from ..fitting.model.default_accuracy import accuracy_of, image_noise, is_length
from ..fitting.shape_dial import Situation, dialled
from ..geometry import Mesh
from ..optics import Optics
from ..runs.fit_settings import SHAPE_CHOICES
from ..runs.seeds import Seeds
from ..runs.settings import FitSettings, SceneSettings
from ..scene import Grid
from .forecast import Forecast, forecast
from .machine_costs import costs
from .rough_surfaces import rough_surfaces


@dataclass(frozen=True, eq=False)
class SceneNow:
    """A fit that could be started.

    choice : choice of accuracy, as on the dial.
    image : (Z, Y, X), or something that converts to such an array.
    scene : PSF and effects.
    settings : settings of the fit; their accuracy is replaced by that of the choice.
    known : surfaces already found for the points of the seeds; None if there are none yet.
    """

    choice: str
    image: Any
    grid: Grid
    scene: SceneSettings
    settings: FitSettings
    seeds: Seeds
    known: Mesh | None

    @property
    def optics(self) -> Optics:
        """The PSF, computed when asked for. InputError if it is not possible."""
        return optics_of(self.scene)

    def pixels(self) -> NDArray[Any]:
        return np.asarray(self.image)

    def mesh(self) -> Mesh:
        """The starting surfaces, or some about as large. InputError if there are none."""
        return rough_surfaces(self.seeds, self.grid, self.known).mesh


@dataclass(frozen=True)
class Outlook:
    """What a fit costs: noise of its image, accuracy that the choice stands for, forecast."""

    noise: float
    accuracy: float
    forecast: Forecast


def outlook(scene: SceneNow) -> Outlook:
    """The outlook of a fit; first measures this machine if that was never done (a second)."""
    known = costs(measure=True)
    pixels = scene.pixels()
    noise = image_noise(pixels)
    start, optics = rough_surfaces(scene.seeds, scene.grid, scene.known), scene.optics
    of_shape = scene.choice in SHAPE_CHOICES or is_length(scene.choice)  # else of images alone
    found = {"accuracy": None if of_shape else accuracy_of(scene.choice, noise)}
    now = Situation.of(start.mesh, scene.grid, optics.sigma_um, noise)
    wanted = dialled(scene.choice.replace(" ", "") if of_shape else "normal", now)
    settings = completed(scene.settings.model_copy(update=found), wanted, scene.seeds.kind)
    effects = scene.scene.effects
    expected = forecast(
        pixels, scene.grid, start.mesh, optics, settings, None, effects, known, start.touching
    )
    return Outlook(noise, settings.image_accuracy, expected)


def expected(job: FitInput) -> Forecast | None:
    """The forecast of a fit; None for invalid input, on which the fit itself will report."""
    settings = job.settings
    try:
        return forecast(
            job.image,
            job.grid,
            job.mesh,
            job.optics,
            settings.fit,
            job.counted,
            settings.scene.effects,
        )
    except InputError:
        return None
