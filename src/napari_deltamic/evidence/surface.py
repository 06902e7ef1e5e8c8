"""Derivatives of the expected image in the surface: each where it is, on a piece of the grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.mesh import Mesh
from ..scene import Grid, Renderer, Scene
from .fitted_scene import FittedScene
from .modes import ShapeModes

# Of the PSF's width: a difference of shapes. Measured: half changes scores by 0.7 % and errors of a
# PSF by 3 %, twice by 5 % and 12 %.
_MOVE = 0.08
_ACCURACY = 1e-2  # derivatives are many. Measured: half and twice change scores by 1 and 7 %


class SurfaceColumns:
    """Columns (N, K) for changes of shape and density of a scene.

    Parameters
    ----------
    scene
        At which the image is differentiated.
    grid, frame
        Of the piece that is judged, and of the whole image.
    index
        (N,) flat indices into the piece of the voxels that count.
    accuracy
        Of the images; derivatives need not be better than 1 %.
    """

    def __init__(
        self, scene: FittedScene, grid: Grid, frame: Grid, index: np.ndarray, accuracy: float
    ) -> None:
        self.scene, self.grid, self.frame, self.index = scene, grid, frame, index
        self.accuracy = max(accuracy, _ACCURACY)
        self._reach = np.asarray(scene.optics.reach(self.accuracy))
        for effect in scene.effects.present():
            self._reach = np.hypot(self._reach, effect.reach(self.accuracy))
        self.contrasts: list[np.ndarray] = []
        if scene.insides is not None:
            cells = torch.from_numpy(scene.light.of_cells(scene.mesh.region_ids()))
            seen = scene.insides.contrasts(scene.effects, frame, cells)
            self.contrasts = [scene.light.interior * one.numpy() for one in seen]

    def shape(self, modes: ShapeModes) -> np.ndarray:
        """Change of the expected image for a coefficient of 1 um of each mode."""
        moved = np.abs(modes.fields).max(2) > 0
        of_faces = moved[:, self.scene.mesh.faces].any(2)

        def column(piece: _Piece, k: int) -> Tensor:
            return piece.moved(modes.fields[k])

        return self._filled(of_faces, column)

    def density(self, fields: np.ndarray) -> np.ndarray:
        """For a coefficient of 1 of each field (M, F) of the logarithm of the density."""

        def column(piece: _Piece, k: int) -> Tensor:
            return piece.dimmed(fields[k])

        return self._filled(fields != 0, column)

    def _filled(self, of_faces: np.ndarray, column: Callable[[_Piece, int], Tensor]) -> np.ndarray:
        """(N, K), stored column by column; those of the same faces share a piece."""
        out = np.zeros((len(of_faces), len(self.index)))
        whole = np.zeros(self.grid.shape)
        for faces, which in _alike(of_faces):
            piece = self._piece(faces)
            if piece is None:
                continue
            for k in which:
                whole[piece.box] = (self.scene.amplitude * column(piece, k)).numpy()
                out[k] = whole.reshape(-1)[self.index]
            whole[piece.box] = 0.0
        return out.T

    def _piece(self, faces: np.ndarray) -> _Piece | None:
        """What of the grid the light of some faces falls on; None where none does."""
        mesh = self.scene.mesh
        used, index = np.unique(mesh.faces[faces], return_inverse=True)
        v = mesh.vertices_numpy()[used]
        size, origin = np.asarray(self.grid.voxel_size), np.asarray(self.grid.origin)
        first = np.floor((v.min(0) - self._reach - origin) / size).astype(int)
        last = np.ceil((v.max(0) + self._reach - origin) / size).astype(int) + 1
        first, last = np.clip(first, 0, None), np.minimum(last, self.grid.shape)
        if (first >= last).any():
            return None
        box = (slice(first[0], last[0]), slice(first[1], last[1]), slice(first[2], last[2]))
        z, y, x = (float(c) for c in origin + first * size)
        n = last - first
        grid = Grid((int(n[0]), int(n[1]), int(n[2])), self.grid.voxel_size, (z, y, x))
        part = Mesh(v, index.reshape(-1, 3), mesh.regions[faces])
        return _Piece.of(self, part, used, faces, grid, box)


def _alike(of_faces: np.ndarray) -> Iterator[tuple[np.ndarray, list[int]]]:
    """Faces that count (F,), and the rows that they count in."""
    groups: dict[bytes, list[int]] = {}
    for k, row in enumerate(of_faces):
        if row.any():
            groups.setdefault(np.packbits(row).tobytes(), []).append(k)
    for which in groups.values():
        yield of_faces[which[0]], which


@dataclass(frozen=True)
class _Piece:
    """Some faces of a scene, and the piece of the grid that they are seen in."""

    scene: FittedScene
    box: tuple[slice, slice, slice]
    mesh: Mesh
    vertices: np.ndarray
    faces: np.ndarray
    renderer: Renderer
    otf: Tensor
    density: np.ndarray
    contrasts: list[np.ndarray]

    @classmethod
    def of(
        cls,
        columns: SurfaceColumns,
        mesh: Mesh,
        vertices: np.ndarray,
        faces: np.ndarray,
        grid: Grid,
        box: tuple[slice, slice, slice],
    ) -> _Piece:
        scene = columns.scene
        # The inside is no part of it: its derivative is on the surface.
        renderer = Renderer(
            Scene.of(mesh, scene.optics, scene.effects),
            grid,
            columns.accuracy,
            frame=columns.frame,
            margin=_MOVE * min(scene.optics.sigma_um),
        )
        held = np.ones(len(scene.mesh.faces)) if scene.density is None else scene.density
        density, otf = scene.light.membrane * held[faces], renderer.otf(scene.optics)
        contrasts = [one[faces] for one in columns.contrasts]
        return cls(scene, box, mesh, vertices, faces, renderer, otf, density, contrasts)

    def moved(self, field: np.ndarray) -> Tensor:
        """Derivative of the rendered image for vertices that move along a field (V, 3)."""
        along, v = field[self.vertices], self.mesh.vertices_numpy()
        h = _MOVE * min(self.scene.optics.sigma_um) / max(float(np.abs(along).max()), 1e-12)
        ends = [self._surface(v + side * h * along) for side in (1, -1)]
        change = (ends[0] - ends[1]) / (2 * h)
        if self.contrasts:
            # A surface that moves outwards by d leaves a layer of the solid of thickness d.
            outwards = np.einsum("fd,fd->f", along[self.mesh.faces].mean(1), self.mesh.normals())
            faces, plan = torch.from_numpy(self.mesh.faces), self.renderer.plan
            placed = torch.from_numpy(v - np.asarray(self.renderer.grid.origin))
            layers = [torch.from_numpy(contrast * outwards) for contrast in self.contrasts]
            left = [plan.transform(placed, faces, layer) for layer in layers]
            change = change + (left[0] if len(left) == 1 else torch.stack(left))
        return self.renderer.image(change, self.otf)

    def dimmed(self, field: np.ndarray) -> Tensor:
        """Derivative for a density that grows by a share of itself, of the whole mesh's faces."""
        v = self.mesh.vertices_numpy()
        change = self._surface(v, self.density * field[self.faces])
        return self.renderer.image(change, self.otf)

    def _surface(self, vertices: np.ndarray, density: np.ndarray | None = None) -> Tensor:
        weight = torch.from_numpy(self.density if density is None else density)
        return self.renderer.transform(torch.from_numpy(vertices), weight)
