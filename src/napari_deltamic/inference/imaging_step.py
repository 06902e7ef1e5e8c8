"""The other half of the staggered scheme: shape held, parameters of PSF and effects moved.

The paper takes Adam steps. Imaging has a handful of parameters and their images are cheap once the
mesh is transformed, so a damped Gauss-Newton step of all of them, amplitude and background
included, gets there in a few steps without a step size to tune.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..fourier.devices import widest
from ..optics import Optics
from ..scene import Renderer
from ..scene.effects import (
    Effect,
    Effects,
    GainEffect,
    OffsetEffect,
    TransferEffect,
)
from .level import Level, Voxels
from .likelihood import solve_scale

_DIFFERENCE = 1e-3  # of optics' parameters
_EFFECT_DIFFERENCE = 1e-2  # of effects', in units of their scale
_LARGEST = 0.15  # of one step of optics' parameters
_LARGEST_EFFECT = 1.0  # of effects'
_DAMPING = 1e-6

Transform = Callable[[Renderer], Tensor]  # of the present mesh and density


@dataclass(frozen=True)
class Imaging:
    """What is moved: the PSF, where it is fitted, and the effects whose numbers are."""

    optics: Optics
    effects: Effects
    fit_psf: bool

    @property
    def fitted(self) -> bool:
        """Whether there is anything to move."""
        return self.fit_psf or bool(self.effects.fitted())


def imaging_step(
    level: Level,
    renderer: Renderer,
    imaging: Imaging,
    transform: Transform,
    voxels: Voxels,
    start: Optics,
) -> tuple[Optics, Effects]:
    """Optics and effects after one damped Gauss-Newton step on the weighted least squares.

    The optics' parameters stay within the limits of those at the start, effects within their
    bounds: an image that tells nothing about the PSF, noise for example, would let it run to
    nothing or beyond the image.
    """
    with torch.no_grad():
        spectrum = transform(renderer)
        otf = renderer.otf(imaging.optics)
        image = voxels.of(level.rendered(renderer, spectrum, otf))
        a, b, _ = solve_scale(image, voxels.measured, voxels.weights)
        columns = [image, torch.ones_like(image)]
        n_optics = 0
        if imaging.fit_psf:
            columns += [
                a * voxels.of(level.rendered(renderer, spectrum, change))
                for change in _otf_changes(renderer, imaging.optics)
            ]
            n_optics = len(columns) - 2
        now = _Now(level, renderer, imaging, transform, spectrum, otf, voxels)
        fitted = imaging.effects.fitted()
        for effect in fitted:
            columns += effect_columns(now, effect, a, image)
        root, wide = torch.sqrt(voxels.weights), widest(image.device)
        jacobian = torch.stack([c * root for c in columns], 1).to(wide)
        residual = ((voxels.measured - a * image - b) * root).to(wide)
        held = torch.zeros(len(columns), 2, dtype=torch.bool)
        if fitted:
            held[2 + n_optics :] = torch.cat([torch.stack(e.at_bounds(), 1) for e in fitted])
        delta = _bounded_solution(jacobian, residual, held)
        if not bool(torch.isfinite(delta).all()):
            return imaging.optics, imaging.effects
        delta = delta[2:] * _share(delta[2:], n_optics, fitted)
        optics = imaging.optics
        if n_optics:
            low, high = start.limits()
            p = optics.parameters() + delta[:n_optics]
            optics = optics.with_parameters(p.clamp(low, high))
        moved: dict[str, Effect] = {}
        at = n_optics
        for effect in fitted:
            p = effect.parameters()
            moved[effect.name] = effect.with_parameters(p + delta[at : at + len(p)])
            at += len(p)
        return optics, imaging.effects.replace(**moved)


@dataclass(frozen=True)
class _Now:
    """Where the derivatives are taken."""

    level: Level
    renderer: Renderer
    imaging: Imaging
    transform: Transform
    spectrum: Tensor
    otf: Tensor
    voxels: Voxels


def effect_columns(now: _Now, effect: Effect, amplitude: float, image: Tensor) -> list[Tensor]:
    """(N,) derivatives of the measured image by each of the effect's parameters."""
    p = effect.parameters()
    columns = []
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = _EFFECT_DIFFERENCE
        # Where a bound is near, the difference is one-sided.
        up, down = effect.with_parameters(p + change), effect.with_parameters(p - change)
        width = float((up.parameters() - down.parameters())[i])
        columns.append(_difference(now, up, down, effect, amplitude, image) / width)
    return columns


