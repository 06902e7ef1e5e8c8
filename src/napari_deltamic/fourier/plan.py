"""Plan: band, method and quadrature rules for an accuracy, with expected error and time."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor, log, log2, prod, sqrt
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from .band import Band, band_error, threshold_for
from .closed_form import band_ft
from .nonuniform import points_ft
from .quadrature import Rule, choose_rules
from .triangle import cross

Method = Literal["closed form", "non-uniform"]

# Shares of the accuracy: the errors of band, quadrature and transform are independent and add in
# squares, so that together they use 95 % of it at most.
_BAND_SHARE, _RULE_SHARE, _TRANSFORM_SHARE = 0.7, 0.6, 0.2
# Below this accuracy rounding in single precision would show.
_SINGLE_ABOVE = 3e-5
# Below this one rounding in double precision shows, and only the closed form everywhere is left.
_EXACT_BELOW = 1e-13
# Cost of a forward and a backward pass per unit of work, in seconds on one core of 2024; relative
# sizes choose the method, absolute ones are a first guess of the time.
_SECONDS_PER_PAIR = {True: 4e-9, False: 1e-8}
_SECONDS_PER_POINT = {True: 4e-7, False: 8e-7}
_SECONDS_PER_MODE = {True: 1.1e-9, False: 3e-9}


@dataclass(frozen=True, eq=False)
class Plan:
    """How u_hat is computed on a band.

    Attributes
    ----------
    method
        ``"closed form"`` or ``"non-uniform"``.
    accuracy
        Requested relative L2 error of the rendered image; 0 is the closed form at every wavevector.
    expected_error, expected_seconds
        What the plan expects of one rendering with its gradient.
    """

    method: Method
    band: Band
    accuracy: float
    threshold: float
    single: bool
    tolerance: float
    rules: list[tuple[Rule, np.ndarray]] = field(repr=False)
    expected_error: float
    expected_seconds: float

    @property
    def points(self) -> int:
        """Quadrature points; 0 for the closed form."""
        return sum(len(r.weights) * len(f) for r, f in self.rules)

    def transform(self, vertices: Tensor, faces: Tensor, density: Tensor) -> Tensor:
        """u_hat on the box of the band, differentiable in vertices and density.

        ``vertices`` (V, 3) um relative to the centre of the grid's first voxel.
        """
        if self.method == "closed form":
            rows = band_ft(vertices, faces, density, self.band.rows, self.band.spacing, self.single)
            return self.band.to_box(rows)
        points, weights = quadrature_points(vertices, faces, density, self.rules)
        return points_ft(
            points, weights, self.band.half, self.band.spacing, self.tolerance, self.single
        )


def quadrature_points(
    vertices: Tensor, faces: Tensor, density: Tensor, rules: list[tuple[Rule, np.ndarray]]
) -> tuple[Tensor, Tensor]:
    """Points (M, 3) and weights (M,) = area x density x rule; differentiable."""
    corners = vertices.to(torch.float64)[faces]
    # Half a cross product's norm; its gradient is zero, not NaN, where the area is.
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mass = torch.linalg.vector_norm(normal, dim=1) / 2 * density
    points, weights = [], []
    for rule, where in rules:
        every = len(where) == len(faces)
        own = corners if every else corners[torch.from_numpy(where)]
        b = torch.from_numpy(rule.barycentric).to(corners.dtype)
        w = torch.from_numpy(rule.weights).to(corners.dtype)
        points.append((b @ own).reshape(-1, 3))
        m = mass if every else mass[torch.from_numpy(where)]
        weights.append((m[:, None] * w).reshape(-1))
    if len(points) == 1:
        return points[0], weights[0]
    return torch.cat(points), torch.cat(weights)


def make_plan(
    vertices: np.ndarray,
    faces: np.ndarray,
    fft_shape: tuple[int, int, int],
    voxel_size: tuple[float, float, float],
    width: tuple[float, float, float],
    accuracy: float,
    method: Method | None = None,
    margin: float = 1.0,
    aligned: bool = True,
) -> Plan:
    """Choose band, method and rules for an accuracy.

    Parameters
    ----------
    vertices, faces
        (V, 3) um, (F, 3).
    fft_shape, voxel_size
        The periodic grid; um.
    width
        um along Z, Y, X: the band at threshold t reaches ``sqrt(2 ln(1/t)) / width`` (for a
        Gaussian PSF, ``1 / sqrt(inverse covariance)``, which is sigma where it is diagonal).
    accuracy
        Relative L2 error of the rendered image; 0 for the closed form at every wavevector.
    method
        Forces a method; by default the cheaper one.
    margin
        Rules are chosen as if edges were longer by this factor (a mesh that is being fitted moves).
    aligned
        Whether the axes of the PSF are those of the grid; otherwise all of the box is computed.

    Raises
    ------
    InputError
        If the accuracy is negative, not a number, or 1 or more.
    """
    check_accuracy(accuracy)
    if method not in (None, "closed form", "non-uniform"):
        raise InputError(f"method must be 'closed form' or 'non-uniform', not {method!r}")
    if accuracy < _EXACT_BELOW:
        band = Band.full(fft_shape, voxel_size)
        time = prod(band.box_shape) * len(faces) * _SECONDS_PER_PAIR[False]
        return Plan("closed form", band, accuracy, 0.0, False, 0.0, [], 0.0, time)
    area, thin = _size(vertices / np.asarray(width), faces)
    threshold = threshold_for(_BAND_SHARE * accuracy, area, thin)
    radius = tuple(sqrt(2 * log(1 / threshold)) / w for w in width)
    band = Band.within(fft_shape, voxel_size, radius, aligned)  # type: ignore[arg-type]
    single = accuracy >= _SINGLE_ABOVE
    tolerance = max(_TRANSFORM_SHARE * accuracy, 1e-6 if single else 1e-14)
    rules = choose_rules(
        margin * _edge_phases(vertices, faces, radius, aligned), threshold, _RULE_SHARE * accuracy
    )
    points = sum(len(r.weights) * len(f) for r, f in rules)
    modes = prod(band.box_shape)
    seconds: dict[Method, float] = {
        "closed form": 0.75 * modes * len(faces) * _SECONDS_PER_PAIR[single],
        "non-uniform": points * _SECONDS_PER_POINT[single]
        + 8 * modes * log2(modes + 2) * _SECONDS_PER_MODE[single],
    }
    chosen = method if method is not None else min(seconds, key=lambda m: seconds[m])
    # The law of the band is that of a smooth surface; corners and edges were seen to add a sixth.
    error = min(accuracy, 1.2 * band_error(threshold, area, thin))
    if chosen == "closed form":
        return Plan(chosen, band, accuracy, threshold, single, 0.0, [], error, seconds[chosen])
    error = min(accuracy, float(np.hypot(np.hypot(error, _RULE_SHARE * accuracy), tolerance)))
    return Plan(chosen, band, accuracy, threshold, single, tolerance, rules, error, seconds[chosen])


def check_accuracy(accuracy: float) -> None:
    """InputError unless the accuracy is at least 0 and below 1."""
    if not 0 <= accuracy < 1:
        raise InputError(f"accuracy must be at least 0 and below 1, not {accuracy}")


def _size(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, bool]:
    """Area, and whether the mesh is thin (2 volume / area), in widths of the PSF."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(normal, axis=1).sum() / 2)
    centred = corners[:, 0] - vertices.mean(0)
    volume = abs(float(np.einsum("fi,fi->", centred, normal)) / 6)
    # Rounded down, to the safe side, so that the tables of one mesh serve its neighbours.
    steps = floor(2 * log2(max(area, 1e-6)))
    return 2.0 ** (steps / 2), 2 * volume < 1.5 * area


def _edge_phases(
    vertices: np.ndarray, faces: np.ndarray, radius: tuple[float, ...], aligned: bool
) -> np.ndarray:
    """(F,) largest phase along the longest edge of each face, anywhere in the band."""
    if not len(faces):
        return np.zeros(0)
    corners = vertices[faces] * np.asarray(radius)
    edges = np.abs(corners - np.roll(corners, 1, axis=1))
    phases = np.sqrt((edges**2).sum(-1)) if aligned else edges.sum(-1)
    return phases.max(1)
