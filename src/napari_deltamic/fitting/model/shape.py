"""The surface of a fit with what its vertices carry: one door for a new triangulation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ...common.choices import DensityModel
from ...geometry.mesh import FloatArray, IntArray, Mesh
from .density import Density


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh, and what goes along when its triangles change.

    Attributes
    ----------
    mesh
        Its vertices are read-only: states share them.
    model
        What a density belongs to: nothing, walls, or vertices.
    log_density
        (D,) of each wall or vertex; None while nothing is known of it.
    pinned
        (V,) bool: vertices that stay where they are.
    """

    mesh: Mesh
    model: DensityModel
    log_density: FloatArray | None
    pinned: np.ndarray

    @classmethod
    def begun(cls, mesh: Mesh, model: DensityModel) -> Shape:
        """One of which only the mesh is known."""
        shape = cls(mesh, model, None, np.zeros(len(mesh.vertices), bool))
        return shape.moved(mesh.vertices_numpy(), None)

    def face_densities(self) -> FloatArray:
        """(F,) relative to the mean; 1 while nothing is known of them."""
        density = Density(self.mesh, self.model, 1.0)  # its width is of priors
        log = np.zeros(len(density)) if self.log_density is None else self.log_density
        return density.faces_numpy(log)

    def moved(self, vertices: FloatArray, log_density: FloatArray | None) -> Shape:
        """The same connectivity elsewhere: vertices (V, 3) um."""
        own = np.array(vertices, dtype=np.float64)
        own.setflags(write=False)
        return replace(self, mesh=self.mesh.with_vertices(own), log_density=log_density)

    def with_pins(self, pinned: np.ndarray) -> Shape:
        """Other vertices pinned, (V,) bool."""
        return replace(self, pinned=np.array(pinned, bool))

    def with_model(self, model: DensityModel) -> Shape:
        """The same densities, of another kind."""
        if model == self.model:
            return self
        log = None
        if self.log_density is not None and model != "uniform":
            log = Density(self.mesh, model, 1.0).of_faces(self.face_densities())
        return replace(self, model=model, log_density=log)

    def retriangulated(
        self, mesh: Mesh, origin: IntArray | None = None, carried: FloatArray | None = None
    ) -> Shape:
        """The same regions with other triangles.

        Parameters
        ----------
        mesh
            The new one.
        origin
            (V,) old vertex that each new one equals, -1 for a new one; None: not known.
        carried
            (V,) log densities of its vertices where they are known; else those of the nearest old
            vertices are taken.
        """
        places = mesh.vertices_numpy().copy()
        old = self.mesh.vertices_numpy()
        log = self.log_density
        if self.model == "smooth" and log is not None:
            log = carried if carried is not None else log[_nearest(old, places, origin)]
        elif self.model == "interface" and log is not None:
            log = _by_walls(self.mesh, mesh, log)
        pins = np.zeros(len(places), bool)
        if self.pinned.any():
            # They stay where they are: their nearest new vertices take their places.
            held = old[self.pinned]
            rows = cKDTree(places).query(held)[1]
            places[rows], pins[rows] = held, True
        places.setflags(write=False)
        return Shape(mesh.with_vertices(places), self.model, log, pins)


def _nearest(old: FloatArray, places: FloatArray, origin: IntArray | None) -> IntArray:
    found = np.full(len(places), -1, np.int64) if origin is None else origin.copy()
    new = np.flatnonzero(found < 0)
    if len(new):
        found[new] = cKDTree(old).query(places[new])[1]
    return found


def _by_walls(before: Mesh, after: Mesh, log: FloatArray) -> FloatArray:
    """Log density of each wall; those that are new have the mean."""
    own = {tuple(pair): value for pair, value in zip(before.interfaces()[0], log, strict=True)}
    return np.array([own.get(tuple(pair), 0.0) for pair in after.interfaces()[0]])
