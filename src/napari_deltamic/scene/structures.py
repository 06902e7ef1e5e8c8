"""What a scene may hold: surfaces, solids, filaments and points.

Each gives its Fourier transform on a band, by its closed form or by the particle-mesh. What the
latter takes, measured (48^3 to 96^3 voxels, accuracies 1e-2 to 1e-5, one core): the transform of a
solid 3.4 to 4.4 times as long as that of its surface, together with its gradient 1.9 to 2.3 times,
since a solid's gradient is the simpler one; filaments and points as long as a surface of as many
quadrature points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..fourier import Band, Plan, make_plan
from ..fourier.filament import LinePlan, make_line_plan, path_segments
from ..fourier.plan import Cutoff, Method
from ..fourier.solid import contrasts, solid_transform
from ..fourier.spreading import Transfer
from ..geometry.mesh import FARTHEST, FloatArray, Mesh, is_tensor, to_numpy
from ..geometry.windings import right_side_out
from .effects import Effects
from .effects.base import FaceEffect
from .effects.object_side import Surfaces, acts_on_object, object_transform
from .grid import Grid

Values = float | np.ndarray | Tensor
_LARGEST_DENSITY = 1e30  # so that its products with areas and volumes are numbers


@dataclass(frozen=True)
class Site:
    """Where and how structures are transformed.

    Attributes
    ----------
    grid, frame
        Of the image, and of the whole image, to which effects refer.
    fft_shape
        Of the periodic grid.
    width
        um along Z, Y, X; of the band (see :func:`napari_deltamic.fourier.make_plan`).
    aligned
        Whether the axes of the PSF are those of the grid.
    cutoff
        Where the OTF ends, for a PSF that is not Gaussian.
    transfer
        The OTF with what effects make of it.
    """

    grid: Grid
    frame: Grid
    fft_shape: tuple[int, int, int]
    width: tuple[float, float, float]
    accuracy: float
    method: Method | None
    aligned: bool
    effects: Effects
    cutoff: Cutoff | None = None
    transfer: Transfer | None = None

    def local(self, positions: Tensor) -> Tensor:
        """Positions relative to the centre of the first voxel."""
        return positions - torch.tensor(self.grid.origin, dtype=positions.dtype)


class Transform(Protocol):
    """A structure planned for a site."""

    @property
    def band(self) -> Band:
        """On whose box the result lies."""

    @property
    def single(self) -> bool:
        """Whether it is in single precision."""

    def __call__(self) -> Tensor:
        """u_hat; two boxes where the PSF changes with depth. Differentiable."""


@dataclass(frozen=True)
class _Planned:
    plan: Plan | LinePlan
    compute: Callable[[], Tensor]

    @property
    def band(self) -> Band:
        return self.plan.band

    @property
    def single(self) -> bool:
        return self.plan.single

    def __call__(self) -> Tensor:
        return self.compute()


class Structure(Protocol):
    """Something that shines."""

    def positions(self) -> FloatArray:
        """(N, 3) um: points whose bounds are those of the structure."""

    def planned(self, site: Site) -> Transform:
        """Its transform for a site; :func:`napari_deltamic.scene.render_scene` calls it."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Membranes: the faces of a mesh; a wall between two regions is two membranes.

    Attributes
    ----------
    mesh
        Vertices in um; rendering is differentiable in them where they are a tensor.
    density
        Fluorophores per um^2 of membrane: one number, or (F,).
    """

    mesh: Mesh
    density: Values = 1.0

    def __post_init__(self) -> None:
        _check(self.density, len(self.mesh.faces), "density", "face")

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return self.mesh.vertices_numpy()

    def planned(self, site: Site) -> Transform:
        """See ``Structure``."""
        plan = _mesh_plan(self.mesh, site)
        surfaces = Surfaces.of(self.mesh)
        vertices = _tensor(self.mesh.vertices)

        def compute() -> Tensor:
            weight = torch.as_tensor(self.mesh.membranes(), dtype=torch.float64)
            if is_tensor(self.density) or not np.array_equal(self.density, 1.0):
                weight = weight * torch.as_tensor(self.density)
            if acts_on_object(site.effects):
                return object_transform(
                    plan, vertices, surfaces, weight, site.effects, site.grid, site.frame
                )
            return plan.transform(site.local(vertices), surfaces.faces, weight)

        return _Planned(plan, compute)


@dataclass(frozen=True, eq=False)
class Solid:
    """The inside of the regions of a mesh: cytoplasm, nuclei, a filled bead.

    Attributes
    ----------
    mesh
        Closed regions; rendering is differentiable in the vertices where they are a tensor. Those
        that are inside out are turned, with a RepairWarning.
    density
        Fluorophores per um^3: one number for all regions, region number -> number (0 for those not
        named), or (R,) in the order of ``mesh.region_ids()``.
    """

    mesh: Mesh
    density: Values | Mapping[int, float] = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "mesh", right_side_out(self.mesh))
        ids = self.mesh.region_ids()
        if isinstance(self.density, Mapping):
            unknown = [k for k in self.density if k not in ids]
            if unknown:
                raise InputError(f"the mesh has no region {unknown[0]}")
            _check(np.array(list(self.density.values()), float), None, "density", "region")
        else:
            _check(self.density, len(ids), "density", "region")
        for region, density in zip(ids.tolist(), self.densities().tolist(), strict=True):
            if density and not self.mesh.is_closed(region):
                raise InputError(f"region {region} is not closed: a solid needs closed surfaces")

    def densities(self) -> Tensor:
        """(R,) fluorophores per um^3, in the order of ``mesh.region_ids()``."""
        ids = self.mesh.region_ids().tolist()
        if isinstance(self.density, Mapping):
            return torch.tensor([float(self.density.get(k, 0.0)) for k in ids])
        return torch.as_tensor(self.density, dtype=torch.float64).expand(len(ids))

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return self.mesh.vertices_numpy()

    def planned(self, site: Site) -> Transform:
        """See ``Structure``."""
        plan = _mesh_plan(self.mesh, site)
        surfaces = Surfaces.of(self.mesh)
        vertices = _tensor(self.mesh.vertices)
        middles = torch.stack([_middle(self.mesh, k) for k in surfaces.ids])

        def seen(densities: Tensor) -> Tensor:
            contrast = contrasts(surfaces.regions, surfaces.ids, densities.to(torch.float64))
            return solid_transform(plan, site.local(vertices), surfaces.faces, contrast)

        return _Planned(plan, lambda: _through(seen, self.densities(), middles, site))


@dataclass(frozen=True, eq=False)
class Filament:
    """Thin threads: straight segments between vertices.

    Attributes
    ----------
    vertices
        (V, 3) um; rendering is differentiable in a tensor.
    segments
        (S, 2) vertices that each joins; None: one after the other.
    density
        Fluorophores per um: one number, or (S,).
    """

    vertices: np.ndarray | Tensor
    segments: np.ndarray | None = None
    density: Values = 1.0

    def __post_init__(self) -> None:
        n = len(_positions(self.vertices, "vertices"))
        joined = self.joined()
        if joined.ndim != 2 or joined.shape[1] != 2 or not len(joined):
            raise InputError(f"segments must have shape (S, 2), not {joined.shape}")
        if joined.min() < 0 or joined.max() >= n:
            raise InputError("a segment names a vertex that is not there")
        _check(self.density, len(joined), "density", "segment")

    def joined(self) -> np.ndarray:
        """(S, 2) the segments."""
        if self.segments is None:
            return path_segments(len(self.vertices))
        return np.asarray(self.segments, np.int64)

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return _positions(self.vertices, "vertices")

    def planned(self, site: Site) -> Transform:
        """See ``Structure``."""
        vertices, segments = _tensor(self.vertices), self.joined()
        return _line(vertices, segments, _each(self.density, len(segments)), site)


@dataclass(frozen=True, eq=False)
class Points:
    """Spots much smaller than the PSF.

    Attributes
    ----------
    places
        (P, 3) um; rendering is differentiable in a tensor.
    weight
        Fluorophores of each: one number, or (P,).
    """

    places: np.ndarray | Tensor
    weight: Values = 1.0

    def __post_init__(self) -> None:
        n = len(_positions(self.places, "points"))
        if not n:
            raise InputError("there are no points")
        _check(self.weight, n, "weight", "point")

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return _positions(self.places, "points")

    def planned(self, site: Site) -> Transform:
        """See ``Structure``."""
        places = _tensor(self.places)
        every = np.arange(len(places))[:, None]
        return _line(places, every, _each(self.weight, len(places)), site)


# ---------------------------------------------------------------------------------------- inside


def _mesh_plan(mesh: Mesh, site: Site) -> Plan:
    return make_plan(
        mesh.vertices_numpy() - np.asarray(site.grid.origin),
        mesh.faces,
        site.fft_shape,
        site.grid.voxel_size,
        site.width,
        site.accuracy,
        site.method,
        aligned=site.aligned,
        cutoff=site.cutoff,
        transfer=site.transfer,
    )


def _line(vertices: Tensor, elements: np.ndarray, weights: Tensor, site: Site) -> Transform:
    plan = make_line_plan(
        to_numpy(vertices) - np.asarray(site.grid.origin),
        elements,
        site.fft_shape,
        site.grid.voxel_size,
        site.width,
        site.accuracy,
        site.method,
        site.aligned,
        site.cutoff,
        site.transfer,
    )
    joined = torch.from_numpy(elements)

    def seen(weights: Tensor) -> Tensor:
        return plan.transform(site.local(vertices), joined, weights)

    return _Planned(
        plan, lambda: _through(seen, weights, vertices[joined].mean(1).to(torch.float64), site)
    )


def _through(
    seen: Callable[[Tensor], Tensor], weights: Tensor, places: Tensor, site: Site
) -> Tensor:
    """A transform with the effects that act on the object, each part of it at its place."""
    for effect in site.effects.present():
        if isinstance(effect, FaceEffect):
            weights = weights * effect.face_weights(places, site.frame)
    depth = site.effects.depth_psf
    if depth is None:
        return seen(weights)
    last = weights * depth.depths(places, site.frame)
    return torch.stack([seen(weights - last), seen(last)])


def _middle(mesh: Mesh, region: int) -> Tensor:
    used = np.unique(mesh.faces[(mesh.regions == region).any(1)])
    return _tensor(mesh.vertices)[torch.from_numpy(used)].detach().to(torch.float64).mean(0)


def _tensor(values: Any) -> Tensor:
    return values if is_tensor(values) else torch.tensor(np.asarray(values, dtype=np.float64))


def _each(values: Values, count: int) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float64).expand(count)


def _positions(values: Any, name: str) -> FloatArray:
    try:
        found = to_numpy(values).astype(np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers of shape (N, 3), in um") from None
    if found.ndim != 2 or found.shape[1] != 3:
        raise InputError(f"{name} must have shape (N, 3), not {found.shape}")
    if not (np.abs(found) < FARTHEST).all():  # false for NaN, too
        raise InputError(f"{name} must be finite numbers (um)")
    return found


def _check(values: Any, count: int | None, name: str, of: str) -> None:
    """One finite number, or one for each."""
    try:
        found = to_numpy(values).astype(np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} takes numbers, not {values!r}") from None
    if found.ndim and count is not None and found.shape != (count,):
        raise InputError(
            f"{name} must be one number, or one per {of} ({count}), not shape {found.shape}"
        )
    if not (np.abs(found) < _LARGEST_DENSITY).all():  # false for NaN, too
        raise InputError(f"{name} must be finite, and below {_LARGEST_DENSITY:g}")
