"""What the widget starts with: the user's choices on the plugin's page of napari's preferences.

The page and its defaults are the ``configurations`` of the manifest (napari 0.9, npe2 0.9).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from npe2 import PluginManager
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from ...common.choices import Modality
from ...fitting.model.default_accuracy import usable_choice
from ...runs.optics_settings import MicroscopeOptics
from ...runs.settings import FitSettings
from ...scene.effects import Effects
from ..document import Document
from ..fit_choice import NORMAL

PLUGIN = "napari-deltamic"
_FIT = ("fit_psf", "density")


def _readable(text: str) -> str:
    Effects.from_text(text)
    return text


class Preferences(BaseModel):
    """The settings of a new widget.

    fit : density and whether the PSF is fitted; the rest as always.
    accuracy : what the dial shows, a name or a number.
    preview_seeds : whether the surfaces that a fit would start from are shown.
    show_rendered : whether the rendered image is shown.
    effects : those ticked, as ``--effects`` names them.
    psf : kind of PSF; for that of an objective its modality, aperture, immersion and wavelength
        (um).
    updates_per_second : of the viewer while a fit runs, at most.
    """

    model_config = ConfigDict(frozen=True)

    fit: FitSettings = FitSettings()
    accuracy: Annotated[str, AfterValidator(usable_choice)] = NORMAL
    preview_seeds: bool = True
    show_rendered: bool = False
    effects: Annotated[str, AfterValidator(_readable)] = "none"
    psf: Literal["Gaussian", "from the objective"] = "Gaussian"
    modality: Modality = "confocal"
    na: Annotated[float, Field(gt=0, lt=2)] = 1.2
    immersion: str = "water"
    wavelength: Annotated[float, Field(ge=0.2, le=2)] = 0.52
    updates_per_second: Annotated[int, Field(ge=1, le=30)] = 30

    @property
    def objective(self) -> MicroscopeOptics:
        """The numbers of the objective; a light sheet has one as thick as most."""
        numbers = self.model_dump(include={"modality", "na", "immersion", "wavelength"})
        return MicroscopeOptics(**numbers, sheet=2.0)

    def show(self, doc: Document, optics: Any, preview: Any) -> None:
        """Set a new window, with its panels of the PSF and of the preview."""
        doc.settings.show_fit(self.fit)
        doc.settings.show_accuracy(self.accuracy)
        doc.settings.show_effects(Effects.from_text(self.effects))
        optics.begin_with(self.objective, self.psf)
        preview.prefer(self.preview_seeds)
        doc.look("rendered" if self.show_rendered else "image")
        doc.work.look_at_most(self.updates_per_second)


def read_preferences() -> tuple[Preferences, str]:
    """The preferences, and one line about what in them could not be used ('' if nothing).

    Without the page (an older napari, or one that has not looked for plugins) these are the
    defaults.
    """
    try:
        from napari.settings import get_plugin_settings
    except ImportError:  # before napari 0.9
        return Preferences(), ""
    if PLUGIN not in PluginManager.instance():
        return Preferences(), ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks about other plugins are not for our user
        try:
            page: Any = get_plugin_settings(PLUGIN)
            pages = (page.fit, page.optics, page.viewing)
            chosen = {k: v for part in pages for k, v in part.model_dump().items()}
        except Exception as error:  # unreadable preferences must not cost the widget
            reason = " ".join(str(error).split())[:200]
            return Preferences(), f"the preferences of deltaMic cannot be read: {reason}"
    return usable(chosen)


def usable(chosen: Mapping[str, Any]) -> tuple[Preferences, str]:
    """Preferences from plain values by name; those that are invalid are left out, and named."""
    fit, unfit = _checked(FitSettings, {k: v for k, v in chosen.items() if k in _FIT})
    rest, unusable = _checked(Preferences, {k: v for k, v in chosen.items() if k not in _FIT})
    wrong = ", ".join(f"{name} = {chosen[name]}" for name in (*unfit, *unusable))
    remark = f"these preferences cannot be used and are ignored: {wrong}" if wrong else ""
    return rest.model_copy(update={"fit": fit}), remark


def _checked(model: type[Any], values: dict[str, Any]) -> tuple[Any, list[str]]:
    """A model from the values that it accepts, and the names of the others."""
    try:
        return model(**values), []
    except ValidationError as error:
        wrong = [str(name) for one in error.errors() for name in one["loc"][:1]]
    return model(**{k: v for k, v in values.items() if k not in wrong}), wrong
