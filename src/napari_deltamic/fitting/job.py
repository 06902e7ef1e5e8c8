"""A fit that is ready to run: what the command line and the widget both put together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.doing import doing
from ..geometry import Mesh
from ..optics import GaussianPSF, Optics
from ..runs.optics_settings import optics_from_values
from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..runs.seeds import SeedKind as SeedKind
from ..runs.settings import NEAR_LEVELS, FitSettings, RunSettings, SceneSettings
from ..scene import Grid
from ..scene.effects import Effects
from ..scene.render import offset
from . import FitState, counted_voxels, fit
from .model.default_accuracy import image_noise
from .model.hot_voxels import without_hot
from .rivals.found_psf import same_kind, settings_of
from .shape_dial import Dialled, Situation, dialled, with_edges
from .voxels.voxel_ownership import counted_around


@dataclass(frozen=True, eq=False)
class FitInput:
    """What a fit takes.

    image : (Z, Y, X); NaN where missing.
    counted : (Z, Y, X) bool: voxels that may count; None for all.
    second : (Z, Y, X) second view, where the settings have one; None for that of its file.
    kind : how near to the membranes the mesh lies.
    predicted : um, mean distance to the true surface that is to be expected; None where it is not
        known.
    crowded : regions in which a user placed several points.
    missing : numbers, from 1, of a user's points for which there is no cell.
    with_hot : the image as it was read, if some of its voxels are missing here, as no PSF can have
        made them so bright.
    psf_guessed : whether nobody has said how wide the PSF is.
    """

    settings: RunSettings
    image: NDArray[Any]
    grid: Grid
    mesh: Mesh
    optics: Optics
    counted: NDArray[np.bool_] | None
    second: NDArray[Any] | None = None
    kind: SeedKind = "rough"
    predicted: float | None = None
    crowded: frozenset[int] = frozenset()
    missing: tuple[int, ...] = ()
    with_hot: NDArray[Any] | None = None
    psf_guessed: bool = False

    @property
    def has_missing(self) -> bool:
        """Whether some voxels were missing when the image was read."""
        return bool(np.isnan(self.as_read).any())

    @property
    def as_read(self) -> NDArray[Any]:
        """(Z, Y, X) the image with its hot voxels."""
        return self.image if self.with_hot is None else self.with_hot

    def without_hot(self) -> FitInput:
        """The same, with hot voxels missing."""
        image, hot = without_hot(self.image)
        return replace(self, image=image, with_hot=self.image) if hot else self

    def with_settings(self, **parts: Any) -> FitInput:
        """The same with other parts of the settings: ``fit``, ``scene``, ``seeds``."""
        return replace(self, settings=self.settings.model_copy(update=parts))


def levelled(image: NDArray[Any], grid: Grid, effects: Effects) -> NDArray[Any]:
    """(Z, Y, X) an image without what effects add to it; itself where they add nothing."""
    added = offset(effects, grid)
    return image if added is None else np.asarray(image - added.numpy(), np.float32)


def optics_of(scene: SceneSettings) -> Optics:
    """The PSF of the settings; a Gaussian of 1.2 voxels where they give none.

    Raises
    ------
    InputError
        If its numbers cannot be, or the file of a measured one cannot be used.
    """
    if scene.optics is not None:
        return scene.optics.build()
    return GaussianPSF(scene.sigma or [SIGMA_IN_VOXELS * d for d in scene.voxel_size])


def scene_with(scene: SceneSettings, optics: Optics) -> SceneSettings:
    """The settings of a scene whose PSF has moved on, in a fit for example.

    What settings of that kind do not hold (the OTF of a bead) stays as it is.
    """
    if isinstance(optics, GaussianPSF):
        if optics.diagonal:
            return scene.model_copy(update={"sigma": optics.sigma_um, "optics": None})
        rows = optics.covariance.detach().tolist()
        tilted = optics_from_values({"kind": "gaussian", "covariance": rows})
        return scene.model_copy(update={"sigma": None, "optics": tilted})
    found, given = settings_of(optics), scene.optics
    if found is not None and (given is None or type(given.build()) is not type(optics)):
        return scene.model_copy(update={"sigma": None, "optics": found})
    if given is None:
        return scene
    return scene.model_copy(update={"optics": given.moved(optics.described())})


def following(job: FitInput, state: FitState) -> FitInput:
    """The job of a fit that has begun anew, with another kind of PSF or other voxels; or itself."""
    if state.counted is not None and state.counted is not job.counted:
        job = replace(job, counted=state.counted)
    scene, optics = job.settings.scene, job.optics
    if not same_kind(state.optics, optics):
        scene, optics = scene_with(scene, state.optics), state.optics
    elif state.effects.names == scene.effects.names:
        return job
    effects = scene.effects.without(*set(scene.effects.names) - set(state.effects.names))
    new = [e for e in state.effects.present() if e.name not in effects.names]
    scene = scene.model_copy(update={"effects": effects.adding(*new)})
    return replace(job.with_settings(scene=scene), optics=optics)


def assemble(
    settings: RunSettings,
    image: NDArray[Any],
    grid: Grid,
    mesh: Mesh,
    kind: SeedKind,
    second: NDArray[Any] | None = None,
) -> FitInput:
    """Everything that a fit needs; what the settings leave open follows from seeds and noise."""
    optics = optics_of(settings.scene)
    level = levelled(image, grid, settings.scene.effects)
    now = Situation.of(mesh, grid, optics.sigma_um, image_noise(level))
    wanted = dialled(settings.fit.shape_error, now)
    mesh = with_edges(mesh, wanted.edge)
    settings = settings.model_copy(update={"fit": completed(settings.fit, wanted, kind)})
    doing("finding which voxels belong to the cells")
    ground = counted_around if kind == "rough" else counted_voxels
    counted = ground(level, grid, mesh, optics)
    return FitInput(
        settings, image, grid, mesh, optics, counted, second, kind, predicted=wanted.predicted
    )


def completed(fit: FitSettings, wanted: Dialled, kind: SeedKind) -> FitSettings:
    """Settings of which nothing is left open: the dial and the kind of the seeds decide."""
    found: dict[str, Any] = {}
    if kind != "rough" and fit.levels is None:
        found["levels"] = NEAR_LEVELS
    if fit.accuracy is None:
        found["accuracy"] = wanted.accuracy
    if fit.flatness is None:
        found["flatness"] = wanted.flatness
    if fit.tolerance == FitSettings().tolerance:
        found["tolerance"] = wanted.tolerance
    if fit.trials:
        found["trials"] = wanted.trials
    return fit.model_copy(update=found)


def start(job: FitInput, resume: str | Path | None = None) -> Iterator[FitState]:
    """Start the fit; see :func:`napari_deltamic.fit`."""
    return fit(
        job.image,
        job.grid,
        job.mesh,
        job.optics,
        settings=job.settings.fit,
        counted=job.counted,
        effects=job.settings.scene.effects,
        second=job.second,
        resume=resume,
        counted_may_change=True,
        psf_guessed=job.psf_guessed,
    )
