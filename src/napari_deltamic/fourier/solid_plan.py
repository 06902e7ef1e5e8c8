"""What solids need besides the plan of their surface; made once, for all meshes of a fit.

See :mod:`napari_deltamic.fourier.solid` for the formulas.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from math import floor, sqrt

import numpy as np
import torch
from scipy.special import roots_jacobi
from torch import Tensor

from ..common.kept import Kept, kept
from .band import Band
from .particle_mesh import elements_ft
from .plan import RULE_SHARE, Plan
from .points import Points, placed
from .quadrature import Rule, choose_rules
from .spreading import Spreading, choose_spreading, flat
from .triangle import cross

# Shells are used where each component of xi is at most this over R.
NEAR = 1.0
_LARGEST_PHASE = sqrt(3) * NEAR  # of a point relative to the centre, at such wavevectors
EXACT = 1e-15
_POINT = Rule(0, 1, np.ones((1, 1)), np.ones(1))
# Flux that cancels up to this factor leaves the plan's errors below what was asked: measured on ten
# solids and four PSFs (test_plan.py), which keep to it up to 3.6 and not always from 4 on.
_THICK = 3.0
_AT_ONCE = 128  # sums side by side, about as many as a GPU has multiprocessors
# Points (or sums) times wavevectors of a direct sum: 1 GB in double precision.
_MOST_DIRECT = 1 << 26


@dataclass(frozen=True, eq=False)
class SolidPlan:
    """How u_hat of the inside of closed surfaces is computed on a band.

    Attributes
    ----------
    plan
        Plan of the surface.
    low
        The part of the band that is computed by shells; it always includes zero.
    flux
        Points of the flux, grid and kernels, and whether in single precision.
    shells
        Points of the shells, grid and kernels; in the plan's precision.
    """

    plan: Plan
    low: Band
    flux: tuple[Points, Spreading, bool] | None = field(repr=False)
    shells: tuple[Points, Spreading] | None = field(repr=False)

    @classmethod
    def of(
        cls,
        plan: Plan,
        vertices: np.ndarray,
        faces: np.ndarray,
        contrast: np.ndarray,
        stretch: float = 1.0,
    ) -> SolidPlan:
        """Make a plan for a mesh and for what becomes of it in a fit.

        Whether the solid is thin is judged with the contrast given: if thin cells become far
        brighter than thick ones, images are less accurate than the plan says.

        Parameters
        ----------
        plan
            Its band, method and rules are used; made for this mesh, or one near it.
        vertices, faces, contrast
            (V, 3) um relative to the centre of the grid's first voxel, (F, 3), (F,) see
            :func:`napari_deltamic.fourier.solid.contrasts`.
        stretch
            Factor by which the mesh may grow.
        """
        reach = float(reach_of(torch.from_numpy(vertices), centre_of(torch.from_numpy(vertices))))
        low = _low_band(plan.band, stretch * reach)
        if plan.method == "closed form":
            return cls(plan, low, None, None)
        corners = vertices[faces]
        edges = stretch * np.abs(corners - np.roll(corners, 1, 1))
        phases = np.linalg.norm(edges, axis=2).max(1, initial=0.0)
        phases = _LARGEST_PHASE * phases / max(stretch * reach, 1e-300)
        near = Points(choose_rules(phases, 1.0, RULE_SHARE * plan.accuracy), len(faces))
        count = near.count * len(nodes(plan.tolerance)[0])
        spreading = choose_spreading(
            low.half, low.spacing, flat, plan.tolerance, count, plan.single
        )
        return cls(plan, low, _flux(plan, corners, edges, contrast), (near, spreading))

    def points_of(self, contrast: Tensor) -> tuple[Points, Points]:
        """Return points of flux and shells; walls between equally bright regions have none."""
        assert self.flux is not None
        assert self.shells is not None
        every = self.flux[0], self.shells[0]
        if contrast.requires_grad:
            return every
        seen = contrast.cpu().numpy() != 0
        if seen.all():
            return every
        # The same walls are used again and again; two sets if the PSF changes with depth.
        return self._seen.get(seen.tobytes(), lambda: (every[0].of(seen), every[1].of(seen)))

    def low_shells(
        self, points: Points, centre: Tensor, corners: Tensor, vectors: Tensor, jump: Tensor
    ) -> Tensor:
        """Compute u_hat on the low box by shells of points; differentiable only in the contrast.

        Parameters
        ----------
        points
            As :meth:`points_of` says.
        centre
            (3,) um, of the mesh as it is now.
        corners, vectors
            (F, 3, 3) um; (F, 3) area vectors, um^2.
        jump
            (F,) the contrast.
        """
        assert self.shells is not None
        device, real = corners.device, corners.dtype
        kind = torch.complex64 if self.plan.single else torch.complex128
        arms, volumes = [], []
        t, weight, *_ = self._numbers(real, device)
        for mix, size, of in points.groups(real, device):
            each = mix @ (corners.index_select(0, of) - centre)
            share = (each * vectors.index_select(0, of)[:, None]).sum(2) * size
            arms.append(each.reshape(-1, 3))
            volumes.append((share * jump.index_select(0, of).to(real)[:, None]).reshape(-1))
        if not arms:
            return torch.zeros(self.low.box_shape, dtype=kind, device=device)
        strengths = (weight[:, None] * torch.cat(volumes)).reshape(-1)
        if self.low.half == (0, 0, 0):
            return strengths.sum().reshape(1, 1, 1).to(kind)
        shells = (t[:, None, None] * torch.cat(arms)).reshape(-1, 3)
        terms = max(len(shells), _AT_ONCE) * int(np.prod(self.low.box_shape))
        if _has_atomics(device) and terms <= _MOST_DIRECT:
            return self._directly(centre, shells, strengths).to(kind)
        one, indices = _one_by_one(len(shells)), torch.arange(len(shells), device=device)[:, None]
        return elements_ft(
            shells + centre, indices, strengths, one, self.shells[1], self.plan.single
        )

    def _directly(self, centre: Tensor, arms: Tensor, strengths: Tensor) -> Tensor:
        """Sum over points (P, 3) about the centre, on the low box, wavevector by wavevector."""
        _, _, *axes = self._numbers(arms.dtype, arms.device)
        rest = -len(arms) % _AT_ONCE
        arms = torch.nn.functional.pad(arms, (0, 0, 0, rest)).reshape(_AT_ONCE, -1, 3)
        strengths = torch.nn.functional.pad(strengths, (0, rest)).reshape(_AT_ONCE, -1, 1)
        z, y, x = (_turned(arms[..., i : i + 1] * k) for i, k in enumerate(axes))
        plane = (y[..., :, None] * x[..., None, :]).flatten(2)
        sums = torch.bmm((strengths * z).transpose(1, 2), plane).sum(0)
        z, y, x = (_turned(c * k) for c, k in zip(centre, axes, strict=True))
        return sums.reshape(self.low.box_shape) * (z[:, None, None] * (y[:, None] * x))

    @kept
    def _numbers(self, real: torch.dtype, device: torch.device) -> list[Tensor]:
        """Return shells, their weights, and components of the low wavevectors along each axis."""
        axes = [k.reshape(-1).numpy() for k in self.low.axes(torch.float64)]
        return [placed(a, real, device) for a in (*nodes(self.plan.tolerance), *axes)]

    @cached_property
    def _seen(self) -> Kept[tuple[Points, Points]]:
        return Kept(2)


def centre_of(vertices: Tensor) -> Tensor:
    """Return the centre (3,) of the bounds of vertices (V, 3), um."""
    v = vertices.detach()
    return (v.amin(0) + v.amax(0)) / 2 if len(v) else v.new_zeros(3)


def reach_of(vertices: Tensor, centre: Tensor) -> Tensor:
    """Return how far vertices reach from a centre, um."""
    arms = vertices.detach() - centre
    return arms.norm(dim=1).max() if len(arms) else centre.new_zeros(())


def area_vectors(corners: Tensor) -> Tensor:
    """Return (F, 3) normal times area; Z, Y, X components are left-handed, hence the sign."""
    return -cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def _has_atomics(device: torch.device) -> bool:
    """Whether a device adds points with atomics, which wait for each other on so small a grid."""
    return device.type == "cuda"


def _turned(phase: Tensor) -> Tensor:
    """Return exp(-i phase)."""
    return torch.polar(torch.ones_like(phase), -phase)


@cache
def nodes(error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the fewest shells t, with weights, that integrate t^2 exp(-ist) this accurately."""
    s = np.linspace(0, _LARGEST_PHASE, 50)[:, None]
    t, w = _gauss(16)
    exact = np.exp(-1j * s * t) @ w
    for n in range(1, 10):
        t, w = _gauss(n)
        if np.abs(np.exp(-1j * s * t) @ w - exact).max() < max(error, EXACT) / 3:
            break
    return t, w


