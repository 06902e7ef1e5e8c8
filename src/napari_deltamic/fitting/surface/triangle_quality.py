"""Triangles stay good while a surface is moved far: when to remesh, and what goes along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.ball import ball_radius
from ...geometry.mesh import FloatArray, Mesh
from ...geometry.remeshing import Remeshed, can_remesh, remesh, smallest_angles
from ...geometry.vertex_curvature import vertex_curvature
from ..model.shape import Shape
from .collisions import CollisionGuard


@dataclass(frozen=True)
class RemeshingRules:
    """When a surface is remeshed, and how long its edges are then.

    Attributes
    ----------
    bad_angle
        Degrees. Measured: half changes nothing in small fits, twice remeshes clusters.
    many
        Share of bad triangles, above that which the last remeshing left, from which on the mesh is
        remeshed. Measured: half and twice change nothing in small fits.
    growth, finest
        Edges grow and shrink with the surface, as if no vertex came or went: by this factor at
        most, since details need vertices, and no further down than this share of the width of the
        PSF.
    coarse
        Of the width of the blurred PSF: edges on a coarse level, which shows nothing finer.
    of_radius
        Of the radius of a ball as large as the smallest region: longer edges would not hold its
        shape.
    fewest
        Vertices: with fewer, triangles cost less than the image.
    far_off
        From a length, by which factor edges count as of another one. Measured: 1.2 and 2.8 change
        nothing in small fits.
    chord
        Of edge^2 times curvature: two thirds of the standard deviation of the gap over a triangle;
        from spheroids, tori and double bubbles with edges of 0.26 to 0.8 um. With long edges there
        are fewer numbers for the noise to move, so it is less.
    refined
        Times in a level that edges are made shorter where the surface is found to be more curved;
        chosen: what shorter edges show may be more curved again.
    """

    bad_angle: float = 15.0
    many: float = 0.02
    growth: float = 1.5
    finest: float = 0.7
    coarse: float = 0.5
    of_radius: float = 0.25
    fewest: int = 600
    far_off: float = 1.4
    chord: float = 0.028
    refined: int = 2


RULES = RemeshingRules()


def gaps(mesh: Mesh) -> FloatArray:
    """(F,) um: how far the flat faces lie from a surface as curved as theirs is."""
    square = (mesh.edge_lengths()[mesh.face_edges()] ** 2).mean(1)
    found: FloatArray = RULES.chord * square * vertex_curvature(mesh)[mesh.faces].mean(1)
    return found


class Remeshing:
    """Remeshes a surface when too many of its triangles have become slivers.

    The edge length is that which the surface had at the start: the user's choice. On levels that
    are blurred edges may be longer, as far as the blur hides it; where the surface is so curved
    that flat triangles of this length would not follow it, edges are shorter.

    Parameters
    ----------
    mesh
        At the start.
    width
        um: of the PSF.
    """

    def __init__(self, mesh: Mesh, width: float) -> None:
        # A face with one corner twice has no third edge to split, collapse or flip.
        corners = np.sort(mesh.faces, axis=1)
        whole = bool((corners[:, 1:] != corners[:, :-1]).all())
        self._start, self._area = mesh.median_edge(), float(mesh.areas().sum())
        self.able = can_remesh() and whole and self._start > 0
        self._finest = min(RULES.finest * width, self._start)
        self.left = 0.0  # share of slivers that the last remeshing left: no use to try again
        self._coarse = 0.0  # um: edges of the level
        self._begun = False  # whether edges are of the level
        self._looks = self._refined = 0  # in the level: at edges; times that they became shorter

    def begin_level(self, mesh: Mesh, blurred: float) -> None:
        """Edges as long as a level allows. blurred : um, width of its PSF; 0 if it is sharp."""
        volumes = np.abs([v for v in mesh.volumes().values()])
        radius = float(ball_radius(volumes.min())) if len(volumes) else 0.0
        fewest = mesh.median_edge() * float(np.sqrt(len(mesh.vertices) / RULES.fewest))
        self._coarse = min(RULES.coarse * blurred, RULES.of_radius * radius, fewest)
        self.left, self._begun = 0.0, False
        self._looks = self._refined = 0

    def to_dict(self) -> dict[str, float]:
        """What a checkpoint keeps."""
        found = {"slivers": self.left, "coarse": self._coarse, "begun": float(self._begun)}
        return found | {"looks": float(self._looks), "refined": float(self._refined)}

    def resume(self, kept: dict[str, float]) -> None:
        """Go on from what :meth:`to_dict` gave."""
        self.left, self._coarse = float(kept["slivers"]), float(kept["coarse"])
        self._begun = bool(kept["begun"])
        self._looks, self._refined = int(kept["looks"]), int(kept["refined"])

    def wanted(self, mesh: Mesh, flatness: float | None) -> bool:
        """Whether the mesh has too many slivers, or edges of another level or curvature.

        flatness : um, how far flat triangles may lie from the surface; None: as far as they do.
        """
        if not self.able:
            return False
        self._looks += 1
        other = not self._begun and self._of_another_level(mesh)
        return other or _slivers(mesh) > self.left + RULES.many or self._too_flat(mesh, flatness)

    def _too_flat(self, mesh: Mesh, flatness: float | None) -> bool:
        """Whether edges are too long for much of a surface that the level has moved."""
        if flatness is None or self._looks < 2 or self._refined >= RULES.refined:
            return False
        wanted = self._lengths(mesh, flatness)[mesh.edges()].mean(1)
        return bool((mesh.edge_lengths() > RULES.far_off * wanted).mean() > RULES.many)

    def _lengths(self, mesh: Mesh, flatness: float | None) -> FloatArray:
        """(V,) um: edges are to have."""
        length = np.full(len(mesh.vertices), self._length(mesh))
        if flatness is None:
            return length
        curvature = np.maximum(vertex_curvature(mesh), 1e-300)
        shorter = np.sqrt(flatness / (RULES.chord * curvature))
        return np.minimum(length, np.maximum(shorter, max(self._finest, self._coarse)))

    def _of_another_level(self, mesh: Mesh) -> bool:
        return not 1 / RULES.far_off < self._level_length(mesh) / mesh.median_edge() < RULES.far_off

    def _level_length(self, mesh: Mesh) -> float:
        grown = self._start * float(np.sqrt(mesh.areas().sum() / max(self._area, 1e-300)))
        return max(min(max(grown, self._finest), RULES.growth * self._start), self._coarse)

    def _length(self, mesh: Mesh) -> float:
        """um: edges are to have; those of the mesh, where these are about right."""
        length = self._level_length(mesh)
        if self._of_another_level(mesh):
            return length
        return min(max(mesh.median_edge(), self._start), max(RULES.growth * self._start, length))

    def renewed(
        self,
        mesh: Mesh,
        carried: np.ndarray,
        fixed: np.ndarray,
        apart: bool = False,
        flatness: float | None = None,
    ) -> Remeshed:
        """The mesh with better triangles; numbers of its vertices and fixed ones go along.

        ``apart``: surfaces that do not cross stay so. ``flatness``: as above.
        """
        self._refined += int(self._too_flat(mesh, flatness))
        length = self._lengths(mesh, flatness)
        done = remesh(mesh, length, passes=3, carried=carried, fixed=fixed, apart=apart)
        self.left, self._begun = _slivers(done.mesh), True
        return done

    def of_shape(
        self, shape: Shape, guard: CollisionGuard, apart: bool, flatness: float | None
    ) -> Shape | None:
        """The same surface with better triangles; None where they would cross."""
        log = shape.log_density if shape.model == "smooth" else None
        carried = np.zeros((len(shape.mesh.vertices), 0)) if log is None else log[:, None]
        done = self.renewed(shape.mesh, carried, shape.pinned, apart, flatness)
        guard.watch(shape.mesh)
        if not guard.allows(done.mesh):
            self.refused(shape.mesh)
            return None
        values = None if log is None else np.ascontiguousarray(done.carried[:, 0])
        return shape.retriangulated(done.mesh, None, values).with_pins(done.fixed)

    def given(self) -> None:
        """The mesh was replaced from outside: its edges stay as they are until the next level."""
        self._begun = True

    def refused(self, mesh: Mesh) -> None:
        """The mesh was kept as it was: it is tried again when more slivers have come."""
        self.left, self._begun = _slivers(mesh), True


def _slivers(mesh: Mesh) -> float:
    return float((smallest_angles(mesh) < RULES.bad_angle).mean())
