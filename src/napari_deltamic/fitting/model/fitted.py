"""All that is fitted, with what the steps have taught: one object, changed as a whole."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...common.choices import DensityModel, Structure, StructureChoice
from ...errors import InputError
from ...geometry.mesh import FloatArray, Mesh
from ...optics import Optics
from ...scene.effects import Effects
from ...scene.light import INSIDES, MEMBRANES, Light
from ..solvers.lbfgs import Learnt
from .amplitudes import may_shine
from .change import Change
from .density import Density
from .imaging import Imaging
from .shape import Shape
from .variables import Variables

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Fitted:
    """Surface, PSF and effects as they are now.

    Attributes
    ----------
    shape
        The surface with densities and pins.
    optics, effects
        As they are now.
    first_optics, first_effects
        As they were at the start, or when a user changed them: priors lie around them.
    structure
        What may shine.
    light
        What does.
    dimmed
        (Z, Y, X) what insides show with dark nuclei over what they would without; None: none known.
    learnt
        What the optimiser knows, as long as its unknowns are the same.
    """

    shape: Shape
    optics: Optics
    effects: Effects
    first_optics: Optics
    first_effects: Effects
    structure: Structure = "membrane"
    light: Light = MEMBRANES
    dimmed: NDArray[np.float32] | None = None
    learnt: Learnt | None = None

    @classmethod
    def begun(
        cls,
        mesh: Mesh,
        optics: Optics,
        effects: Effects,
        model: DensityModel,
        structure: StructureChoice = "membrane",
    ) -> Fitted:
        """Everything as it is at the start."""
        held = optics.detach()
        found = cls(Shape.begun(mesh, model), held, effects, held, effects)
        return found.with_structure(may_shine(structure, mesh, held))

    def with_structure(self, structure: Structure) -> Fitted:
        """Something else may shine: what was learnt is of another model."""
        light = INSIDES if structure == "interior" else MEMBRANES
        light = replace(light, cells=self.light.cells)
        dimmed = self.dimmed if structure == "interior" else None
        return replace(self, structure=structure, light=light, dimmed=dimmed, learnt=None)

    def seen_through(self, optics: Optics) -> Fitted:
        """Through another kind of PSF: what was learnt is of other unknowns."""
        return replace(self, optics=optics, first_optics=optics, learnt=None)

    def with_effects(self, effects: Effects) -> Fitted:
        """With other effects: what was learnt is of other unknowns."""
        return replace(self, effects=effects, first_effects=effects, learnt=None)

    @property
    def mesh(self) -> Mesh:
        """The surface."""
        return self.shape.mesh

    def moved(self, at: Variables, imaging: Imaging, density_fitted: bool) -> Fitted:
        """The same unknowns elsewhere."""
        known = density_fitted or self.shape.log_density is not None
        log = at.density if known and len(at.density) else self.shape.log_density
        optics = self.optics
        if len(at.optics):
            optics = imaging.optics_of(torch.from_numpy(at.optics)).detach()
        shape, effects = self.shape.moved(at.vertices, log), imaging.effects_of(at.effects)
        return replace(self, shape=shape, optics=optics, effects=effects)

    def retriangulated(self, shape: Shape) -> Fitted:
        """The same with another triangulation; what was learnt belonged to other unknowns."""
        return replace(self, shape=shape, learnt=None)

    def displaced(self, vertices: FloatArray, optics: Optics) -> Fitted:
        """The surface at (V, 3) um and another PSF of that kind; brightness is forgotten."""
        return replace(self, shape=self.shape.moved(vertices, None), optics=optics, learnt=None)

    def with_density(self, model: DensityModel) -> Fitted:
        """The same densities, modelled in another way."""
        return replace(self, shape=self.shape.with_model(model), learnt=None)

    def with_nuclei(self, dimmed: NDArray[np.float32]) -> Fitted:
        """The same with nuclei that dim the insides; (Z, Y, X), see the attribute."""
        return replace(self, dimmed=dimmed)

    def shining(self, light: Light) -> Fitted:
        """The same with this light."""
        return replace(self, light=light)

    def taught(self, learnt: Learnt | None) -> Fitted:
        """The same with what the optimiser knows now."""
        return replace(self, learnt=learnt)

    def changed(self, change: Change, model: DensityModel) -> Fitted:
        """The same after a change from outside, of which the optimiser knows nothing."""
        shape = self.shape
        if change.mesh is not None:
            shape = _replaced(shape, change.mesh)
        if change.pinned is not None:
            shape = shape.with_pins(change.pinned)
        found = replace(self, shape=shape.with_model(model), learnt=None)
        if model == "uniform":  # insides are taken to be even
            found = replace(found, dimmed=None)
        if change.optics is not None:
            held = change.optics.detach()
            found = replace(found, optics=held, first_optics=held)
        if change.effects is not None:
            found = replace(found, effects=change.effects, first_effects=change.effects)
        return found

    # ------------------------------------------------------------------------- checkpoints

    def saved(self) -> Arrays:
        """What a checkpoint keeps, but for the numbers of effects."""
        log = self.shape.log_density
        return {
            "vertices": self.mesh.vertices_numpy(),
            "faces": self.mesh.faces,
            "regions": self.mesh.regions,
            "pinned": self.shape.pinned,
            "log_density": np.zeros(0) if log is None else log,
            "optics": self.optics.parameters().detach().numpy(),
            "first_optics": self.first_optics.parameters().detach().numpy(),
            "light": np.array([self.light.membrane, self.light.interior]),
            "insides": np.array(self.light.cells, np.float64).reshape(-1, 2),
            **({} if self.dimmed is None else {"dimmed": self.dimmed}),
            **({} if self.learnt is None else self.learnt.saved()),
        }

    def _surface_loaded(self, found: Arrays) -> Fitted:
        """The same with the surface, pins and PSF that :meth:`saved` wrote."""
        if found["optics"].shape != tuple(self.optics.parameters().shape):
            raise other_settings()
        mesh = Mesh(found["vertices"], found["faces"], found["regions"])
        if found["pinned"].shape != (len(mesh.vertices),):
            raise InputError("the checkpoint is damaged: its pins are of another mesh")
        shape = Shape.begun(mesh, self.shape.model).with_pins(found["pinned"])
        optics = self.optics.with_parameters(torch.from_numpy(found["optics"]))
        return replace(self, shape=shape, optics=optics)

    def loaded(
        self, found: Arrays, effects: Effects, first: Effects, density_known: bool
    ) -> Fitted:
        """The same with everything that :meth:`saved` wrote.

        Raises
        ------
        InputError
            If they are of another PSF or other effects, or do not fit together.
        """
        if (effects.names, first.names) != 2 * (self.effects.names,):
            raise other_settings()
        restored = self._surface_loaded(found)
        shape, mesh = restored.shape, restored.mesh
        if density_known:
            known = len(Density(mesh, shape.model, 1.0))
            if found["log_density"].shape != (known,):
                raise InputError("the checkpoint is damaged: its densities are of another mesh")
            shape = shape.moved(mesh.vertices_numpy(), found["log_density"])
        membrane, interior = found["light"].tolist()
        kept = {"membrane": membrane, "interior": interior, "cells": found["insides"]}
        light = Light.from_dict(kept)
        optics = self.first_optics.with_parameters(torch.from_numpy(found["first_optics"]))
        around = replace(restored, effects=effects, first_optics=optics, first_effects=first)
        around = replace(around, shape=shape, light=light, dimmed=found.get("dimmed"))
        return around.taught(Learnt.loaded(found))


def other_settings() -> InputError:
    """What to raise for a checkpoint of another fit."""
    return InputError("the checkpoint belongs to a fit with other settings")


def fingerprint(mesh: Mesh) -> np.ndarray:
    """What tells a starting mesh from others, whatever becomes of it."""
    counts = [len(mesh.vertices), len(mesh.faces)]
    return np.array([*counts, zlib.crc32(np.ascontiguousarray(mesh.faces).tobytes())])


def _replaced(shape: Shape, mesh: Mesh) -> Shape:
    """A mesh from outside, as it is."""
    old = shape.mesh
    if np.array_equal(mesh.faces, old.faces) and np.array_equal(mesh.regions, old.regions):
        return shape.moved(mesh.vertices_numpy(), shape.log_density)
    return shape.with_pins(np.zeros(len(old.vertices), bool)).retriangulated(mesh)
