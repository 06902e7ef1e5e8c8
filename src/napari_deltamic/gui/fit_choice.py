"""The user's choices for a fit: accuracy, PSF, effects and all else; panels show and edit them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from psygnal import Signal

from ..common.triple import Triple, triple
from ..errors import InputError
from ..fitting.model.default_accuracy import (
    accuracy_of,
    chosen,
    image_noise,
    is_length,
    relative,
    written,
)
from ..runs.fit_settings import SHAPE_CHOICES
from ..runs.optics_settings import MicroscopeOptics
from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..runs.settings import FitSettings, SceneSettings, validated
from ..scene.effects import Effects, ViewEffect
from .image_source import ImageSource, SecondSource
from .viewing.frame import voxel_size

NORMAL = "normal"


class FitChoice:
    """The user's choices for a fit of the image chosen.

    What is typed may be invalid: InputError says why when it is asked for.

    Attributes
    ----------
    accuracy : a name or a number, as on the dial.
    psf : its settings; None for a Gaussian; an InputError where they are not complete.
    sigma : um, the widths of that Gaussian.
    effects : without the second view, which is chosen by its layer.
    noise : of the image chosen.
    """

    changed = Signal(bool)  # whether by the user; else (a session, undo) panels show all anew

    def __init__(self, image: ImageSource, second: SecondSource) -> None:
        self._image, self._second = image, second
        self._fit: FitSettings | InputError = FitSettings()
        self.accuracy = NORMAL
        self.psf: Any = None
        self.sigma: Triple = (1.0, 1.0, 1.0)
        self.effects = Effects()
        self.noise = NoiseOf(image)
        self._sigma_given = False
        self._came_with_image = False  # whether the PSF did
        image.replaced.connect(self._forget_psf)
        image.changed.connect(self._guess_sigma)
        second.edited.connect(partial(self.changed.emit, True))
        self._guess_sigma()

    # ---- what is chosen -----------------------------------------------------------------------

    def fit_settings(self) -> FitSettings:
        """The settings of the fit. InputError if one is invalid."""
        word = self.accuracy
        of_shape = word in SHAPE_CHOICES or is_length(word)  # numbers alone are of images
        by_noise = word == NORMAL or is_length(word)
        found = {
            "accuracy": None if by_noise else self.number(),
            "shape_error": word.replace(" ", "") if of_shape else NORMAL,
        }
        return self.other_settings().model_copy(update=found)

    def fit_of_any_image(self) -> FitSettings:
        """The same for other images: what depends on the noise is left to each of them."""
        found = self.fit_settings()
        named = self.accuracy in SHAPE_CHOICES
        return found.model_copy(update={"accuracy": None}) if named else found

    def other_settings(self) -> FitSettings:
        """The same without the accuracy. InputError if one is invalid."""
        if isinstance(self._fit, InputError):
            raise InputError(str(self._fit))
        return self._fit

    def scene_settings(self) -> SceneSettings:
        """Voxel size of the chosen image, PSF and effects. InputError if the PSF is incomplete."""
        if isinstance(self.psf, InputError):
            raise InputError(str(self.psf))
        values = {
            "voxel_size": self._image.frame().voxel_size,
            "sigma": self.sigma if self.psf is None else None,
            "optics": self.psf,
            "effects": self.effects.in_role(ViewEffect, self._second.view()),
        }
        return validated(SceneSettings, values)

    def number(self) -> float:
        """The number that the chosen accuracy stands for on this image."""
        return accuracy_of(self.accuracy, self.noise() if relative(self.accuracy) else 0.0)

    @property
    def psf_is_open(self) -> bool:
        """Whether the PSF was not given, so that the image tells it when a fit starts."""
        return not self._sigma_given and self.psf is None

    def psf_key(self) -> str:
        """A key that is equal as long as the PSF is the same."""
        return repr(self.sigma if self.psf is None else self.psf)

    def psf_in_words(self) -> str:
        """The PSF in a few words."""
        if self.psf is None:
            return f"Gaussian {widths_in_words(self.sigma)} µm"
        if isinstance(self.psf, MicroscopeOptics):
            return f"{self.psf.modality} NA {self.psf.na:g}"
        return str(self.psf.kind)

    # ---- by the user --------------------------------------------------------------------------

    def edit_fit(self, values: Mapping[str, Any]) -> None:
        """Take plain values of all settings except the accuracy."""
        self._fit = _made(lambda: validated(FitSettings, dict(values)))
        self.changed.emit(True)

    def type_accuracy(self, choice: str) -> None:
        """Take a typed accuracy, which may not be complete yet."""
        self.accuracy = chosen(choice)

    def edit_accuracy(self, choice: str) -> None:
        self.type_accuracy(choice)
        self.changed.emit(True)

    def edit_psf(self, settings: Callable[[], Any]) -> None:
        """Take the settings of a PSF from a function, or the InputError that it raises."""
        self.psf = _made(settings)
        self.changed.emit(True)

    def edit_sigma(self, sigma: Triple) -> None:
        self.sigma, self._sigma_given, self._came_with_image = sigma, True, False
        self.changed.emit(True)

    def edit_effects(self, effects: Effects) -> None:
        self.effects = effects
        self.changed.emit(True)

    # ---- by something else --------------------------------------------------------------------

    def show_fit(self, settings: FitSettings) -> None:
        """Take the settings of a fit."""
        self._fit = settings.model_copy(update={"accuracy": None, "shape_error": NORMAL})
        number = NORMAL if settings.accuracy is None else written(settings.accuracy)
        self.show_accuracy(number if settings.shape_error == NORMAL else settings.shape_error)

    def show_accuracy(self, choice: str) -> None:
        self.accuracy = chosen(choice)
        self.changed.emit(False)

    def show_scene(self, scene: SceneSettings, *, psf_is_open: bool = False) -> None:
        """Take a PSF and effects, which belong to the image chosen.

        psf_is_open : whether nobody gave that PSF: it is only what is shown until a fit starts.
        """
        self._came_with_image = self._image.layer is not None
        self.psf = scene.optics
        if scene.sigma is not None:
            self.sigma, self._sigma_given = scene.sigma, not psf_is_open
        self.show_effects(scene.effects)

    def show_effects(self, effects: Effects) -> None:
        """Take effects; the second view, which is a layer, stays as it is."""
        self.effects = effects.in_role(ViewEffect, None)
        self.changed.emit(False)

    def _forget_psf(self) -> None:
        """Forget a PSF that belongs to an image which is no longer chosen."""
        if self._came_with_image:
            self._came_with_image, self._sigma_given, self.psf = False, False, None

    def _guess_sigma(self) -> None:
        """Adapt a PSF that nobody gave for this image to the image, or its voxel size."""
        layer = self._image.layer
        if layer is not None and not self._sigma_given:
            self.sigma = triple(SIGMA_IN_VOXELS * d for d in voxel_size(layer))
        self.changed.emit(False)


def widths_in_words(sigma: Triple) -> str:
    """Widths along Z, Y, X in words; one number if Y and X are the same."""
    z, y, x = (f"{s:.2f}" if s >= 0.1 else f"{s:.3f}" for s in sigma)
    return f"{z} (z), {y} (yx)" if y == x else f"{z} (z), {y} (y), {x} (x)"


def _made(make: Callable[[], Any]) -> Any:
    """What a function returns, or the InputError that it raises."""
    try:
        return make()
    except InputError as error:
        return error


class NoiseOf:
    """The noise of the chosen image, measured once for each image and time."""

    def __init__(self, image: ImageSource) -> None:
        self._image = image
        self._of: tuple[Any, ...] | None = None  # the image and time that it is of
        self._noise = 0.0
        self._held = False

    def __call__(self) -> float:
        """The noise. InputError if there is no image."""
        if self.known is None:
            self.learn(self._image.key(), image_noise(self._image.stack()))
        return self._noise

    @property
    def known(self) -> float | None:
        """The noise if it was measured, else None."""
        return self._noise if self._held or self._of == self._image.key() else None

    def hold(self, on: bool) -> None:
        """While a fit runs, keep the noise of its image, if known."""
        self._held = on and self.known is not None

    def learn(self, key: tuple[Any, ...], noise: float) -> None:
        """Take over a noise that was measured elsewhere."""
        if key and not self._held:
            self._of, self._noise = key, noise
