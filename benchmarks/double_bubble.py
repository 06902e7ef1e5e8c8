"""Two cells under given surface tensions: three spherical caps, whose every number is known."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.mesh import OUTSIDE, FloatArray, IntArray, Mesh
from napari_deltamic.geometry.remeshing import can_remesh, remesh

_ROUNDS = 2  # of remeshing and putting the vertices back on the caps
_FLAT = 1e-9  # of the rim's curvature: a cap with less is a plane, or its radius would overflow


@dataclass(frozen=True)
class DoubleBubble:
    """Regions 1, at lower X, and 2, around the X axis; the rim lies in the plane X = 0.

    rim : um; radius of the circle in which the three walls meet.
    tensions : of the outer walls of regions 1 and 2, and of the wall between them; any unit.
    tilt : radians by which the shared wall leaves the plane of the rim, towards region 2: 0 is
        flat, with equal pressures.

    Raises
    ------
    InputError
        If one tension is as large as the two others together, so that no rim can be at rest, or
        the tilt makes a wall turn inside out.
    """

    rim: float
    tensions: tuple[float, float, float]
    tilt: float = 0.0

    def __post_init__(self) -> None:
        first, second, shared = self.tensions
        largest = max(self.tensions)
        if not (min(self.tensions) > 0 and 2 * largest < first + second + shared):
            raise InputError(
                f"tensions {self.tensions} cannot balance: one is as large as the others together"
            )
        if not self.rim > 0:
            raise InputError(f"the rim of a double bubble must be positive (um), not {self.rim}")
        _, directions = self._directions()
        if not (directions[0][1] < 0 < directions[1][1]):
            raise InputError(f"a tilt of {self.tilt} turns a wall inside out")

    def _directions(self) -> tuple[FloatArray, FloatArray]:
        """Openings (3,) of the outside, regions 1 and 2, and the walls' directions (3, 2) r, x."""
        first, second, shared = self.tensions

        def between(a: float, b: float, c: float) -> float:
            """Angle between forces a and b that c balances."""
            return float(np.arccos((c * c - a * a - b * b) / (2 * a * b)))

        in_first, in_second = between(first, shared, second), between(second, shared, first)
        openings = np.array([2 * np.pi - in_first - in_second, in_first, in_second])
        wall = np.pi - self.tilt  # inwards, from the r axis towards the x axis
        angles = [wall + in_first, wall - in_second, wall]
        return openings, np.array([[cos(a), sin(a)] for a in angles])

    @property
    def angles(self) -> FloatArray:
        """(3,) degrees: the openings of the outside, of region 1 and of region 2 at the rim."""
        return np.degrees(self._directions()[0])

    @property
    def curvatures(self) -> FloatArray:
        """(3,) 1/um: of the caps of 1, 2 and the wall; positive outwards, or out of region 2."""
        found: FloatArray = self._directions()[1][:, 1] / self.rim * np.array([-1.0, 1.0, -1.0])
        return found

    @property
    def pressures(self) -> tuple[float, float]:
        """Of regions 1 and 2, above that of the outside, in tensions per um (Laplace)."""
        one, two, _ = 2 * np.asarray(self.tensions) * self.curvatures
        return float(one), float(two)

    @property
    def volumes(self) -> tuple[float, float]:
        """um^3 of regions 1 and 2."""
        below, above, wall = (self._cap(k)[1] for k in range(3))
        return wall - below, above - wall

    @property
    def areas(self) -> FloatArray:
        """(3,) um^2: of the outer walls of regions 1 and 2, and of the shared wall."""
        heights = np.array([self._cap(k)[0] for k in range(3)])
        return np.pi * (self.rim**2 + heights**2)

    def _cap(self, k: int) -> tuple[float, float]:
        """Height of a cap above the plane of the rim, um, and its volume, um^3, signed alike."""
        r, x = self._directions()[1][k]
        # The tangent at the rim opens by this much from the plane; a sphere of curvature |x| / rim.
        height = self.rim * np.tan(atan2(abs(x), -r) / 2) * np.sign(x)
        return float(height), float(np.pi * height * (3 * self.rim**2 + height**2) / 6)

    def mesh(self, edge_length: float) -> Mesh:
        """Its mesh, with every vertex on its cap; edges of about this length, um."""
        if not 0 < edge_length <= self.rim / 2:
            raise InputError("edge_length must be positive, and at most half the rim")
        heights = [self._cap(k)[0] for k in range(3)]
        # From top to rim, along the cap, are 1.11 chords for half a ball, more for more than that.
        longest = max(1.2 * hypot(self.rim, h) for h in heights)
        rings = int(np.ceil(longest / edge_length))
        flat, disc = _disc(rings)
        within = np.linalg.norm(flat, axis=1) < 1 - 1e-9  # rounding: those of the rim lie at 1
        rim = flat[~within]
        number = np.empty(len(flat), np.int64)
        number[~within] = np.arange(len(rim))
        vertices = [np.column_stack([np.zeros(len(rim)), self.rim * rim])]
        faces, regions, start = [], [], len(rim)
        for k, pair in enumerate(((1, OUTSIDE), (2, OUTSIDE), (1, 2))):
            number[within] = start + np.arange(within.sum())
            start += int(within.sum())
            vertices.append(self._on_cap(k, flat[within]))
            # Out of region 1 is towards lower X for its outer wall, towards higher X for the rest.
            faces.append(number[disc if k else disc[:, ::-1]])
            regions.append(np.tile(pair, (len(disc), 1)))
        points = np.concatenate(vertices)[:, [1, 2, 0]]
        mesh = Mesh(points, np.concatenate(faces), np.concatenate(regions))
        if mesh.region_volume(1) < 0:
            mesh = Mesh(points, mesh.faces[:, ::-1], mesh.regions)
        for _ in range(_ROUNDS if can_remesh() else 0):
            mesh = self._projected(remesh(mesh, edge_length, passes=2).mesh)
        return mesh

    def _on_cap(self, k: int, flat: FloatArray) -> FloatArray:
        """(N, 3) X, Z, Y on a cap, from places (N, 2) in the unit disc, evenly by arc length."""
        height = self._cap(k)[0]
        opening = 2 * np.arctan(abs(height) / self.rim)  # half the angle that the cap spans
        share = np.linalg.norm(flat, axis=1)
        way = flat / np.where(share > 0, share, 1)[:, None]
        if abs(self.curvatures[k]) * self.rim < _FLAT:
            return np.column_stack([np.zeros(len(flat)), self.rim * flat])
        radius = self.rim / np.sin(opening)
        out = radius * np.sin(share * opening)
        up = np.sign(height) * (abs(height) - radius * (1 - np.cos(share * opening)))
        return np.column_stack([up, out[:, None] * way])

    def _projected(self, mesh: Mesh) -> Mesh:
        """Every vertex on its cap, or on the rim."""
        v = mesh.vertices_numpy().copy()
        kind = np.where((mesh.regions != OUTSIDE).all(1), 2, mesh.regions.max(1) - 1)
        touches = np.zeros((len(v), 3), bool)
        np.logical_or.at(touches, (mesh.faces, kind[:, None]), True)
        several = touches.sum(1) > 1
        across = np.linalg.norm(v[:, :2], axis=1)
        v[several, :2] *= (self.rim / across[several])[:, None]
        v[several, 2] = 0
        for k in range(3):
            own = touches[:, k] & ~several
            height = self._cap(k)[0]
            if abs(self.curvatures[k]) * self.rim < _FLAT:
                v[own, 2] = 0
                continue
            center = np.array([0, 0, (height**2 - self.rim**2) / (2 * height)])
            away = v[own] - center
            radius = (height**2 + self.rim**2) / (2 * abs(height))
            v[own] = center + away * (radius / np.linalg.norm(away, axis=1))[:, None]
        return mesh.with_vertices(v)


def _disc(rings: int) -> tuple[FloatArray, IntArray]:
    """Places (N, 2) in the unit disc and triangles (M, 3): hexagonal rings drawn to circles."""
    span = np.arange(-rings, rings + 1)
    a, b = (g.ravel() for g in np.meshgrid(span, span, indexing="ij"))
    ring = np.maximum(np.maximum(abs(a), abs(b)), abs(a + b))
    a, b, ring = (values[ring <= rings] for values in (a, b, ring))
    plane = np.column_stack([a + b / 2, b * np.sqrt(3) / 2])
    length = np.linalg.norm(plane, axis=1)
    places = plane * (ring / np.where(length > 0, length, 1) / rings)[:, None]
    index = {(int(p), int(q)): k for k, (p, q) in enumerate(zip(a, b, strict=True))}
    faces = []
    for p in range(-rings, rings):
        for q in range(-rings, rings):
            right, up, corner = (p + 1, q), (p, q + 1), (p + 1, q + 1)
            for triangle in (((p, q), right, up), (right, corner, up)):
                if all(place in index for place in triangle):
                    faces.append([index[place] for place in triangle])
    return places, np.array(faces, np.int64)