def _difference(
    now: _Now, up: Effect, down: Effect, effect: Effect, amplitude: float, image: Tensor
) -> Tensor:
    """What the measured image changes by, from one value of an effect to another."""
    grid, frame, voxels = now.level.grid, now.level.frame, now.voxels
    if isinstance(effect, OffsetEffect):
        assert isinstance(up, OffsetEffect)
        assert isinstance(down, OffsetEffect)
        change = up.offset(grid, frame) - down.offset(grid, frame)
        return voxels.of(change.expand(grid.shape)).to(image.dtype)
    if isinstance(effect, GainEffect):
        assert isinstance(up, GainEffect)
        assert isinstance(down, GainEffect)
        ratio = (up.gain(grid, frame) - down.gain(grid, frame)) / effect.gain(grid, frame)
        return amplitude * image * voxels.of(ratio.expand(grid.shape)).to(image.dtype)
    ends = [
        now.renderer.with_effects(now.imaging.effects.replace(**{effect.name: e}))
        for e in (up, down)
    ]
    spectrum, otf = now.spectrum, now.otf
    if isinstance(effect, TransferEffect) or effect.name == "depth_psf":
        otf = ends[0].otf(now.imaging.optics) - ends[1].otf(now.imaging.optics)
    else:
        spectrum = now.transform(ends[0]) - now.transform(ends[1])
    return amplitude * voxels.of(now.level.rendered(now.renderer, spectrum, otf))


def _otf_changes(renderer: Renderer, optics: Optics) -> list[Tensor]:
    """Derivatives of the OTF by each parameter."""
    p = optics.parameters()
    changes = []
    for i in range(len(p)):
        change = torch.zeros_like(p)
        change[i] = _DIFFERENCE
        otf = renderer.otf(optics.with_parameters(p + change)) - renderer.otf(
            optics.with_parameters(p - change)
        )
        changes.append(otf / (2 * _DIFFERENCE))
    return changes


def _bounded_solution(jacobian: Tensor, residual: Tensor, held: Tensor) -> Tensor:
    """Least squares; parameters that would leave by the bound they are at are held.

    held : (P, 2) bool: whether a parameter is at its lower and at its upper bound.
    """
    # A handful of numbers, from wherever the images are.
    normal, right = (
        t.cpu().to(torch.float64) for t in (jacobian.T @ jacobian, jacobian.T @ residual)
    )
    diagonal = torch.diagonal(normal)
    # A column of zeros says nothing, and leaves its parameter where it is.
    damping = torch.where(diagonal > 0, _DAMPING * diagonal, 1.0)
    free = torch.ones(len(right), dtype=torch.bool)
    delta = torch.zeros_like(right)
    for _ in range(len(right)):
        own = free.nonzero()[:, 0]
        delta = torch.zeros_like(right)
        system = normal[own][:, own] + torch.diag(damping[own])
        delta[own] = torch.linalg.solve(system, right[own])
        leaves = (held[:, 0] & (delta < 0)) | (held[:, 1] & (delta > 0))
        if not bool(leaves.any()):
            break
        free &= ~leaves
    return delta


def _share(delta: Tensor, n_optics: int, fitted: tuple[Effect, ...]) -> float:
    """How much of a step to take: none of its parameters far."""
    largest = float(delta[:n_optics].abs().max()) / _LARGEST if n_optics else 0.0
    at = n_optics
    for effect in fitted:
        n = len(effect.parameters())
        if not isinstance(effect, OffsetEffect):  # in which the image is linear
            largest = max(largest, float(delta[at : at + n].abs().max()) / _LARGEST_EFFECT)
        at += n
    return min(1.0, 1.0 / max(largest, 1e-12))
