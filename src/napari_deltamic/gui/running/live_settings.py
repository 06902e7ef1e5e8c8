"""Settings edited while a fit runs: what it adopts at once, and what it cannot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from ...common.description import described
from ...errors import InputError
from ...fitting import Change
from ...fitting.job import optics_of, scene_with
from ...fitting.rivals.found_psf import same_kind
from ...optics import Optics
from ...runs.settings import FitSettings, SceneSettings
from ...scene.effects import Effects, ViewEffect, kind_of
from ..document import Document
from .edits import Edits

_FIT = described(FitSettings)


class LiveSettings:
    """Hands what the user edits to the running fit."""

    def __init__(self, doc: Document, edits: Edits) -> None:
        self._doc, self._edits = doc, edits
        self._fit: FitSettings | None = None  # of the fit, as it was last told
        self._shown: FitSettings | None = None  # what was chosen then
        self._psf = ""  # that was chosen then
        self._scene: SceneSettings | None = None  # as it was last looked at
        self._effects = Effects()  # those that were chosen then
        doc.work.changed.connect(self._started)
        doc.began.connect(self._began)
        edits.settings_undone.connect(self._undone)
        doc.settings.changed.connect(self._edited)
        doc.image.changed.connect(self._image_changed)

    def _started(self) -> None:
        if not self._doc.running:
            return
        settings = self._doc.settings
        self._fit, self._shown, self._psf = None, settings.fit_settings(), settings.psf_key()
        self._scene, self._effects = None, settings.effects
        # A fit that goes on from the history has its own image and second view, whatever has become
        # of those in the panels.
        with suppress(InputError):
            self._scene = settings.scene_settings()
            self._effects = self._scene.effects

    def _began(self, fresh: bool) -> None:
        present = self._doc.present()
        if present is not None:
            self._fit = present.job.settings.fit
        self._edited(True)  # what was edited while the seeds were prepared

    @property
    def _running(self) -> bool:
        return self._doc.running and self._fit is not None

    def _edited(self, by_user: bool) -> None:
        if by_user and self._running:
            self._attempt(self._hand_over, "the fit goes on as it was")

    def _attempt(self, action: Callable[[], None], otherwise: str) -> None:
        """Run an action, or tell why it failed, and what happens instead."""
        try:
            action()
        except InputError as error:
            self._doc.noted.emit(f"{error}; {otherwise}")

    def _image_changed(self) -> None:
        if self._running:
            # A PSF that is only guessed follows the voxel size, but not in a fit.
            self._psf = self._doc.settings.psf_key()
            link, chosen = self._doc.link, self._doc.image.layer
            if link is None or chosen is link.image_layer:
                self._attempt(self._tell_fixed, "the fit goes on with the image it has")
            elif chosen is not None and link.image_layer in self._doc.viewer.layers:
                text = f"the fit goes on with '{link.image_layer.name}'"
                self._doc.noted.emit(f"{text}; the next run takes '{chosen.name}'")

    def _hand_over(self) -> None:
        settings = self._doc.settings
        fit, scene, psf = settings.fit_settings(), settings.scene_settings(), settings.psf_key()
        # The fit has the image of its second view, or has none.
        shown = scene.effects.in_role(ViewEffect, self._effects.view)
        assert self._fit is not None
        other = [name for name in _FIT if getattr(fit, name) != getattr(self._shown, name)]
        later = [_FIT[name].title for name in other if not _FIT[name].live]
        if later:
            self._shown = fit
            self._doc.noted.emit(f"{' and '.join(later)}: used from the next run on")
        changed = {name: getattr(fit, name) for name in other if _FIT[name].live}
        if "accuracy" in changed:
            changed["accuracy"] = settings.number()  # also where the noise decides
        words = [_words(name, value) for name, value in changed.items()]
        effects = None
        if shown != self._effects:
            effects = self._with_found(shown)
            words.append("effects " + (", ".join(shown.names) or "none").replace("_", " "))
        if words:
            after = self._fit.model_copy(update=changed)
            change = Change(settings=after if changed else None, effects=effects)
            self._edits.change(change, ", ".join(words))
            self._fit, self._shown, self._effects = after, fit, shown
        if psf != self._psf:
            optics = self._other_optics(scene)
            if optics is not None:
                self._edits.change(Change(optics=optics), f"PSF {settings.psf_in_words()}")
            self._psf = psf  # one that was refused is shown still, and told again
        self._tell_fixed()

    def _other_optics(self, scene: SceneSettings) -> Optics | None:
        """The PSF shown; None, after a message, if the fit cannot take it."""
        present = self._doc.present()
        optics = optics_of(scene)
        if present is None or same_kind(optics, present.state.optics):
            return optics
        self._doc.noted.emit("The new PSF applies to the next run.")
        return None

    def _with_found(self, shown: Effects) -> Effects:
        """The effects shown; those that stay keep the numbers that the fit has found."""
        present = self._doc.present()
        if present is None:
            return shown
        same = {
            effect.name: effect
            for effect in present.state.effects.present()
            if getattr(shown, effect.name) == getattr(self._effects, effect.name) is not None
        }
        return shown.replace(**same)

    def _tell_fixed(self) -> None:
        """Tell once what cannot change while a fit runs."""
        before, self._scene = self._scene, self._doc.settings.scene_settings()
        if before is not None and before.effects.view != self._scene.effects.view:
            self._doc.noted.emit(f"{kind_of(ViewEffect).title}: used from the next run on")

    def _undone(self, back: Change) -> None:
        # It fails where the image or the second view have changed since.
        otherwise = "the change is undone in the fit, but the panels still show it"
        self._attempt(partial(self._show, back), otherwise)

    def _show(self, back: Change) -> None:
        settings = self._doc.settings
        if back.settings is not None:
            settings.show_fit(back.settings)
            self._fit, self._shown = back.settings, settings.fit_settings()
        if back.optics is not None:
            settings.show_scene(scene_with(settings.scene_settings(), back.optics))
            self._psf = settings.psf_key()
        if back.effects is not None:
            settings.show_effects(back.effects)
            self._effects = settings.scene_settings().effects


def _words(name: str, value: Any) -> str:
    if isinstance(value, bool):
        value = "yes" if value else "no"
    if isinstance(value, float):
        value = np.format_float_scientific(value, trim="-", exp_digits=1)
    found = _FIT[name]
    return f"{found.title} {found.automatic if value is None else value}"
