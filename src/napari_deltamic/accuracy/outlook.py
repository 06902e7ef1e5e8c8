"""What a fit that could be started would cost: its forecast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..fitting.job import FitInput, optics_of
from ..fitting.model.default_accuracy import accuracy_of, image_noise
from ..fitting.shape_dial import with_trials
from ..geometry import Mesh
from ..optics import Optics
from ..runs.seeds import Seeds
from ..runs.settings import NEAR_LEVELS, FitSettings, SceneSettings
from ..scene import Grid
from .forecast import Forecast, forecast
from .machine_costs import costs
from .renewed_forecast import RenewedForecast
from .rough_surfaces import rough_surfaces

Forecaster = Forecast | RenewedForecast  # says how long a fit will still take


@dataclass(frozen=True, eq=False)
class SceneNow:
    """A fit that could be started.

    choice : of the accuracy, as on the dial.
    image : (Z, Y, X), or what becomes such an array.
    scene : PSF and effects.
    settings : of the fit; the accuracy is that of the choice.
    known : surfaces that points of the seeds have already; None where that is not known.
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
        """The PSF, computed when asked. InputError where it cannot be."""
        return optics_of(self.scene)

    def pixels(self) -> NDArray[Any]:
        return np.asarray(self.image)

    def mesh(self) -> Mesh:
        """The surfaces, or some about as large. InputError where there are none."""
        return rough_surfaces(self.seeds, self.grid, self.known).mesh


@dataclass(frozen=True)
class Outlook:
    """What a scene costs: noise of its image, accuracy that the choice stands for, forecast."""

    noise: float
    accuracy: float
    forecast: Forecast


def outlook(scene: SceneNow) -> Outlook:
    """The forecast of a scene; measures this machine where that was never done (a second)."""
    known = costs(measure=True)
    pixels = scene.pixels()
    noise = image_noise(pixels)
    accuracy = accuracy_of(scene.choice, noise)
    trials = scene.settings.trials and with_trials(scene.choice)
    found: dict[str, Any] = {"accuracy": accuracy, "trials": trials}
    if scene.seeds.kind != "rough" and scene.settings.levels is None:
        found["levels"] = NEAR_LEVELS
    settings = scene.settings.model_copy(update=found)
    effects = scene.scene.effects
    start = rough_surfaces(scene.seeds, scene.grid, scene.known)
    expected = forecast(
        pixels, scene.grid, start.mesh, scene.optics, settings, None, effects, known, start.touching
    )
    return Outlook(noise, accuracy, expected)


def expected(job: FitInput) -> Forecaster | None:
    """What forecasts how long a fit will take; None where the fit will say what is wrong."""
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
