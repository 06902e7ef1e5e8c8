"""What a fit would be of, as the panels show it: for its forecast and for measurements."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...accuracy.forecast import Forecast, forecast
from ...accuracy.machine_costs import costs
from ...accuracy.rough_surfaces import points_of, rough_surfaces
from ...fitting.default_accuracy import image_noise
from ...fitting.job import optics_of
from ...geometry import Mesh
from ...optics import Optics
from ...runs.seeds import Seeds
from ...runs.settings import NEAR_LEVELS, FitSettings, SceneSettings
from ...scene import Grid
from ..document import Document
from .accuracy_dial import accuracy_of


@dataclass(frozen=True, eq=False)
class SceneNow:
    """A fit that could be started; nothing in it knows of a widget or a layer.

    choice : of the accuracy dial.
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
    guessed: bool


def outlook(scene: SceneNow) -> Outlook:
    """The forecast of a scene; measures this machine where that was never done (a second)."""
    known = costs(measure=True)
    pixels = scene.pixels()
    noise = image_noise(pixels)
    accuracy = accuracy_of(scene.choice, noise)
    found: dict[str, Any] = {"accuracy": accuracy}
    if scene.seeds.kind != "rough" and scene.settings.levels is None:
        found["levels"] = NEAR_LEVELS
    settings = scene.settings.model_copy(update=found)
    effects = scene.scene.effects
    start = rough_surfaces(scene.seeds, scene.grid, scene.known)
    given = scene.grid, start.mesh, scene.optics, settings
    expected = forecast(pixels, *given, None, effects, known, start.touching)
    return Outlook(noise, accuracy, expected, start.guessed)


class NoiseOf:
    """The noise of the image chosen, measured once for each image and time."""

    def __init__(self, doc: Document) -> None:
        self._doc = doc
        self._of: tuple[Any, ...] = ()
        self._noise: float | None = None
        self.held = False  # while a fit runs, that of its image counts

    def __call__(self) -> float:
        """The noise. InputError if there is no image."""
        known = self.known
        if known is None:
            known = image_noise(self._doc.image.stack())
            self.learn(self.key(), known)
        return known

    @property
    def known(self) -> float | None:
        """The noise where it was measured, else None."""
        return self._noise if self.held or self._of == self.key() else None

    def key(self) -> tuple[Any, ...]:
        """What it is the noise of."""
        image = self._doc.image
        if image.layer is None:
            return ()
        return weakref.ref(image.layer), id(image.layer.data), image.time, image.box

    def hold(self) -> None:
        """A fit begins."""
        self.held = self.known is not None

    def let_go(self) -> None:
        """It has ended."""
        self.held = False

    def learn(self, key: tuple[Any, ...], noise: float) -> None:
        """Take over what was measured elsewhere."""
        if key and not self.held:
            self._of, self._noise = key, noise


def scene_key(doc: Document) -> tuple[Any, ...]:
    """The same as long as image, voxel size and PSF are."""
    image = doc.image
    size = None if image.layer is None else tuple(image.layer.scale)
    return id(image.layer), image.time, image.box, size, doc.settings.optics.key()


def scene_now(doc: Document) -> SceneNow:
    """The scene as it is chosen; touches no voxel. InputError if something is missing."""
    image, frame = doc.image, doc.image.frame()
    seeds = doc.cells.seeds(frame, copied=False)
    return SceneNow(
        choice=doc.settings.accuracy.choice,
        image=image.unread(image.layer),
        grid=frame.grid(image.shape()),
        scene=doc.settings.scene_settings(),
        settings=doc.settings.other_settings(),
        seeds=seeds,
        known=_known_surfaces(doc, points_of(seeds)),
    )


def _known_surfaces(doc: Document, points: int) -> Mesh | None:
    """What the preview shows, else what the fit of this image has or found."""
    if doc.cells.preview_mesh is not None:
        return doc.cells.preview_mesh
    record = doc.record
    if record is None or record.link.image_layer is not doc.image.layer:
        return None
    state = doc.run.state if doc.running else record.state
    if state is None:
        return None
    mesh: Mesh = state.mesh
    return mesh if len(np.unique(mesh.regions[mesh.regions > 0])) == points else None
