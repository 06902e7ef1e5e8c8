"""What a fit keeps of itself between two iterations, so that it can go on from there."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ..common.choices import DensityModel, Structure
from ..common.reading import json_values, one_reason
from ..errors import InputError
from ..optics import GaussianPSF
from ..runs.fit_settings import validated
from ..scene.effects import Effects, Halo
from .model.fitted import Arrays, Fitted, other_settings
from .model.problem import Problem
from .rivals.found_psf import FoundPSF, held_of, psf_from, values_of
from .stage import Stage
from .surface.topology import TopologyPolicy
from .voxels.ground_again import with_ground

_FORMER = "former_"  # before the names of that fit's arrays


@dataclass(frozen=True)
class Checkpoint:
    """A fit whose objective is about to be posed.

    Attributes
    ----------
    start
        What tells its starting mesh from others.
    density
        What densities are to belong to in the end.
    fitted, stage, policy
        As they are.
    levels
        Of the fit.
    remeshing
        See :meth:`~.triangle_quality.Remeshing.to_dict`.
    former
        As saved, of the fit with a Gaussian PSF that this one is held against.
    problem
        What is to be explained.
    """

    start: np.ndarray
    density: DensityModel
    fitted: Fitted
    stage: Stage
    levels: tuple[float, ...]
    policy: TopologyPolicy
    remeshing: dict[str, float]
    former: Arrays | None = None
    problem: Problem | None = None

    def saved(self) -> Arrays:
        """Everything as arrays."""
        shape = self.fitted.shape
        plain = {
            **self.stage.to_dict(),
            "upkeep": self.remeshing,
            "effects": self.fitted.effects.to_dict(),
            "first_effects": self.fitted.first_effects.to_dict(),
            "policy": self.policy.to_dict(),
            "density": self.density,
            "density_now": shape.model,
            "structure": self.fitted.structure,
            "density_known": shape.log_density is not None,
            "objective": values_of(self.fitted.first_optics),
        }
        return {
            "seed": self.start,
            "level_optics": self.stage.blurred_for.parameters().detach().numpy(),
            "levels": np.array(self.levels),
            "run": np.array(json.dumps(plain)),
            **self.fitted.saved(),
            **{_FORMER + name: values for name, values in (self.former or {}).items()},
            **self._ground(),
        }

    def _are_nuclei(self, dimmed: np.ndarray) -> bool:
        """Whether such an image, (Z, Y, X), may be what nuclei dim here."""
        of_image = self.problem is None or dimmed.shape == self.problem.image.shape
        return of_image and bool(((dimmed > 0) & (dimmed <= 1)).all())

    def _ground(self) -> Arrays:
        """What was found on the way of what is to be explained.

        The voxels that may count, and how often they were found anew; the local background.
        """
        problem, found = self.problem, Arrays()
        if problem is not None and problem.ground_changed:
            found |= {"counted": problem.counted, "anew": np.array(problem.anew)}
        if problem is not None and problem.let_go is not None:
            found["let_go"] = problem.let_go
        if problem is not None and problem.local_background is not None:
            found["local_background"] = problem.local_background
        return found

    def loaded(self, found: Arrays) -> Checkpoint:
        """This one with what another has saved.

        Raises
        ------
        InputError
            If it is damaged, or of another mesh or fit.
        """
        try:
            return self._loaded(found)
        except InputError:
            raise
        except Exception as error:  # whatever damaged values may lead to
            raise InputError(f"the checkpoint is damaged ({one_reason(error)})") from error

    def _loaded(self, found: Arrays) -> Checkpoint:
        for name, values in found.items():
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                raise InputError(f"the checkpoint is damaged: {name} is not finite")
        if not np.array_equal(found["seed"], self.start):
            raise InputError("the checkpoint belongs to another mesh")
        if not np.array_equal(found["levels"], np.array(self.levels)):
            raise other_settings()
        if "dimmed" in found and not self._are_nuclei(found["dimmed"]):
            raise InputError("the checkpoint is damaged: its nuclei are of another image")
        plain: dict[str, Any] = json_values(str(found["run"]))
        # Where the PSF began is of the checkpoint: settings may hold where it has come to.
        if held_of(plain["objective"]) != held_of(values_of(self.fitted.first_optics)):
            raise other_settings()
        if plain["density"] != self.density:
            raise other_settings()
        begun = self.fitted.with_density(plain["density_now"])
        if not 0 <= int(plain["level_number"]) <= len(self.levels):
            raise InputError("the checkpoint is damaged: it is of a level that there is not")
        effects = validated(Effects, plain["effects"])
        first = validated(Effects, plain["first_effects"])
        structure: Structure = plain["structure"]
        known = bool(plain["density_known"])
        fitted = begun.with_structure(structure).loaded(found, effects, first, known)
        blurred_for = fitted.optics.with_parameters(torch.from_numpy(found["level_optics"]))
        return replace(
            self,
            fitted=fitted,
            stage=Stage.from_dict(plain, blurred_for),
            policy=TopologyPolicy.from_dict(plain["policy"]),
            remeshing={name: float(plain["upkeep"][name]) for name in self.remeshing},
        )


def problem_in(found: Arrays, given: Problem) -> Problem:
    """What a fit is to explain that goes on from a checkpoint; given : at its start.

    Raises
    ------
    InputError
        If the voxels that counted are of another image.
    """
    if "local_background" in found:
        given = _without(found["local_background"], given)
    if "counted" not in found:
        return given
    counted = found["counted"]
    if counted.shape != given.counted.shape or counted.dtype != bool or "anew" not in found:
        raise InputError("the checkpoint is damaged: its voxels are of another image")
    let_go = found.get("let_go")
    if let_go is not None and (let_go.shape != counted.shape or let_go.dtype != np.uint8):
        raise InputError("the checkpoint is damaged: its neighbours are of another image")
    return with_ground(replace(given, let_go=let_go), counted, int(found["anew"]))


def _without(around: np.ndarray, given: Problem) -> Problem:
    """The problem without such a local background."""
    if around.shape != given.image.shape or around.dtype != np.float32:
        raise InputError("the checkpoint is damaged: its local background is of another image")
    return replace(given, image=given.image - around, local_background=around)


def former_in(found: Arrays) -> Arrays:
    """The checkpoint within another of the fit that it is held against; empty if there is none."""
    start = len(_FORMER)
    return {name[start:]: found[name] for name in found if name.startswith(_FORMER)}


def effects_in(found: Arrays, given: Effects) -> Effects:
    """The effects that a fit had begun with: those given, or these and a tilted PSF's halo."""
    if not isinstance(objective_in(found), GaussianPSF):
        return given
    try:
        first = validated(Effects, json_values(str(found["run"]))["first_effects"])
    except (KeyError, TypeError, ValueError, InputError):  # damaged
        return given
    return first if first.without(Halo.name).names == given.names else given


def objective_in(found: Arrays) -> FoundPSF | None:
    """The objective's PSF that a fit had begun with; None where it was another one."""
    try:
        values = json_values(str(found["run"]))["objective"]
        return None if values is None else psf_from(values)
    except (KeyError, TypeError, ValueError, InputError):  # damaged
        return None
