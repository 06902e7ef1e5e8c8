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
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..fourier import Plan, make_plan
from ..fourier.filament import LinePlan, make_line_plan, path_segments
from ..fourier.plan import Cutoff, Method
from ..fourier.solid import contrasts, solid_transform
from ..fourier.spreading import Transfer
from ..geometry.mesh import FARTHEST, FloatArray, Mesh, is_tensor, to_numpy
from ..geometry.windings import right_side_out
from .effects import Effects
from .effects.base import FaceEffect
from .grid import Grid

Values = float | np.ndarray | Tensor
_CPU = torch.device("cpu")
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
    stretch
        By how much edges of a mesh may grow before its plan no longer holds.
    device
        Where structures are transformed.
    """

    grid: Grid
    frame: Grid
    fft_shape: tuple[int, int, int]
    width: tuple[float, float, float]
    accuracy: float
    method: Method | None
    aligned: bool
    cutoff: Cutoff | None = None
    transfer: Transfer | None = None
    stretch: float = 1.0
    device: torch.device = _CPU

    def local(self, positions: Tensor) -> Tensor:
        """Positions relative to the centre of the first voxel."""
        return positions - torch.tensor(self.grid.origin, dtype=positions.dtype)


class Planned(Protocol):
    """A structure planned for a site."""

    @property
    def plan(self) -> Plan | LinePlan:
        """On the box of whose band transforms lie."""

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """u_hat with the effects on the object; two boxes where the PSF changes with depth.

        Differentiable. Vertices (V, 3) um and densities: others than those that it was planned with
        (near them); densities of a surface alone.
        """


class Structure(Protocol):
    """Something that shines."""

    def positions(self) -> FloatArray:
        """(N, 3) um: points whose bounds are those of the structure."""

    def planned(self, site: Site) -> Planned:
        """Ready to be transformed for a site; a :class:`~.render.Renderer` asks for it."""


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

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        return _PlannedSurface(self, site, _mesh_plan(self.mesh, site))


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

    @cached_property
    def _middles(self) -> Tensor:
        """(R, 3) um, where effects on the object take the regions to lie."""
        return torch.stack([_middle(self.mesh, k) for k in self.mesh.region_ids()])

    def contrasts(self, effects: Effects, frame: Grid) -> list[Tensor]:
        """(F,) signal per um^3 behind each face minus that in front, as the effects make it.

        Two where the PSF changes with depth: what is seen through that of the first slice, and
        through that of the last.
        """
        ids, regions = self.mesh.region_ids(), self.mesh.regions
        own = self.densities().to(torch.float64)
        seen = _shares(own, lambda: self._middles, frame, effects)
        return [contrasts(regions, ids, densities) for densities in seen]

    def positions(self) -> FloatArray:
        """See ``Structure``."""
        return self.mesh.vertices_numpy()

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        return _PlannedSolid(self, site, _mesh_plan(self.mesh, site))


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

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        segments = self.joined()
        weights = _each(self.density, len(segments))
        return _PlannedLine.of(_tensor(self.vertices), segments, weights, site)


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

    def planned(self, site: Site) -> Planned:
        """See ``Structure``."""
        places = _tensor(self.places)
        every = np.arange(len(places))[:, None]
        return _PlannedLine.of(places, every, _each(self.weight, len(places)), site)


def membranes_and_insides(mesh: Mesh, interior: float = 0.0) -> tuple[Structure, ...]:
    """Its membranes, of density 1, and the insides of its regions where they shine."""
    return (Surface(mesh), Solid(mesh, interior)) if interior else (Surface(mesh),)


# --------------------------------------------------------------------------------------- planned


class _PlannedSurface:
    """See ``Planned``."""

    def __init__(self, surface: Surface, site: Site, plan: Plan) -> None:
        self._surface, self._site, self.plan = surface, site, plan
        mesh, there = surface.mesh, site.device
        self._faces = torch.as_tensor(mesh.faces, device=there)
        self._membranes = torch.as_tensor(mesh.membranes(), dtype=torch.float64, device=there)
        self._origin = torch.tensor(site.grid.origin, dtype=torch.float64, device=there)

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        weight = self._weight(density)
        if vertices is None:
            vertices = _tensor(self._surface.mesh.vertices)
        there = self._site.device if not _act_on_object(effects) else _CPU
        vertices, faces, weight = (t.to(there) for t in (vertices, self._faces, weight))
        placed = vertices - self._origin.to(vertices)
        seen = _shares(weight, lambda: vertices[faces].mean(1), self._site.frame, effects)
        return _joined([self.plan.transform(placed, faces, part) for part in seen])

    def _weight(self, density: Tensor | None) -> Tensor:
        weight = self._membranes
        own = self._surface.density
        if density is None and (is_tensor(own) or not np.array_equal(own, 1.0)):
            # A copy of an array: torch warns of those that are read-only.
            density = torch.tensor(own) if isinstance(own, np.ndarray) else torch.as_tensor(own)
        if density is None:
            return weight
        if density.ndim and density.shape != weight.shape:
            raise InputError(
                f"density must have shape ({len(weight)},), one number per face, "
                f"not {tuple(density.shape)}"
            )
        return weight * density.to(weight.device)


class _PlannedSolid:
    """See ``Planned``."""

    def __init__(self, solid: Solid, site: Site, plan: Plan) -> None:
        self._solid, self._site, self.plan = solid, site, plan
        self._faces = torch.as_tensor(solid.mesh.faces)

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        placed = self._site.local(
            _tensor(self._solid.mesh.vertices) if vertices is None else vertices
        )
        seen = self._solid.contrasts(effects, self._site.frame)
        return _joined([solid_transform(self.plan, placed, self._faces, part) for part in seen])


@dataclass(frozen=True)
class _PlannedLine:
    """See ``Planned``; of segments, or of points."""

    plan: LinePlan
    vertices: Tensor
    elements: Tensor
    weights: Tensor
    site: Site

    @classmethod
    def of(
        cls, vertices: Tensor, elements: np.ndarray, weights: Tensor, site: Site
    ) -> _PlannedLine:
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
        return cls(plan, vertices, torch.from_numpy(elements), weights, site)

    def transform(
        self, effects: Effects, vertices: Tensor | None = None, density: Tensor | None = None
    ) -> Tensor:
        """See ``Planned``."""
        vertices = self.vertices if vertices is None else vertices
        placed = self.site.local(vertices)

        def middles() -> Tensor:
            return vertices[self.elements].mean(1).to(torch.float64)

        seen = _shares(self.weights, middles, self.site.frame, effects)
        return _joined([self.plan.transform(placed, self.elements, part) for part in seen])


def _mesh_plan(mesh: Mesh, site: Site) -> Plan:
    return make_plan(
        mesh.vertices_numpy() - np.asarray(site.grid.origin),
        mesh.faces,
        site.fft_shape,
        site.grid.voxel_size,
        site.width,
        site.accuracy,
        site.method,
        margin=site.stretch,
        aligned=site.aligned,
        cutoff=site.cutoff,
        device=site.device.type,
        transfer=site.transfer,
    )


def _act_on_object(effects: Effects) -> bool:
    """Whether the object's transform is another with these effects."""
    faces = any(isinstance(effect, FaceEffect) for effect in effects.present())
    return faces or effects.depth is not None


def _shares(
    weights: Tensor, places: Callable[[], Tensor], frame: Grid, effects: Effects
) -> list[Tensor]:
    """Weights (N,) with the effects that act on the object, each at its place (N, 3) um.

    Two where the PSF changes with depth: those seen through that of the first slice, and through
    that of the last.
    """
    if not _act_on_object(effects):
        return [weights]
    at = places()
    for effect in effects.present():
        if isinstance(effect, FaceEffect):
            weights = weights * effect.face_weights(at, frame)
    if effects.depth is None:
        return [weights]
    last = weights * effects.depth.depths(at, frame)
    return [weights - last, last]


def _joined(seen: list[Tensor]) -> Tensor:
    return seen[0] if len(seen) == 1 else torch.stack(seen)


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