def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Jacobi rule for the weight t^2 on 0..1."""
    x, w = roots_jacobi(n, 0, 2)
    return (x + 1) / 2, w / 8


def _low_band(band: Band, reach: float) -> Band:
    half = tuple(
        min(k, floor(NEAR / max(reach * s, 1e-300)))
        for k, s in zip(band.half, band.spacing, strict=True)
    )
    return Band(band.fft_shape, band.voxel_size, half)  # type: ignore[arg-type]


@lru_cache(maxsize=8)
def _one_by_one(count: int) -> Points:
    """Return the rule for elements that are points themselves."""
    return Points([(_POINT, np.arange(count))], count)


def _flux(
    plan: Plan, corners: np.ndarray, edges: np.ndarray, contrast: np.ndarray
) -> tuple[Points, Spreading, bool]:
    """Return points, grid and precision of the flux: those of the plan unless the solid is thin.

    The flux through opposite faces cancels but for their distance: errors relative to the surface
    are as many times larger relative to what lies inside. edges : (F, 3, 3) um along the axes.
    """
    assert plan.spreading is not None
    vectors = area_vectors(torch.from_numpy(corners)).numpy()
    middle = corners.reshape(-1, 3).mean(0) if len(corners) else np.zeros(3)
    volume = abs(float((((corners[:, 0] - middle) * vectors).sum(1) * contrast).sum())) / 3
    area = float((np.linalg.norm(vectors, axis=1) * np.abs(contrast)).sum())
    reach = [k * s for k, s in zip(plan.band.half, plan.band.spacing, strict=True)]
    # Cancellation at a third of the band's radius; beyond the cap there is hardly an inside.
    cancelled = min(area / max(volume * sum(reach) / 9, 1e-300), 1e8)
    if cancelled < _THICK or not area:
        return plan.quadrature_of(len(corners)), plan.spreading, plan.single
    tolerance = max(plan.tolerance / cancelled, 1e-13)
    single = plan.single and tolerance > 5e-6
    phases = np.linalg.norm(edges * np.asarray(reach), axis=2).max(1)
    # As if the OTF were flat over the band: rules finer and kernels wider than necessary.
    rules = choose_rules(phases, 1.0, max(RULE_SHARE * plan.accuracy / cancelled, 1e-12))
    points = Points(rules, len(corners))
    spreading = choose_spreading(
        plan.band.half, plan.band.spacing, flat, tolerance, points.count, single, dipoles=True
    )
    return points, spreading, single
